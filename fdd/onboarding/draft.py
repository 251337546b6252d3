"""The draft of a site file as YAML, with what is unsure said beside it; it loads as it stands."""

from __future__ import annotations

import io
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from fdd.onboarding.export import ExportSource, sampling
from fdd.onboarding.guess import Guess
from fdd.onboarding.quantity import Found
from fdd.onboarding.roles import NO_SUN, Part

_STEPS = (60, 300, 600, 900, 1800, 3600)
_WORDS = {60: "1 min", 300: "5 min", 600: "10 min", 900: "15 min", 1800: "30 min", 3600: "1 h"}
_GATES = {"heat_exchanger": ("m_flow_hot", "m_flow_cold"), "radiator": ("m_flow",), "gordon_ng": ("power",),
          "air_handler": ("fan",), "pump": ("speed",)}  # fmt: skip
"""What says that a machine runs."""


@dataclass(frozen=True)
class Draft:
    """What is known of a site before it is written."""

    name: str
    zone: Guess
    sources: Sequence[ExportSource]
    found: Sequence[Found]
    parts: Sequence[Part]
    source_of: Mapping[str, str]

    @property
    def names(self) -> dict[str, str]:
        """Point name of every column."""
        taken: dict[str, str] = {}
        for f in self.found:
            key = symbol(f.series.title or f.series.name)
            number, made = 2, key
            while made in taken.values():
                made, number = f"{key}_{number}", number + 1
            taken[f.series.name] = made
        return taken

    @property
    def used(self) -> set[str]:
        """Columns that equipment uses."""
        return {column for part in self.parts for column in part.roles.values()}

    @property
    def step(self) -> int:
        """Length of a frame [s]: the usual sampling, not below five minutes."""
        usual = max((sampling(s) for s in self.sources), default=300.0)
        return next((s for s in _STEPS if s >= max(300.0, 0.9 * usual)), 3600)


def symbol(text: str) -> str:
    """A name that a site file takes."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-") or "point"


def write(draft: Draft, folder: Path) -> str:
    """YAML of the draft, paths relative to ``folder`` where they lie within it."""
    names, used = draft.names, draft.used
    site = CommentedMap({"name": draft.name, "zone": draft.zone.value, "step": _WORDS[draft.step]})
    _remark(site, "zone", draft.zone)
    if draft.step > 1200:
        site["max_gap"] = "3 h"
    if _sparse(draft):
        site["hold"] = "1 h"
        site.yaml_add_eol_comment("unsure: points are recorded as they change", "hold")
    site["false_alarms_per_year"] = 2
    if draft.sources:
        tables = [_source(s.keys, folder) for s in draft.sources]
        site.update({"source": tables[0]} if len(tables) == 1 else {"sources": tables})
    points = CommentedMap()
    for f in draft.found:
        if f.series.name in used:
            points[names[f.series.name]] = _point(f, names, draft)
            _say(points, names[f.series.name], f)
    for part in draft.parts:
        if part.model == "zone" and NO_SUN not in part.roles:
            heat = _quoted(names[part.roles["P_heat"]])
            points["no_sun"] = _flow({"expression": f"0 [W/m^2] * where({heat} > 0 [W], 1, 1)"})
            points.yaml_add_eol_comment("no column holds the sun; the model is told so", "no_sun")
    site["points"] = points
    by_column = {f.series.name: f for f in draft.found}
    site["equipment"] = CommentedMap({p.name: _equipment(p, names, by_column) for p in draft.parts})
    site.yaml_set_start_comment(
        "Drafted from an export. What is marked 'unsure' was guessed: read it before it is used."
    )
    return _dumped(site) + _unused(draft, names)


def _dumped(tree: Any) -> str:
    out = io.StringIO()
    yaml = YAML()
    yaml.width = 110
    yaml.dump(tree, out)
    return out.getvalue()


def _remark(table: CommentedMap, key: str, guess: Guess) -> None:
    if guess.sureness != "sure":
        table.yaml_add_eol_comment(f"{guess.sureness}: {guess.why}", key)


def _say(points: CommentedMap, key: str, f: Found) -> None:
    others = f"; it may be {' or '.join(f.others)}" if f.others else ""
    points.yaml_add_eol_comment(f"{f.quantity}, {f.sureness}: {f.why}{others}", key)


def _source(keys: Mapping[str, Any], folder: Path) -> CommentedMap:
    table = CommentedMap()
    for key, value in keys.items():
        if key == "path":
            value = [_relative(p, folder) for p in value] if isinstance(value, list) else _relative(value, folder)
        table[key] = _flow(value)
    return table


def _relative(path: str, folder: Path) -> str:
    relative = os.path.relpath(Path(path).resolve(), folder.resolve())
    return str(Path(path).resolve()) if relative.startswith(os.path.join("..", "..")) else relative  # noqa: PTH118


def _flow(value: Any) -> Any:
    if isinstance(value, Mapping):
        table = CommentedMap({k: _flow(v) for k, v in value.items()})
        table.fa.set_flow_style()
        return table
    if isinstance(value, list | tuple):
        row = CommentedSeq([_flow(v) for v in value])
        row.fa.set_flow_style()
        return row
    return value


def _point(f: Found, names: Mapping[str, str], draft: Draft) -> CommentedMap:
    table: dict[str, Any] = {}
    if names[f.series.name] != f.series.name:
        table["column"] = f.series.name
    if len(draft.sources) > 1 and f.series.name in draft.source_of:
        table["source"] = draft.source_of[f.series.name]
    table["unit"] = f.unit
    if f.absolute:
        table["quantity"] = "temperature"
    if f.fluid:
        table["fluid"] = f.fluid
    if f.series.name in _regressed(draft):
        table["sensor_sd"] = 0.18 if f.unit.lower().endswith("f") else 0.1
    if f.missing:
        table["missing"] = [float(m) for m in f.missing]
    if f.bounds:
        table["range"] = [float(b) for b in f.bounds]
    flow = _flow(table)
    assert isinstance(flow, CommentedMap)
    return flow


def _regressed(draft: Draft) -> set[str]:
    """Temperatures that a chiller's regression uses: it must know their errors."""
    return {c for p in draft.parts if p.model == "gordon_ng" for r, c in p.roles.items() if r.startswith("T_")}


