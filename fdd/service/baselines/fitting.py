"""``fdd fit``: baselines for a site's equipment from a healthy history."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from rich.console import Console
from rich.progress import Progress, TaskID

from fdd.greybox.plots import write_html
from fdd.greybox.results import FitResult
from fdd.greybox.validate import validate
from fdd.records import Baseline
from fdd.residual_monitors.daily import READY, scale_of
from fdd.service.baselines.chiller_fit import FittedChiller, learn_chiller
from fdd.service.baselines.history import History, read_history, runs
from fdd.service.baselines.identify import IdentifyError, chance, data_of, identify
from fdd.service.baselines.plausible import objections
from fdd.service.baselines.probation import on_probation, split
from fdd.service.baselines.rows_fit import FittedRows, learn_rows
from fdd.service.baselines.structure import choose
from fdd.service.baselines.versions import accept, propose
from fdd.service.monitoring.power import CHANCE, DAYS, Foretold
from fdd.service.site.errors import UsageError
from fdd.service.site.feed import Feed
from fdd.service.site.plan import Chiller, Component, RowEquipment
from fdd.service.site.site_context import SiteContext, open_site
from fdd.store.store import Store

# Parameter charts widened by more than this are worth a warning.
LOOSE = 1.5


Watched = Component | Chiller | RowEquipment


@dataclass(frozen=True)
class Fitted:
    """One component's new baseline and how good it is."""

    baseline: Baseline
    result: FitResult
    warnings: tuple[str, ...]
    against: tuple[str, ...] = ()

    def summary(self) -> str:
        """The fit's table, and what the charts will see of it."""
        lines = [str(self.result.summary()), ""]
        for symbol, s in self.baseline.innovation.items():
            lines.append(
                f"  innovations of {symbol}: standard deviation {s['sd']:.3f} (1 when the model is right), "
                f"lag-one autocorrelation {s['lag1']:+.3f} (0 when it is)"
            )
        lines += [f"  {line}" for line in probation_told(self.baseline)]
        lines += [f"  warning: {w}" for w in self.warnings if w not in self.result.warnings]
        name, version = self.baseline.component, self.baseline.version
        lines += [f"  structure: {line}" for line in self.baseline.diagnostics.get("structure", ())]
        if not self.against:
            return "\n".join([*lines, f"  baseline version {version} of {name} is in force"])
        lines.append(f"  baseline version {version} of {name} is NOT in force, because")
        lines += [f"    {reason}" for reason in self.against]
        lines.append(f"    whoever knows better: fdd baselines SITE --approve {name} {version}")
        return "\n".join(lines)


AnyFitted = Fitted | FittedChiller | FittedRows


def fit_site(
    site_file: Path,
    data: Path | None,
    *,
    since: str | None,
    until: str | None,
    only: list[str] | None,
    html: Path | None,
    starts: int,
    console: Console,
) -> list[AnyFitted]:
    """Fit every component (or those named), put the baselines in force, and say what is wrong with them.

    Raises
    ------
    UsageError : no such equipment, or nothing could be fitted
    """
    context = open_site(site_file, data)
    fitted = fit_open_site(context, since=since, until=until, only=only, starts=starts, console=console)
    if html:
        later = _later(context, until)
        for path in _write_validation([f for f in fitted if isinstance(f, Fitted)], context, later, html):
            console.print(f"validation: {path}")
    return fitted


def fit_open_site(
    context: SiteContext,
    *,
    since: str | None = None,
    until: str | None = None,
    only: Sequence[str] | None = None,
    starts: int = 3,
    console: Console,
) -> list[AnyFitted]:
    """The same for a site that is open, without a page.

    Raises
    ------
    UsageError : no such equipment, or nothing could be fitted
    """
    chosen = watched_of(context, only)
    with Progress(console=console, transient=True) as progress:
        task = progress.add_task("reading", total=None)
        history = read_span(context, since, until)
        progress.update(task, description="fitting", total=len(chosen), completed=0)
        fitted, failures = fit_history(context, chosen, history, starts=starts, tell=_teller(progress, task))
    if failures and not fitted:
        raise UsageError("nothing could be fitted\n  " + "\n  ".join(failures.values()))
    for failure in failures.values():
        console.print(f"[yellow]not fitted:[/yellow] {failure}")
    return fitted


def _teller(progress: Progress, task: TaskID) -> Callable[[str, int], None]:
    return lambda name, done: progress.update(task, description=f"fitting {name}", completed=done)


def fit_history(
    context: SiteContext,
    chosen: Sequence[Watched],
    history: History,
    *,
    starts: int = 3,
    tell: Callable[[str, int], None],
) -> tuple[list[AnyFitted], dict[str, str]]:
    """Fit these components to a history and keep what was found; ``tell`` hears which is fitted and how many are done.

    Returns
    -------
    The new baselines, and why each of the others has none.
    """
    fitted: list[AnyFitted] = []
    failures: dict[str, str] = {}
    store = context.store()
    for done, component in enumerate(chosen):
        tell(component.name, done)
        try:
            found = _fit(context, component, history, starts)
        except IdentifyError as error:
            failures[component.name] = str(error)
        else:
            fitted.append(_kept(store, found))
    store.close()
    return fitted, failures


def _later(context: SiteContext, until: str | None) -> History | None:
    """What the sources hold after the fitted span, to cross-validate on."""
    if until is None:
        return None
    try:
        return read_span(context, until, None)
    except UsageError:
        return None


