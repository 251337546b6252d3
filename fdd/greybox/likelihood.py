"""Records, and the likelihood of a model for them with exact gradient and Fisher information in one pass."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.greybox import codegen, robust
from fdd.greybox.kernels import Kernel, default_method, kernel
from fdd.greybox.record_faults import DataError, dead_outputs, frozen, output_faults, range_faults, time_faults
from fdd.greybox.scale import chain
from fdd.models.declare import ComponentModel

if TYPE_CHECKING:
    import pandas as pd

FloatArray = NDArray[np.float64]
Unit = str | tuple[str, str]
FAILURES = {
    6: "a state or its covariance is not finite",
    7: "an innovation variance is not positive",
    8: "the dynamics are too fast for the time step (more than 20 000 Runge-Kutta substeps)",
}
TOO_FAST = 8
STIFF = 32  # Runge-Kutta substeps a sample from which local linearisation is tried
BOUND = 1e-5  # error of a predicted state by substeps, in its standard deviations
MOST_DOUBLINGS = 8
LOCAL_COST = 16  # Runge-Kutta substeps that one of local linearisation costs: 5 (four states) to 22 (two) were measured


@dataclass(frozen=True)
class Data:
    """One record of an experiment or of operation.

    Attributes
    ----------
    t : shape (N,), time [s], strictly increasing, not necessarily even
    u : shape (N, n_u), inputs in the model's order; ``u[k]`` acts on [t_k, t_k+1) (hold "zero") or is joined linearly
    y : shape (N, n_y), outputs in the model's order, NaN where missing
    hold : how inputs act between samples
    x0, P0 : replace the model's start value (n_x,) and covariance (n_x, n_x) at t_0
    name : shown in messages
    """

    t: FloatArray
    u: FloatArray
    y: FloatArray
    hold: codegen.Hold = "zero"
    x0: FloatArray | None = None
    P0: FloatArray | None = None
    name: str = "data"
    dt: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        t = np.ascontiguousarray(self.t, dtype=np.float64)
        u = _matrix(self.u, len(t))
        y = _matrix(self.y, len(t))
        for key, value in (("t", t), ("u", u), ("y", y), ("dt", _steps(t))):
            object.__setattr__(self, key, value)
        if t.ndim != 1 or len(t) < 2:
            raise DataError(f"{self.name}: {t.size} samples; at least two are needed")
        if len(u) != len(t) or len(y) != len(t):
            raise DataError(f"{self.name}: t has {len(t)} rows, u {len(u)} and y {len(y)}; they must have the same")
        bad = np.flatnonzero(~(self.dt > 0))
        if bad.size:
            k = int(bad[0]) + 1
            raise DataError(
                f"{self.name}: time does not increase at row {k}: {t[k]} after {t[k - 1]} "
                f"({bad.size} such rows); sort the record and drop duplicates"
            )

    @classmethod
    def from_frame(
        cls,
        df: pd.DataFrame,
        model: ComponentModel,
        *,
        columns: Mapping[str, str] | None = None,
        units: Mapping[str, Unit] | None = None,
        zone: str | None = None,
        hold: codegen.Hold = "zero",
        name: str = "data",
    ) -> Data:
        """A record from a table with a datetime index (or one in seconds), its columns bound by name.

        Parameters
        ----------
        columns : model symbol to column, where they are not called the same
        units : model symbol to the unit of its column; with the fluid for volume flows, ``("l/h", "water")``
        zone : IANA zone of local times that name none; UTC unless given

        Raises
        ------
        DataError : what cannot be used, with the remedy
        """
        from fdd.greybox.frame import bound, seconds

        if len(df) < 2:
            raise DataError(f"{name}: {len(df)} rows; at least two are needed")
        u, y = bound(df, model, columns, units, name)
        # A record begins with everything measured and ends with its inputs known; gaps between are told by check().
        usable = np.flatnonzero(np.isfinite(u).all(axis=1))
        whole = usable[np.isfinite(y[usable]).all(axis=1)]
        begin, end = (int(whole[0]), int(usable[-1]) + 1) if len(whole) else (0, len(df))
        data = cls(seconds(df.index, zone, name)[begin:end], u[begin:end], y[begin:end], hold=hold, name=name)
        data.check(model)
        return data

    def __len__(self) -> int:
        return len(self.t)

    def check(self, model: ComponentModel) -> list[str]:
        """Refuse what no filter can use; return warnings about what makes parameters hard to find.

        Raises
        ------
        DataError : wrong number of columns, an input missing or infinite, an output without any value, too few samples
        """
        for table, array in (("inputs", self.u), ("outputs", self.y)):
            symbols = model.symbols[table]
            if array.shape[1] != len(symbols):
                raise DataError(
                    f"{self.name}: {array.shape[1]} columns of {table}, but {model.name} "
                    f"has {len(symbols)}: {', '.join(symbols)}"
                )
        self._check_start(model)
        warnings = time_faults(self.name, self.dt)
        for j, symbol in enumerate(model.symbols["inputs"]):
            bad = np.flatnonzero(~np.isfinite(self.u[:, j]))
            if bad.size:
                raise DataError(
                    f"{self.name}: input {symbol} is missing in {bad.size} of {len(self)} rows, first in row {bad[0]}; "
                    "fill it or cut the record there (outputs may be missing, inputs may not)"
                )
            if np.ptp(self.u[:, j]) == 0:
                warnings.append(
                    f"{self.name}: input {symbol} is constant at {self.u[0, j]:g}; "
                    "parameters that act only through its changes cannot be found"
                )
        for j, symbol in enumerate(model.symbols["outputs"]):
            if not np.isfinite(self.y[:, j]).any():
                raise DataError(f"{self.name}: output {symbol} has no value in any of {len(self)} rows")
            if np.isinf(self.y[:, j]).any():
                raise DataError(
                    f"{self.name}: output {symbol} is infinite in row {int(np.flatnonzero(np.isinf(self.y[:, j]))[0])}"
                )
        warnings += range_faults(self.name, model, self.u, self.y)
        output_faults(self.name, model, self.y, self.x0 is not None)
        for table, array in (("inputs", self.u), ("outputs", self.y)):
            for symbol, column in zip(model.symbols[table], array.T, strict=True):
                warnings += frozen(self.name, symbol, column, table == "outputs")
        return warnings

    def _check_start(self, model: ComponentModel) -> None:
        """Refuse a start value or covariance that is not of the model's states."""
        n, names = len(model.states), ", ".join(model.symbols["states"])
        for key, array, shape in (("x0", self.x0, (n,)), ("P0", self.P0, (n, n))):
            if array is None:
                continue
            given = np.asarray(array, dtype=np.float64)
            if given.shape != shape:
                raise DataError(
                    f"{self.name}: {key} has shape {given.shape}, but {model.name} has {n} states ({names}); "
                    f"give an array of shape {shape}"
                )
            if not np.isfinite(given).all():
                where = np.argwhere(~np.isfinite(given))[0].tolist()
                raise DataError(f"{self.name}: {key}{where} is {given[tuple(where)]}; give finite numbers")
        if self.P0 is not None:
            P0 = np.asarray(self.P0, dtype=np.float64)
            least = float(np.linalg.eigvalsh(0.5 * (P0 + P0.T)).min())
            if not np.allclose(P0, P0.T, rtol=1e-9, atol=0.0) or least < -1e-9 * float(np.abs(P0).max(initial=1e-300)):
                raise DataError(
                    f"{self.name}: P0 is no covariance (smallest eigenvalue {least:g}); "
                    "give a symmetric matrix without negative eigenvalues"
                )


