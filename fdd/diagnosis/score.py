"""Scores alarms against known faults, by the framework of Frank et al. (2019).

Two ways of counting stand side by side, because they answer different questions:

*days*   Every day of every component is one sample: faulty or not, alarmed or not. Gives the framework's rates. Days
         begin at midnight of the site's zone; a day in which a component gave no data is no sample.
*cases*  Every labelled stretch of a fault is one sample: found or missed, rightly named or not, after how long.

An alarm counts from when it is raised until its evidence is gone (returned to normal) or it is cleared; while it is
suppressed as another's consequence it does not count. A case whose component is alarmed already at its onset is
*masked*: nobody could have seen it, it is neither found nor missed.

References
----------
Frank, S., Lin, G., Jin, X., Singla, R., Farthing, A., Granderson, J. (2019), A performance evaluation framework for
building fault detection and diagnosis algorithms, Energy and Buildings 192, 84-92. Wilson, E. B. (1927), J. Am. Stat.
Assoc. 22, 209-212. Garwood, F. (1936), Biometrika 28, 437-442.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist, median
from typing import Literal

from fdd.records import NANOSECONDS, Alarm, AlarmState
from fdd.residual_monitors.budget import YEAR, poisson_interval

Diagnosis = Literal["correct", "wrong", "none"]
Outcome = Literal["found", "missed", "masked"]
STANDING = (AlarmState.RAISED, AlarmState.ACKNOWLEDGED, AlarmState.SHELVED)


@dataclass(frozen=True, slots=True)
class Label:
    """A fault that is known to have been there in [start, end) [ns]; ``severity`` in the labeller's own measure."""

    component: str
    fault: str
    start: int
    end: int
    severity: float | None = None


@dataclass(frozen=True, slots=True)
class Standing:
    """A stretch in which a component's alarm stood, and the causes it named first, with the time each was named."""

    component: str
    start: int
    end: int
    named: tuple[tuple[int, str], ...]

    def cause_before(self, time: int) -> str | None:
        """What was held likeliest until ``time``; None where no cause was named."""
        return next((name for at, name in reversed(self.named) if at < time and name), None)


@dataclass(frozen=True, slots=True)
class Share:
    """``count`` of ``of``, with the limits of its 95 % Wilson interval; None where there is nothing to count."""

    count: int
    of: int

    @property
    def value(self) -> float | None:
        """The share itself."""
        return self.count / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        """Limits of the interval; [0, 1] where there is nothing to count."""
        return wilson(self.count, self.of)


@dataclass(frozen=True, slots=True)
class Rate:
    """Events in so many years, with the limits of their exact 95 % Poisson interval [1/a]."""

    count: int
    years: float

    @property
    def value(self) -> float | None:
        """Events a year."""
        return self.count / self.years if self.years > 0 else None

    @property
    def interval(self) -> tuple[float, float | None]:
        """Limits [1/a]."""
        low, high = poisson_interval(self.count)
        return (low / self.years, high / self.years) if self.years > 0 else (0.0, None)


@dataclass(frozen=True, slots=True)
class Case:
    """What became of one label: ``delay`` [s] from its start to the alarm, ``named`` the cause held likeliest then."""

    label: Label
    outcome: Outcome
    delay: float | None = None
    diagnosis: Diagnosis | None = None
    named: str | None = None


@dataclass(frozen=True, slots=True)
class Days:
    """Component-days by truth and alarm; days that a fault covers in part are faulty."""

    true_positive: int
    false_negative: int
    false_positive: int
    true_negative: int
    correct: int
    wrong: int
    undiagnosed: int

    @property
    def rates(self) -> dict[str, Share]:
        """The framework's rates: of faulty days, of healthy days, and of days with a fault that was detected."""
        faulty = self.true_positive + self.false_negative
        healthy = self.false_positive + self.true_negative
        return {
            "true positive": Share(self.true_positive, faulty),
            "false negative": Share(self.false_negative, faulty),
            "false positive": Share(self.false_positive, healthy),
            "true negative": Share(self.true_negative, healthy),
            "correct diagnosis": Share(self.correct, self.true_positive),
            "wrong diagnosis": Share(self.wrong, self.true_positive),
            "no diagnosis": Share(self.undiagnosed, self.true_positive),
        }


@dataclass(frozen=True, slots=True)
class Group:
    """Cases that belong together: shares found (masked ones left out) and rightly named, median delay [s]."""

    found: Share
    correct: Share
    masked: int
    delay: float | None


@dataclass(frozen=True, slots=True)
class Score:
    """All that the comparison gave; ``false`` are alarms outside every label."""

    days: Days
    cases: tuple[Case, ...]
    false: tuple[Standing, ...]
    false_alarms: Rate

    @property
    def overall(self) -> Group:
        """All cases together."""
        return group(self.cases)

    def by_severity(self) -> dict[tuple[str, float | None], Group]:
        """Cases of each fault at each severity, in that order."""
        keys = {(c.label.fault, c.label.severity) for c in self.cases}
        ordered = sorted(keys, key=lambda k: (k[0], k[1] is not None, k[1] or 0.0))
        return {k: group([c for c in self.cases if (c.label.fault, c.label.severity) == k]) for k in ordered}


