"""Languages: all that the service says stands in a catalogue file, one a language."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

from fdd.evidence import ChartKind

FILES = resources.files("fdd.report") / "catalogue"
ENGLISH = "en"


@dataclass(frozen=True)
class Language:
    """One catalogue: templates by section and code."""

    code: str
    sections: Mapping[str, Mapping[str, str]]

    def chart(self, kind: ChartKind) -> str:
        """The title of a kind of chart."""
        return self.sections["charts"][kind]

    def message(self, code: str) -> str:
        """The template of a message."""
        return self.sections["messages"][code]

    def words(self, code: str, **arguments: Any) -> str:
        """A part of a sentence, with its arguments."""
        return self.sections["words"][code].format(**arguments)

    def declared(self, text: str) -> str:
        """A text of a model's declaration: its own in English, else its translation, or itself where there is none."""
        return self.sections.get("declared", {}).get(text, text)


def languages() -> tuple[str, ...]:
    """Codes of the languages that there are."""
    return tuple(sorted(f.name.removesuffix(".toml") for f in FILES.iterdir() if f.name.endswith(".toml")))


@cache
def language(code: str = ENGLISH) -> Language:
    """The catalogue of a language, by its code (``en``).

    Raises
    ------
    ValueError : there is no such catalogue
    """
    if code not in languages():
        raise ValueError(f"there is no catalogue for the language {code!r}; there are {', '.join(languages())}")
    return Language(code, tomllib.loads((FILES / f"{code}.toml").read_text(encoding="utf-8")))
