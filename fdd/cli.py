"""The command ``fdd``: every verb, what it prints, and how it fails."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, cast

# Before numpy is loaded: its threads fight over small matrices, and cost orders of magnitude on a busy machine.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import typer
from rich.console import Console
from rich.table import Table

from fdd import __version__

app = typer.Typer(
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Fault detection and diagnosis for installed HVAC plant.",
)
screen = Console(stderr=True)
out = Console()

SiteFile = Annotated[Path, typer.Argument(help="Site file (YAML).", show_default=False)]
DataFile = Annotated[Path | None, typer.Argument(help="CSV or Parquet file; default: the site's own sources.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON object, for machines.")]
Since = Annotated[
    str | None, typer.Option("--from", help="Leave out what is before this time (ISO 8601, site's zone).")
]
Until = Annotated[str | None, typer.Option("--until", help="Leave out what is at or after this time.")]


def example(*lines: str) -> str:
    """The example every verb's help ends with."""
    return "[bold]Example[/bold]\n\n" + "\n\n".join(f"$ {line}" for line in lines)


@app.callback(help="Fault detection and diagnosis for installed HVAC plant.")
def quiet_log() -> None:
    """Verbs speak for themselves: of the service's log only warnings, on stderr; ``fdd run`` says all."""
    import logging

    import structlog

    structlog.configure(
        wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING),
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),
    )


def _print_json(value: Any) -> None:
    print(json.dumps(value, default=str))


@app.command(epilog=example("fdd demo", "fdd demo --fault none --seed 3 --json"))
def demo(
    fault: Annotated[str, typer.Option(help="fouling, air, sludge, bias or none.")] = "fouling",
    seed: Annotated[int, typer.Option(help="Seed of weather, noise and faults.")] = 1,
    weeks: Annotated[int, typer.Option(help="Weeks of plant time that are watched, after three of learning.")] = 4,
    folder: Annotated[Path, typer.Option(help="Where the site file, the store and the report go.")] = Path("var/demo"),
    store_kind: Annotated[
        str,
        typer.Option("--store", help="sqlite, or influx: FDD_INFLUX_URL, _ORG, _BUCKET and _TOKEN say where."),
    ] = "sqlite",
    as_json: AsJson = False,
) -> None:
    """Simulate a plant with a fault, stream it over Zenoh into the daemon, raise the alarm, write the report."""
    from fdd.service.verbs.demo import run_demo

    result = run_demo(fault=fault, seed=seed, weeks=weeks, folder=folder, console=screen, store_kind=store_kind)
    if as_json:
        _print_json(result.document())
        return
    out.print(result.story(), soft_wrap=True)


@app.command(epilog=example("fdd init export/ --out plant.yaml", "fdd init trend.csv model.ttl --zone Europe/Paris"))
def init(
    exports: Annotated[
        list[Path],
        typer.Argument(help="Files or folders: CSV, workbook, Parquet, Haystack (JSON, Zinc), Brick (Turtle)."),
    ],
    out_file: Annotated[Path, typer.Option("--out", help="Where the site file goes.")] = Path("site.yaml"),
    name: Annotated[str | None, typer.Option(help="Name of the site; default: the export's.")] = None,
    zone: Annotated[str | None, typer.Option(help="Time zone of local times, such as Europe/Copenhagen.")] = None,
    force: Annotated[bool, typer.Option(help="Write over a site file that is there.")] = False,
    as_json: AsJson = False,
) -> None:
    """Draft a site file from an export: times, units, quantities and roles, and how sure each guess is."""
    from fdd.onboarding.init import start
    from fdd.service.site.errors import UsageError

    if out_file.exists() and not force:
        raise UsageError(f"{out_file} is there already; name another with --out, or write over it with --force")
    asks = sys.stdin.isatty() and sys.stdout.isatty() and not as_json
    started = start(exports, out_file, name=name, zone=zone, ask=_ask if asks else None)
    if as_json:
        _print_json(started.document())
    else:
        started.print(out)
    raise typer.Exit(1 if started.errors else 0)


