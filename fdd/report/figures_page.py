"""A page of tables and plots in one HTML file that needs nothing else; for scores and chart designs."""

from __future__ import annotations

import base64
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from fdd.report.plots import STYLE

HASHED: dict[str, Any] = {"svg.hashsalt": "fdd"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A plot as a data address, and what it shows in words."""

    source: str
    alt: str


@dataclass(frozen=True, slots=True)
class Part:
    """A section: a table, plots, or both."""

    title: str
    head: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    figures: Sequence[Picture] = ()
    note: str = ""


def picture(figure: Figure, alt: str) -> Picture:
    """A figure as SVG that gives the same bytes every time."""
    buffer = io.BytesIO()
    with mpl.rc_context(HASHED):  # type: ignore[arg-type]
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    return Picture("data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode(), alt)


def drawn(draw: Callable[[Figure], None], alt: str, size: tuple[float, float] = (7.2, 3.0)) -> Picture:
    """A picture in the house style; ``draw`` fills the figure."""
    with mpl.rc_context(STYLE):  # type: ignore[arg-type]
        figure = Figure(figsize=size, layout="constrained")
        draw(figure)
        return picture(figure, alt)


def write_page(path: Path, title: str, kicker: str, lines: Sequence[str], parts: Sequence[Part]) -> Path:
    """Write the page; its folder is made where it is missing."""
    environment = Environment(
        loader=PackageLoader("fdd.report", "."), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    assert environment.loader is not None
    css = environment.loader.get_source(environment, "style.css")[0]
    html = environment.get_template("figures_page.html.j2").render(
        title=title, kicker=kicker, lines=lines, parts=parts, css=Markup(css)
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(html, encoding="utf-8")
    return path
