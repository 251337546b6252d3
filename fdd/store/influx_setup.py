"""Prepare an InfluxDB 2 server: buckets with retention, the downsampling task, tokens that can do only what they must.

    python -m fdd.store.influx_setup --url http://127.0.0.1:8086 --org plant --bucket hvac \\
        --admin-token-file admin.token --tokens tokens/

Running it again changes only what differs. It makes

* ``<bucket>``: what the daemon writes, kept for ``raw_days``;
* ``<bucket>_hourly``: hourly values for long spans, kept for ``hourly_days``, filled by a task;
* ``<bucket>_documents``: alarms, baselines and the like, kept for ever;
* ``daemon.token`` (reads and writes the first and third, reads the second) and ``grafana.token`` (reads all three).
"""

# mypy: disable-error-code="no-untyped-call"
# The client's management interface has no types.

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer
from influxdb_client.client.influxdb_client import InfluxDBClient
from influxdb_client.domain.authorization import Authorization
from influxdb_client.domain.bucket_retention_rules import BucketRetentionRules
from influxdb_client.domain.onboarding_request import OnboardingRequest
from influxdb_client.domain.permission import Permission
from influxdb_client.domain.permission_resource import PermissionResource
from influxdb_client.domain.task_create_request import TaskCreateRequest
from influxdb_client.rest import ApiException
from influxdb_client.service.setup_service import SetupService
from urllib3.exceptions import HTTPError

from fdd.store.influx import flux_text
from fdd.store.schema import MEASUREMENTS, StoreError
from fdd.store.store import StoreUnavailableError

RAW_DAYS = 730
HOURLY_DAYS = 3650


@dataclass(frozen=True, slots=True)
class Plan:
    """What to set up."""

    org: str
    bucket: str
    raw_days: int = RAW_DAYS
    hourly_days: int = HOURLY_DAYS

    @property
    def buckets(self) -> dict[str, int]:
        """Bucket to the days it keeps its points; 0 is for ever."""
        return {self.bucket: self.raw_days, self.hourly: self.hourly_days, f"{self.bucket}_documents": 0}

    @property
    def hourly(self) -> str:
        """The bucket of hourly values."""
        return f"{self.bucket}_hourly"

    @property
    def tokens(self) -> dict[str, tuple[tuple[str, str], ...]]:
        """Who may do what to which bucket."""
        documents = f"{self.bucket}_documents"
        return {
            "daemon": (
                ("read", self.bucket),
                ("write", self.bucket),
                ("read", self.hourly),
                ("read", documents),
                ("write", documents),
            ),
            "grafana": (("read", self.bucket), ("read", self.hourly), ("read", documents)),
        }


def downsampling(plan: Plan) -> str:
    """The Flux task. It does the last six hours again each time, so that late data count; the same key overwrites."""

    def part(function: str) -> str:
        tables = {m.name: [f.name for f in m.fields if f.hourly == function] for m in MEASUREMENTS.values()}
        alternatives = " or ".join(
            f'(r._measurement == "{name}" and ({" or ".join(f"r._field == {flux_text(f)}" for f in fields)}))'
            for name, fields in tables.items()
            if fields
        )
        return (
            f"raw |> filter(fn: (r) => {alternatives}) "
            f'|> aggregateWindow(every: 1h, fn: {function}, createEmpty: false, timeSrc: "_start") '
            f"|> to(bucket: {flux_text(plan.hourly)}, org: {flux_text(plan.org)})"
        )

    return "\n".join(
        [
            'import "date"',
            f"option task = {{name: {flux_text(f'fdd downsample {plan.bucket}')}, every: 1h, offset: 10m}}",
            "stop = date.truncate(t: now(), unit: 1h)",
            f"raw = from(bucket: {flux_text(plan.bucket)}) |> range(start: date.sub(from: stop, d: 6h), stop: stop)",
            *(part(function) for function in ("mean", "max", "last")),
        ]
    )


def onboard(url: str, org: str, bucket: str, username: str, password: str) -> str:
    """Set up a server that has never been used; returns the administrator's token.

    Raises
    ------
    StoreError : the server has been set up before
    """
    with InfluxDBClient(url, token="") as client:
        setup = SetupService(client.api_client)
        if not setup.get_setup().allowed:
            raise StoreError(f"InfluxDB at {url} has been set up before; give its administrator's token instead")
        request = OnboardingRequest(username, password, org, bucket)
        answer = setup.post_setup(onboarding_request=request)
        return str(answer.auth.token)