def _ask(question: str, guessed: str, others: Sequence[str]) -> str:
    choices = f" [{', '.join(others)}]" if others else ""
    return str(typer.prompt(f"{question}{choices}", default=guessed, err=True))


@app.command(epilog=example("fdd check plant.yaml", "fdd check plant.yaml history.csv --html data.html"))
def check(
    site_file: SiteFile,
    data: DataFile = None,
    html: Annotated[Path | None, typer.Option(help="Write a page about the data here, with a picture.")] = None,
    as_json: AsJson = False,
) -> None:
    """Check a site file and the quality of its data, without network; exit code 3 where most of the data is lost."""
    from fdd.service.verbs.check import check_all

    result = check_all(site_file, data, html)
    if as_json:
        _print_json(result.document())
    else:
        result.print(out)
    raise typer.Exit(result.exit_code)


@app.command(epilog=example("fdd fit plant.yaml history.csv --until 2026-03-01"))
def fit(
    site_file: SiteFile,
    data: DataFile = None,
    since: Since = None,
    until: Until = None,
    only: Annotated[list[str] | None, typer.Option(help="Fit this equipment only; may be repeated.")] = None,
    starts: Annotated[int, typer.Option(help="Searches for the best fit, from scattered starts.", min=1)] = 3,
    html: Annotated[Path | None, typer.Option(help="Write the validation report here.")] = None,
    as_json: AsJson = False,
) -> None:
    """Fit baselines by maximum likelihood to a healthy history, and put them in force."""
    from fdd.service.baselines.fitting import fit_site

    fitted = fit_site(site_file, data, since=since, until=until, only=only, html=html, starts=starts, console=screen)
    if as_json:
        _print_json(
            {"baselines": [asdict(f.baseline) for f in fitted], "warnings": [w for f in fitted for w in f.warnings]}
        )
        return
    for item in fitted:
        out.print(item.summary(), highlight=False, markup=False, soft_wrap=True)


@app.command(epilog=example("fdd chiller plant.yaml history.csv --until 2026-03-01 --html chiller.html"))
def chiller(
    site_file: SiteFile,
    data: DataFile = None,
    since: Since = None,
    until: Annotated[
        str | None, typer.Option(help="End of the healthy period that the rest is compared with (ISO 8601).")
    ] = None,
    only: Annotated[list[str] | None, typer.Option(help="Study this chiller only; may be repeated.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write the study with its plots here.")] = None,
    as_json: AsJson = False,
) -> None:
    """Study a site's chillers: points kept, estimates side by side with intervals, charts, and a verdict."""
    from fdd.service.verbs.chiller_study import study_site

    studies = study_site(site_file, data, since=since, until=until, only=only, html=html, console=screen)
    if as_json:
        _print_json({"chillers": [s.document() for s in studies]})
        return
    for item in studies:
        item.print(out)


@app.command(epilog=example("fdd replay plant.yaml history.csv --from 2026-03-01", "fdd replay plant.yaml --json"))
def replay(
    site_file: SiteFile,
    data: DataFile = None,
    since: Since = None,
    until: Until = None,
    verdicts: Annotated[Path | None, typer.Option(help="Write every verdict here, a JSON line each.")] = None,
    store: Annotated[
        bool, typer.Option("--store", help="Keep all in the site's store: alarms, explain, ack and report work on it.")
    ] = False,
    as_json: AsJson = False,
) -> None:
    """Run the engine over history, exactly as the daemon would have; print the alarms."""
    from fdd.service.verbs.replay import replay_site

    result = replay_site(site_file, data, since=since, until=until, verdicts=verdicts, console=screen, store=store)
    if as_json:
        _print_json(result.document())
    else:
        result.print(out)


