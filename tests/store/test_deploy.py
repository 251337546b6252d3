"""What stands in deploy/: the files fit together, and whatever this machine can run of them works."""

from __future__ import annotations

import os
import re
import shutil
import stat
import subprocess
import time
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from dashboards import settings
from dashboards.provisioning import data_source
from fdd.service.daemon import metrics
from fdd.service.daemon.metrics import MetricsServer
from fdd.store.store import StoreConfig
from tests.store.influxd import needed_influxd

ROOT = Path(__file__).resolve().parents[2]
DEPLOY = ROOT / "deploy"


def compose() -> dict[str, dict[str, dict[str, object]]]:
    tree: dict[str, dict[str, dict[str, object]]] = YAML(typ="safe").load((DEPLOY / "compose.yaml").read_text())
    return tree


def test_image_copies_what_is_there_and_does_not_run_as_root() -> None:
    text = (DEPLOY / "Dockerfile").read_text()
    sources = [line.split()[1] for line in text.splitlines() if line.startswith("COPY ") and "--" not in line]
    sources += re.findall(r"^COPY --chmod=\S+ (\S+)", text, re.M)
    assert "deploy/healthcheck.sh" in sources
    assert all((ROOT / s).exists() for s in sources), sources
    user = re.findall(r"^USER (\d+):", text, re.M)[-1]
    assert int(user) > 1000
    assert re.search(r"^HEALTHCHECK ", text, re.M)
    assert "--require-hashes" in text


def test_every_secret_that_compose_mounts_is_made_once_and_closed_to_others(tmp_path: Path) -> None:
    shutil.copy(DEPLOY / "secrets.sh", tmp_path)
    subprocess.run(["bash", tmp_path / "secrets.sh"], check=True, capture_output=True)
    wanted = {Path(str(s["file"])).name for s in compose()["secrets"].values()}
    made = {p.name: p.read_text() for p in (tmp_path / "secrets").iterdir()}
    assert set(made) == wanted
    assert all(len(text) >= 64 for text in made.values())
    assert len(set(made.values())) == len(made)
    assert stat.S_IMODE((tmp_path / "secrets").stat().st_mode) == 0o700
    assert f"fdd:{made['zenoh.password']}\n" in made["zenoh.users"]
    subprocess.run(["bash", tmp_path / "secrets.sh"], check=True, capture_output=True)
    assert {p.name: p.read_text() for p in (tmp_path / "secrets").iterdir()} == made


def test_no_secret_is_kept_in_the_repository() -> None:
    ignored = (DEPLOY / ".gitignore").read_text().split()
    assert {"secrets/", ".env"} <= set(ignored)


def test_compose_and_example_and_provisioning_agree_on_names() -> None:
    services = compose()["services"]
    example = (DEPLOY / "env.example").read_text()
    used = set(re.findall(r"\$\{(FDD_\w+)", (DEPLOY / "compose.yaml").read_text()))
    assert used == set(re.findall(r"^(FDD_\w+)=", example, re.M))
    source = data_source()["datasources"][0]
    wanted = set(re.findall(r"\$(FDD_\w+)", str(source))) | {"FDD_ALERT_WEBHOOK"}
    assert wanted <= set(services["grafana"]["environment"])  # type: ignore[call-overload]
    folder = str(Path(settings.TOKEN_FILE).parent)
    assert any(str(v).split(":")[1] == folder for v in services["grafana"]["volumes"])  # type: ignore[attr-defined]
    assert f"--tokens={folder}" in services["setup"]["command"]  # type: ignore[operator]
    site = YAML(typ="safe").load((DEPLOY / "site" / "site.example.yaml").read_text())
    assert StoreConfig.of(site["store"]).token_file == Path(folder) / "daemon.token"
    assert site["sources"][0]["password_file"].endswith("/zenoh.password")


def test_every_service_is_hardened_or_says_why_not() -> None:
    for name, service in compose()["services"].items():
        if name != "influxdb":  # its image starts as root to hand its folders to its own user
            assert service["cap_drop"] == ["ALL"], name
            assert service["read_only"] is True, name
        published = service.get("ports", [])
        assert all(re.match(r"\$\{FDD_\w+_BIND:-127\.0\.0\.1\}:", str(p)) for p in published), name  # type: ignore[attr-defined]


