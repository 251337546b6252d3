"""A plant as a small typed graph: components, control blocks and sensors whose named ports are connected.

Ports are named ``owner.symbol`` and carry a unit; only equal units connect. The same component models that the filters
use are simulated here as one system; for monitoring each runs alone and takes its neighbours' *measured* values.

    plant = Network()
    plant.signal("weather.T_out", "degC")
    plant.add("hx", heat_exchanger(), C_hot=8e3)
    plant.connect("hx.T_cold_out", "radiator.T_supply")
    plant.sensor("hx.T_cold_out", noise=0.05)
    plant.connect(measured("hx.T_cold_out"), "controller.T")

Time runs in steps: outputs and blocks are evaluated at a step's beginning and act until its end (zero-order hold), as
a controller's cycle does, and as the filters assume of their inputs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from difflib import get_close_matches
from graphlib import CycleError, TopologicalSorter
from typing import Any

from fdd.greybox.equations import trace
from fdd.models.declare import ComponentModel, Namespace, Quantity

BlockStep = Callable[[Namespace, Namespace, Namespace], tuple[Mapping[str, Any], Mapping[str, Any]]]
MEASURED = "measured "


class PlantError(ValueError):
    """A plant that cannot run; the text names the port, the problem and the remedy."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A block's parameter or memory: symbol, unit, value, meaning."""

    symbol: str
    unit: str
    value: float
    meaning: str


@dataclass(frozen=True, slots=True)
class Block:
    """Control or an ideal element without a state of its own between steps but its memory.

    ``step(memory, u, p)`` returns the outputs and the next memory, each by symbol; it is traced like a model.
    """

    name: str
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    step: BlockStep
    settings: tuple[Setting, ...] = ()
    memory: tuple[Setting, ...] = ()


@dataclass(slots=True)
class Component:
    """A component of the plant with its true parameters."""

    name: str
    model: ComponentModel
    parameters: dict[str, float]
    initial: dict[str, float]


@dataclass(slots=True)
class Controller:
    """A block of the plant with its settings."""

    name: str
    block: Block
    settings: dict[str, float]


@dataclass(frozen=True, slots=True)
class Sensor:
    """A measured point: ``value + value * relative * z1 + noise * z2``; ``source`` is the signal it sees."""

    point: str
    source: str
    unit: str
    noise: float
    relative: float