@app.command(
    epilog=example(
        "fdd audit plant.yaml healthy.csv --from 2026-03-01",
        "fdd audit plant.yaml healthy.csv --fit-until 2026-03-01 --json",
    )
)
def audit(
    site_file: SiteFile,
    data: DataFile = None,
    fit_until: Annotated[
        str | None,
        typer.Option("--fit-until", help="Fit to what is before this time first, for this audit alone (ISO 8601)."),
    ] = None,
    since: Since = None,
    until: Until = None,
    as_json: AsJson = False,
) -> None:
    """Check the promise of false alarms on a healthy record: alarms that came, of those promised, by chart.

    Every alarm is cleared after a day, so that one that stands hides no others. Alarms on a record with faults are not
    false: give it one that is known to be healthy.
    """
    from fdd.service.verbs.audit import audit_site

    found, opened = audit_site(site_file, data, fit_until=fit_until, since=since, until=until, console=screen)
    if as_json:
        _print_json(found.document())
    else:
        found.print(out, opened.local)


@app.command(epilog=example("fdd study plant.yaml", "fdd study plant.yaml history.csv --until 2026-03-01 --out r.html"))
def study(
    site_file: SiteFile,
    data: DataFile = None,
    until: Annotated[
        str | None,
        typer.Option(help="End of the healthy part that is learned from; default: half, 28 days at most."),
    ] = None,
    out_file: Annotated[Path, typer.Option("--out", help="Where the report goes.")] = Path("report.html"),
    pdf: Annotated[Path | None, typer.Option(help="Where a PDF goes.")] = None,
    starts: Annotated[int, typer.Option(help="Searches for the best fit, from scattered starts.", min=1)] = 3,
    anyway: Annotated[bool, typer.Option("--anyway", help="Go on where most of the data is lost.")] = False,
    as_json: AsJson = False,
) -> None:
    """Check, fit, replay and report in one go; alarms, explain, ack, clear and report work on it afterwards."""
    from fdd.service.verbs.study import MostlyLostError, study_site

    try:
        found = study_site(
            site_file, data, until=until, out=out_file, pdf=pdf, starts=starts, anyway=anyway, console=screen
        )
    except MostlyLostError as error:
        screen.print(f"[bold red]error:[/bold red] {error}", highlight=False, soft_wrap=True)
        raise typer.Exit(3) from None
    if as_json:
        _print_json(found.document())
    else:
        found.print(out)


@app.command(epilog=example("fdd run plant.yaml"))
def run(
    site_file: SiteFile,
    until_end: Annotated[bool, typer.Option(help="Stop when the sources say that their stream has ended.")] = False,
    fresh: Annotated[bool, typer.Option(help="Forget the saved state and start afresh.")] = False,
) -> None:
    """Run the daemon: take samples from the site's sources until told to stop (Ctrl-C, SIGTERM)."""
    from fdd.service.daemon.run import run_site

    run_site(site_file, until_end=until_end, fresh=fresh)


alarms = typer.Typer(no_args_is_help=False, help="List alarms, and say what was done about them.")
app.add_typer(alarms, name="alarms", epilog=example("fdd alarms list plant.yaml", "fdd alarms ack plant.yaml hx.1"))

Key = Annotated[
    str, typer.Argument(metavar="ALARM", help="Handle of the alarm, as `fdd alarms list` prints it, or its key.")
]
Comment = Annotated[str, typer.Option(help="What was seen or done.")]
By = Annotated[str, typer.Option(help="Who says so.")]
USER = os.environ.get("USER", "operator")


@alarms.command("list", epilog=example("fdd alarms list plant.yaml", "fdd alarms list plant.yaml --all --json"))
def alarms_list(
    site_file: SiteFile,
    every: Annotated[bool, typer.Option("--all", help="Cleared alarms too.")] = False,
    as_json: AsJson = False,
) -> None:
    """List open alarms, newest last."""
    from fdd.service.verbs.operate import read_alarms

    found = read_alarms(site_file, every=every)
    if as_json:
        _print_json({"alarms": found})
        return
    if not found:
        out.print("No open alarms.")
    for a in found:
        head = f"{a['handle']}  {a['state']}, {a['severity']}, raised {a['raised_local']}, since {a['since_local']}"
        out.print(f"{head}\n  {a['summary']}", highlight=False, markup=False, soft_wrap=True)