def _equipment(part: Part, names: Mapping[str, str], found: Mapping[str, Found]) -> CommentedMap:
    from fdd.config.chiller import ROLES
    from fdd.models.registry import get_model

    chiller = part.model == "gordon_ng"
    inputs = {q.symbol for q in ROLES} if chiller else {q.symbol for q in get_model(part.model).inputs}
    table = CommentedMap({"model": part.model})
    roles = {r: names[c] for r, c in part.roles.items()}
    if part.model == "zone" and NO_SUN not in roles:
        roles[NO_SUN] = "no_sun"
        table["parameters"] = _flow({"A_w": {"initial": 1.0, "fixed": True}})
    table["inputs"] = _flow({r: p for r, p in roles.items() if r in inputs})
    outputs = {r: p for r, p in roles.items() if r not in inputs}
    if outputs:
        table["outputs"] = _flow(outputs)
    when = _when(part, names, found)
    if when:
        table["when"] = when
        table.yaml_add_eol_comment("unsure: a twentieth of what is usual while it runs", "when")
        if not chiller:
            table["start_up"] = "20 min"
    if chiller:
        options = {"errors": {"flow_ch": {"relative": 0.05}, "power": {"relative": 0.01}}}
        load = _rated(part, found)
        table["options"] = _flow({"rated_load": load, **options} if load else options)
        table.yaml_add_eol_comment("unsure: the largest load seen [W]; instruments' errors as usual", "options")
    doubtful = [f"{r} ({s})" for r, s in part.sureness.items() if s != "sure"]
    if doubtful:
        table.yaml_set_comment_before_after_key("inputs", before=f"roles to look at: {', '.join(doubtful)}", indent=4)
    return table


def _when(part: Part, names: Mapping[str, str], found: Mapping[str, Found]) -> str:
    """What says that a machine runs, where the record shows that it stands at times."""
    terms = []
    for role in _GATES.get(part.model, ()):
        if role not in part.roles:
            continue
        f = found[part.roles[role]]
        seen = f.in_si(f.series.values)
        seen = seen[np.isfinite(seen)]
        if not len(seen):
            continue
        limit = float(np.percentile(seen, 95)) / 20.0
        if limit > 0 and np.mean(seen < limit) > 0.02:
            name = names[part.roles[role]]
            unit = "" if f.si == "1" else f" [{f.si}]"
            terms.append(f"{_quoted(name)} > {limit:.2g}{unit}")
    return " and ".join(terms)


def _quoted(name: str) -> str:
    """A point's name as expressions take it."""
    return name if re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.]*", name) else f"`{name}`"


def _rated(part: Part, found: Mapping[str, Found]) -> float | None:
    """The largest usual cooling load [W], to two digits."""
    flow, warm, cold = (found[part.roles[r]] for r in ("flow_ch", "T_chi", "T_cho"))
    if not len(flow.series.values) or len(flow.series.values) != len(warm.series.values):
        return None
    load = 4186.0 * flow.in_si(flow.series.values) * (warm.in_si(warm.series.values) - cold.in_si(cold.series.values))
    load = load[np.isfinite(load)]
    return float(f"{np.percentile(load, 99):.2g}") if len(load) and np.percentile(load, 99) > 0 else None


def _sparse(draft: Draft) -> bool:
    """Whether points are recorded when they change: their samples come far apart at times, and irregularly."""
    for source in draft.sources:
        for values in source.values.values():
            seen = source.time[np.isfinite(values)]
            if len(seen) > 20:
                steps = np.diff(seen) / 1e9
                if np.median(steps) * 3 < np.percentile(steps, 90) and np.percentile(steps, 90) > draft.step:
                    return True
    return False


def _unused(draft: Draft, names: Mapping[str, str]) -> str:
    """Points that no equipment uses, as comments that can be taken in."""
    points = CommentedMap()
    for f in draft.found:
        if f.series.name not in draft.used and f.quantity:
            points[names[f.series.name]] = _point(f, names, draft)
            _say(points, names[f.series.name], f)
    if not points:
        return ""
    lines = ["", "# No equipment uses these; move what is wanted under points.", *_dumped(points).splitlines()]
    return "\n".join(line if line.startswith("#") or not line else f"#   {line}" for line in lines) + "\n"
