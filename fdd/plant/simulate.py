"""Run a plant: components by the filters' own kernels, blocks and sensors by one generated function.

A component's step is a draw from what its filter would predict from a known state: mean by the kernel (exact
discretisation where the drift is linear, Runge-Kutta elsewhere) plus noise with the predicted covariance. Components of
the same model step together.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fdd.greybox.equations import trace
from fdd.greybox.kernels import Kernel, kernel
from fdd.models.declare import ComponentModel
from fdd.plant.compiled import advance_function
from fdd.plant.evaluate import Evaluator
from fdd.plant.network import Component, Network, PlantError
from fdd.records import FloatArray

PIECES = 5  # a nonlinear component draws its noise this often within a step


@dataclass(frozen=True, slots=True)
class Change:
    """A course of values, shape (n,), that replaces a parameter (``owner.symbol``) from step to step."""

    target: str
    values: FloatArray


@dataclass(frozen=True, slots=True)
class SensorFault:
    """What a sensor makes of the truth: ``gain * value + offset``, noise times ``noise``; ``frozen`` keeps a value."""

    point: str
    gain: FloatArray
    offset: FloatArray
    noise: FloatArray
    frozen: NDArray[np.bool_]
    swapped_with: str | None = None
    swapped: NDArray[np.bool_] | None = None


@dataclass(frozen=True, slots=True)
class Block:
    """A stretch of simulated time: measured points (n, n_points) and true signals (n, n_signals)."""

    start: int
    measured: FloatArray
    true: FloatArray


class _Kind:
    """All components of one model."""

    def __init__(
        self,
        model: ComponentModel,
        members: Sequence[tuple[int, Component]],
        network: Network,
        slots: Mapping[str, int],
    ) -> None:
        self.kernel: Kernel = kernel(model)
        self.names = [c.name for _, c in members]
        self.pieces = 1 if trace(model).linear else PIECES
        n, module = len(members), self.kernel.module
        self.parameters = np.array([[c.parameters[p.symbol] for p in model.parameters] for _, c in members])
        self.constants = np.zeros((n, module.NC))
        self.work = np.zeros((n, module.SIZE))
        self.inputs = np.array(
            [[slots[network.wires[f"{c.name}.{q.symbol}"]] for q in model.inputs] for _, c in members], dtype=np.int64
        ).reshape(n, len(model.inputs))
        self.first = np.array([at for at, _ in members], dtype=np.int64)
        self.states = len(model.states)
        self.symbols = [p.symbol for p in model.parameters]
        self.advance = advance_function(self.kernel, self.pieces)
        for i in range(n):
            self.prepare(i)

    def prepare(self, i: int) -> None:
        """After a change of parameters."""
        self.kernel.module.prepare(self.parameters[i], self.constants[i])
        if self.kernel.variant.method == "exact":
            self.work[i, self.kernel.module.KEY] = np.nan  # forget the discretisation


class Simulator:
    """Steps a network through time.

    Parameters
    ----------
    network : the plant
    step : length of a step [s]
    seed : everything random comes from it; the same seed gives the same numbers whatever the chunk size
    plain : leave blocks and sensors uncompiled, for a large plant that runs once
    """

    def __init__(self, network: Network, step: float, seed: int, *, plain: bool = False) -> None:
        self.network, self.step = network, step
        self.evaluator = Evaluator(network, plain)
        self.points = list(network.sensors)
        self.outside = list(network.signals)
        process, sensors = np.random.SeedSequence(seed).spawn(2)
        self._sensor_rng = np.random.default_rng(sensors)
        self._x = self.evaluator.initial_states()
        self._kinds = self._group()
        self._process_rng = [np.random.default_rng(s) for s in process.spawn(len(self._kinds))]

    def _group(self) -> list[_Kind]:
        groups: dict[tuple[Any, ...], list[tuple[int, Component]]] = {}
        models: dict[tuple[Any, ...], ComponentModel] = {}
        for name, component in self.network.components.items():
            m = component.model
            key = (m.name, m.version, repr(sorted(m.options.items())))
            models.setdefault(key, m)
            groups.setdefault(key, []).append((self.evaluator.first_state[name], component))
        return [_Kind(models[k], members, self.network, self.evaluator.slots) for k, members in groups.items()]

    def run(
        self,
        outside: Mapping[str, FloatArray],
        changes: Sequence[Change] = (),
        sensor_faults: Sequence[SensorFault] = (),
        chunk: int = 2016,
        progress: Callable[[int, int], None] | None = None,
    ) -> Iterator[Block]:
        """Simulate as many steps as the outside signals have, in blocks of ``chunk`` steps.

        Parameters
        ----------
        outside : each declared signal, shape (n,)
        changes, sensor_faults : courses of shape (n,)
        progress : called with steps done and steps in all

        Raises
        ------
        PlantError : an outside signal or a change's target that the plant does not have, or a state that is not finite
        """
        n = self._length(outside)
        setters = [self._setter(c) for c in changes]
        table = np.column_stack([outside[s] for s in self.outside]) if self.outside else np.zeros((n, 0))
        for start in range(0, n, chunk):
            stop = min(start + chunk, n)
            yield self._chunk(start, stop, table, changes, setters, sensor_faults)
            if progress:
                progress(stop, n)

    def _chunk(
        self,
        start: int,
        stop: int,
        table: FloatArray,
        changes: Sequence[Change],
        setters: Sequence[Callable[[float], None]],
        sensor_faults: Sequence[SensorFault],
    ) -> Block:
        ev, n = self.evaluator, stop - start
        gain, offset, frozen, source = self._sensors(start, stop, sensor_faults)
        noise = [
            rng.standard_normal((n, len(k.first), k.pieces, k.states))
            for rng, k in zip(self._process_rng, self._kinds, strict=True)
        ]
        true = np.empty((n, ev.size))
        for k in range(n):
            for change, setter in zip(changes, setters, strict=True):
                value = change.values[start + k]
                if start + k == 0 or value != change.values[start + k - 1]:
                    setter(float(value))
            ev.step(table[start + k], self._x, gain[k], offset[k], frozen[k], source[k])
            true[k] = ev.signals
            for kind, z in zip(self._kinds, noise, strict=True):
                kind.advance(self._x, ev.signals, kind.inputs, kind.first, kind.constants, kind.work, self.step, z[k])
        if not np.isfinite(self._x).all():
            raise PlantError(
                f"the plant's state is not finite between steps {start} and {stop}; check parameters and wiring"
            )
        return Block(start, true[:, ev.measured_slots], true)

    def _length(self, outside: Mapping[str, FloatArray]) -> int:
        for name in self.outside:
            if name not in outside:
                raise PlantError(f"the plant needs the outside signal {name!r}; give it to run()")
        return len(next(iter(outside.values())))

    def _setter(self, change: Change) -> Callable[[float], None]:
        owner, _, symbol = change.target.rpartition(".")
        if owner in self.network.controllers:
            return self.evaluator.setter(owner, symbol)
        for kind in self._kinds:
            if owner in kind.names and symbol in kind.symbols:
                i, j = kind.names.index(owner), kind.symbols.index(symbol)

                def put(value: float, kind: _Kind = kind, i: int = i, j: int = j) -> None:
                    kind.parameters[i, j] = value
                    kind.prepare(i)

                return put
        raise PlantError(f"no parameter is called {change.target!r}; name it owner.symbol")

    def _sensors(
        self, start: int, stop: int, faults: Sequence[SensorFault]
    ) -> tuple[FloatArray, FloatArray, NDArray[np.bool_], NDArray[np.int64]]:
        """Gain, offset (with noise), frozen and source signal of every sensor over a stretch, each (n, n_points)."""
        n, sensors = stop - start, list(self.network.sensors.values())
        z = self._sensor_rng.standard_normal((n, len(sensors), 2))
        noise = np.array([s.noise for s in sensors])
        relative = np.array([s.relative for s in sensors])
        spread, factor, shift = np.ones((n, len(sensors))), np.ones((n, len(sensors))), np.zeros((n, len(sensors)))
        frozen = np.zeros((n, len(sensors)), dtype=np.bool_)
        source = np.tile(np.array([self.evaluator.slots[s.source] for s in sensors], dtype=np.int64), (n, 1))
        own = source[0].copy()
        for f in faults:
            j = self._point(f.point)
            spread[:, j] *= f.noise[start:stop]
            factor[:, j] *= f.gain[start:stop]
            shift[:, j] += f.offset[start:stop]
            frozen[:, j] |= f.frozen[start:stop]
            if f.swapped_with is not None and f.swapped is not None:
                i, on = self._point(f.swapped_with), f.swapped[start:stop]
                source[on, j], source[on, i] = own[i], own[j]
        gain = factor * (1.0 + spread * relative * z[:, :, 0])
        return gain, shift + spread * noise * z[:, :, 1], frozen, source

    def _point(self, point: str) -> int:
        if point not in self.points:
            raise PlantError(f"no sensor is called {point!r}; the plant measures {', '.join(self.points)}")
        return self.points.index(point)