def _write_validation(fitted: Sequence[Fitted], context: SiteContext, later: History | None, path: Path) -> list[Path]:
    """Every test of each fit on its longest run, cross-validated on the longest one after it, with plots.

    One page a component, named after it where there are several.
    """
    components = {c.name: c for c in context.plan.components}
    points = {
        c.name: {
            **dict(zip(c.model.symbols["inputs"], c.inputs, strict=True)),
            **dict(zip(c.model.symbols["outputs"], c.outputs, strict=True)),
        }
        for c in context.plan.components
    }
    written = []
    for f in fitted:
        own = path if len(fitted) == 1 else path.with_name(f"{path.stem}-{f.baseline.component}{path.suffix}")
        errors = {
            symbol: sd
            for symbol, point in points[f.baseline.component].items()
            if (sd := context.site.points[point].sensor_sd_si) is not None
        }
        own.parent.mkdir(parents=True, exist_ok=True)
        after = runs(context.plan, components[f.baseline.component], later) if later is not None else []
        other = data_of(max(after, key=lambda r: len(r.time))) if after else None
        longest = max(f.result.records, key=len)
        write_html(validate(f.result, longest, other=other, uncertainty=errors or None), own)
        written.append(own)
    return written


def _fit(context: SiteContext, watched: Watched, history: History, starts: int) -> AnyFitted:
    if isinstance(watched, Chiller):
        return learn_chiller(context.plan, watched, history)
    if isinstance(watched, RowEquipment):
        return learn_rows(context.plan, watched, history)
    mine, held = split(history)
    choice = choose(context.plan, watched, mine)
    # A variant that won over others has been searched for already.
    searches = starts if choice.start is None else 1
    baseline, result = identify(context.plan, choice.component, mine, start=choice.start, starts=searches)
    against = objections(choice.component, result)
    diagnostics = {**baseline.diagnostics, **choice.document, **({"objections": list(against)} if against else {})}
    baseline = replace(baseline, diagnostics=diagnostics)
    if len(held):
        baseline = on_probation(context.plan, choice.component, baseline, history, int(held.time[0]))
    return Fitted(baseline, result, warnings_of(baseline, result), against)


def _kept(store: Store, found: AnyFitted) -> AnyFitted:
    """Put in force, or kept for a person to approve where something speaks against it."""
    keep = propose if isinstance(found, Fitted) and found.against else accept
    return replace(found, baseline=keep(store, found.baseline))


def probation_told(baseline: Baseline) -> list[str]:
    """What later weeks than the fit's own said of a baseline, and what its charts will find."""
    about = baseline.diagnostics.get("probation")
    if about is None:
        return [
            f"probation: no weeks are left that the fit has not seen; for {READY} days only gross faults ring, "
            "and limits narrow over the three weeks after them (a longer history has this at once)"
        ]
    days, scales = int(about["days"]), [scale_of(k) for k in about.get("day", {}).values()]
    lines = [
        f"probation: {days} days that the fit has not seen; the model's daily errors are "
        f"{max(scales, default=1.0):.1f} times what its noise explains"
    ]
    if about["alarms"]:
        lines.append(
            f"warning: {', '.join(about['alarms'])} rang in these days, and nothing was learned from then on: "
            "look for a fault, or fit to another time"
        )
    lines.append(f"found within {DAYS} days in {CHANCE:.0%} of cases:")
    lines += [f"  {Foretold(**f).words()}" for f in about["foretold"]]
    return lines


def read_span(context: SiteContext, since: str | None, until: str | None) -> History:
    """Everything the site's sources hold in [since, until), framed.

    Raises
    ------
    UsageError : no frame is left
    """
    feed = Feed(context.site)
    feed.open()
    history, counts = read_history(context.plan, feed.batches())
    feed.close()
    span = history.between(context.nanoseconds(since), context.nanoseconds(until))
    if len(span) == 0:
        reach = (
            f"{context.local(history.time[0])} to {context.local(history.time[-1])}"
            if len(history)
            else "no time at all"
        )
        lost = {k: n for k, n in (counts | feed.counters()).items() if n and k != "accepted"}
        raise UsageError(
            f"no usable data between {since or 'the beginning'} and {until or 'the end'}; "
            f"the sources reach over {reach}; rejected: {lost or 'nothing'}"
        )
    return span


def watched_of(context: SiteContext, only: Sequence[str] | None = None) -> list[Watched]:
    """Everything of a site that can have a baseline, or what is named of it.

    Raises
    ------
    UsageError : no such equipment
    """
    every: list[Watched] = [*context.plan.equipment, *context.plan.watched]
    names = list(dict.fromkeys(c.name for c in every))
    for name in only or ():
        if name not in names:
            raise UsageError(f"no equipment is named {name!r}; there are {', '.join(names)}")
    return [c for c in every if not only or c.name in only]


def warnings_of(baseline: Baseline, result: FitResult) -> tuple[str, ...]:
    """What a reader must know before trusting a baseline."""
    found = list(result.warnings)
    for symbol, s in baseline.innovation.items():
        if abs(s["lag1"]) > chance(s["samples"]):
            found.append(
                f"{symbol}: innovations are not white (lag-one autocorrelation {s['lag1']:+.2f}): the model misses "
                "part of the dynamics; the colour is taken out before they are charted, and faults show later"
            )
    loose = {k: v for k, v in baseline.diagnostics.get("score_spread", {}).items() if v > LOOSE}
    if loose:
        worst = max(loose, key=lambda k: loose[k])
        found.append(
            f"scores vary up to {loose[worst]:.1f} times more than the model says ({worst}); parameter charts are "
            "widened by that much"
        )
    return tuple(found)