def _steps(t: FloatArray) -> FloatArray:
    """Time steps; those that differ by rounding only are made equal, so that they share one discretisation."""
    dt = np.diff(t)
    if not len(dt) or not np.isfinite(dt).all():
        return dt
    order = np.argsort(dt, kind="stable")
    ordered = dt[order]
    tolerance = np.maximum(1e-9 * np.abs(ordered), 4 * np.spacing(np.abs(t).max()))
    group = np.concatenate([[0], np.cumsum(np.diff(ordered) > tolerance[1:])])
    first = np.flatnonzero(np.concatenate([[True], np.diff(group) > 0]))
    middle = (first + np.append(first[1:], len(dt)) - 1) // 2
    out = np.empty_like(dt)
    out[order] = ordered[middle][group]
    return out


def _matrix(a: ArrayLike, rows: int) -> FloatArray:
    out = np.asarray(a, dtype=np.float64)
    if out.ndim == 1:
        out = out.reshape(-1, 1) if out.size else np.zeros((rows, 0))
    return np.ascontiguousarray(out)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Negative log-likelihood with derivatives on the transform scale; ``reason`` is empty where it is finite."""

    value: float
    gradient: FloatArray
    information: FloatArray
    reason: str = ""


@dataclass(frozen=True, slots=True)
class FilterPath:
    """What a filter saw: arrays over the samples of one record.

    ``predicted``, ``variance`` (N, n_y): one-step predictions of the outputs and their variances;
    ``innovation``, ``innovation_variance``: those of the sequential updates, independent over outputs;
    ``x``, ``P`` predicted and ``xf``, ``Pf`` filtered states (N, n) and covariances (N, n, n).
    """

    predicted: FloatArray
    variance: FloatArray
    innovation: FloatArray
    innovation_variance: FloatArray
    x: FloatArray
    P: FloatArray
    xf: FloatArray
    Pf: FloatArray

    @property
    def standardised(self) -> FloatArray:
        """Innovations over their standard deviations, (N, n_y): white with unit variance while the model holds."""
        return np.asarray(self.innovation / np.sqrt(self.innovation_variance))


class Likelihood:
    """The negative log-likelihood of one model for one or several records.

    NLL = 1/2 sum(log S + e^2 / S + log 2 pi) over all scalar innovations (Andersen 2001, Eq. 2.16, corrected); the
    first sample updates the start value at t_0 and counts. Fisher information is sum(w w'/S + dS dS'/(2 S^2)).

    With ``huber`` (2 to 3 are usual) an innovation beyond so many standard deviations counts as an outlier: see
    :mod:`fdd.greybox.robust` for what it may do to states and estimates.
    """

    def __init__(
        self,
        model: ComponentModel,
        data: Data | list[Data] | tuple[Data, ...],
        *,
        method: codegen.Method | None = None,
        substeps: int | None = None,
        huber: float = math.inf,
        plain: bool = False,
    ) -> None:
        self.model = model
        self.records = [data] if isinstance(data, Data) else list(data)
        self.warnings = [w for record in self.records for w in record.check(model)]
        dead_outputs(self.records[0].name, model, [record.y for record in self.records])
        if not huber > 0:
            raise ValueError(f"huber is {huber}; give a positive number of standard deviations, 2 to 3 are usual")
        self.method, self.plain, self.huber = method, plain, float(huber)
        self.share = robust.expectation(huber)
        self._nsub = [np.full(len(d.dt), float(substeps or 0)) for d in self.records]
        self._fixed_substeps = substeps is not None
        self._methods = [method or default_method(model, d.hold) for d in self.records]
        # What follows from the model alone needs no look at parameters.
        self._chosen = self._fixed_substeps or method is not None or "rk4" not in self._methods

    def of(self, record: Data) -> Likelihood:
        """The likelihood of the same model for another record."""
        return Likelihood(self.model, record, method=self.method, huber=self.huber, plain=self.plain)

    def kernel(self, i: int, tangents: bool) -> Kernel:
        """The kernel of one record."""
        hold = self.records[i].hold
        return kernel(
            self.model,
            method=self._methods[i],
            hold=hold,
            tangents=tangents,
            robust=math.isfinite(self.huber),
            plain=self.plain,
        )

    def prediction(self) -> str:
        """How each record is predicted between samples, as chosen last."""
        return "; ".join(dict.fromkeys(map(_words, self._methods, self._nsub)))

    def choose_substeps(self, values: FloatArray) -> bool:
        """Choose method and substeps anew at these parameters; True where that changed any.

        Where Runge-Kutta would need more than ``STIFF`` substeps a sample, local linearisation takes its place if it
        costs less. They stay as they are between calls, so that the likelihood is one smooth function during a search.
        Where a likelihood exists with those that stand and with no others, they stand.
        """
        if self._fixed_substeps or all(method == "exact" for method in self._methods):
            return False
        before = [(method, n.copy()) for method, n in zip(self._methods, self._nsub, strict=True)]
        self._chosen = True
        for i, n in enumerate(self._nsub):
            if self.method is None and self._methods[i] == "local":
                self._methods[i] = "rk4"
            n[:] = 0
            status = self._run(i, values, False)[-1]
            if self.method is None and self._methods[i] == "rk4" and (status == TOO_FAST or n.mean() > STIFF):
                self._linearise(i, values, status)
            if self._methods[i] == "rk4" and (status == 0 or (status != TOO_FAST and self._steady(i, values))):
                self._refine(i, values)
            self._keep_what_works(i, values, *before[i])
        after = zip(self._methods, self._nsub, strict=True)
        return any(a[0] != b[0] or (a[1] != b[1]).any() for a, b in zip(before, after, strict=True))

    def _steady(self, i: int, values: FloatArray) -> bool:
        """The fewest equal substeps (a power of two) with which a record has a likelihood that those chosen broke."""
        before = self._nsub[i].copy()
        for k in range(1, 12):
            self._nsub[i][:] = 2.0**k
            if self._run(i, values, False)[-1] == 0:
                return True
        self._nsub[i][:] = before
        return False

    def _refine(self, i: int, values: FloatArray) -> None:
        """Double the substeps of intervals whose end moves by it: the Jacobian at an interval's start may be tame.

        By step doubling (Hairer, Norsett and Wanner 1993, II.4) an error of order four is a fifteenth of the change.
        In the end predicted states and their standard deviations are within ``BOUND`` standard deviations.
        """
        n = self._nsub[i]
        for _ in range(MOST_DOUBLINGS):
            coarse, before = n.copy(), self._predictions(i, values)
            n *= 2
            after = self._predictions(i, values)
            n[:] = coarse
            if before is None or after is None:
                return
            change = np.abs(after[0] - before[0]) + np.abs(after[1] - before[1])
            rough = (change > 15 * BOUND * after[1]).any(axis=1)
            if not rough.any():
                return
            n[rough] *= 2

    def _predictions(self, i: int, values: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Predicted states and their standard deviations at the ends of all intervals, (N - 1, n) each."""
        _, reason, _, _, _, path, _ = self._run(i, values, False, keep=True)
        if reason:
            return None
        n, half = len(self.model.states), path.shape[1] // 2
        variance = np.einsum("tii->ti", unpack(path[1:, n:half], n))
        return path[1:, :n], np.sqrt(np.maximum(variance, 1e-300))

    def _keep_what_works(self, i: int, values: FloatArray, method: codegen.Method, substeps: FloatArray) -> None:
        """Take a record's former method and substeps back where only these have a likelihood."""
        if not substeps.any() or self._run(i, values, False)[-1] == 0:
            return
        chosen = self._methods[i], self._nsub[i].copy()
        self._methods[i], self._nsub[i][:] = method, substeps
        if self._run(i, values, False)[-1] != 0:
            self._methods[i], self._nsub[i][:] = chosen

    def _linearise(self, i: int, values: FloatArray, status: int) -> None:
        """Local linearisation for a record, unless Runge-Kutta has a likelihood and costs less."""
        n, slow = self._nsub[i], self._nsub[i].copy()
        self._methods[i], n[:] = "local", 0.0
        other = self._run(i, values, False)[-1]
        if status == 0 and (other != 0 or n.sum() * LOCAL_COST > slow.sum()):
            self._methods[i], n[:] = "rk4", slow

    def value(self, values: FloatArray) -> float:
        """NLL at natural parameters (n_p,); infinite where the filter fails."""
        self._choose_once(values)
        return float(sum(self._run(i, values, False)[0] for i in range(len(self.records))))

    def evaluate(self, values: FloatArray, information: bool = True) -> Evaluation:
        """NLL, gradient and Fisher information at natural parameters (n_p,), derivatives on the transform scale.

        Without ``information`` it is left zero, which saves its part of the time.
        """
        self._choose_once(values)
        k = len(values)
        total, gradient, fisher = 0.0, np.zeros(k), np.zeros((k, k))
        for i in range(len(self.records)):
            value, reason, g, info, *_ = self._run(i, values, True, want=information)
            if reason:
                return Evaluation(math.inf, gradient, fisher, reason)
            total, gradient, fisher = total + value, gradient + g, fisher + info
        scale = chain(self.model, values)
        return Evaluation(total, gradient * scale, fisher * np.outer(scale, scale) if information else fisher)

    def losses(self, values: FloatArray) -> FloatArray:
        """What each measured value adds to the NLL at natural parameters (n_p,), all records after one another."""
        out = []
        for path in self.paths(values):
            losses = robust.loss(path.standardised**2, self.huber) + np.log(2 * np.pi * path.innovation_variance)
            out.append(0.5 * losses[np.isfinite(losses)])
        return np.concatenate(out)

    def paths(self, values: FloatArray) -> list[FilterPath]:
        """What the filter saw in each record at natural parameters (n_p,)."""
        self._choose_once(values)
        return [self._path(i, values) for i in range(len(self.records))]

    def _choose_once(self, values: FloatArray) -> None:
        if not self._chosen:
            self.choose_substeps(values)

    def _path(self, i: int, values: FloatArray) -> FilterPath:
        _, reason, _, _, out, path, _ = self._run(i, values, False, keep=True)
        if reason:
            raise DataError(f"{self.model.name}: {reason}")
        n, q = len(self.model.states), len(self.model.outputs)
        x, P, xf, Pf = np.split(path, [n, path.shape[1] // 2, path.shape[1] // 2 + n], axis=1)
        predicted, variance, e, s = (out[:, j * q : (j + 1) * q] for j in range(4))
        return FilterPath(predicted, variance, e, s, x, unpack(P, n), xf, unpack(Pf, n))

    def _run(
        self, i: int, values: FloatArray, tangents: bool, keep: bool = False, want: bool = True
    ) -> tuple[Any, ...]:
        d = self.records[i]
        k = self.kernel(i, tangents)
        n_p, q, nz = len(values), d.y.shape[1], k.layout.nz
        grad, info = np.zeros(n_p), np.zeros((n_p, n_p))
        out = np.empty((len(d), 4 * q))
        path = np.empty((len(d) if keep else 0, 2 * nz))
        x0 = np.zeros(0) if d.x0 is None else np.ascontiguousarray(d.x0, dtype=np.float64)
        P0 = np.zeros(0) if d.P0 is None else np.asarray(d.P0, dtype=np.float64)[np.triu_indices(k.layout.n)].copy()
        given, result = int(d.x0 is not None) + 2 * int(d.P0 is not None), np.zeros(2)
        with np.errstate(all="ignore"):
            status = k.module.run(
                len(d), d.dt, d.u, d.y, np.ascontiguousarray(values, dtype=np.float64), given, x0, P0, k.constants(),
                k.workspace(), self._nsub[i], self.huber, self.share, out, int(keep), path, int(want), grad,
                info, result,
            )  # fmt: skip
        value, at = float(result[0]), int(result[1])
        reason = ""
        if status:
            where = f"row {at} (t = {d.t[at]:g})" if at < len(d) else "some row"
            reason = f"{d.name}: in {where} {FAILURES[status]}"
        return value, reason, grad, info, out, path, status


def _words(method: codegen.Method, n: FloatArray) -> str:
    if method == "exact":
        return "exact discretisation"
    name = {"rk4": "Runge-Kutta of order four", "local": "local linearisation (stiff)"}[method]
    few, most = (int(n.min()), int(n.max())) if len(n) else (0, 0)
    return f"{name}, {few if few == most else f'{few} to {most}'} substep{'s' if most > 1 else ''} a sample"


def unpack(P: FloatArray, n: int) -> FloatArray:
    """Packed upper triangles (N, n(n+1)/2) as symmetric matrices (N, n, n)."""
    out = np.empty((len(P), n, n))
    rows, columns = np.triu_indices(n)
    out[:, rows, columns] = P
    out[:, columns, rows] = P
    return out
