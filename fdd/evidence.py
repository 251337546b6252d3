"""What an alarm carries, as types: its kind, the charts behind it, causes, cost, and what is said, as codes.

Nothing here is a sentence: a :class:`Message` is a code with arguments, and the report's catalogues hold the words of
each language. Documents (checkpoint, store, answers) are read and written here and nowhere else; those of before, with
sentences in place of messages, are read, too.

A chart is named ``component/symbol:kind``; the tests of rows ``component/ROW +`` (or ``-``, the side), the bank of
alternatives on settled readings ``component/steady readings``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from enum import StrEnum
from typing import Any, Literal

JsonObject = dict[str, Any]
Scale = Literal["relative", "absolute"]

STEADY = "steady readings"
"""What the bank of alternatives watches."""


class ChartKind(StrEnum):
    """Every kind of chart that may raise an alarm; its title stands in the report's catalogues."""

    CUSUM = "cusum"
    DAY = "day"
    SCORE = "score"
    FLATLINE = "flatline"
    AUTOCORRELATION = "autocorrelation"
    PERIODOGRAM = "periodogram"
    DISPERSION = "dispersion"
    CLUSTER = "cluster"
    WEEKLY = "weekly"
    ROW = "row"
    STEADY = "steady"


class AlarmKind(StrEnum):
    """What an alarm speaks of: the plant, its model, or one place of equipment that is watched by rows."""

    PLANT = "plant"
    MODEL = "model"
    PLACE = "place"


def parts_of(chart: str) -> tuple[str, ChartKind]:
    """What a chart watches (a symbol, or a row's name) and its kind, from its name.

    Raises
    ------
    ValueError : there is no such kind; name it in :class:`ChartKind` and give it a title in every catalogue
    """
    own = chart.rpartition("/")[2]
    if own == STEADY:
        return STEADY, ChartKind.STEADY
    symbol, colon, kind = own.rpartition(":")
    if colon:
        return symbol, ChartKind(kind)
    if own[-2:] in (" +", " -"):
        return own[:-2], ChartKind.ROW
    raise ValueError(f"chart {chart!r} has no kind; name it component/symbol:kind")


def has_kind(chart: str) -> bool:
    """Whether this version still has the kind of chart that a name in the store speaks of."""
    try:
        parts_of(chart)
    except ValueError:
        return False
    return True


@dataclass(frozen=True, slots=True)
class Message:
    """What is said: a code of the catalogues and its arguments, in order of their names.

    Two codes are of a kind of their own: ``declared`` holds a text of a model's declaration (its English is its own
    source, other languages translate it), ``written`` one that stands as it is.
    """

    code: str
    arguments: tuple[tuple[str, Any], ...] = ()

    @classmethod
    def of(cls, code: str, **arguments: Any) -> Message:
        """A message; arguments are texts, numbers, tuples of texts, or messages."""
        return cls(code, tuple(sorted(arguments.items())))

    @classmethod
    def declared(cls, text: str) -> Message:
        """A text of a model's declaration."""
        return cls.of("declared", text=text)

    @classmethod
    def read(cls, document: str | JsonObject) -> Message:
        """What :meth:`document` wrote; a bare text, as alarms of before hold it, stands as it is."""
        if isinstance(document, str):
            return cls.of("written", text=document)
        return cls.of(document["code"], **{k: _argument(v) for k, v in document.get("arguments", {}).items()})

    def document(self) -> JsonObject:
        """Plain data."""
        return {"code": self.code, "arguments": {k: _plain(v) for k, v in self.arguments}}

    def __getitem__(self, name: str) -> Any:
        return dict(self.arguments)[name]


def _plain(value: Any) -> Any:
    if isinstance(value, Message):
        return value.document()
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _argument(value: Any) -> Any:
    if isinstance(value, dict):
        return Message.read(value)
    return tuple(_argument(v) for v in value) if isinstance(value, list) else value


def check(do: str, expect: str = "") -> Message:
    """What to do, and the reading to expect, both declared texts."""
    if not expect:
        return Message.declared(do)
    return Message.of("check", do=Message.declared(do), expect=Message.declared(expect))


