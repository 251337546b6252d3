"""What was kept of the budget of false alarms: alarms that came in the time watched, against those promised."""

from __future__ import annotations

from collections.abc import Iterable

from fdd.diagnosis.judged import is_consequence, judged_false
from fdd.records import Alarm, JsonObject
from fdd.residual_monitors.budget import Realised, realised


class Tally:
    """Alarms that were closed: those of their own (no consequences of others), and of these the false ones."""

    def __init__(self) -> None:
        self.own, self.false = 0, 0

    def close(self, alarm: Alarm) -> None:
        """An alarm was cleared."""
        if not is_consequence(alarm):
            self.own += 1
            self.false += judged_false(alarm)

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {"own": self.own, "false": self.false}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self.own, self.false = int(state["own"]), int(state["false"])


def realised_rate(tally: Tally, open_alarms: Iterable[Alarm], seconds: float, promised: float) -> JsonObject:
    """The budget for status, metrics and dashboards.

    Parameters
    ----------
    seconds : in which charts could judge, since the state of the service began [s]
    promised : false alarms a year

    Returns
    -------
    ``promised_per_year``, ``years`` watched, and ``alarms`` and ``judged_false``, each with ``count``, ``per_year``,
    ``low`` and ``high`` (95 % Poisson interval) and ``consistent``; without these two where nothing was watched yet.
    All alarms are an upper bound of the false ones, those that an operator called false a lower one.
    """
    own = tally.own + sum(not is_consequence(a) for a in open_alarms)
    table: JsonObject = {"promised_per_year": promised, "years": seconds / (365.25 * 86400.0)}
    if seconds > 0:
        table["alarms"] = _told(realised(own, seconds, promised))
        table["judged_false"] = _told(realised(tally.false, seconds, promised))
    return table


def _told(r: Realised) -> JsonObject:
    return {"count": r.count, "per_year": r.rate, "low": r.low, "high": r.high, "consistent": r.consistent}
