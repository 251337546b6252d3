"""Online filters of many components of one model type, stepped in one call.

All of their state is one float64 array (components, entries), so that a checkpoint is one write.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.greybox import codegen, native
from fdd.greybox.kernels import Kernel, aligned, kernel
from fdd.greybox.likelihood import unpack
from fdd.greybox.scale import chain, from_scale, to_scale
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]
SCHEMA = 1
# A step that only takes up a measurement; long enough to be one, too short for anything to happen in it [s].
MOMENT = 1e-6
STATUS = (
    "good",
    "not active",
    "started",
    "waiting for the measurements that start values need",
    "time did not increase",
    "input missing, last value held",
    "restarting: a state or its covariance became infinite",
    "restarting: an innovation variance was not positive",
    "restarting: the gap is too long for the dynamics",
)
# From this status on a component has been given up and starts afresh.
BROKEN = STATUS.index("restarting: a state or its covariance became infinite")


@dataclass(frozen=True, slots=True)
class Step:
    """One sample of every component; shapes as in ``docs/architecture.md``.

    ``innovation`` and ``variance`` are those of each output given the past; ``standardised`` are the innovations of the
    sequential updates over their standard deviations, independent over outputs and time, each N(0, 1).
    The first sample of a filter has no innovation (NaN), because the start values are made from it.
    """

    predicted: FloatArray
    innovation: FloatArray
    variance: FloatArray
    standardised: FloatArray
    score: FloatArray
    information: FloatArray
    status: NDArray[np.int64]


class FilterBank:
    """Extended Kalman filters of n components of one model.

    Parameters
    ----------
    model : the component model
    parameters : shape (n, n_p), natural scale, in the order of ``model.parameters``
    score : also compute score and information of every sample. The score is -sum(w e / S), w = d innovation / d theta,
        theta on the declared transform scale; the term with the derivative of S is left out on purpose, because
        without it the score keeps mean zero when the noise is wrong and the physics right.
    method : of prediction; exact discretisation or Runge-Kutta by default, "local" for stiff models (local.py)

    Raises
    ------
    ValueError : wrong shape, a parameter that is not finite
    """

    def __init__(
        self, model: ComponentModel, parameters: ArrayLike, *, score: bool = True, hold: codegen.Hold = "zero",
        method: codegen.Method | None = None, plain: bool = False, lanes: int | None = None,
    ) -> None:  # fmt: skip
        self.model = model
        if lanes is None:
            lanes = 1 if plain or method == "local" else native.width()
        self.kernel: Kernel = kernel(model, method=method, hold=hold, tangents=score, plain=plain, lanes=lanes)
        values = np.array(parameters, dtype=np.float64, ndmin=2)
        self.parameters = np.empty_like(values)
        self._lanes, blocks = lanes, -(-len(values) // lanes)
        # Components side by side, so that one place of several is a vector; the last block is filled with spare ones.
        self._c = aligned(blocks, self.kernel.module.NC, lanes)
        self._blocks = aligned(blocks, self.kernel.module.PERSISTENT, lanes)
        self._scale = np.ones((blocks * lanes, values.shape[1]))
        self._w = self.kernel.workspace()
        self._score = score
        self.set_parameters(np.arange(len(values)), values)

    def __len__(self) -> int:
        return len(self.parameters)

    def set_parameters(self, which: ArrayLike, parameters: ArrayLike) -> None:
        """Put new parameters (natural scale, (k, n_p)) under running filters; their states go on."""
        rows = np.arange(len(self))[np.asarray(which)]
        values = np.array(parameters, dtype=np.float64, ndmin=2)
        names = self.model.symbols["parameters"]
        if values.shape != (len(rows), len(names)):
            raise ValueError(
                f"{self.model.name}: parameters have shape {values.shape}; expected {(len(rows), len(names))}"
            )
        if not np.isfinite(values).all():
            r, k = np.argwhere(~np.isfinite(values))[0]
            raise ValueError(
                f"{self.model.name}: parameter {names[k]} of component {rows[r]} is {values[r, k]}; give a number"
            )
        self.parameters[rows] = values
        self._scale[rows] = chain(self.model, values)
        padded = np.resize(self.parameters, self._scale.shape) if len(self) else self._scale
        with np.errstate(all="ignore"):
            self.kernel.module.prepare_bank(len(padded), padded, self._c)
        at = self.kernel.layout.offsets
        if "KEY" in at:
            self._set(rows, at["KEY"], at["KEY"] + 1, 0.0)  # the discretisation must be made anew
        self._set(rows, at["T"], at["STARTED"], 0.0)

    def _set(self, rows: NDArray[np.int64], first: int, last: int, values: FloatArray | float) -> None:
        """Put ``values`` (rows, last - first) into the states of some components."""
        self._blocks[rows // self._lanes, first:last, rows % self._lanes] = values

    def _get(self, first: int, last: int) -> FloatArray:
        """A part of the state of every component, (n, last - first)."""
        part = self._blocks[:, first:last].transpose(0, 2, 1)
        return np.ascontiguousarray(part).reshape(-1, last - first)[: len(self)]

    def move(self, rows: NDArray[np.int64], by: FloatArray) -> None:
        """Move parameters (r, n_p) by little on the transform scale, and states with them by their tangents."""
        at, n, K = self.kernel.layout.offsets["T"], self.kernel.layout.n, self.kernel.layout.K
        size = self.kernel.layout.nz * K
        tangents = self._get(at, at + size)[rows]
        old = self.parameters[rows]
        new = np.array(
            [
                [from_scale(q, to_scale(q, v) + d) for q, v, d in zip(self.model.parameters, *pair, strict=True)]
                for pair in zip(old, by, strict=True)
            ]
        )
        self.set_parameters(rows, new)
        self._set(rows, at, at + size, tangents)
        shift = np.einsum("rik,rk->ri", tangents[:, : n * K].reshape(-1, n, K)[:, :, : new.shape[1]], new - old)
        self._set(rows, 0, n, self._get(0, n)[rows] + np.where(np.isfinite(shift), shift, 0.0))

    def step(
        self,
        dt: ArrayLike,
        u: ArrayLike,
        y: ArrayLike,
        active: ArrayLike | None = None,
        unseen: ArrayLike | None = None,
    ) -> Step:
        """One sample of every active component.

        Parameters
        ----------
        dt : shape (n,), time since the component's previous sample [s]; the first one is not looked at
        u : shape (n, n_u), inputs measured now; they act until the next sample
        y : shape (n, n_y), outputs measured now, NaN where missing
        active : shape (n,), False leaves a component as it is
        unseen : shape (n,), True where inputs have got from their previous values to these at an unknown time between
        """
        if unseen is not None and np.any(unseen):
            dt = self._predict_unseen(np.flatnonzero(unseen), np.array(np.broadcast_to(dt, len(self)), float), u)
        n, m, q = len(self), len(self.model.inputs), len(self.model.outputs)
        y = np.array(y, dtype=np.float64).reshape(n, q)
        y[np.isinf(y)] = np.nan
        on = np.ones(n, dtype=np.bool_) if active is None else np.asarray(active, dtype=np.bool_)
        n_p, full = self.parameters.shape[1] if self._score else 0, len(self._scale)
        out, status = np.empty((full, 4 * q)), np.empty(full, dtype=np.int64)
        score, info = np.empty((full, n_p)), np.empty((full, n_p, n_p))
        given = (self._padded(dt, n), self._padded(u, n, m), self._padded(y, n, q), self._padded(on, n, of=np.bool_))
        with np.errstate(all="ignore"):
            self.kernel.module.bank(
                full, *given, self._c, self._blocks, self._w, out, int(self._score), self._scale, score, info, status
            )
        out, score, info, status = out[:n], score[:n], info[:n], status[:n]
        predicted = out[:, :q]
        return Step(
            predicted=predicted,
            innovation=y - predicted,
            variance=out[:, q : 2 * q],
            standardised=out[:, 2 * q : 3 * q] / np.sqrt(out[:, 3 * q :]),
            score=score,
            information=info,
            status=status,
        )

    def _predict_unseen(self, rows: NDArray[np.int64], dt: FloatArray, u: ArrayLike) -> FloatArray:
        """Predict these components where inputs moved unseen; returns ``dt`` with only a moment left to them.

        Inputs may have moved at once or only now. The prediction lies halfway, and as far to either side is a standard
        deviation more: what the measurement then corrects, and the charts are not told of.
        """
        k, at = self.kernel.layout, self.kernel.layout.offsets
        given = np.broadcast_to(np.asarray(u, dtype=np.float64), (len(self), k.inputs))[rows]
        late, early = self._some(rows), self._some(rows)
        early._set(np.arange(len(rows)), at["UPREV"], at["UPREV"] + k.inputs, given)
        nothing = np.full((len(rows), len(self.model.outputs)), np.nan)
        good = [np.less(bank.step(dt[rows], given, nothing).status, BROKEN) for bank in (late, early)]
        end = at["UPREV"] + k.inputs
        first, second = late._get(0, end), early._get(0, end)
        mean = 0.5 * (first + second)
        apart = 0.5 * (first - second)[:, : k.n]
        for i in range(k.n):
            for j in range(i, k.n):
                mean[:, k.n + codegen.packed(i, j, k.n)] += apart[:, i] * apart[:, j]
        done = good[0] & good[1]  # the others break in the step itself, which says why
        self._set(rows[done], 0, end, mean[done])
        dt[rows[done]] = MOMENT
        return dt

    def _some(self, rows: NDArray[np.int64]) -> FilterBank:
        """Some components with their states in a bank of their own."""
        bank, blocks = copy.copy(self), -(-len(rows) // self._lanes)
        filled = np.resize(rows, blocks * self._lanes)
        for name in ("_c", "_blocks"):
            whole = getattr(self, name)
            part = aligned(blocks, whole.shape[1], self._lanes)
            taken = whole[filled // self._lanes, :, filled % self._lanes]
            part[:] = taken.reshape(blocks, self._lanes, -1).transpose(0, 2, 1)
            setattr(bank, name, part)
        bank._scale, bank.parameters = self._scale[filled], self.parameters[rows]
        return bank

    def _padded(self, values: ArrayLike, *shape: int, of: type = np.float64) -> NDArray[Any]:
        """An array of every component with zeros for the spare ones behind."""
        out: NDArray[Any] = np.zeros((len(self._scale), *shape[1:]), dtype=of)
        out[: len(self)] = np.broadcast_to(np.asarray(values, dtype=of), shape)
        return out

    def states(self) -> tuple[FloatArray, FloatArray]:
        """Filtered states (n, n_x) and covariances (n, n_x, n_x) after the last step; NaN where not started."""
        k = self.kernel.layout
        at = k.offsets["STARTED"]
        started = self._get(at, at + 1)[:, 0] != 0
        x, P = self._get(0, k.n), unpack(self._get(k.n, k.nz), k.n)
        x[~started], P[~started] = np.nan, np.nan
        return x, P

    def reset(self, which: ArrayLike | None = None) -> None:
        """Forget the states of these components (all by default); they start anew at their next active sample."""
        rows, at = np.arange(len(self)), self.kernel.layout.offsets["STARTED"]
        self._set(rows if which is None else rows[np.asarray(which)], at, at + 1, 0.0)

    def warm(self) -> None:
        """Compile, or load from the cache, before the first tick."""
        spare = FilterBank.__new__(FilterBank)
        spare.__dict__.update(self.__dict__)
        spare._blocks = self._blocks.copy()
        n, m, q = len(self), len(self.model.inputs), len(self.model.outputs)
        spare.step(np.ones(n), np.zeros((n, m)), np.zeros((n, q)), np.zeros(n, dtype=np.bool_))

    def export_state(self) -> dict[str, Any]:
        """Plain data: arrays and JSON scalars, with the cached discretisation, so that a restart changes no bit."""
        return {
            "schema": SCHEMA,
            "model": self.model.name,
            "model_version": self.model.version,
            "layout": self._layout(),
            "parameters": self.parameters.copy(),
            "state": self._get(0, self.kernel.module.PERSISTENT),
        }

    def _layout(self) -> str:
        k = self.kernel
        return (
            f"{codegen.FORMAT} {k.variant.method} {k.variant.hold} {k.layout.n} {k.layout.K} {k.layout.varying} "
            f"{k.module.PERSISTENT}"
        )

    def restore_state(self, state: Mapping[str, Any]) -> None:
        """Take up what :meth:`export_state` gave.

        Raises
        ------
        ValueError : of another schema, model, version or shape
        """
        expected = {
            "schema": SCHEMA, "model": self.model.name, "model_version": self.model.version, "layout": self._layout(),
        }  # fmt: skip
        for key, value in expected.items():
            if state.get(key) != value:
                raise ValueError(
                    f"filter state has {key} {state.get(key)!r}, this bank {value!r}; "
                    "start the filters anew instead of restoring"
                )
        array = np.array(state["state"], dtype=np.float64)
        shape = len(self), self.kernel.module.PERSISTENT
        if array.shape != shape:
            raise ValueError(f"filter state has shape {array.shape}, this bank {shape}")
        rows = np.arange(len(self))
        self.set_parameters(rows, state["parameters"])
        self._set(rows, 0, shape[1], array)