@dataclass
class Network:
    """Components, blocks, sensors and their connections."""

    signals: dict[str, str] = field(default_factory=dict)
    components: dict[str, Component] = field(default_factory=dict)
    controllers: dict[str, Controller] = field(default_factory=dict)
    sensors: dict[str, Sensor] = field(default_factory=dict)
    wires: dict[str, str] = field(default_factory=dict)

    def signal(self, name: str, unit: str) -> None:
        """Declare a signal from outside: weather, occupancy, a district network's temperature."""
        self._new(name)
        self.signals[name] = unit

    def add(
        self, name: str, model: ComponentModel, initial: Mapping[str, float] | None = None, **parameters: float
    ) -> None:
        """Add a component; parameters not given are typical ones.

        Raises
        ------
        PlantError : name taken, unknown parameter or state, value outside its bounds
        """
        self._new(name)
        known = {p.symbol: p for p in model.parameters}
        for symbol, value in parameters.items():
            if symbol not in known:
                raise PlantError(f"{name}: {model.name} has no parameter {symbol!r}{_nearest(symbol, known)}")
            p = known[symbol]
            if not p.lower <= value <= p.upper:
                raise PlantError(f"{name}: {symbol} = {value} {p.unit} is outside [{p.lower}, {p.upper}] {p.unit}")
        states = [s.symbol for s in model.states]
        for symbol in initial or {}:
            if symbol not in states:
                raise PlantError(f"{name}: {model.name} has no state {symbol!r}{_nearest(symbol, states)}")
        values = {s: p.typical for s, p in known.items()} | parameters
        self.components[name] = Component(name, model, values, dict(initial or {}))

    def control(self, name: str, block: Block, **settings: float) -> None:
        """Add a block; settings not given keep the block's own.

        Raises
        ------
        PlantError : name taken or unknown setting
        """
        self._new(name)
        known = {s.symbol: s.value for s in block.settings}
        for symbol in settings:
            if symbol not in known:
                raise PlantError(f"{name}: block {block.name} has no setting {symbol!r}{_nearest(symbol, known)}")
        self.controllers[name] = Controller(name, block, known | settings)

    def connect(self, source: str, *targets: str) -> None:
        """Wire an output to inputs.

        Raises
        ------
        PlantError : unknown port, units that differ, or an input that is wired already
        """
        unit = self._source_unit(source)
        for target in targets:
            needed = self._input_unit(target)
            if needed != unit:
                raise PlantError(f"{source} [{unit}] cannot feed {target} [{needed}]; the units differ")
            if target in self.wires:
                raise PlantError(f"{target} is already fed by {self.wires[target]}; an input has one source")
            self.wires[target] = source

    def sensor(self, port: str, noise: float = 0.0, relative: float = 0.0, point: str | None = None) -> None:
        """Measure an output, or what feeds an input, as a point named like the port.

        Parameters
        ----------
        noise : standard deviation in the signal's unit
        relative : standard deviation as a share of the value
        """
        source = self.wires.get(port, port)
        if source.startswith(MEASURED):
            source = self.sensors[source.removeprefix(MEASURED)].source
        name = point or port
        if name in self.sensors:
            raise PlantError(f"point {name} is already measured; give the second sensor another point name")
        self.sensors[name] = Sensor(name, source, self._source_unit(source), noise, relative)

    def order(self) -> list[tuple[str, str]]:
        """What to evaluate in a step, sources first: ``("output", port)``, ``("block", name)``, ``("sensor", point)``.

        Raises
        ------
        PlantError : an input without a source, or blocks that wait for each other
        """
        self._check_complete()
        after: dict[tuple[str, str], set[tuple[str, str]]] = {}
        for name, component in self.components.items():
            for q in component.model.outputs:
                needs = [f"{name}.{u}" for u in feedthrough(component.model, q.symbol)]
                after[("output", f"{name}.{q.symbol}")] = {n for t in needs if (n := self._node(self.wires[t]))}
        for name, controller in self.controllers.items():
            sources = [self.wires[f"{name}.{q.symbol}"] for q in controller.block.inputs]
            after[("block", name)] = {n for s in sources if (n := self._node(s))}
        for point, sensor in self.sensors.items():
            after[("sensor", point)] = {n for n in [self._node(sensor.source)] if n}
        try:
            return list(TopologicalSorter(after).static_order())
        except CycleError as error:
            loop = " -> ".join(name for _, name in error.args[1])
            raise PlantError(
                f"blocks wait for each other: {loop}. Put a component with a state or a memory between"
            ) from None

    def _node(self, source: str) -> tuple[str, str] | None:
        if source.startswith(MEASURED):
            return ("sensor", source.removeprefix(MEASURED))
        if source in self.signals:
            return None
        owner, _, symbol = source.rpartition(".")
        if owner in self.controllers:
            return ("block", owner)
        if symbol in [s.symbol for s in self.components[owner].model.states]:
            return None
        return ("output", source)

    def _check_complete(self) -> None:
        for port in self.inputs():
            if port not in self.wires:
                raise PlantError(f"{port} [{self._input_unit(port)}] is not connected; connect a source to it")

    def inputs(self) -> list[str]:
        """All input ports."""
        ports = [f"{n}.{q.symbol}" for n, c in self.components.items() for q in c.model.inputs]
        return ports + [f"{n}.{q.symbol}" for n, c in self.controllers.items() for q in c.block.inputs]

    def _new(self, name: str) -> None:
        if name in self.components or name in self.controllers or name in self.signals:
            raise PlantError(f"the plant already has {name!r}; choose another name")

    def _source_unit(self, source: str) -> str:
        if source.startswith(MEASURED):
            point = source.removeprefix(MEASURED)
            if point not in self.sensors:
                raise PlantError(f"no sensor measures {point!r}{_nearest(point, self.sensors)}; add it first")
            return self.sensors[point].unit
        units = dict(self.signals)
        for name, component in self.components.items():
            units |= {f"{name}.{q.symbol}": q.unit for q in (*component.model.states, *component.model.outputs)}
        for name, controller in self.controllers.items():
            units |= {f"{name}.{q.symbol}": q.unit for q in controller.block.outputs}
        if source not in units:
            raise PlantError(f"no output is called {source!r}{_nearest(source, units)}")
        return units[source]

    def _input_unit(self, target: str) -> str:
        owner, _, symbol = target.rpartition(".")
        quantities: tuple[Quantity, ...] = ()
        if owner in self.components:
            quantities = self.components[owner].model.inputs
        elif owner in self.controllers:
            quantities = self.controllers[owner].block.inputs
        for q in quantities:
            if q.symbol == symbol:
                return q.unit
        raise PlantError(f"no input is called {target!r}{_nearest(target, self.inputs())}")


def measured(point: str) -> str:
    """The measured value of a point, as a source for :meth:`Network.connect`."""
    return MEASURED + point


def feedthrough(model: ComponentModel, output: str) -> tuple[str, ...]:
    """Inputs that an output depends on without delay."""
    system = trace(model)
    h = system.h[[q.symbol for q in model.outputs].index(output)]
    return tuple(q.symbol for q, u in zip(model.inputs, system.u, strict=True) if u.index in h.symbols)


def _nearest(word: str, known: Any) -> str:
    close = get_close_matches(word, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""
