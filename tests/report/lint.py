"""What no report may say: numbers that are none, shares above one, estimates outside intervals, signs against words.

``watching`` puts it under every report that a test renders.
"""

from __future__ import annotations

import html as markup
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

NUMBER = r"[-+−]?\d[\d ]*(?:[.,]\d+)?(?:e[-+]?\d+)?"
UNIT = r"(?: ?(?:%|[A-Za-z°/²³·]+(?:[/·][A-Za-z²³()·]+)*))?"
_NONE = re.compile(r"(?<![\w.-])(?:nan|NaN|inf|None(?! in | of )|null|undefined)(?![\w-])")
_INTERVAL = re.compile(rf"({NUMBER})({UNIT}) \((?:95 %:? ?)?({NUMBER}) to ({NUMBER})\)")
_SHARE = re.compile(r"(\d{3,}(?:\.\d+)?) % (?:likely|probable|sure|certain)")
_SIGN = re.compile(r"[-−]\d[\d.]*(?: ?(?:%|K|W|kW|degC|kg/s))? (?:more|less|higher|lower|above|below)\b")


def text_of(html: str) -> str:
    """What a reader sees, pictures and styles left out."""
    shown = re.sub(r"(?s)<(script|style|svg|head)\b.*?</\1>", " ", html)
    shown = re.sub(r"data:[a-z/+]+;base64,[A-Za-z0-9+/=]+", " ", shown)
    return re.sub(r"\s+", " ", markup.unescape(re.sub(r"(?s)<[^>]+>", " ", shown)))


def faults_in(html: str) -> list[str]:
    """Every statement that cannot be so, with what stands around it."""
    text = text_of(html)
    found = [f"a number that is none: {_around(text, m)}" for m in _NONE.finditer(text)]
    found += [f"a share above one: {_around(text, m)}" for m in _SHARE.finditer(text) if float(m[1]) > 100.0]
    found += [f"a sign against its word: {_around(text, m)}" for m in _SIGN.finditer(text)]
    for m in _INTERVAL.finditer(text):
        value, low, high = (_number(m[i]) for i in (1, 3, 4))
        # A value may be rounded to fewer digits than its limits.
        slack = 0.51 * 10.0 ** -_decimals(m[1]) if "e" not in m[1] else abs(value) * 0.05
        if low > high:
            found.append(f"an interval the wrong way round: {_around(text, m)}")
        elif not low - slack <= value <= high + slack:
            found.append(f"an estimate outside its interval: {_around(text, m)}")
    return found


def _number(text: str) -> float:
    return float(text.replace(" ", "").replace("−", "-").replace(",", "."))


def _decimals(text: str) -> int:
    return len(text.rpartition(".")[2]) if "." in text else 0


def _around(text: str, match: re.Match[str]) -> str:
    return f"...{text[max(0, match.start() - 60) : match.end() + 40]}..."


@contextmanager
def watching() -> Iterator[None]:
    """Every report rendered inside is read; one that says what cannot be fails its test."""
    from fdd.report import render

    plain = render.render_html

    def read(*arguments: Any, **more: Any) -> str:
        html = plain(*arguments, **more)
        faults = faults_in(html)
        assert not faults, "\n".join(faults)
        return html

    render.render_html = read
    try:
        yield
    finally:
        render.render_html = plain