@dataclass(frozen=True, slots=True)
class ChartEvidence:
    """A chart that passed its limit, in numbers.

    Attributes
    ----------
    symbol, kind : what it watches, and how
    statistic, limit, direction : at the alarm; +1 for above what was expected, -1 for below
    since, raised : estimated onset, and when the limit was passed [ns]
    change, standard_error, scale : of the parameter if it alone is responsible, where the chart can tell; a share, or
        in the parameter's unit
    point, unchanged_seconds : of a reading that is frozen
    words : a row's finding
    """

    symbol: str
    kind: ChartKind
    statistic: float = 0.0
    limit: float = 1.0
    direction: int = 0
    since: int = 0
    raised: int = 0
    change: float | None = None
    standard_error: float | None = None
    scale: Scale | None = None
    point: str | None = None
    unchanged_seconds: float | None = None
    words: Message | None = None

    @property
    def strength(self) -> float:
        """Evidence that a parameter has moved: its change in standard errors; 0 where the chart cannot tell."""
        return abs(self.change) / self.standard_error if self.change is not None and self.standard_error else 0.0

    def document(self) -> JsonObject:
        """Plain data."""
        return {**_given(self), "kind": str(self.kind)}

    @classmethod
    def read(cls, name: str, document: JsonObject) -> ChartEvidence:
        """What :meth:`document` wrote of the chart of that name."""
        symbol, kind = parts_of(name)
        known = {k: v for k, v in document.items() if k in _names(cls)}
        if "words" in known:
            known["words"] = Message.read(known["words"])
        return cls(**{"symbol": symbol, **known, "kind": kind})


@dataclass(frozen=True, slots=True)
class Size:
    """How large a fault is, in the unit of its cause."""

    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Cause:
    """A likely cause: ``kind`` says whether of the component, a sensor, upstream or unknown; None: not weighed."""

    name: str
    meaning: Message
    likelihood: float | None = None
    speaks_for: tuple[Message, ...] = ()
    speaks_against: tuple[Message, ...] = ()
    checks: tuple[Message, ...] = ()
    where: str = ""
    kind: str = ""
    size: Size | None = None

    def document(self) -> JsonObject:
        """Plain data."""
        told: JsonObject = {"name": self.name, "meaning": self.meaning.document()}
        if self.likelihood is not None:
            told["likelihood"] = self.likelihood
        told |= {
            "for": [m.document() for m in self.speaks_for],
            "against": [m.document() for m in self.speaks_against],
            "checks": [m.document() for m in self.checks],
        }
        told |= {k: v for k, v in (("where", self.where), ("kind", self.kind)) if v}
        return told if self.size is None else told | {"size": {"value": self.size.value, "unit": self.size.unit}}

    @classmethod
    def read(cls, document: JsonObject) -> Cause:
        """What :meth:`document` wrote."""
        name, size = str(document.get("name", "")), document.get("size")
        return cls(
            name,
            Message.read(document.get("meaning") or name),
            document.get("likelihood"),
            messages(document.get("for")),
            messages(document.get("against")),
            messages(document.get("checks")),
            str(document.get("where", "")),
            str(document.get("kind", "")),
            None if size is None else Size(float(size["value"]), str(size["unit"])),
        )


def messages(documents: Any) -> tuple[Message, ...]:
    """Messages from their documents, or from texts."""
    return tuple(Message.read(d) for d in documents or ())


@dataclass(frozen=True, slots=True)
class Cost:
    """What a fault costs a day, with its 95 % interval; energy in kWh.

    ``kind`` says whether energy or comfort is lost; ``basis`` is the assumption, ``why`` why there is no value.
    """

    currency: str = "EUR"
    value: float | None = None
    lower: float | None = None
    upper: float | None = None
    energy: float | None = None
    half_width: float | None = None
    degree_hours: float | None = None
    kind: Literal["energy", "comfort", "none"] = "none"
    basis: Message | None = None
    why: Message | None = None

    def document(self) -> JsonObject:
        """Plain data; units stand in the names."""
        told = {_COST.get(f.name, f.name): getattr(self, f.name) for f in fields(self)}
        return told | {k: "" if told[k] is None else told[k].document() for k in ("basis", "why")}

    @classmethod
    def read(cls, document: JsonObject | float) -> Cost:
        """What :meth:`document` wrote; a bare number is a value."""
        if not isinstance(document, dict):
            return cls(value=float(document))
        known = {f.name: document.get(_COST.get(f.name, f.name), f.default) for f in fields(cls)}
        said = {k: Message.read(known[k]) if known[k] else None for k in ("basis", "why")}
        return cls(**{**known, **said, "currency": str(known["currency"] or "EUR")})


