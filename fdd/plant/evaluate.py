"""What happens at the beginning of a step: outputs, blocks and sensors, as one generated function.

All signals stand in one array; a slot is a signal's place in it. The equations of outputs and blocks are traced like a
model's and written out in an order in which each needs only what stands before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.trace import Expr, Graph, Level, Namespace
from fdd.plant.compiled import compiled
from fdd.plant.network import MEASURED, Network, PlantError
from fdd.records import FloatArray

PART = 24  # outputs, blocks and sensors in one generated function
_INFIX = {"add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


class Evaluator:
    """Signals, memories and settings of a plant, and the function that fills them.

    ``plain`` runs the function as ordinary Python: slower by some 0.3 us an operation, and ready at once.

    Attributes
    ----------
    slots : signal name to its place in ``signals``
    signals : shape (size,), values of the last step
    measured_slots : places of the measured points, in the order of the sensors
    first_state : component name to the place of its first state in the plant's state vector
    """

    def __init__(self, network: Network, plain: bool = False) -> None:
        self.network = network
        order = network.order()
        names = list(network.signals)
        for name, c in network.components.items():
            own = {q.symbol for q in c.model.outputs}
            names += [f"{name}.{s.symbol}" for s in c.model.states if s.symbol not in own]
            names += [f"{name}.{q.symbol}" for q in c.model.outputs]
        names += [f"{n}.{q.symbol}" for n, c in network.controllers.items() for q in c.block.outputs]
        names += [MEASURED + point for point in network.sensors]
        self.slots = {name: i for i, name in enumerate(names)}
        self.size = len(names)
        self.signals = np.zeros(self.size)
        self.measured_slots = np.array([self.slots[MEASURED + p] for p in network.sensors], dtype=np.int64)
        self.first_state, at = {}, 0
        for name, c in network.components.items():
            self.first_state[name] = at
            at += len(c.model.states)
        self._memory_at = self._places(lambda c: [m.symbol for m in c.block.memory])
        self._setting_at = self._places(lambda c: list(c.settings))
        self.memory = np.array([m.value for c in network.controllers.values() for m in c.block.memory])
        self.settings = np.array([v for c in network.controllers.values() for v in c.settings.values()])
        parameters = [v for c in network.components.values() for v in c.parameters.values()]
        self.parameters = np.array(parameters)
        self._function = self._compile(order, plain)
        self._started = False

    def _places(self, symbols: Callable[[Any], list[str]]) -> dict[str, int]:
        keys = [f"{name}.{s}" for name, c in self.network.controllers.items() for s in symbols(c)]
        return {key: i for i, key in enumerate(keys)}

    def step(
        self,
        outside: FloatArray,
        x: FloatArray,
        gain: FloatArray,
        offset: FloatArray,
        frozen: NDArray[np.bool_],
        source: NDArray[np.int64],
    ) -> None:
        """Fill ``signals`` from the outside signals, the states and what the sensors are like."""
        self.signals[: len(outside)] = outside
        self._function(self.signals, x, self.memory, self.settings, self.parameters, gain, offset, frozen, source)

    def setter(self, owner: str, symbol: str) -> Callable[[float], None]:
        """How to change a block's setting."""
        key = f"{owner}.{symbol}"
        if key not in self._setting_at:
            raise PlantError(
                f"no setting is called {key!r}; it has {', '.join(self.network.controllers[owner].settings)}"
            )

        def put(value: float) -> None:
            self.settings[self._setting_at[key]] = value

        return put

    def initial_states(self) -> FloatArray:
        """Given initial values; 20 degC, or 0 for what is no temperature."""
        values = []
        for c in self.network.components.values():
            for s in c.model.states:
                values.append(c.initial.get(s.symbol, 20.0 if s.unit == "degC" else 0.0))
        return np.array(values, dtype=np.float64)

    def _compile(self, order: list[tuple[str, str]], plain: bool) -> Callable[..., None]:
        copies = []
        for name, c in self.network.components.items():
            own = {q.symbol for q in c.model.outputs}
            for i, state in enumerate(c.model.states):
                if state.symbol not in own:
                    copies.append(f"s[{self.slots[f'{name}.{state.symbol}']}] = x[{self.first_state[name] + i}]")
        writers = {"output": self._output, "block": self._block, "sensor": self._sensor}
        pieces = [copies, *(writers[kind](name) for kind, name in order)]
        arguments = "s, x, m, p, q, gain, offset, frozen, source"
        # Short functions compile in a time that grows with their number only; one long one would take its square.
        parts = [list(chain.from_iterable(pieces[i : i + PART])) for i in range(0, len(pieces), PART)]
        text = "".join(
            f"@jit\ndef part{k}({arguments}):\n    " + "\n    ".join([*lines, "return"]) + "\n\n\n"
            for k, lines in enumerate(parts)
        )
        calls = "\n    ".join(f"part{k}({arguments})" for k in range(len(parts)))
        text += f"@jit\ndef evaluate({arguments}):\n    {calls}\n"
        if not plain:
            function: Callable[..., None] = compiled(text).evaluate
            return function
        scope: dict[str, Any] = {f: getattr(math, f) for f in ("exp", "log", "sqrt", "tanh", "sin", "cos", "fabs")}
        exec(compile(text.replace("@jit\n", ""), "<plant>", "exec"), scope)
        interpreted: Callable[..., None] = scope["evaluate"]
        return interpreted

    def _output(self, port: str) -> list[str]:
        owner, _, symbol = port.rpartition(".")
        c, writer = self.network.components[owner], _Writer(f"{self.slots[port]}")
        first = self.first_state[owner]
        offset = list(self.network.components).index(owner)
        base = sum(len(list(self.network.components.values())[i].parameters) for i in range(offset))
        x = writer.names("state", owner, {s.symbol: f"x[{first + i}]" for i, s in enumerate(c.model.states)})
        u = writer.names("input", owner, self._wired(owner, [q.symbol for q in c.model.inputs]))
        p = writer.names("parameter", owner, {q: f"q[{base + i}]" for i, q in enumerate(c.parameters)})
        return writer.assign({f"s[{self.slots[port]}]": c.model.observe(x, u, p)[symbol]})

    def _block(self, name: str) -> list[str]:
        c, writer = self.network.controllers[name], _Writer(name.replace("-", "_"))
        memories = {m.symbol: f"m[{self._memory_at[f'{name}.{m.symbol}']}]" for m in c.block.memory}
        m = writer.names("memory", name, memories)
        u = writer.names("input", name, self._wired(name, [q.symbol for q in c.block.inputs]))
        p = writer.names("setting", name, {s: f"p[{self._setting_at[f'{name}.{s}']}]" for s in c.settings})
        outputs, kept = c.block.step(m, u, p)
        targets = {f"s[{self.slots[f'{name}.{q.symbol}']}]": outputs[q.symbol] for q in c.block.outputs}
        return writer.assign(targets | {memories[k]: v for k, v in kept.items()})

    def _wired(self, owner: str, symbols: list[str]) -> Mapping[str, str]:
        return {s: f"s[{self.slots[self.network.wires[f'{owner}.{s}']]}]" for s in symbols}

    def _sensor(self, point: str) -> list[str]:
        j, slot = list(self.network.sensors).index(point), self.slots[MEASURED + point]
        return [f"if not frozen[{j}]:", f"    s[{slot}] = gain[{j}] * s[source[{j}]] + offset[{j}]"]


