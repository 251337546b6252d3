"""Gathers a report from a store: findings, healthy equipment, what was not monitored, and the false-alarm budget."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

from fdd.records import Alarm, AlarmState, Baseline
from fdd.report.chillers import MODEL as CHILLER
from fdd.report.chillers import ChillerSection, chiller_section
from fdd.report.evidence import Catalogue, Evidence, latest, load
from fdd.report.findings import URGENCY, Finding, finding, of_model, order
from fdd.report.monitoring import (
    Budget,
    Count,
    Unmonitored,
    Watch,
    budget,
    by_component,
    counts,
    unmonitored,
    watch,
)
from fdd.report.site import ComponentInfo, OutputInfo, ParameterInfo, ReportError, SiteInfo
from fdd.report.words import DAY, inside, interval, local_day, quantity
from fdd.store.store import Store

__all__ = [
    "Action",
    "BaselineInForce",
    "ComponentInfo",
    "OutputInfo",
    "ParameterInfo",
    "Report",
    "ReportError",
    "SiteInfo",
    "gather",
]

PERIOD = 7 * DAY
"""Length of the period where none is given: a week."""
LEAD = 3 * DAY
"""How long before the onset the evidence plots begin."""


@dataclass(frozen=True, slots=True)
class Action:
    """One of the things to do first."""

    do: str
    expect: str
    where: str
    why: str
    anchor: str = ""


@dataclass(frozen=True, slots=True)
class BaselineInForce:
    """The healthy reference of one component."""

    component: str
    title: str
    version: int
    versions: int
    model: str
    span: str
    samples: int
    reason: str
    parameters: tuple[tuple[str, str, str], ...]
    """(meaning, value with unit, 95 % interval)"""


@dataclass(frozen=True, slots=True)
class Report:
    """All a report says; ``start`` and ``end`` in ns, both None where the store is empty."""

    site: SiteInfo
    start: int | None
    end: int | None
    actions: tuple[Action, ...]
    findings: tuple[Finding, ...]
    consequences: tuple[Finding, ...]
    closed: tuple[Finding, ...]
    healthy: tuple[Watch, ...]
    unmonitored: tuple[Unmonitored, ...]
    baselines: tuple[BaselineInForce, ...]
    budget: Budget | None
    counts: tuple[Count, ...]
    chillers: tuple[ChillerSection, ...] = ()
    models: tuple[Finding, ...] = ()
    """Alarms of models that no longer describe their component: no fault of the plant is claimed."""

    @property
    def status(self) -> str:
        """The state of the plant in one line."""
        n = len(self.findings)
        blind = len(_blind(self.unmonitored))
        if self.end is None:
            return "Nothing has been monitored yet"
        seen = len(self.site.components) - blind
        if n:
            shelved = sum(f.state is AlarmState.SHELVED for f in self.findings)
            aside = f", {shelved} of them set aside" if shelved else ""
            return f"{n} finding{'s' * (n > 1)}{aside}"
        if seen <= 0:
            return "No finding, but nothing could be monitored"
        well = f"All well on {seen} monitored component{'s' * (seen > 1)}"
        return well + "".join(f"; {note}" for note in self.notes)

    @property
    def notes(self) -> tuple[str, ...]:
        """What else page one says of the plant: what was not monitored, and models that no longer hold."""
        blind, stale = len(_blind(self.unmonitored)), len(self.standing_models)
        notes = [f"{blind} could not be monitored"] if blind else []
        return (*notes, *([f"{stale} model{'s need' if stale > 1 else ' needs'} attention"] if stale else []))

    @property
    def standing_models(self) -> tuple[Finding, ...]:
        """Models that need attention for a reason of their own: no finding explains them."""
        return tuple(f for f in self.models if f.state in URGENCY)

    def only(self, f: Finding) -> Report:
        """One finding of the report, with what to do about it."""
        return replace(
            self,
            actions=_actions((f,), ()),
            findings=(f,),
            consequences=(),
            closed=(),
            models=(),
            healthy=(),
            unmonitored=(),
            baselines=(),
            budget=None,
            counts=(),
            chillers=(),
        )

    @property
    def well(self) -> bool:
        """Whether there is no finding and everything was monitored."""
        return self.end is not None and not self.findings and not _blind(self.unmonitored)


def _blind(gaps: Iterable[Unmonitored]) -> set[str]:
    """Components of which nothing could be monitored."""
    return {u.name for u in gaps if u.what == "everything"}


def gather(
    store: Store, site: SiteInfo, start: int | None = None, end: int | None = None, period: int = PERIOD
) -> Report:
    """Read all that a report says.

    Parameters
    ----------
    store : may be open read only
    site : names, units, zone and budget
    start, end : period [ns]; by default ``period`` up to the newest prediction, a week

    Raises
    ------
    ReportError : the period is empty, or the site's time zone is unknown
    """
    _ = site.tz  # refused before anything is read
    alarms = [Alarm.read(d) for d in store.list("alarm")]
    catalogue = Catalogue.of(store)
    if end is None:
        newest = latest(store, catalogue)
        times = [a.updated for a in alarms] if newest is None else [newest]
        end = max(times) + 1 if times else None
    if end is None:
        blind = [_never(name, info) for name, info in site.components.items()]
        return Report(site, None, None, (), (), (), (), (), tuple(blind), (), None, counts(store, 2**62))
    start = end - period if start is None else start
    if start >= end:
        raise ReportError(f"the period begins at {start} and ends at {end} [ns]; give a start before the end")
    alarms = sorted((a for a in alarms if a.raised < end), key=order)
    versions = by_component([Baseline(**d) for d in store.list("baseline")])
    return _assemble(store, catalogue, site, alarms, versions, start, end)


def _never(name: str, info: ComponentInfo) -> Unmonitored:
    return Unmonitored(
        info.title,
        name,
        "everything",
        "no data have been processed yet",
        "Fit a baseline on a healthy stretch (fdd fit), then run the service (fdd run) or replay history (fdd replay).",
    )


def _assemble(
    store: Store,
    catalogue: Catalogue,
    site: SiteInfo,
    alarms: Sequence[Alarm],
    versions: Mapping[str, tuple[Baseline, ...]],
    start: int,
    end: int,
) -> Report:
    stale = [a for a in alarms if of_model(a) and a.state is not AlarmState.CLEARED]
    standing = [a for a in alarms if a.state in URGENCY and a not in stale]
    suppressed = [a for a in alarms if a.state is AlarmState.SUPPRESSED and a not in stale]
    cleared = [a for a in alarms if a.state is AlarmState.CLEARED and a.updated >= start]
    pages: dict[str, Finding] = {}
    watches: list[Watch] = []
    chillers: list[ChillerSection] = []
    in_force = _in_force(store, site, versions)
    for name in dict.fromkeys([*site.components, *(a.component for a in standing)]):
        own = [a for a in standing if a.component == name]
        first = min([start, *(a.since - LEAD for a in own)])
        evidence = load(store, catalogue, name, first, end, versions.get(name, ()))
        pages |= {a.key: finding(a, site, evidence, suppressed, end) for a in own}
        if name in site.components:
            watches.append(watch(name, site.components[name], evidence, start, end))
        reference = in_force.get(name)
        if reference is not None and reference.model == CHILLER:
            told = [pages[a.key] for a in own]
            chillers.append(chiller_section(store, site, reference, evidence, told, start, end))
    findings = tuple(pages[a.key] for a in standing)
    blind = [gap for w in watches for gap in unmonitored(w, in_force.get(w.component), site, start, end)]
    troubled = {a.component for a in (*standing, *suppressed, *stale)} | _blind(blind)
    return Report(
        site=site,
        start=start,
        end=end,
        actions=_actions(findings, blind),
        findings=findings,
        consequences=tuple(finding(a, site, Evidence(), (), end) for a in suppressed),
        closed=tuple(finding(a, site, Evidence(), (), end) for a in cleared),
        healthy=tuple(w for w in watches if w.component not in troubled),
        unmonitored=tuple(blind),
        baselines=tuple(_baseline(b, site, len(versions[name])) for name, b in in_force.items()),
        budget=budget(alarms, watches, site, start, end),
        counts=counts(store, end),
        chillers=tuple(chillers),
        models=tuple(finding(a, site, Evidence(), (), end) for a in stale),
    )


def _in_force(store: Store, site: SiteInfo, versions: Mapping[str, tuple[Baseline, ...]]) -> dict[str, Baseline]:
    """The baseline each component runs on; the pointer is the document ``state`` ``baseline/NAME``."""
    found = {}
    for name in site.components:
        pointer = store.get("state", f"baseline/{name}")
        for b in versions.get(name, ()):
            if pointer and b.version == int(pointer["version"]):
                found[name] = b
    return found


def _baseline(b: Baseline, site: SiteInfo, versions: int) -> BaselineInForce:
    info = site.component(b.component)
    rows = []
    for symbol, described in info.parameters.items():
        if symbol not in b.parameters:
            continue
        value, error = b.parameters[symbol], b.standard_errors.get(symbol)
        spread = "not known"
        if error is not None and error == error:
            spread = interval(value - 1.96 * error, value + 1.96 * error, described.unit)
        rows.append((described.meaning or symbol, quantity(value, described.unit), spread))
    span = f"{local_day(b.start, site.tz)} to {local_day(b.end, site.tz)}"
    model = f"{info.model} (version {b.model_version})"
    return BaselineInForce(b.component, info.title, b.version, versions, model, span, b.samples, b.reason, tuple(rows))


def _actions(findings: Sequence[Finding], blind: Sequence[Unmonitored], most: int = 3) -> tuple[Action, ...]:
    """The first checks of the top findings, taken in turns; where none stands, what keeps equipment unwatched."""
    urgent = [f for f in findings if f.state is not AlarmState.SHELVED]
    queues = [list(f.checks) or [c for cause in f.causes for c in cause.checks] for f in urgent]
    actions: list[Action] = []
    while len(actions) < most and any(queues):
        for f, queue in zip(urgent, queues, strict=True):
            if queue and len(actions) < most:
                item = queue.pop(0)
                why = f"suspected: {inside(f.causes[0].meaning)}" if f.causes else f.summary
                told = any(a.anchor == f.anchor for a in actions)
                actions.append(Action(item.do, item.expect, _place(f.info), "" if told else why, f.anchor))
    if not urgent:
        everything = [u for u in blind if u.what in ("everything", "the end of the period")]
        actions = [Action(u.remedy, "", u.title, f"Not monitored: {u.why}.") for u in everything[:most]]
    return tuple(actions)


def _place(info: ComponentInfo) -> str:
    return f"{info.title}, {info.location}" if info.location else info.title
