"""A day's verdict on equipment: rows of expectations and the bank of alternatives, each ringing and naming together.

Rows say that something is wrong, and which faults would explain that; the bank says which fault explains the settled
readings. Their product names the cause. The chance that *nothing* is wrong has a prior of 0.9 a day: probabilities are
worth as much as that number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import stats
from scipy.special import logsumexp

from fdd.diagnosis import bank
from fdd.diagnosis.bank import NORMAL, UNKNOWN, Fitted, Weighed
from fdd.diagnosis.evidence import Beliefs, Statistic, Test, allowed_chance, judge, learn, seen_of, statistics, within
from fdd.evidence import Cause as AlarmCause
from fdd.evidence import Message, Size, check
from fdd.models.expectation import Day, EquipmentModel, Row, Values
from fdd.records import JsonObject

CONTRADICTS = 6.0
"""Log-odds that a ringing row which a cause does not explain takes from it, at most: rows are not infallible."""
LARGEST = 1.5
"""A command or status above this is no share."""
SHOWN = 0.01
"""Causes less likely than this are not told."""


@dataclass(frozen=True)
class Knowledge:
    """What normal days have taught about one piece of equipment; nothing before."""

    rows: Beliefs = field(default_factory=Beliefs)
    form: bank.Belief | None = None
    days: int = 0

    def document(self) -> JsonObject:
        """Plain data."""
        form = None if self.form is None else self.form.document()
        return {"rows": self.rows.document(), "form": form, "days": self.days}

    @classmethod
    def of(cls, document: JsonObject) -> Knowledge:
        """What :meth:`document` wrote."""
        form = None if document["form"] is None else bank.Belief.of(document["form"])
        return cls(Beliefs.of(document["rows"]), form, int(document["days"]))


@dataclass(frozen=True)
class Examined:
    """What a day gives to judge, or to learn from: statistics of its rows, and blocks of settled operation."""

    statistics: tuple[Statistic, ...]
    blocks: Values | None


@dataclass(frozen=True, slots=True)
class Cause:
    """A cause with its probability, and what the day says for and against it."""

    name: str
    meaning: Message
    probability: float
    size: float | None
    unit: str
    speaks_for: tuple[Message, ...]
    speaks_against: tuple[Message, ...]
    checks: tuple[Message, ...]

    def told(self) -> AlarmCause:
        """As an alarm carries it."""
        return AlarmCause(
            name=self.name,
            meaning=self.meaning,
            likelihood=round(self.probability, 3),
            speaks_for=self.speaks_for,
            speaks_against=self.speaks_against,
            checks=self.checks,
            size=None if self.size is None else Size(float(f"{self.size:.2g}"), self.unit),
        )


@dataclass(frozen=True)
class Verdict:
    """A day judged.

    Attributes
    ----------
    tests : of every row that could be judged
    bank_ratio : log of the mean likelihood ratio of all faults against normal, over its limit; None without a bank
    bank_limit : that limit [nats]
    causes : most likely first; empty where nothing rings
    """

    tests: tuple[Test, ...]
    bank_ratio: float | None
    bank_limit: float
    causes: tuple[Cause, ...]

    @property
    def ringing(self) -> tuple[Test, ...]:
        """Rows beyond their limits, the furthest first."""
        return tuple(sorted((t for t in self.tests if t.rings), key=lambda t: -t.ratio))

    @property
    def rings(self) -> bool:
        """Whether anything is beyond its limit."""
        return bool(self.ringing) or (self.bank_ratio or 0.0) >= 1.0

    @property
    def judged(self) -> bool:
        """Whether the day allowed any test at all."""
        return bool(self.tests) or self.bank_ratio is not None


class ShareError(ValueError):
    """A signal that is no share; the text says which, and what to do."""


def examine(model: EquipmentModel, day: Day) -> Examined:
    """Reduce a day to what is judged and learned.

    Raises
    ------
    ShareError : a command, position or status that goes beyond 1
    """
    # A rule's own value has no names, and may be any number.
    for role in (r for r in model.roles if r.unit == "1" and r.names and r.symbol in day):
        top = np.nanmax(day[role.symbol], initial=0.0)
        if top > LARGEST:
            raise ShareError(
                f"{role.symbol} ({role.meaning}) reads up to {top:g}, and goes from 0 to 1; give its point the unit "
                "'%', or map it to a derived point, such as STATUS > 1.5"
            )
    return Examined(tuple(statistics(model, day)), None if model.form is None else bank.blocks(model.form, day))


def teach(model: EquipmentModel, days: Sequence[Examined], errors: Mapping[str, float] | None = None) -> Knowledge:
    """What normal days teach; fewer than five teach nothing."""
    seen = [d for d in days if d.statistics or d.blocks is not None]
    rows = learn(model, [d.statistics for d in seen], errors)
    blocks = [d.blocks for d in seen if d.blocks is not None]
    form = bank.learn(model.form, blocks) if model.form is not None else None
    if form is not None:
        form = replace(form, seen=seen_of([_drivers(model, b) for b in blocks]))
    return Knowledge(rows, form, len(seen))


def _drivers(model: EquipmentModel, blocks: Values) -> dict[str, float]:
    """What came from outside while the equipment had settled, its mean by role."""
    return {role: float(blocks[role].mean()) for role in model.drivers if role in blocks}


def judge_day(
    model: EquipmentModel,
    day: Examined,
    knowledge: Knowledge,
    false_alarms_per_year: float,
    errors: Mapping[str, float] | None = None,
) -> Verdict:
    """Judge one day.

    Parameters
    ----------
    false_alarms_per_year : share of the budget that this equipment has
    errors : standard deviations of the sensors' errors by role, where the site knows better than the model
    """
    allowed = allowed_chance(false_alarms_per_year, len(day.statistics) + (day.blocks is not None))
    tests = judge(model, day.statistics, knowledge.rows, allowed, errors)
    limit = float(-np.log(allowed))
    ringing = [t for t in tests if t.rings]
    weighed, ratio = None, None
    if model.form is not None and day.blocks is not None:
        learned = knowledge.form
        known = learned is not None and within(learned.seen, _drivers(model, day.blocks))
        belief = learned if learned is not None and known else bank.prior(model.form)
        ratio = 0.0
        if ringing or bank.misfit(model.form, day.blocks, belief) > limit - 1.0:
            weighed = bank.weigh(model, day.blocks, belief)
            ratio = max(0.0, weighed.odds_against_normal(odds(model))) / limit
    causes = _causes(model, ringing, weighed) if ringing or (ratio or 0.0) >= 1.0 else ()
    return Verdict(tuple(tests), ratio, limit, causes)


def odds(model: EquipmentModel) -> dict[str, float]:
    """Share of each fault among all before the day was seen."""
    total = sum(f.odds for f in model.faults)
    return {f.name: f.odds / total for f in model.faults}


def _causes(model: EquipmentModel, ringing: Sequence[Test], weighed: Weighed | None) -> tuple[Cause, ...]:
    share, rows = odds(model), {r.name: r for r in model.rows}
    fitted: dict[str, Fitted] = {f.name: f for f in weighed.faults} if weighed else {}
    plain = weighed.normal.evidence if weighed else 0.0
    left = 1.0 - sum(bank.PRIOR.values())
    logs = {
        f.name: np.log(left * share[f.name])
        + (fitted[f.name].evidence if f.name in fitted else plain)
        - sum(_contradiction(t) for t in ringing if f.name not in explained(rows[t.statistic.row], t.statistic.side))
        for f in model.faults
    }
    logs[NORMAL] = np.log(bank.PRIOR[NORMAL]) + plain - sum(_surprise(t) for t in ringing)
    unknown = weighed.unknown.evidence if weighed else plain
    logs[UNKNOWN] = np.log(bank.PRIOR[UNKNOWN]) + unknown - sum(min(1.0, _contradiction(t)) for t in ringing)
    total = float(logsumexp(list(logs.values())))
    ranked = sorted(((float(np.exp(v - total)), name) for name, v in logs.items()), reverse=True)
    return tuple(
        _cause(model, name, p, fitted.get(name), plain, ringing)
        for p, name in ranked
        if p >= SHOWN or name == ranked[0][1]
    )


def explained(row: Row, side: int) -> tuple[str, ...]:
    """Faults that explain this side of a row."""
    return row.high_causes if side > 0 else row.low_causes


def _contradiction(t: Test) -> float:
    return min(CONTRADICTS, _surprise(t))


def _surprise(t: Test) -> float:
    """Log-likelihood that normal operation loses by a row this far off."""
    z = float(stats.norm.isf(max(t.chance, 1e-300)))
    return 0.5 * z * z


def _cause(
    model: EquipmentModel, name: str, p: float, fitted: Fitted | None, plain: float, ringing: Sequence[Test]
) -> Cause:
    rows = {r.name: r for r in model.rows}
    fault = next((f for f in model.faults if f.name == name), None)
    supports: list[Message] = []
    objects: list[Message] = []
    for t in ringing:
        agrees = fault is None or name in explained(rows[t.statistic.row], t.statistic.side)
        (supports if agrees and name != NORMAL else objects).append(row_message(rows[t.statistic.row], t))
    size = None
    if fault is not None and fitted is not None:
        gain = fitted.evidence - plain
        if gain > 1.0:
            size = fitted.size
            supports.append(Message.of("settled_fit", nats=gain))
        elif gain < -1.0:
            objects.append(Message.of("settled_normal", nats=-gain))
    meaning = Message.declared(fault.meaning) if fault else Message.of("chance" if name == NORMAL else "no_known_fault")
    checks = tuple(check(*c.split(": ", 1)) for c in fault.checks) if fault else ()
    return Cause(name, meaning, p, size, fitted.unit if fitted else "", tuple(supports), tuple(objects), checks)


def row_message(row: Row, t: Test) -> Message:
    """A row's finding with its numbers."""
    s = t.statistic
    words = Message.declared(row.high if s.side > 0 else row.low)
    unit = "" if row.unit == "1" else f" {row.unit}"
    return Message.of("row", words=words, value=s.value, unit=unit, expected=t.expected, spread=2 * t.sd)