def test_healthcheck_passes_only_while_the_journal_is_young(tmp_path: Path) -> None:
    def healthy() -> bool:
        environment = {**os.environ, "FDD_STATE": str(tmp_path), "FDD_SILENT_MINUTES": "10"}
        return subprocess.run([DEPLOY / "healthcheck.sh"], env=environment, capture_output=True).returncode == 0

    assert not healthy()
    state = tmp_path / "north.state.sqlite-wal"
    state.touch()
    assert healthy()
    old = time.time() - 660
    os.utime(state, (old, old))
    assert not healthy()


def test_healthcheck_asks_the_health_endpoint_where_there_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    def healthy(port: int) -> bool:
        environment = {**os.environ, "FDD_HEALTH": f"http://127.0.0.1:{port}/health"}
        return subprocess.run([DEPLOY / "healthcheck.sh"], env=environment, capture_output=True).returncode == 0

    server = MetricsServer(("127.0.0.1", 0))
    try:
        assert healthy(server.address[1])
        monkeypatch.setattr(metrics, "STALE_SECONDS", 0.0)
        assert not healthy(server.address[1])
    finally:
        server.close()
    assert not healthy(server.address[1])
    site = YAML(typ="safe").load((DEPLOY / "site" / "site.example.yaml").read_text())
    assert compose()["services"]["daemon"]["environment"] == {"FDD_HEALTH": f"http://{site['metrics']}/health"}


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="no systemd here")
@pytest.mark.parametrize("unit", ["hvac-fdd", "influxd-fdd"])
def test_systemd_accepts_the_unit(unit: str, tmp_path: Path) -> None:
    text = (DEPLOY / "systemd" / f"{unit}.service").read_text()
    # The programs and users of an installed service are not on this machine.
    text = re.sub(r"^ExecStart=\S+", f"ExecStart={shutil.which('true')}", text, flags=re.M)
    text = re.sub(r"^(User|Group)=.*\n", "", text, flags=re.M)
    text = text.replace("/opt/hvac-fdd/docs", str(ROOT / "docs"))
    path = tmp_path / f"{unit}.service"
    path.write_text(text)
    done = subprocess.run(["systemd-analyze", "verify", "--man=no", path], capture_output=True, text=True, timeout=60)
    complaints = [line for line in (done.stdout + done.stderr).splitlines() if path.name in line]
    assert complaints == []
    path.write_text(text.replace("Restart=on-failure", "Restart=sometimes"))
    wrong = subprocess.run(["systemd-analyze", "verify", "--man=no", path], capture_output=True, text=True, timeout=60)
    assert path.name in wrong.stdout + wrong.stderr


def test_influxd_unit_uses_options_that_the_server_knows() -> None:
    known = subprocess.run([needed_influxd(), "run", "--help"], capture_output=True, text=True).stdout
    used = re.findall(r"--([\w-]+)", (DEPLOY / "systemd" / "influxd-fdd.service").read_text())
    assert used
    assert all(f"--{option} " in known for option in used)


def compose_command() -> list[str]:
    """Compose as built by deploy/compose-check, as a plugin of the client, or on its own."""
    cache = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hvac-fdd" / "compose"
    built = [[str(p)] for p in sorted(cache.glob("docker-compose-*[0-9]"))]
    for command in [*built[-1:], ["docker", "compose"], ["docker-compose"]]:
        if shutil.which(command[0]) and subprocess.run([*command, "version"], capture_output=True).returncode == 0:
            return command
    pytest.skip("no docker compose here: run deploy/compose-check/build.sh")


@pytest.mark.integration
def test_compose_accepts_the_file_and_refuses_a_missing_setting(tmp_path: Path) -> None:
    command = [*compose_command(), "-f", str(DEPLOY / "compose.yaml"), "--env-file"]
    done = subprocess.run([*command, str(DEPLOY / "env.example"), "config"], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert set(YAML(typ="safe").load(done.stdout)["services"]) == set(compose()["services"])
    (tmp_path / "env").write_text("FDD_ORG=plant\nFDD_BUCKET=hvac\n")
    missing = subprocess.run([*command, str(tmp_path / "env"), "config"], capture_output=True, text=True, timeout=60)
    assert missing.returncode != 0
    assert "FDD_ALERT_WEBHOOK" in missing.stderr