def set_up(
    url: str, admin_token: str, plan: Plan, tokens: Path, *, rotate: bool = False, mode: int = 0o600
) -> dict[str, Path]:
    """Make or update everything; returns the token files.

    ``rotate`` makes new tokens and revokes the old ones; ``mode`` is the token files' permission.

    Raises
    ------
    StoreError : the server refuses, with its reason
    StoreUnavailableError : it does not answer
    """
    try:
        with InfluxDBClient(url, token=admin_token, org=plan.org, timeout=30_000) as client:
            organisations = client.organizations_api().find_organizations(org=plan.org)
            if not organisations:
                raise StoreError(f"InfluxDB at {url} has no organisation {plan.org!r}")
            org_id = str(organisations[0].id)
            buckets = {name: _bucket(client, org_id, name, days) for name, days in plan.buckets.items()}
            _task(client, org_id, plan)
            return _tokens(client, org_id, plan, buckets, tokens, rotate=rotate, mode=mode)
    except ApiException as problem:
        said = str(problem.message or problem.reason)[:300]
        raise StoreError(f"InfluxDB at {url} refused the set-up ({problem.status}): {said}") from problem
    except HTTPError as problem:
        raise StoreUnavailableError(f"InfluxDB at {url} does not answer: {problem}") from problem


def _bucket(client: InfluxDBClient, org_id: str, name: str, days: int) -> str:
    rule = BucketRetentionRules(type="expire", every_seconds=days * 86_400)
    api = client.buckets_api()
    found = api.find_bucket_by_name(name)
    if found is None:
        found = api.create_bucket(bucket_name=name, org=org_id, retention_rules=rule)
    elif sum(r.every_seconds for r in found.retention_rules) != days * 86_400:
        found.retention_rules = [rule]
        api.update_bucket(found)
    return str(found.id)


def _task(client: InfluxDBClient, org_id: str, plan: Plan) -> None:
    api, flux = client.tasks_api(), downsampling(plan)
    found = api.find_tasks(name=f"fdd downsample {plan.bucket}")
    if not found:
        api.create_task(task_create_request=TaskCreateRequest(org_id=org_id, flux=flux, status="active"))
    elif found[0].flux != flux:
        found[0].flux = flux
        api.update_task(found[0])


def _tokens(
    client: InfluxDBClient, org_id: str, plan: Plan, buckets: dict[str, str], folder: Path, *, rotate: bool, mode: int
) -> dict[str, Path]:
    api = client.authorizations_api()
    folder.mkdir(parents=True, exist_ok=True)
    existing = api.find_authorizations()
    files = {}
    for who, rights in plan.tokens.items():
        description = f"fdd {who} {plan.bucket}"
        old = [a for a in existing if a.description == description]
        files[who] = folder / f"{who}.token"
        if old and files[who].is_file() and not rotate:
            continue
        permissions = [_permission(org_id, buckets[bucket], action) for action, bucket in rights]
        made = api.create_authorization(
            authorization=Authorization(org_id=org_id, description=description, permissions=permissions)
        )
        _write_secret(files[who], str(made.token), mode)
        for a in old:
            api.delete_authorization(a)
    return files


def _permission(org_id: str, bucket_id: str, action: str) -> Any:
    return Permission(action=action, resource=PermissionResource(type="buckets", id=bucket_id, org_id=org_id))


def _write_secret(path: Path, text: str, mode: int = 0o600) -> None:
    """Nobody else may read it, from the first byte on; the old one stands until the new one is whole."""
    part = path.with_suffix(".part")
    part.unlink(missing_ok=True)
    with os.fdopen(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "w") as file:
        file.write(text + "\n")
    part.chmod(mode)
    part.replace(path)


def main(
    url: Annotated[str, typer.Option(help="such as http://127.0.0.1:8086")],
    org: Annotated[str, typer.Option(help="organisation")],
    bucket: Annotated[str, typer.Option(help="bucket of the site")],
    tokens: Annotated[Path, typer.Option(help="folder for the token files")],
    admin_token_file: Annotated[Path | None, typer.Option(help="file with an administrator's token")] = None,
    admin_password_file: Annotated[
        Path | None, typer.Option(help="for a new server: file with the password of its user 'admin'")
    ] = None,
    raw_days: Annotated[int, typer.Option(help="days to keep what the daemon writes; 0: for ever")] = RAW_DAYS,
    hourly_days: Annotated[int, typer.Option(help="days to keep hourly values; 0: for ever")] = HOURLY_DAYS,
    rotate: Annotated[bool, typer.Option("--rotate", help="make new tokens and revoke the old ones")] = False,
    group_readable: Annotated[
        bool, typer.Option("--group-readable", help="let the folder's group read the token files, as containers need")
    ] = False,
) -> None:
    """Make the buckets, the downsampling task and the least-privilege tokens of a site."""
    try:
        if admin_token_file is not None and admin_token_file.is_file():
            token = admin_token_file.read_text().strip()
        elif admin_password_file is not None and admin_password_file.is_file():
            token = onboard(url, org, bucket, "admin", admin_password_file.read_text().strip())
            _write_secret(admin_token_file or tokens / "admin.token", token)
        else:
            raise StoreError(
                "give --admin-token-file, or for a new server --admin-password-file, naming a file that is there"
            )
        plan, mode = Plan(org, bucket, raw_days, hourly_days), 0o640 if group_readable else 0o600
        for who, path in set_up(url, token, plan, tokens, rotate=rotate, mode=mode).items():
            typer.echo(f"{who}: {path}")
    except StoreError as problem:
        typer.echo(str(problem), err=True)
        raise typer.Exit(1) from None


if __name__ == "__main__":
    typer.run(main)