@alarms.command("ack", epilog=example('fdd alarms ack plant.yaml hx.1 --comment "on my way"'))
def alarms_ack(site_file: SiteFile, key: Key, comment: Comment = "", by: By = USER) -> None:
    """Acknowledge an alarm: somebody has seen it."""
    from fdd.service.verbs.operate import command

    out.print(command(site_file, key, "acknowledge", by, comment))


@alarms.command("shelve", epilog=example("fdd alarms shelve plant.yaml hx.1 --for '3 d'"))
def alarms_shelve(
    site_file: SiteFile,
    key: Key,
    span: Annotated[str, typer.Option("--for", help="How long, such as '3 d' or '8 h'.")],
    comment: Comment = "",
    by: By = USER,
) -> None:
    """Hide an alarm for a time that has an end."""
    from fdd.service.verbs.operate import command

    out.print(command(site_file, key, "shelve", by, comment, span=span))


@alarms.command("clear", epilog=example('fdd alarms clear plant.yaml hx.1 --comment "plates cleaned"'))
def alarms_clear(site_file: SiteFile, key: Key, comment: Comment = "", by: By = USER) -> None:
    """Close an alarm; its charts start again, so a fault that is still there rings again."""
    from fdd.service.verbs.operate import command

    out.print(command(site_file, key, "clear", by, comment))


