"""What a healthy history teaches about equipment that is watched by rows of expectations, as the store keeps it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from zoneinfo import ZoneInfo

import numpy as np

from fdd.diagnosis.equipment import Examined, Knowledge, ShareError, examine, teach
from fdd.diagnosis.evidence import ENOUGH
from fdd.records import Baseline
from fdd.service.baselines.history import History
from fdd.service.baselines.identify import IdentifyError
from fdd.service.monitoring.row_monitors import day_of, midnight_after
from fdd.service.site.plan import Plan, RowEquipment


@dataclass(frozen=True)
class FittedRows:
    """What normal days have taught about one piece of equipment, and how much of it is sharpened."""

    baseline: Baseline
    tests: int
    warnings: tuple[str, ...]

    def summary(self) -> str:
        """What a reader must know of it."""
        b, knowledge = self.baseline, Knowledge.of(self.baseline.diagnostics["rows"])
        form = "and the steady form" if knowledge.form else "but not the steady form"
        lines = [
            f"{b.component}: {b.samples} days judged; {len(knowledge.rows.tests)} of {self.tests} tests {form} "
            "are sharpened by them, the others are judged by declared accuracies"
        ]
        lines += [f"  warning: {w}" for w in self.warnings]
        lines.append(f"  baseline version {b.version} of {b.component} is in force")
        return "\n".join(lines)


def examined_days(plan: Plan, equipment: RowEquipment, history: History) -> list[Examined]:
    """Every day of the site's zone in a history, as the engine would judge it."""
    columns = {name: i for i, name in enumerate(plan.columns)}
    days = []
    for a, b in pairwise(_midnights(history, ZoneInfo(plan.zone))):
        inside = slice(*np.searchsorted(history.time, (a, b)).tolist())
        time, values = history.time[inside], history.values[inside]
        if len(time):
            days.append(examine(equipment.model, day_of(equipment, columns, time, values, plan.step, plan.hold)))
    return days


def _midnights(history: History, zone: ZoneInfo) -> list[int]:
    """Ends of the days in which there are frames, after the first frame's own time."""
    found, i = [int(history.time[0])], 0
    while i < len(history.time):
        found.append(midnight_after(int(history.time[i]), zone))
        i = int(np.searchsorted(history.time, found[-1]))
    return found


def learn_rows(plan: Plan, equipment: RowEquipment, history: History, reason: str = "fitted") -> FittedRows:
    """Learn from a healthy history.

    Raises
    ------
    IdentifyError : no day of it could be judged, or a signal is no share
    """
    try:
        days = [d for d in examined_days(plan, equipment, history) if d.statistics or d.blocks is not None]
    except ShareError as error:
        raise IdentifyError(f"{equipment.name}: {error}") from None
    if not days:
        raise IdentifyError(
            f"{equipment.name}: no day of the history allows a judgement; `fdd check` says what is missing"
        )
    knowledge = teach(equipment.model, days, equipment.errors)
    few = (
        f"only {len(days)} day(s) could be judged, and {ENOUGH} are needed to learn from; declared accuracies are used"
    )
    baseline = Baseline(
        component=equipment.baseline,
        version=0,
        model=equipment.model.name,
        model_version="rows 1",
        options={},
        parameters={},
        standard_errors={},
        covariance=[],
        start=int(history.time[0]),
        end=int(history.time[-1]),
        samples=len(days),
        log_likelihood=0.0,
        innovation={},
        diagnostics={"rows": knowledge.document()},
        reason=reason,
    )
    return FittedRows(baseline, len({s.key for d in days for s in d.statistics}), (few,) if len(days) < ENOUGH else ())
