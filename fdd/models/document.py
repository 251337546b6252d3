"""A page for every model, made from its declaration: ``python -m fdd.models.document [--check]``.

``--check`` writes nothing and fails where a page is missing or stale, so that equations and pages cannot part.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import sympy
from rich.console import Console

from fdd.models.declare import ComponentModel, Quantity
from fdd.models.registry import MODELS, get_model

FOLDER = Path(__file__).resolve().parents[2] / "docs" / "models"
# Shown with options where the default hides what the paper is about.
SHOWN: Mapping[str, Mapping[str, Any]] = {"heat_exchanger": {"compartments": 2}, "pipe_thermal": {"compartments": 2}}

FAULTS = """Which fault moves which parameter: [measured in simulation](faults/matrix.md), also
[as data](faults/matrix.json). Models [on measured data](faults/measured.md), and
[a simulated air handler](faults/air-handler-plant.md) watched by the engine.
"""


def page(name: str) -> str:
    """The Markdown page of one model."""
    model = get_model(name)
    shown = get_model(name, **SHOWN.get(name, {}))
    about = (sys.modules[MODELS[name].__module__].__doc__ or "").strip()
    parts = [
        "<!-- Made by python -m fdd.models.document; do not edit. -->",
        f"# {model.title}",
        f"`{name}`, version {model.version}. Options: {_options(model)}.",
        f"```text\n{about}\n```",
        "## Equations",
        _equations(shown, SHOWN.get(name)),
        "## Sensors and range",
        _sensors(model),
        "## Quantities",
        _table(("symbol", "unit", "role", "meaning", "holds in"), _quantities(model)),
        "## Parameters",
        _table(("symbol", "unit", "typical", "bounds", "scale", "meaning", "source"), _parameters(model)),
        "## Faults",
        _table(("fault", "meaning", "shows through", "check first"), _faults(model)),
        "## References",
        "\n".join(f"* {r}" for r in model.references),
    ]
    return "\n\n".join(parts) + "\n"


def index() -> str:
    """The list of all models."""
    rows = []
    for name in sorted(MODELS):
        m = get_model(name)
        needed = ", ".join(f"`{q.symbol}`" for q in (*m.inputs, *m.outputs))
        rows.append((f"[{m.title}]({name}.md)", f"`{name}`", str(len(m.states)), str(len(m.parameters)), needed))
    head = "<!-- Made by python -m fdd.models.document; do not edit. -->\n\n# Component models\n\n"
    return head + _table(("model", "name", "states", "parameters", "points it needs"), rows) + "\n\n" + FAULTS


def pages() -> dict[str, str]:
    """File name to text of every page."""
    return {"README.md": index(), **{f"{name}.md": page(name) for name in sorted(MODELS)}}


def stale(folder: Path = FOLDER) -> list[str]:
    """Names of pages that are missing or not what the declarations say."""
    return [n for n, text in pages().items() if not (folder / n).is_file() or (folder / n).read_text("utf-8") != text]


def _options(model: ComponentModel) -> str:
    return ", ".join(f"`{k}={v!r}`" for k, v in model.options.items()) or "none"


def _equations(model: ComponentModel, options: Mapping[str, Any] | None) -> str:
    symbols = {
        kind: SimpleNamespace(**{q.symbol: sympy.Symbol(_symbol(q.symbol), real=True) for q in table})
        for kind, table in (("x", model.states), ("u", model.inputs), ("p", model.parameters))
    }
    args = (symbols["x"], symbols["u"], symbols["p"])
    rates, outputs = model.drift(*args), model.observe(*args)
    lines = [rf"\frac{{d {_latex(q)}}}{{dt}} &= {sympy.latex(sympy.sympify(rates[q.symbol]))}" for q in model.states]
    lines += [rf"{_latex(q)} &= {sympy.latex(sympy.sympify(outputs[q.symbol]))}" for q in model.outputs]
    note = f"Shown with {', '.join(f'`{k}={v}`' for k, v in options.items())}.\n\n" if options else ""
    body = " \\\\\n".join(lines)
    return f"{note}$$\n\\begin{{aligned}}\n{body}\n\\end{{aligned}}\n$$"


def _symbol(name: str) -> str:
    head, _, tail = name.partition("_")
    return f"{head}_{{{tail.replace('_', ',')}}}" if tail else head


def _latex(q: Quantity) -> str:
    return str(sympy.latex(sympy.Symbol(_symbol(q.symbol))))


def _sensors(model: ComponentModel) -> str:
    needed = ", ".join(f"`{q.symbol}` ({q.meaning})" for q in (*model.inputs, *model.outputs))
    units = {q.symbol: q.unit for q in (*model.inputs, *model.outputs)}
    ranges = ", ".join(f"`{s}` from {low:g} to {high:g} {units[s]}" for s, (low, high) in model.valid.items())
    return f"Needs at least: {needed}; an input may be a constant where it hardly varies.\n\nHolds for {ranges}."


def _quantities(model: ComponentModel) -> Iterable[Sequence[str]]:
    for role, table in (("state", model.states), ("input", model.inputs), ("output", model.outputs)):
        for q in table:
            low, high = model.valid.get(q.symbol, (None, None))
            yield (f"`{q.symbol}`", q.unit, role, q.meaning, "" if low is None else f"{low:g} to {high:g}")


def _parameters(model: ComponentModel) -> Iterable[Sequence[str]]:
    for p in model.parameters:
        bounds = f"{p.lower:g} to {p.upper:g}"
        yield (f"`{p.symbol}`", p.unit, f"{p.typical:g}", bounds, p.transform, p.meaning, p.source)


def _faults(model: ComponentModel) -> Iterable[Sequence[str]]:
    for f in model.faults:
        shows = ", ".join(f"`{s}` {('either way', 'up', 'down')[sign]}" for s, sign in f.shows.items())
        yield (f.name, f.meaning, shows, "; ".join(f.checks))


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    lines += [f"| {' | '.join(c.replace('|', chr(92) + '|') for c in row)} |" for row in rows]
    return "\n".join(lines)


def main(arguments: Sequence[str]) -> int:
    """Write the pages, or check them."""
    console = Console()
    old = stale()
    if "--check" in arguments:
        for name in old:
            console.print(f"docs/models/{name} is stale; run: python -m fdd.models.document")
        return 1 if old else 0
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in pages().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
    console.print(f"{len(pages())} pages, {len(old)} new, in docs/models")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
