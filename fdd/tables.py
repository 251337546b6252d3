"""What every table of the site file shares: frozen, unknown keys refused with the nearest known one, durations."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Annotated, Any
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from fdd.units import UnitError, conversion, seconds


class ConfigError(ValueError):
    """A site file that cannot be used: which key, on which line, what is wrong, what to do.

    ``others`` holds the further errors of the same file, so that one run shows them all.
    """

    def __init__(self, key: str, line: int, problem: str, remedy: str = "", *, file: str = "") -> None:
        self.key, self.line, self.problem, self.remedy, self.file = key, line, problem, remedy, file
        self.others: tuple[ConfigError, ...] = ()
        super().__init__(key, line, problem, remedy)

    def __str__(self) -> str:
        place = f"{self.file or 'site file'}, line {self.line}" if self.line else (self.file or "site file")
        text = f"{place}: {self.key}: {self.problem}" if self.key else f"{place}: {self.problem}"
        text = f"{text.rstrip('.')}. {self.remedy}" if self.remedy else text
        return "\n".join([text, *map(str, self.others)])


def refusal(problem: str, remedy: str = "", key: str = "") -> PydanticCustomError:
    """An error raised inside validation; ``key`` extends the place pydantic knows."""
    # Braces in the text would be read as a template.
    return PydanticCustomError("refused", "{problem}", {"problem": problem, "remedy": remedy, "key": key})


def suggestion(word: str, known: list[str]) -> str:
    """Nearest known word, or all of them."""
    close = get_close_matches(word, known, n=1, cutoff=0.5)
    return f"Did you mean {close[0]!r}?" if close else f"Known here: {', '.join(known) or 'nothing'}."


class Strict(BaseModel):
    """A table of the site file."""

    model_config = ConfigDict(frozen=True, extra="forbid", arbitrary_types_allowed=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, table: Any) -> Any:
        if isinstance(table, dict):
            known = [f.alias or name for name, f in cls.model_fields.items()]
            for key in table:
                if key not in known:
                    raise refusal(f"unknown key {key!r}", suggestion(str(key), known), str(key))
        return table


class SourceOptions(Strict):
    """What every source has; each kind adds its own keys next to its code."""

    kind: str = Field(description="which kind of source: csv, excel, parquet, zenoh, mqtt, bacnet, plant")
    name: str = Field(default="", description="name of this source where there are several; defaults to its kind")

    @property
    def label(self) -> str:
        """Name in positions and counters."""
        return self.name or self.kind


def _duration(value: Any) -> Any:
    try:
        return seconds(value)
    except UnitError as error:
        raise refusal(error.statement, error.remedy) from None


def _positive(value: float) -> float:
    if value <= 0:
        raise refusal(f"{value:g} s is not positive", "Give a duration above zero, like '5 min'.")
    return value


def _not_negative(value: float) -> float:
    if value < 0:
        raise refusal(f"{value:g} s is negative", "Give zero or more, like '0 s'.")
    return value


def _zone(value: str) -> str:
    try:
        ZoneInfo(value)
    except Exception:  # zoneinfo raises OSError, ValueError and KeyError alike
        raise refusal(f"{value!r} is no time zone", "Use an IANA name such as Europe/Copenhagen, or UTC.") from None
    return value


def _unit(value: Any) -> Any:
    text = "1" if value in (1, "1") else value
    if not isinstance(text, str):
        raise refusal(f"{value!r} is no unit", 'Write it as text: unit: degC, unit: "%", unit: "1".')
    try:
        conversion(text)
    except UnitError as error:
        raise refusal(error.statement, error.remedy) from None
    return text


# Seconds inside, text with a unit in the file.
Duration = Annotated[float, BeforeValidator(_duration), AfterValidator(_positive)]
DurationOrZero = Annotated[float, BeforeValidator(_duration), AfterValidator(_not_negative)]
Zone = Annotated[str, AfterValidator(_zone)]
UnitText = Annotated[str, BeforeValidator(_unit)]