def wilson(count: int, of: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval for a share (Wilson 1927); [0, 1] for nothing out of nothing.

    >>> [round(x, 4) for x in wilson(8, 10)]
    [0.4902, 0.9433]
    """
    if not 0 <= count <= of:
        raise ValueError(f"{count} of {of} is no share; give 0 <= count <= of")
    if of == 0:
        return 0.0, 1.0
    z = NormalDist().inv_cdf(0.5 + confidence / 2)
    share, extra = count / of, z * z / of
    half = z * (share * (1 - share) / of + extra / (4 * of)) ** 0.5
    low, high = ((share + extra / 2 + sign * half) / (1 + extra) for sign in (-1, 1))
    return (0.0 if count == 0 else low), (1.0 if count == of else high)


def standing(changes: Iterable[Alarm], end: int) -> list[Standing]:
    """Stretches in which alarms stood, from every change of every alarm in order of time.

    Parameters
    ----------
    changes : alarms as the engine gave them
    end : of the data [ns]; alarms that still stand do so until then
    """
    open_: dict[str, Standing] = {}
    closed: list[Standing] = []
    for alarm in changes:
        cause = alarm.causes[0].name if alarm.causes else ""
        known = open_.get(alarm.key)
        if alarm.state in STANDING:
            known = known or Standing(alarm.component, alarm.updated, end, ())
            open_[alarm.key] = Standing(known.component, known.start, end, (*known.named, (alarm.updated, cause)))
        elif known is not None:
            closed.append(Standing(known.component, known.start, alarm.updated, known.named))
            del open_[alarm.key]
    return sorted([*closed, *open_.values()], key=lambda s: (s.start, s.component))


def score(
    labels: Sequence[Label],
    alarms: Sequence[Standing],
    components: Sequence[str],
    days: Sequence[tuple[int, int]],
    settle: int = 0,
    seen: Callable[[str, int, int], bool] | None = None,
) -> Score:
    """Compare alarms with labels.

    Parameters
    ----------
    labels : may overlap; those of components that are not watched count as missed
    alarms : see :func:`standing`
    components : that were watched
    days : [start, end) of each day watched, in order [ns]
    settle : after a fault's end, in which its alarm may still stand and nothing is counted [ns]
    seen : whether a component gave data in [start, end); days in which it gave none are no sample. None: it always did

    Raises
    ------
    ValueError : a label that ends before it starts
    """
    for label in labels:
        if label.end <= label.start:
            raise ValueError(f"label {label.component} {label.fault}: its end is not after its start")
    per = {c: [a for a in alarms if a.component == c] for c in (*components, *(x.component for x in labels))}
    cases = tuple(_case(label, per[label.component], settle) for label in labels)
    false = tuple(a for a in alarms if not any(_explains(x, a, settle) for x in labels))
    counted = _days(labels, per, components, days, settle, seen)
    healthy = counted.false_positive + counted.true_negative
    length = sum(end - start for start, end in days) / len(days) / NANOSECONDS if days else 0.0
    # Alarms are promised for the plant: its years, in which a share of components may be faulty.
    years = healthy * length / YEAR / max(1, len(components))
    return Score(counted, cases, false, Rate(len(false), years))


def group(cases: Sequence[Case]) -> Group:
    """Shares and median delay of these cases; a case that was not found has an infinite delay."""
    seen = [c for c in cases if c.outcome != "masked"]
    found = [c for c in seen if c.outcome == "found"]
    delays = [float("inf") if c.delay is None else c.delay for c in seen]
    middle = median(delays) if delays else float("inf")
    correct = sum(c.diagnosis == "correct" for c in found)
    return Group(
        found=Share(len(found), len(seen)),
        correct=Share(correct, len(found)),
        masked=len(cases) - len(seen),
        delay=middle if middle < float("inf") else None,
    )


def _explains(label: Label, alarm: Standing, settle: int) -> bool:
    """Whether an alarm was raised while the fault, or what is left of it, was there."""
    return label.component == alarm.component and label.start <= alarm.start < label.end + settle


def _case(label: Label, alarms: Sequence[Standing], settle: int) -> Case:
    if any(a.start < label.start < a.end for a in alarms):
        return Case(label, "masked")
    first = next((a for a in alarms if label.start <= a.start < label.end + settle), None)
    if first is None:
        return Case(label, "missed")
    named = first.cause_before(label.end + settle)
    return Case(label, "found", (first.start - label.start) / NANOSECONDS, _diagnosis(named, [label]), named)


def _diagnosis(named: str | None, labels: Sequence[Label]) -> Diagnosis:
    if named is None:
        return "none"
    return "correct" if any(x.fault == named for x in labels) else "wrong"


def _days(
    labels: Sequence[Label],
    alarms: Mapping[str, Sequence[Standing]],
    components: Sequence[str],
    days: Sequence[tuple[int, int]],
    settle: int,
    seen: Callable[[str, int, int], bool] | None,
) -> Days:
    count = dict.fromkeys(("true_positive", "false_negative", "false_positive", "true_negative"), 0)
    names: dict[Diagnosis, int] = {"correct": 0, "wrong": 0, "none": 0}
    for component in components:
        own = [x for x in labels if x.component == component]
        for start, end in days:
            if seen is not None and not seen(component, start, end):
                continue
            there = [x for x in own if x.start < end and x.end > start]
            if not there and any(x.end <= start < x.end + settle for x in own):
                continue
            ringing = [a for a in alarms[component] if a.start < end and a.end > start]
            count[("true_" if bool(there) == bool(ringing) else "false_") + _sign(ringing)] += 1
            if there and ringing:
                names[_diagnosis(ringing[-1].cause_before(end), there)] += 1
    return Days(**count, correct=names["correct"], wrong=names["wrong"], undiagnosed=names["none"])


def _sign(ringing: Sequence[Standing]) -> str:
    return "positive" if ringing else "negative"
