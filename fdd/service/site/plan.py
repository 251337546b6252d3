"""What the engine watches: a site file, resolved to columns of a frame.

Everything that can be wrong in a site is found here, before the first sample.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fdd.chiller_eiv.config import ChillerConfig
from fdd.config import Equipment, Site, component_model
from fdd.config.chiller import chiller_config, chillers_share, is_chiller
from fdd.config.equipment_rows import has_filter, kind_of, points_of, rows_budget, rows_share, rule_of, sensor_errors
from fdd.expressions import Expression
from fdd.greybox.scale import Prior
from fdd.models.declare import ComponentModel, Parameter
from fdd.models.expectation import EquipmentModel
from fdd.models.structures import Structure, structures
from fdd.records import NANOSECONDS, Baseline, FloatArray


@dataclass(frozen=True, slots=True)
class Derived:
    """A point computed from others: ``compute`` takes columns by name, each (m,), and returns (m,)."""

    name: str
    compute: Callable[[Mapping[str, FloatArray]], FloatArray]


@dataclass(frozen=True, slots=True)
class Component:
    """One piece of equipment under a filter.

    ``inputs`` and ``outputs`` are point names in the order of the model; ``when`` names the column of its gate, which
    is 1 while the machine may be judged; ``start_up`` is how long its charts rest after a start [ns]. ``upstream`` has
    components whose alarm explains this one's; ``charts`` the kinds that watch it (empty: all), ``exclude`` the outputs
    and parameters that get none.
    """

    name: str
    model: ComponentModel
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    when: str | None = None
    start_up: int = 0
    weight: float = 1.0
    upstream: frozenset[str] = frozenset()
    charts: frozenset[str] = frozenset()
    exclude: frozenset[str] = frozenset()
    equipment: Equipment | None = None

    @property
    def plates(self) -> dict[str, tuple[float, float]]:
        """Plate values of the model's parameters, and the factor within which an estimate is theirs."""
        given = self.equipment.parameters if self.equipment is not None else {}
        symbols = [p.symbol for p in self.model.parameters if p.transform == "log"]
        return {s: (p.plate, p.within) for s in symbols if (p := given.get(s)) is not None and p.plate is not None}

    @property
    def priors(self) -> dict[str, Prior]:
        """What plates say of parameters before the data."""
        return {s: Prior(plate, 0.5 * math.log(factor), log=True) for s, (plate, factor) in self.plates.items()}

    def structures(self, step: float, usual: Mapping[str, float]) -> tuple[Structure, ...]:
        """Variants of the model that the site file leaves open, for frames of ``step`` seconds and usual inputs."""
        if self.equipment is None:
            return ()
        said, symbols = {*self.equipment.options, *self.equipment.parameters}, self.model.symbols["parameters"]
        return structures(self.model.name, said, symbols, step, usual)

    def variant(self, options: Mapping[str, Any]) -> Component:
        """The same component with further options of its model."""
        if self.equipment is None:
            return self
        return replace(self, model=_bounded(component_model(self.equipment, options), self.equipment))

    def following(self, baseline: Baseline) -> Component:
        """The component with the variant of its model that a baseline was fitted with.

        What the site file says stands: a baseline of other options is not followed.
        """
        made, said = baseline.options, self.equipment.options if self.equipment is not None else {}
        if baseline.model != self.model.name or _plain(made) == _plain(self.model.options):
            return self
        open_ = {k: v for k, v in made.items() if k not in ("fixed", "tied")}
        if any(_plain(v) != _plain(made.get(k)) for k, v in said.items() if k not in ("fixed", "tied")):
            return self
        return self.variant(open_)

    def carries(self, kind: str, symbol: str) -> bool:
        """Whether a chart of this kind watches this output or parameter."""
        return (not self.charts or kind in self.charts) and symbol not in self.exclude


@dataclass(frozen=True, slots=True)
class Chiller:
    """One chiller: ``inputs`` maps its quantities to columns; ``when`` and ``upstream`` as a component's."""

    name: str
    config: ChillerConfig
    inputs: Mapping[str, str]
    when: str | None = None
    upstream: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class RowEquipment:
    """One piece of equipment watched by rows of expectations.

    ``inputs`` maps roles to columns, ``errors`` roles to their sensors' standard deviations where the site gives them;
    ``when`` and ``upstream`` as a component's.
    """

    name: str
    model: EquipmentModel
    inputs: Mapping[str, str]
    false_alarms_per_year: float
    errors: Mapping[str, float] = field(default_factory=dict)
    when: str | None = None
    upstream: frozenset[str] = frozenset()

    @property
    def baseline(self) -> str:
        """The name its baseline is kept by; a filter of the same equipment has the plain name."""
        return f"{self.name}:rows"