class _Writer:
    """Python lines from traced expressions."""

    def __init__(self, prefix: str) -> None:
        self.graph, self.prefix = Graph(), "".join(ch if ch.isalnum() else "_" for ch in prefix)
        self.known: dict[int, str] = {}
        self.lines: list[str] = []

    def names(self, kind: str, owner: str, places: Mapping[str, str]) -> Namespace:
        """Symbols that stand for places of arrays."""
        symbols = {s: self.graph.symbol(f"{kind} {s}", Level.STATE) for s in places}
        self.known |= {symbols[s].index: place for s, place in places.items()}
        return Namespace(kind, owner, symbols)

    def assign(self, targets: Mapping[str, Any]) -> list[str]:
        """All values first, then the assignments, so that a memory is read before it is written."""
        values = {target: self(self.graph.wrap(e)) for target, e in targets.items()}
        return [*self.lines, *(f"{target} = {value}" for target, value in values.items())]

    def __call__(self, e: Expr) -> str:
        if e.op == "constant":
            return repr(e.value)
        if e.index not in self.known:
            a = [self(arg) for arg in e.args]
            name = self.known[e.index] = f"v{self.prefix}_{e.index}"
            self.lines.append(f"{name} = {_operation(e.op, a)}")
        return self.known[e.index]


def _operation(op: str, a: list[str]) -> str:
    if op in _INFIX:
        return f"{a[0]} {_INFIX[op]} {a[1]}"
    if op == "neg":
        return f"-{a[0]}"
    if op == "where":
        return f"{a[1]} if {a[0]} else {a[2]}"
    if op in ("min", "max"):
        return f"{a[0]} if {a[0]} {'<' if op == 'min' else '>'} {a[1]} else {a[1]}"
    return f"{'fabs' if op == 'abs' else op}({a[0]})"
