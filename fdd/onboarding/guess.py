"""A guess, how sure it is, and why: what every part of the draft hands on to the review."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Sureness = Literal["sure", "likely", "unsure"]
ORDER: tuple[Sureness, ...] = ("unsure", "likely", "sure")


@dataclass(frozen=True, slots=True)
class Guess:
    """One value of the draft: its ``key``, what it was taken for, how sure, why, and what else it may be."""

    key: str
    value: str
    sureness: Sureness
    why: str
    others: tuple[str, ...] = ()


class ExportError(ValueError):
    """An export that cannot be read; the text says which file, what was expected and what to do."""


def graded(probability: float) -> Sureness:
    """``sure`` from 0.97, ``likely`` from 0.8, else ``unsure``."""
    return "sure" if probability >= 0.97 else "likely" if probability >= 0.8 else "unsure"
