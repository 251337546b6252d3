"""What a report has to know of a site besides the store: names for people, units and the promise made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError


class ReportError(Exception):
    """A report that cannot be made; the text says what, where and the remedy."""


class OutputInfo(NamedTuple):
    """A measured output of a component: the point it is read from ("" = not measured), SI unit, meaning."""

    point: str
    unit: str
    meaning: str


class ParameterInfo(NamedTuple):
    """A physical parameter of a component: SI unit and meaning."""

    unit: str
    meaning: str


@dataclass(frozen=True)
class ComponentInfo:
    """One piece of equipment as people know it.

    ``outputs`` maps symbol to (point, unit, meaning), ``parameters`` symbol to (unit, meaning); plain tuples will do.
    ``model`` is the model's title in words; ``daily`` equipment is judged once a day, without a filter.
    """

    title: str
    model: str
    outputs: Mapping[str, OutputInfo] = field(default_factory=dict)
    parameters: Mapping[str, ParameterInfo] = field(default_factory=dict)
    location: str = ""
    daily: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "outputs", {s: OutputInfo(*o) for s, o in self.outputs.items()})
        object.__setattr__(self, "parameters", {s: ParameterInfo(*p) for s, p in self.parameters.items()})

    def meaning(self, symbol: str) -> str:
        """What a symbol stands for; the symbol itself where nobody has said."""
        if symbol in self.outputs:
            return self.outputs[symbol].meaning or symbol
        if symbol in self.parameters:
            return self.parameters[symbol].meaning or symbol
        return symbol


@dataclass(frozen=True)
class SiteInfo:
    """One site as people know it.

    Attributes
    ----------
    name : of the site
    zone : IANA time zone in which the report's times are given
    false_alarms_per_year : the budget, for the whole plant [1/a]
    components : name to what it is, in the order they are reported
    tariffs : ``currency`` and prices per kWh (``heat``, ``cooling``, ``electricity``), where known
    language : of the report and of lists of alarms
    """

    name: str
    zone: str
    false_alarms_per_year: float
    components: Mapping[str, ComponentInfo]
    tariffs: Mapping[str, float | str | None] = field(default_factory=dict)
    language: str = "en"

    @cached_property
    def tz(self) -> ZoneInfo:
        """The time zone.

        Raises
        ------
        ReportError : there is no zone of that name
        """
        try:
            return ZoneInfo(self.zone)
        except (ZoneInfoNotFoundError, ValueError):
            raise ReportError(
                f"site {self.name!r}: there is no time zone {self.zone!r}; give an IANA name such as Europe/Berlin"
            ) from None

    @property
    def currency(self) -> str:
        """Currency of the tariffs."""
        return str(self.tariffs.get("currency") or "EUR")

    def component(self, name: str) -> ComponentInfo:
        """What is known of a component; its bare name where it has left the site file."""
        return self.components.get(name) or ComponentInfo(title=name, model="no longer in the site file")