@dataclass(frozen=True, slots=True)
class Plan:
    """All the engine needs to know; times in ns.

    ``false_alarms_per_year`` is the promise for the whole plant; ``apart_per_year`` is what chillers and equipment
    that is watched by rows have of it to themselves, ``filters_per_year`` what is left for the charts on filters.
    """

    site: str
    step: int
    lateness: int
    max_gap: int
    max_jump: int
    hold: int
    false_alarms_per_year: float
    points: tuple[str, ...]
    derived: tuple[Derived, ...]
    components: tuple[Component, ...]
    chillers: tuple[Chiller, ...] = ()
    equipment: tuple[RowEquipment, ...] = ()
    zone: str = "UTC"
    tariffs: Mapping[str, float | str | None] = field(default_factory=dict)
    learning: int = 28 * 86400 * NANOSECONDS
    deadband: float = 0.0
    apart_per_year: float = 0.0

    @property
    def filters_per_year(self) -> float:
        """False alarms a year that the charts on filters may give."""
        return self.false_alarms_per_year - self.apart_per_year

    @property
    def watched(self) -> tuple[Component | Chiller, ...]:
        """Everything that can have a baseline: components, then chillers."""
        return (*self.components, *self.chillers)

    @property
    def baseline_names(self) -> tuple[str, ...]:
        """Names that baselines are kept by, of everything that can have one."""
        return (*(c.name for c in self.watched), *(e.baseline for e in self.equipment))

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of a frame's columns: the measured points, then the derived ones."""
        return (*self.points, *(d.name for d in self.derived))

    def following(self, baselines: Mapping[str, Baseline]) -> Plan:
        """The plan with the variants of models that baselines were fitted with."""
        followed = (c.following(baselines[c.name]) if c.name in baselines else c for c in self.components)
        return replace(self, components=tuple(followed))

    def derive(self, values: FloatArray) -> FloatArray:
        """Columns (m, n_columns) from the measured points' values (m, n_points)."""
        table = {name: values[:, i] for i, name in enumerate(self.points)}
        for derived in self.derived:
            table[derived.name] = np.broadcast_to(derived.compute(table), len(values))
        return np.column_stack([table[name] for name in self.columns])


def plan_of(site: Site) -> Plan:
    """Resolve a checked site; gates become derived columns of 1 and 0."""
    derived = [Derived(name, expression) for name, expression in site.derived.items()]
    components, chillers, rows = [], [], []
    for name, equipment in site.equipment.items():
        gate = site.gate(name)
        when = None
        if gate is not None:
            when = f"{name}/when"
            derived.append(Derived(when, _as_number(gate)))
        if is_chiller(equipment):
            config, upstream = chiller_config(site, name), frozenset(equipment.upstream)
            chillers.append(Chiller(name, config, dict(equipment.inputs), when, upstream))
            continue
        kind = kind_of(equipment)
        mapped = {**equipment.inputs, **equipment.outputs}
        if kind is not None:
            mapped = points_of(equipment, kind)
            errors, upstream = sensor_errors(site, equipment, kind), frozenset(equipment.upstream)
            rows.append(RowEquipment(name, kind, mapped, rows_budget(site, name), errors, when, upstream))
            if not has_filter(equipment):
                continue
        model = _bounded(component_model(equipment), equipment)
        components.append(
            Component(
                name=name,
                model=model,
                inputs=tuple(mapped[q.symbol] for q in model.inputs),
                outputs=tuple(mapped[q.symbol] for q in model.outputs),
                when=when,
                start_up=_nanoseconds(equipment.start_up),
                weight=equipment.weight * (1.0 if kind is None else 0.5),
                upstream=frozenset(equipment.upstream),
                charts=frozenset(equipment.charts.kinds),
                exclude=frozenset(equipment.charts.exclude),
                equipment=equipment,
            )
        )
    for name, rule in site.rules.items():
        expected, condition = site.rule(name)
        derived.append(Derived(f"{name}/expect", expected))
        if condition is not None:
            derived.append(Derived(f"{name}/when", _as_number(condition)))
        kind, budget = rule_of(site, name)
        when = None if condition is None else f"{name}/when"
        rows.append(RowEquipment(name, kind, {"value": f"{name}/expect"}, budget, {}, when, frozenset(rule.upstream)))
    return Plan(
        site=site.name,
        step=_nanoseconds(site.step),
        lateness=_nanoseconds(site.lateness),
        max_gap=_nanoseconds(site.max_gap),
        learning=_nanoseconds(site.learning),
        deadband=site.reidentify.deadband if site.reidentify else 0.0,
        max_jump=_nanoseconds(site.max_jump),
        hold=_nanoseconds(site.hold),
        false_alarms_per_year=site.false_alarms_per_year,
        apart_per_year=site.false_alarms_per_year * (chillers_share(site) + rows_share(site)),
        points=tuple(site.measured),
        derived=tuple(derived),
        components=tuple(components),
        chillers=tuple(chillers),
        equipment=tuple(rows),
        zone=site.zone,
        tariffs=site.tariffs.model_dump(),
    )


def _plain(value: Any) -> str:
    """Options as they come back from a store."""
    return json.dumps(value, sort_keys=True)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * NANOSECONDS)


def _as_number(gate: Expression) -> Callable[[Mapping[str, FloatArray]], FloatArray]:
    return lambda columns: gate.gate(columns).astype(np.float64)


def _bounded(model: ComponentModel, equipment: Equipment) -> ComponentModel:
    """The model with the site's starting values and bounds in place of its own."""

    def given(p: Parameter) -> Parameter:
        spec = equipment.parameters.get(p.symbol)
        if spec is None:
            return p
        lower = p.lower if spec.lower is None else spec.lower
        upper = p.upper if spec.upper is None else spec.upper
        first = p.typical if spec.plate is None else spec.plate
        typical = min(max(first, lower), upper) if spec.initial is None else spec.initial
        return replace(p, typical=typical, lower=lower, upper=upper)

    return replace(model, parameters=tuple(given(p) for p in model.parameters))
