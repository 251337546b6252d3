"""All charts of a site: which families there are, and the limits that the budget gives them.

Every component carries the families listed in :data:`FAMILIES`. The plant's budget of false alarms is spread over
components by weight, and within a component evenly; families of another purpose have a share of their own, and the
others get what their limits cannot use.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from fdd.evidence import AlarmKind
from fdd.records import NANOSECONDS, IntArray, JsonObject
from fdd.residual_monitors.budget import YEAR, spread
from fdd.residual_monitors.chart import Phase, Verdicts
from fdd.service.alarms.book import subject
from fdd.service.filtering.filters import FilterGroup, GroupStep
from fdd.service.monitoring.chart_family import BoolArray, Family, FamilyKind
from fdd.service.monitoring.day_charts import DAYS, DayCharts
from fdd.service.monitoring.flatline_charts import FLATLINE
from fdd.service.monitoring.health_charts import HEALTH, HealthCharts
from fdd.service.monitoring.innovation_charts import INNOVATIONS, InnovationCharts
from fdd.service.monitoring.power import Foretold, foretell
from fdd.service.monitoring.score_charts import SCORES, ScoreCharts
from fdd.service.site.plan import Component, Plan

# The families that components carry, in the order of their streams.
FAMILIES = (DAYS, INNOVATIONS, SCORES, FLATLINE, HEALTH)
# A statistic below this share of its limit says that what raised the alarm is gone (hysteresis).
NORMAL = 0.25


@dataclass(frozen=True, slots=True)
class ChartStep:
    """What all charts said of one frame, (n_streams,); ``rang`` are the streams that have just passed their limits."""

    verdicts: Verdicts
    rang: IntArray
    normal: BoolArray


class Charts:
    """Every chart of a site."""

    def __init__(self, plan: Plan, groups: Sequence[FilterGroup]) -> None:
        self._plan, self._groups = plan, tuple(groups)
        self._allotted = _budgets(plan, groups)
        self._kinds = [kind.build(plan, groups, arl) for kind, arl in zip(FAMILIES, self._allotted, strict=True)]
        self._families: list[Family] = [f for families in self._kinds for f in families]
        self.streams = tuple(s for f in self._families for s in f.streams)
        of: dict[str, list[int]] = {
            subject(c.name, k): [] for g in groups for c in g.components for k in (AlarmKind.PLANT, AlarmKind.MODEL)
        }
        for i, stream in enumerate(self.streams):
            of[subject(stream.component, stream.alarm)].append(i)
        self._of = {name: np.array(rows, dtype=np.int64) for name, rows in of.items()}
        self._edges = np.cumsum([0, *(len(f.streams) for f in self._families)])
        self._phase = np.zeros(len(self.streams), dtype=np.uint8)
        self._standing = np.zeros(len(self.streams), dtype=np.bool_)
        # What has asked for a new baseline and was cleared: it rests until there is one, for asking again is no news.
        self._asked = np.zeros(len(self.streams), dtype=np.bool_)
        self._held: frozenset[str] = frozenset()

    def update(self, steps: Sequence[GroupStep]) -> ChartStep:
        """Feed one frame to every chart; say which have just passed their limits."""
        said = [f.update(steps) for f in self._families]
        verdicts = Verdicts(*(np.concatenate([getattr(v, f.name) for v in said]) for f in fields(Verdicts)))
        if self._asked.any():
            verdicts = replace(verdicts, phase=np.where(self._asked, np.uint8(Phase.NO_DATA), verdicts.phase))
        alarm = verdicts.phase == Phase.ALARM
        normal = ~alarm | (verdicts.statistic < NORMAL * verdicts.limit)
        # A chart stays in alarm until it is reset; one whose evidence was gone and has come back rings again.
        rang = alarm & (verdicts.statistic >= verdicts.limit) & ~self._standing
        self._standing = (self._standing | rang) & ~normal
        self._phase = verdicts.phase
        self._hold()
        return ChartStep(verdicts, np.flatnonzero(rang), normal)

    def _hold(self) -> None:
        """No chart learns anything of a component with a chart of the plant in alarm."""
        alarmed = np.flatnonzero(self._phase == Phase.ALARM)
        held = frozenset(self.streams[i].component for i in alarmed if self.streams[i].alarm is AlarmKind.PLANT)
        if held != self._held:
            self._held = held
            for family in self._families:
                family.hold(held)

    @property
    def phases(self) -> dict[str, int]:
        """How many charts are in each phase."""
        return {p.name.lower().replace("_", " "): int((self._phase == p).sum()) for p in Phase}

    @property
    def promised(self) -> dict[tuple[str, str], float]:
        """False alarms a year that a component may give by each kind of its charts, which together are the budget."""
        frames = YEAR * NANOSECONDS / self._plan.step
        members = [(g, c, b) for g in self._groups for c, b in zip(g.components, g.baselines, strict=True)]
        found: dict[tuple[str, str], float] = {}
        for family, arl in zip(FAMILIES, self._allotted, strict=True):
            streams = {s for f in self._kinds[FAMILIES.index(family)] for s in f.streams}
            for g, c, b in members:
                kinds = [s.name.rpartition(":")[2] for s in streams if s.component == c.name]
                rate = frames / arl[c.name] * family.carried(g, c) * family.used(c, b, arl[c.name])
                for kind in kinds:
                    found[c.name, kind] = found.get((c.name, kind), 0.0) + rate / len(kinds)
        return found

    def estimate(self, stream: int, updates: int) -> JsonObject:
        """Size of what a stream has found, where its chart can tell."""
        family = int(np.searchsorted(self._edges, stream, side="right")) - 1
        return self._families[family].estimate(stream - int(self._edges[family]), updates)

    def parameters(self, updates: int) -> list[tuple[str, float, float, float]]:
        """Estimates of every component's parameters from the last ``updates``; see :class:`ScoreCharts`."""
        return [row for f in self._families if isinstance(f, ScoreCharts) for row in f.parameters(updates)]

    def days(self) -> dict[str, tuple[int, int]]:
        """Days that were closed since a component's baseline came in force, and how many of them were judged."""
        return {k: v for f in self._families if isinstance(f, DayCharts) for k, v in f.watched().items()}

    def standing(self) -> dict[str, tuple[bool, bool]]:
        """Whether a component's charts of days are still calibrating, and whether its last day was in their range."""
        return {k: v for f in self._families if isinstance(f, DayCharts) for k, v in f.standing().items()}

    def foretold(self) -> dict[str, list[Foretold]]:
        """The smallest fault of each kind that a component's charts will find, as far as its days have told."""
        known = {k: v for f in self._families if isinstance(f, DayCharts) for k, v in f.scales().items()}
        baselines = {b.component: b for g in self._groups for b in g.baselines}
        return {
            name: foretell(baselines[name], {s: scale for s, (scale, _) in of.items()}, next(iter(of.values()))[1])
            for name, of in known.items()
        }

    def taught(self, component: str) -> JsonObject:
        """What the days that were seen have taught of a healthy component, by kind of chart; see ``probation``."""
        found: JsonObject = {}
        for f in self._families:
            if isinstance(f, DayCharts | InnovationCharts | ScoreCharts | HealthCharts) and component in (
                known := f.taught()
            ):
                found[f.kind] = known[component]
        return found

    def is_normal(self, name: str, step: ChartStep) -> bool:
        """Whether every chart of a component, or of its model, said in this step that what raised its alarm is gone."""
        return bool(step.normal[self._of[name]].all())

    def reset(self, component: str, kind: AlarmKind = AlarmKind.PLANT) -> None:
        """An operator has cleared the component's alarm; after one of the plant, those of its model start again too.

        After one of the model its charts rest until there is a new baseline, which is what it has asked for.
        """
        which = np.zeros(len(self.streams), dtype=np.bool_)
        for each in {kind, AlarmKind.MODEL}:
            which[self._of[subject(component, each)]] = True
        for family, start, stop in zip(self._families, self._edges, self._edges[1:], strict=False):
            family.reset(which[start:stop])
        self._phase = np.where(which, np.uint8(Phase.QUIET), self._phase)
        self._standing &= ~which
        if kind is AlarmKind.MODEL:
            self._asked |= which
        self._hold()

    def rebase(self, components: set[str]) -> None:
        """These components have new baselines; each family says what it starts again, and limits follow the budget."""
        self._asked &= np.array([s.component not in components for s in self.streams], dtype=np.bool_)
        for i, (arl, families) in enumerate(zip(_budgets(self._plan, self._groups), self._kinds, strict=True)):
            if arl != self._allotted[i]:
                self._allotted[i] = arl
                for family in families:
                    family.allot(arl)
        for family, start, stop in zip(self._families, self._edges, self._edges[1:], strict=False):
            which = family.rebase(components)
            self._phase[start:stop] = np.where(which, np.uint8(Phase.QUIET), self._phase[start:stop])
            self._standing[start:stop] &= ~which
        self._hold()

    def export_state(self) -> JsonObject:
        """The charts as plain data."""
        return {
            "families": [f.export_state() for f in self._families],
            "phase": self._phase.copy(),
            "standing": self._standing.copy(),
            "asked": self._asked.copy(),
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        for family, saved in zip(self._families, state["families"], strict=True):
            family.restore_state(saved)
        self._phase = np.array(state["phase"], dtype=np.uint8)
        self._standing = np.array(state["standing"], dtype=np.bool_)
        self._asked = np.array(state["asked"], dtype=np.bool_)
        self._hold()


def _budgets(plan: Plan, groups: Sequence[FilterGroup]) -> list[dict[str, float]]:
    """Mean number of frames between false alarms for each of a component's charts, by family.

    What a family does not need of its own share goes to those of its component that have none: all together are
    promised the whole budget.
    """
    members = [(c, b) for g in groups for c, b in zip(g.components, g.baselines, strict=True)]
    own = {k: _budget(plan, groups, [k], {c.name: k.share for c, _ in members}) for k in FAMILIES if k.share}
    left = {
        c.name: 1.0 - sum(kind.share * kind.used(c, b, arl[c.name]) for kind, arl in own.items()) for c, b in members
    }
    others = _budget(plan, groups, [k for k in FAMILIES if not k.share], left)
    return [own.get(kind, others) for kind in FAMILIES]


def _budget(
    plan: Plan, groups: Sequence[FilterGroup], kinds: Sequence[FamilyKind], share: Mapping[str, float]
) -> dict[str, float]:
    """The same for families that divide such shares of their components' budgets."""
    components = [(c, _charts_of(g, c, kinds)) for g in groups for c in g.components]
    if not components:
        return {}
    weights = [c.weight * share[c.name] for c, _ in components]
    total = sum(weights) / sum(c.weight for c, _ in components)
    each = spread(total * plan.filters_per_year, weights, plan.step / NANOSECONDS)
    return {c.name: float(frames * n) for (c, n), frames in zip(components, each, strict=True)}


def _charts_of(group: FilterGroup, component: Component, kinds: Sequence[FamilyKind]) -> float:
    """How many charts share a component's budget; at least one, so that a component without charts divides nothing."""
    return max(1.0, sum(kind.carried(group, component) for kind in kinds))
