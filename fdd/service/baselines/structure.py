"""Which variant of a model ``fdd fit`` takes where the site file leaves the choice, and why."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data, Likelihood
from fdd.greybox.record_faults import DataError
from fdd.greybox.results import FitResult
from fdd.greybox.scale import ParameterError
from fdd.models.structures import Structure
from fdd.records import NANOSECONDS, JsonObject
from fdd.service.baselines.history import History, Run, runs
from fdd.service.baselines.plausible import objections
from fdd.service.site.plan import Component, Plan

TRAINED = 0.75  # share of the time that variants are fitted to; they are compared on the rest
LEVEL = 0.01  # of the likelihood-ratio tests by which a variant may grow
SHORTEST = 12  # frames of a record that is worth filtering


@dataclass(frozen=True, slots=True)
class Choice:
    """A component with the variant that was chosen, where its search may start, and the comparison in words."""

    component: Component
    start: dict[str, float] | None = None
    reasons: tuple[str, ...] = ()

    @property
    def document(self) -> JsonObject:
        """For the baseline's diagnostics."""
        return {"structure": list(self.reasons)} if self.reasons else {}


@dataclass(frozen=True, slots=True)
class Tried:
    """One variant: its log-likelihood on later data that it was not fitted to, and what speaks against it."""

    structure: Structure
    component: Component
    result: FitResult
    held_out: float
    against: tuple[str, ...]

    def words(self) -> str:
        """One line of the comparison."""
        line = (
            f"{self.structure.words}: log-likelihood {self.result.llf:.1f} where fitted, {self.held_out:.1f} on the "
            "last quarter, held out"
        )
        if self.result.unidentifiable and not self.against:
            line += f" ({', '.join(self.result.unidentifiable)} not told)"
        return f"{line}; not to be put in force: {self.against[0]}" if self.against else line


def choose(plan: Plan, component: Component, history: History) -> Choice:
    """The variant of a component's model for a healthy history: the most likely on held-out data that is plausible.

    Whoever names an option (or a parameter) that the variants are about has chosen; nothing is tried then.
    """
    found = runs(plan, component, history)
    if not found:
        return Choice(component)
    step = plan.step / NANOSECONDS
    options = component.structures(step, _usual(component, found))
    if not options:
        return Choice(component)
    if len(options) == 1:
        return Choice(component.variant(options[0].options), None, (options[0].words,))
    early, late = _split(found)
    if not early or not late:
        return Choice(component.variant(options[0].options), None, (f"{options[0].words}: too little data to compare",))
    tried = [t for t in (_try(component, s, early, late) for s in options) if t is not None]
    if not tried:
        return Choice(component)
    best = _grown(tried) if any(s.contains for s in options) else max(tried, key=lambda t: (not t.against, t.held_out))
    reasons = (f"chosen: {best.structure.words}", *(t.words() for t in tried))
    return Choice(best.component, best.result.params, reasons)


def _try(component: Component, structure: Structure, early: Sequence[Data], late: Sequence[Data]) -> Tried | None:
    variant = component.variant(structure.options)
    try:
        result = fit(variant.model, early, errors="fisher", priors=variant.priors)
    except (DataError, ParameterError):
        return None
    held_out = -Likelihood(variant.model, list(late)).value(result.values)
    return Tried(structure, variant, result, held_out, objections(variant, result))


def _grown(tried: Sequence[Tried]) -> Tried:
    """Of nested variants the one that growing ends with: likelier by the ratio test, and on held-out data (AND)."""
    best = tried[0]
    for larger in tried[1:]:
        if best.structure.words not in larger.structure.contains:
            # Not nested in what stands: it must be likelier everywhere.
            better = larger.result.llf > best.result.llf
        else:
            degrees = max(1, len(larger.result.free) - len(best.result.free))
            better = bool(chi2.sf(2 * (larger.result.llf - best.result.llf), degrees) < LEVEL)
        if better and larger.held_out > best.held_out and not larger.against:
            best = larger
    return best


def _split(found: Sequence[Run]) -> tuple[list[Data], list[Data]]:
    """Records before and after the point in time at which the training share of the frames is over."""
    time = np.concatenate([r.time for r in found])
    cut = int(time[int(TRAINED * (len(time) - 1))])
    early: list[Data] = []
    late: list[Data] = []
    for r in found:
        for part, out in ((r.time <= cut, early), (r.time > cut, late)):
            if part.sum() >= SHORTEST and np.isfinite(r.y[part][0]).all():
                t = r.time[part]
                out.append(Data((t - t[0]) / NANOSECONDS, r.u[part], r.y[part]))
    return early, late


def _usual(component: Component, found: Sequence[Run]) -> dict[str, float]:
    """Median of each input; of flows while anything flows."""
    u = np.concatenate([r.u for r in found])
    usual = {}
    for q, column in zip(component.model.inputs, u.T, strict=True):
        flowing = column[column > 0.01 * column.max()] if q.unit == "kg/s" and column.max() > 0 else column
        usual[q.symbol] = float(np.median(flowing))
    return usual