@alarms.command("history", epilog=example("fdd alarms history plant.yaml", "fdd alarms history plant.yaml KEY --json"))
def alarms_history(
    site_file: SiteFile,
    key: Annotated[str | None, typer.Argument(help="Of one alarm alone.")] = None,
    as_json: AsJson = False,
) -> None:
    """What people asked of alarms and of the service, and what became of it: the audit trail."""
    from fdd.service.verbs.listing import show
    from fdd.service.verbs.operate import history

    found = history(site_file, key)
    if as_json:
        _print_json({"history": found})
        return
    rows = []
    for line in found:
        when = datetime.fromtimestamp(line["wall"], UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        said = {k: line.get(k, "") for k in ("who", "through", "alarm", "outcome", "comment")}
        rows.append({"line": line["line"], "when": when, "what": line["what"], **said})
    show(rows, out)
    if not found:
        out.print("Nobody has asked anything yet.")


@alarms.command("verify", epilog=example("fdd alarms verify plant.yaml"))
def alarms_verify(site_file: SiteFile) -> None:
    """Check that the audit trail was not changed or cut short since the daemon wrote it."""
    from fdd.service.verbs.operate import verify_history

    out.print(verify_history(site_file), soft_wrap=True)


@app.command("turn-back", epilog=example("fdd turn-back plant.yaml --to now"))
def turn_back(
    site_file: SiteFile,
    to: Annotated[str, typer.Option(help="When event time goes on: 'now', or a time in the site's zone.")] = "now",
    by: By = USER,
) -> None:
    """Set event time back after a clock was wrong: filters start afresh, charts, alarms and baselines stand."""
    from fdd.service.verbs.operate import turn_back as ask

    out.print(ask(site_file, to, by), soft_wrap=True)


@app.command(
    epilog=example("fdd score plant.yaml history.csv labels.csv", "fdd score plant.yaml h.csv l.csv --html s.html")
)
def score(
    site_file: SiteFile,
    data: Annotated[Path, typer.Argument(help="CSV or Parquet file.", show_default=False)],
    labels: Annotated[Path, typer.Argument(help="CSV: component,fault,start,end,severity.", show_default=False)],
    settle: Annotated[str, typer.Option(help="After a fault's end, when its alarm may still stand: '2 d'.")] = "0 s",
    html: Annotated[Path | None, typer.Option(help="Write a page with plots here.")] = None,
    as_json: AsJson = False,
) -> None:
    """Score the alarms against known faults: right and wrong, found and missed, how soon, rightly named."""
    from fdd.service.verbs.scoring import score_site
    from fdd.units import seconds

    found = score_site(site_file, data, labels, settle=seconds(settle), console=screen)
    if html:
        found.write(html)
    if as_json:
        _print_json(found.document())
        return
    found.print(out)
    if html:
        screen.print(f"page: {html}")


charts = typer.Typer(no_args_is_help=True, help="Control charts: their limits, and how soon they find what.")
app.add_typer(charts, name="charts", epilog=example("fdd charts design --kind cusum --per-year 1 --interval '5 min'"))


@charts.command("design", epilog=example("fdd charts design", "fdd charts design --kind ewma --plot delay.svg"))
def charts_design(
    kind: Annotated[list[str] | None, typer.Option(help="cusum, ewma, mewma, shewhart; may be repeated.")] = None,
    per_year: Annotated[float, typer.Option(help="False alarms a year of one chart.")] = 1.0,
    interval: Annotated[list[str] | None, typer.Option(help="Time between samples: '5 min'; may be repeated.")] = None,
    k: Annotated[float, typer.Option(help="Reference value of a CUSUM.")] = 0.5,
    lam: Annotated[float, typer.Option(help="Weight of the newest value, EWMA and MEWMA.")] = 0.1,
    baseline: Annotated[int | None, typer.Option(help="Samples of the baseline; widens the limit.")] = None,
    availability: Annotated[float, typer.Option(help="Share of the year with samples.")] = 1.0,
    plot: Annotated[Path | None, typer.Option(help="Write delay against shift here: .svg, .png or .pdf.")] = None,
    html: Annotated[Path | None, typer.Option(help="Write a page with table and plot here.")] = None,
    as_json: AsJson = False,
) -> None:
    """Limits for a promised rate of false alarms, and how soon a shift is then found."""
    from fdd.residual_monitors.design import design_plot, duration, quantile_table
    from fdd.residual_monitors.run_length import Kind
    from fdd.service.verbs.chart_design import designs, document, write_design_page
    from fdd.units import seconds

    every = [seconds(text) for text in interval or ["5 min"]]
    found = designs(
        cast(list[Kind], kind or ["cusum"]), per_year, every, baseline=baseline, availability=availability, k=k, lam=lam
    )
    if plot:
        design_plot(found, plot)
    if html:
        write_design_page(found, html)
    if as_json:
        _print_json(document(found))
        return
    for d in found:
        head, rows = quantile_table(d)
        title = (
            f"{d.name}, every {duration(d.interval)}, {d.false_alarms_per_year:g} false alarms a year: time to an alarm"
        )
        table = Table(*head, title=title, title_justify="left", box=None)
        for row in rows:
            table.add_row(*row)
        out.print(table, soft_wrap=True)
    for path in (plot, html):
        if path:
            screen.print(f"written: {path}")


@app.command(epilog=example("fdd explain plant.yaml hx.1"))
def explain(site_file: SiteFile, key: Key, as_json: AsJson = False) -> None:
    """Show the evidence behind one alarm."""
    from fdd.service.verbs.explain import explain as explained
    from fdd.service.verbs.explain import story

    alarm = explained(site_file, key)
    if as_json:
        _print_json(alarm)
    else:
        out.print(story(site_file, alarm), highlight=False, markup=False, soft_wrap=True)


@app.command(
    epilog=example(
        "fdd report plant.yaml --out report.html --pdf report.pdf",
        "fdd report plant.yaml --period monthly --findings findings.json --findings findings.csv",
    )
)
def report(
    site_file: SiteFile,
    out_file: Annotated[Path, typer.Option("--out", help="Where the HTML goes.")] = Path("report.html"),
    pdf: Annotated[Path | None, typer.Option(help="Where a PDF goes.")] = None,
    findings: Annotated[list[Path] | None, typer.Option(help="Findings as .json or .csv; may be repeated.")] = None,
    period: Annotated[str, typer.Option(help="weekly or monthly, where --from is not given.")] = ("weekly"),
    pages: Annotated[bool, typer.Option(help="A page KEY.html beside it for each alarm, for links.")] = True,
    language: Annotated[str | None, typer.Option(help="Of the findings: en or da; the site file's by default.")] = None,
    since: Since = None,
    until: Until = None,
) -> None:
    """Write the technician's report from what the store holds."""
    from fdd.service.site.errors import UsageError
    from fdd.service.verbs.reporting import PERIODS, report_site

    if period not in PERIODS:
        raise UsageError(f"--period is {period!r}; give weekly or monthly")
    written = report_site(
        site_file,
        out_file,
        pdf=pdf,
        findings=findings or (),
        period=period,
        pages=pages,
        language=language,
        since=since,
        until=until,
    )
    for path in written:
        out.print(str(path), soft_wrap=True)


@app.command(epilog=example("fdd reidentify plant.yaml", "fdd reidentify plant.yaml --only hx --propose --json"))
def reidentify(
    site_file: SiteFile,
    only: Annotated[list[str] | None, typer.Option(help="This equipment only; may be repeated.")] = None,
    until: Until = None,
    days: Annotated[float, typer.Option(help="How many days the history reaches back.", min=1.0)] = 28.0,
    propose: Annotated[bool, typer.Option("--propose", help="Keep what passes for a person to approve.")] = False,
    as_json: AsJson = False,
) -> None:
    """Fit baselines anew from the store; put in force what passes every gate, and never learn a fault."""
    from fdd.service.baselines.reidentify import reidentify_site

    found = reidentify_site(site_file, only=only, until=until, days=days, propose_only=propose, console=screen)
    if as_json:
        _print_json(found.document())
    else:
        found.print(out)


@app.command(epilog=example("fdd learn plant.yaml", "fdd learn plant.yaml --json"))
def learn(site_file: SiteFile, until: Until = None, as_json: AsJson = False) -> None:
    """Fit first baselines to what the daemon has recorded, where there is enough; it does so itself once a day."""
    from fdd.service.baselines.learn import learn_site

    found = learn_site(site_file, until=until)
    if as_json:
        _print_json({"learning": [f.document() for f in found]})
        return
    for each in found:
        out.print(each.words, highlight=False, markup=False, soft_wrap=True)
    if not found:
        out.print("Everything has a baseline.")


@app.command(epilog=example("fdd baselines plant.yaml", "fdd baselines plant.yaml --rollback hx 1"))
def baselines(
    site_file: SiteFile,
    rollback: Annotated[
        tuple[str, int] | None, typer.Option(help="Put this version of this equipment in force again.")
    ] = None,
    approve: Annotated[tuple[str, int] | None, typer.Option(help="Put this version in force and vouch for it.")] = None,
    by: By = USER,
    as_json: AsJson = False,
) -> None:
    """List the baselines that were kept; roll back to one, or approve one."""
    from fdd.service.baselines.revisions import change_baseline, list_baselines
    from fdd.service.verbs.listing import show

    if rollback or approve:
        said = change_baseline(site_file, rollback=rollback, approved=approve, by=by)
        if not as_json:
            out.print(said, soft_wrap=True)
    found = list_baselines(site_file)
    if as_json:
        _print_json({"baselines": found})
        return
    keys = ("component", "version", "status", "from", "until", "samples", "reason")
    show([{k: b[k] for k in keys} for b in found], out)


@app.command(epilog=example("fdd experiment house.yaml house --move 'P_heat=0:5 kW' --days 6 --out prbs.csv"))
def experiment(
    site_file: SiteFile,
    equipment: Annotated[str, typer.Argument(help="Which equipment to learn about.", show_default=False)],
    move: Annotated[list[str], typer.Option(help="An input that may be moved: INPUT=LOW:HIGH[:LEVELS] UNIT.")],
    days: Annotated[float, typer.Option(help="Length of the experiment.")] = 6.0,
    dwell: Annotated[str, typer.Option(help="Shortest time at a level.")] = "30 min",
    out_file: Annotated[Path, typer.Option("--out", help="Where the schedule goes; the plot beside it.")] = Path(
        "experiment.csv"
    ),
    count: Annotated[int, typer.Option(help="Candidate designs to compare.", min=1)] = 12,
) -> None:
    """Propose an experiment: a pseudo-random schedule that makes the parameters most visible."""
    from fdd.service.verbs.experiments import propose

    found = propose(site_file, equipment, move, days=days, dwell=dwell, out=out_file, count=count, console=screen)
    out.print(found.story(), highlight=False, markup=False, soft_wrap=True)


store = typer.Typer(no_args_is_help=True, help="Copy what a site's store holds.")
app.add_typer(store, name="store", epilog=example("fdd store migrate old.yaml new.yaml"))


@store.command("migrate", epilog=example("fdd store migrate sqlite-site.yaml influx-site.yaml"))
def store_migrate(
    site_file: SiteFile, target: Annotated[Path, typer.Argument(help="Site file whose store is written to.")]
) -> None:
    """Copy everything to the store that another site file names; an interrupted copy is started again."""
    from fdd.service.verbs.storage import migrate_site

    out.print(migrate_site(site_file, target, screen), soft_wrap=True)


@store.command("export", epilog=example("fdd store export plant.yaml analysis/ --from 2026-01-01"))
def store_export(
    site_file: SiteFile,
    folder: Annotated[Path, typer.Argument(help="Where the files go.")],
    since: Since = None,
    until: Until = None,
) -> None:
    """Write Parquet for analysis: a file for each measurement, and JSON for each kind of document."""
    from fdd.service.verbs.storage import export_site

    for path in export_site(site_file, folder, screen, since=since, until=until):
        out.print(str(path), soft_wrap=True)


@app.command(epilog=example("fdd status plant.yaml", "fdd status plant.yaml --json"))
def status(site_file: SiteFile, as_json: AsJson = False) -> None:
    """Say how the service stands: samples, lag, charts, baselines, jobs, open alarms."""
    from fdd.service.verbs.status import print_status, read_status

    found = read_status(site_file)
    if as_json:
        _print_json(found)
    else:
        print_status(found, out)
    raise typer.Exit(0 if found["state"] == "running" else 1)


@app.command(epilog=example("fdd models", "fdd models radiator"))
def models(
    name: Annotated[str | None, typer.Argument(help="One model: its equations' quantities and parameters.")] = None,
    as_json: AsJson = False,
) -> None:
    """List the component models, or show one."""
    from fdd.service.verbs.catalogue import catalogue, describe
    from fdd.service.verbs.listing import show

    if name is None:
        rows = catalogue()
        if as_json:
            _print_json({"models": rows})
            return
        show([{k: row[k] for k in ("name", "title", "inputs", "outputs", "options")} for row in rows], out)
        return
    document = describe(name)
    if as_json:
        _print_json(document)
        return
    out.print(f"[bold]{document['title']}[/bold]  (model {name}, version {document['version']})")
    for part in ("states", "inputs", "outputs", "parameters", "faults"):
        show(document[part], out, part)
    for reference in document["references"]:
        out.print(reference)


@app.command()
def version() -> None:
    """Print the version."""
    out.print(__version__)


def main() -> None:
    """Run a verb.

    Every exception class of the project is written for its users: it is printed without a traceback, exit code 1.
    What is logged goes to stderr: with --json, stdout is one object and nothing else.
    """
    import structlog

    structlog.configure(logger_factory=structlog.PrintLoggerFactory(sys.stderr))
    if "FDD_PARENT" in os.environ:
        from fdd.service.daemon.parent import end_with_parent

        end_with_parent()
    try:
        app(standalone_mode=True)
    except Exception as error:
        if type(error).__module__.partition(".")[0] not in ("fdd", "ingest"):
            raise
        screen.print("[bold red]error:[/bold red]", end=" ")
        screen.print(str(error), highlight=False, soft_wrap=True, markup=False)
        sys.exit(1)