_COST = {
    "energy": "kWh_per_day",
    "half_width": "kWh_per_day_half_width",
    "degree_hours": "degree_hours_per_day",
}


@dataclass(frozen=True, slots=True)
class Entry:
    """A step in an alarm's history: by the service for a ``reason``, by a person with a ``comment`` that stands."""

    time: int
    state: str
    actor: str
    comment: str = ""
    reason: Message | None = None
    through: str = ""

    def document(self) -> JsonObject:
        """Plain data; ``comment`` is the person's text or the service's reason."""
        said = self.comment if self.reason is None else self.reason.document()
        told = {"time": self.time, "state": self.state, "actor": self.actor, "comment": said}
        return told | ({"through": self.through} if self.through else {})

    @classmethod
    def read(cls, document: JsonObject) -> Entry:
        """What :meth:`document` wrote."""
        said = document.get("comment", "")
        reason = Message.read(said) if isinstance(said, dict) else None
        return cls(
            int(document["time"]),
            str(document.get("state", "")),
            str(document.get("actor", "")),
            "" if reason else str(said),
            reason,
            str(document.get("through", "")),
        )


@dataclass(frozen=True, slots=True)
class Evidence:
    """What an alarm rests on, and what is known of it.

    Attributes
    ----------
    charts : that passed their limits, by name
    points : measurements that it suspects
    kind, place : what it speaks of; the place of equipment that is watched by rows
    caused_by : key of the alarm that explains it
    shelved_until : [ns]
    departure : changes of parameters and shifts of outputs since the onset, as plain numbers
    cost : a day
    not_diagnosed : why the diagnosis failed
    notes : what else was found, by name: ``heat_balance``, ``watched_by``
    """

    charts: Mapping[str, ChartEvidence] = field(default_factory=dict)
    points: tuple[str, ...] = ()
    kind: AlarmKind = AlarmKind.PLANT
    place: str = ""
    caused_by: str = ""
    shelved_until: int | None = None
    departure: Mapping[str, Any] | None = None
    cost: Cost | None = None
    not_diagnosed: Message | None = None
    notes: Mapping[str, Message] = field(default_factory=dict)

    def document(self) -> JsonObject:
        """Plain data: what is not known is left out; ``kind`` is left out for the plant, and holds a place's name."""
        told: JsonObject = {
            "charts": {name: c.document() for name, c in self.charts.items()},
            "points": list(self.points),
        }
        if self.kind is not AlarmKind.PLANT:
            told["kind"] = self.place or str(self.kind)
        if self.caused_by:
            told["caused_by"] = self.caused_by
        if self.shelved_until is not None:
            told["shelved_until"] = self.shelved_until
        if self.departure is not None:
            told["departure"] = self.departure
        if self.cost is not None:
            told["cost_per_day"] = self.cost.document()
        if self.not_diagnosed is not None:
            told["not_diagnosed"] = self.not_diagnosed.document()
        return told | {k: m.document() for k, m in self.notes.items()}

    @classmethod
    def read(cls, document: JsonObject) -> Evidence:
        """What :meth:`document` wrote; charts of kinds that there are no more are left out."""
        kind, place = kind_of(document)
        cost, why = document.get("cost_per_day"), document.get("not_diagnosed")
        until = document.get("shelved_until")
        return cls(
            {n: ChartEvidence.read(n, c) for n, c in document.get("charts", {}).items() if has_kind(n)},
            tuple(document.get("points", ())),
            kind,
            place,
            str(document.get("caused_by", "")),
            None if until is None else int(until),
            document.get("departure"),
            None if cost is None else Cost.read(cost),
            None if why is None else Message.read(why),
            {k: Message.read(document[k]) for k in NOTES if k in document},
        )


NOTES = ("heat_balance", "watched_by")


def kind_of(document: JsonObject) -> tuple[AlarmKind, str]:
    """The kind of an alarm, and its place, from the document of its evidence."""
    said = str(document.get("kind", AlarmKind.PLANT))
    if said in (AlarmKind.PLANT, AlarmKind.MODEL):
        return AlarmKind(said), ""
    return AlarmKind.PLACE, said


def _names(kind: type) -> set[str]:
    return {f.name for f in fields(kind)}


def _given(record: ChartEvidence) -> JsonObject:
    """The fields that are not None, as plain data."""
    values = {f.name: getattr(record, f.name) for f in fields(record)}
    return {k: _plain(v) for k, v in values.items() if v is not None}
