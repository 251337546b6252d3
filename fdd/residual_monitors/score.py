"""Score charts: one a physical parameter, fed by the filter's tangents; the first line for slow physical faults."""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from fdd.records import FloatArray, IntArray
from fdd.residual_monitors.chart import (
    CAP,
    CLIP,
    LEARNING,
    QUIET,
    Chart,
    Feed,
    Verdicts,
    conclude,
)
from fdd.residual_monitors.information import Change, change
from fdd.residual_monitors.offset import residual
from fdd.residual_monitors.predictive import Uncertainty
from fdd.residual_monitors.run_length import limit_for

OUTLIER = 4.0
"""While the spread is learned, a block counts as at most this many standard deviations."""
CHANCE = 1.645
"""What is off by no more than so many standard errors is chance: one in twenty true models shows more."""
KNOWN = 10**9
"""Blocks behind a spread that is given without their number."""
HOLD = 0.5
"""A component with a statistic above this share of its limit learns nothing of its baseline's error."""


class Score(Chart):
    r"""Two-sided CUSUM on each parameter's standardised score over blocks of samples.

    A lasting fault of 10 to 20 % moves one-step innovations by next to nothing; their correlation with the tangents
    adds up. The same sums give size with error bars and tell parameters apart (:meth:`estimate`). What no parameter
    explains is left to innovation charts.

    Equations
        .. math:: s = -\sum w e / S, \quad I = \sum w w^T / S, \quad z_j = s_j / \sqrt{I_{jj}}

        over a block, with w the innovation's derivative by the parameters at the baseline. While the baseline holds,
        z_j is standard normal; after a change d its mean is (I d)_j / sqrt(I_jj). With ``isolated`` the score projected
        on the others is charted instead: slower, and still while only others move.

    Parameters
    ----------
    limit : shape (n_c, n_p), decision interval of each component's parameters [standard deviations of z]
    block : samples seen that make a block; some hours. Longer than the filter's memory, shorter than the delay wanted.
    k : reference value of the CUSUM on z
    isolated : chart projected scores
    history : blocks kept for :meth:`estimate`
    covariance : shape (n_c, n_p, n_p), of the baseline's parameters on the estimation scale; k is widened so that the
        rate, averaged over their errors, is the promised one. None: the baseline is known.
    enough : blocks; directions of the parameters that the baseline knows worse than from so many blocks of present data
        go on being learned (:mod:`fdd.residual_monitors.offset`), and departures from what is foreseen are charted;
        while such a direction moves a parameter's score by more than it will in the end, its chart says that it is
        learning (an alarm is an alarm all the same). 0: nothing is learned.
    learn : blocks over which the standard deviation of z is learned (at least 1 is taken), for innovations that are not
        white; 0 for filters that pass the whiteness checks

    Sign convention
        Direction +1: the parameter has grown.

    References
    ----------
    Benveniste, A., Basseville, M., Moustakides, G. (1987), IEEE Trans. Autom. Control 32, 583-592. Basseville, M.,
    Nikiforov, I. (1993), Detection of Abrupt Changes, section 8.
    """

    kind = "score"
    feed = Feed.SCORES
    schema = 3
    _state = (
        "count", "elapsed", "score", "information", "upper", "lower", "upper_age", "lower_age", "shown",
        "past_score", "past_information", "past_elapsed", "written", "offset", "covariance",
        "open",
    )  # fmt: skip

    def __init__(
        self,
        limit: ArrayLike,
        *,
        block: int = 72,
        k: float = 0.5,
        isolated: bool = False,
        history: int = 40,
        learn: int = 0,
        covariance: ArrayLike | None = None,
        enough: float = 0.0,
    ) -> None:
        grid = np.array(limit, dtype=np.float64, ndmin=2)
        super().__init__(grid.ravel(), learn=learn)
        if block < 1 or history < 1:
            raise ValueError(f"score chart: block is {block} and history {history}; give at least 1 each")
        if not k >= 0:
            raise ValueError(f"score chart: reference value k is {k}; give zero or more standard deviations")
        self.components, self.parameters = grid.shape
        self.block, self.k, self.isolated, self.history = int(block), float(k), bool(isolated), int(history)
        n, p = grid.shape
        self.covariance = np.zeros((n, p, p)) if covariance is None else np.array(covariance, dtype=np.float64)
        if self.covariance.shape != (n, p, p):
            raise ValueError(
                f"score chart: covariance has shape {self.covariance.shape}; give {(n, p, p)}, one a component"
            )
        self.enough, self.offset = float(enough), np.zeros((n, p))
        self.deadband = np.zeros((n, p))
        self._uncertainty = Uncertainty(self.limit, self.k)
        self._most = np.full(self.n, self.learn, dtype=np.int64)
        self.count = np.zeros(n, dtype=np.int64)
        self.elapsed = np.zeros(n, dtype=np.int64)
        self.score = np.zeros((n, p))
        self.information = np.zeros((n, p, p))
        self.upper, self.lower = np.zeros(self.n), np.zeros(self.n)
        self.upper_age, self.lower_age = np.zeros(self.n, dtype=np.int64), np.zeros(self.n, dtype=np.int64)
        self.shown = np.ones(self.n, dtype=np.int8)
        self.past_score = np.zeros((n, history, p))
        self.past_information = np.zeros((n, history, p, p))
        self.past_elapsed = np.zeros((n, history), dtype=np.int64)
        self.written = np.zeros(n, dtype=np.int64)
        self.open = self._uncertain(np.ones(n, dtype=np.bool_))

    @classmethod
    def design(
        cls,
        arl: ArrayLike,
        *,
        parameters: int = 1,
        block: int = 72,
        k: float = 0.5,
        isolated: bool = False,
        history: int = 40,
        learn: int = 0,
        covariance: ArrayLike | None = None,
        baseline_samples: float = np.inf,
        enough: float = 0.0,
    ) -> Score:
        """Charts with these mean numbers of *samples* between false alarms.

        Parameters
        ----------
        arl : shape (n_c, parameters), or (n_c * parameters,) by component
        covariance : of the baseline, see :class:`Score`; better than ``baseline_samples`` where seasons change
        baseline_samples : samples the baseline was fitted on; limits are widened for its error, which moves every
            block's z by a constant with standard deviation sqrt(block / baseline_samples)
        """
        wanted = np.array(arl, dtype=np.float64, ndmin=1).reshape(-1, parameters) / block
        limit = limit_for("cusum", wanted, k=k, shift_sd=float(np.sqrt(block / baseline_samples)))
        return cls(
            limit, block=block, k=k, isolated=isolated, history=history, learn=learn, covariance=covariance,
            enough=enough,
        )  # fmt: skip

    def update_scores(self, score: ArrayLike, information: ArrayLike) -> Verdicts:
        """Take one sample of every component.

        Parameters
        ----------
        score, information : shape (n_c, n_p) and (n_c, n_p, n_p), from the filter bank; a row that is not finite is one
            that saw nothing (machine off, start-up, no measurement)

        Returns
        -------
        Verdicts of n_c * n_p streams, parameters of a component side by side. No data: nothing was seen, or the data of
        the last block do not speak of the parameter.
        """
        s = np.ascontiguousarray(score, dtype=np.float64)
        i = np.ascontiguousarray(information, dtype=np.float64)
        if s.shape != self.score.shape or i.shape != self.information.shape:
            raise ValueError(
                f"score chart of {self.components} components and {self.parameters} parameters: got scores {s.shape} "
                f"and informations {i.shape}"
            )
        seen, closed = _accumulate(s, i, self.block, self.score, self.information, self.count, self.elapsed)
        rows = np.flatnonzero(closed)
        length, held = self.elapsed[rows], self._held(rows)
        scale = _scale(self.m2, self.seen).reshape(-1, self.parameters)[rows]
        z, allowance = self._close(rows, held, scale) if rows.size else (scale, scale)
        phase, statistic, direction, age = _chart(
            seen, rows, z, scale, allowance, length, held, self.k, self.learn, self._most, self.limit, self.upper,
            self.lower, self.upper_age, self.lower_age, self.shown, self.seen, self.m2, self.latched, self.side,
            self.onset,
        )  # fmt: skip
        phase[(phase == QUIET) & (self.open == 1)] = LEARNING
        return Verdicts(phase, statistic, self.limit, direction, age)

    def set_limit(self, limit: ArrayLike) -> None:
        """Change the limits, and with them what keeps the rate over the baselines' errors."""
        super().set_limit(limit)
        self._uncertainty = Uncertainty(self.limit, self.k)

    def _held(self, rows: IntArray) -> NDArray[np.bool_]:
        """Components that learn nothing now: what moves them may be a fault."""
        high = (np.maximum(self.upper, self.lower) > HOLD * self.limit) | (self.latched == 1)
        return np.asarray(high.reshape(-1, self.parameters)[rows].any(axis=1))

    def _close(self, rows: IntArray, held: NDArray[np.bool_], spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Standardise full blocks, keep them in the history and begin new ones."""
        part, self.offset[rows], self.covariance[rows] = residual(
            self.score[rows], self.information[rows], self.offset[rows], self.covariance[rows],
            spread.max(axis=1), np.where(held, 0.0, self.enough),
        )  # fmt: skip
        found = change(part.score, self.information[rows])
        z = found.isolated if self.isolated else found.single / found.single_error
        z = z / np.sqrt(1.0 + part.learned / np.square(spread))
        streams = (rows[:, None] * self.parameters + np.arange(self.parameters)).ravel()
        wide = (part.learned * self.enough > np.square(spread)).ravel()
        self.open[streams] = np.where(np.repeat(held, self.parameters), self.open[streams], wide)
        standing = self._isolated(rows, found) if self.isolated else part.standing
        variance = (standing / (np.square(spread) + part.learned)).ravel()
        allowance = self._uncertainty.extra(variance, streams).reshape(z.shape)
        allowance = allowance + self._widened_by_deadband(rows, found) / np.sqrt(np.square(spread) + part.learned)
        slot = self.written[rows] % self.history
        self.past_score[rows, slot] = self.score[rows]
        self.past_information[rows, slot] = self.information[rows]
        self.past_elapsed[rows, slot] = self.elapsed[rows]
        self.written[rows] += 1
        self.score[rows], self.information[rows] = 0.0, 0.0
        self.count[rows], self.elapsed[rows] = 0, 0
        return np.ascontiguousarray(np.where(found.visible, z, np.nan)), allowance

    def _isolated(self, rows: IntArray, found: Change) -> FloatArray:
        """Variance that the baseline's error gives to the means of projected scores."""
        own = np.diagonal(self.covariance[rows], axis1=1, axis2=2)
        return np.asarray(np.nan_to_num(own * np.square(found.isolated / found.joint)))

    def _widened_by_deadband(self, rows: IntArray, found: Change) -> FloatArray:
        """How far changes inside the deadband move the means of standardised scores (r, n_p), all of them at once."""
        own = self.deadband[rows]
        if self.isolated:
            return np.asarray(np.nan_to_num(own / found.joint_error))
        diagonal = np.diagonal(self.information[rows], axis1=1, axis2=2)
        moved = np.sqrt(np.square(self.information[rows] * own[:, None, :]).sum(axis=2))
        return np.asarray(moved / np.sqrt(np.where(diagonal > 0, diagonal, 1.0)))

    def tolerate(self, deadband: ArrayLike) -> None:
        """Changes of the parameters, scalar or (n_c, n_p) on the estimation scale, for which no chart rings.

        For what is harmless however well it is seen, such as seasons that a new baseline will follow. The promised rate
        is kept for any change inside; without one, charts are quieter than promised.
        """
        self.deadband = np.array(np.broadcast_to(np.asarray(deadband, dtype=np.float64), self.offset.shape))

    def moved(self, rows: IntArray, by: FloatArray) -> None:
        """The baselines of these components were moved by ``by`` (r, n_p) while no block was begun."""
        self.offset[rows] -= by
        self.past_score[rows] -= np.einsum("rhij,rj->rhi", self.past_information[rows], by)

    def depart(self, rows: NDArray[np.bool_], covariance: FloatArray) -> None:
        """These components start from a new baseline with this covariance (n_c, n_p, n_p); nothing is learned yet."""
        self.offset[rows] = 0.0
        self.covariance[rows] = covariance[rows]
        which = np.repeat(rows, self.parameters)
        self.open[which] = self._uncertain(rows)

    def _uncertain(self, rows: NDArray[np.bool_]) -> NDArray[np.int8]:
        """Parameters of these components that may have to be learned; their first block says which do."""
        return np.asarray(
            (np.diagonal(self.covariance[rows], axis1=1, axis2=2) > 0).ravel() & (self.enough > 0), dtype=np.int8
        )

    def estimate(self, component: int, updates: int, covariance: FloatArray | None = None) -> Change:
        """Changes of a component's parameters over its last ``updates`` (an alarm's ``onset_age``).

        Parameters
        ----------
        covariance : shape (n_p, n_p), of the baseline's parameters on the estimation scale
        """
        kept = min(int(self.written[component]), self.history)
        slots = (self.written[component] - 1 - np.arange(kept)) % self.history
        ages = self.elapsed[component] + np.cumsum(self.past_elapsed[component, slots])
        slots = slots[ages - self.past_elapsed[component, slots] < updates]
        score = self.score[component] + self.past_score[component, slots].sum(axis=0)
        information = self.information[component] + self.past_information[component, slots].sum(axis=0)
        score = score - information @ self.offset[component]
        return change(score, information, covariance, self.spread_of(component))

    def presume(self, rows: NDArray[np.bool_], spread: ArrayLike, blocks: ArrayLike = KNOWN) -> None:
        """Take the standard deviation of z from the baseline, and go on learning it over ``enough`` blocks.

        The noise that a filter was fitted with is as uncertain as its parameters are; where it was found too small,
        scores vary more than they say.

        Parameters
        ----------
        rows : shape (n_c,), components whose baselines are new
        spread : shape (n_c, n_p), at least 1 is taken
        blocks : shape (n_c,) or scalar, how many blocks the baselines found it from
        """
        shape = (self.components, self.parameters)
        which = np.repeat(rows, self.parameters)
        seen = np.broadcast_to(np.asarray(blocks, dtype=np.int64).reshape(-1, 1), shape).ravel()
        variance = np.square(np.maximum(1.0, np.asarray(spread, dtype=np.float64).reshape(shape))).ravel()
        self.seen[which], self.m2[which] = seen[which], (variance * seen)[which]
        self._most[which] = seen[which] + int(self.enough)

    def spread_of(self, component: int) -> FloatArray:
        """Standard deviation of a component's z that was learned, shape (n_p,); 1 where none was."""
        at = slice(component * self.parameters, (component + 1) * self.parameters)
        return _scale(self.m2[at], self.seen[at])

    def visibility(self, component: int, *, joint: bool = False) -> FloatArray:
        """Standard error of each parameter's change over the history, shape (n_p,); inf: not visible.

        ``joint``: when all may move at once. Heat balances whose powers are all scaled by parameters then show none of
        them, though each alone is seen well; a change of less than three of the errors cannot be found by any chart.
        """
        found = self.estimate(component, np.iinfo(np.int64).max)
        return found.joint_error if joint else found.single_error

    def _step(self, z: FloatArray) -> Verdicts:
        raise TypeError("a score chart takes scores and informations: call update_scores")

    def _restart(self, rows: NDArray[np.bool_]) -> None:
        self.upper[rows], self.lower[rows] = 0.0, 0.0
        self.upper_age[rows], self.lower_age[rows] = 0, 0
        whole = rows.reshape(self.components, self.parameters).all(axis=1)
        self.count[whole], self.elapsed[whole], self.written[whole] = 0, 0, 0
        self.score[whole], self.information[whole] = 0.0, 0.0
        self.past_score[whole], self.past_information[whole], self.past_elapsed[whole] = 0.0, 0.0, 0


@numba.njit(cache=True)
def _accumulate(
    score: FloatArray,
    information: FloatArray,
    block: int,
    sums: FloatArray,
    informations: FloatArray,
    count: IntArray,
    elapsed: IntArray,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Add a sample to the blocks; say which components saw something and which blocks are full."""
    n, p = score.shape
    seen = np.empty(n, dtype=np.bool_)
    closed = np.zeros(n, dtype=np.bool_)
    for i in range(n):
        good = True
        for j in range(p):
            good = good and np.isfinite(score[i, j]) and np.isfinite(information[i, j, j])
        seen[i] = good
        elapsed[i] += 1
        if not good:
            continue
        strongest = 1.0
        for j in range(p):
            if information[i, j, j] > 0:
                strongest = max(strongest, abs(score[i, j]) / np.sqrt(information[i, j, j]) / CLIP)
        for j in range(p):
            sums[i, j] += score[i, j] / strongest
            for m in range(p):
                informations[i, j, m] += information[i, j, m]
        count[i] += 1
        closed[i] = count[i] >= block
    return seen, closed


def _scale(total: FloatArray, blocks: IntArray) -> FloatArray:
    """Standard deviation of z from the sum of its squares: 1 where what exceeds it may be chance."""
    n = np.maximum(blocks, 1)
    variance = total / n
    return np.asarray(np.sqrt(np.where(variance > 1.0 + CHANCE * np.sqrt(2.0 / n), variance, 1.0)))


@numba.njit(cache=True)
def _chart(
    seen: NDArray[np.bool_],
    rows: IntArray,
    z: FloatArray,
    scale: FloatArray,
    allowance: FloatArray,
    length: IntArray,
    held: NDArray[np.bool_],
    k: float,
    learn: int,
    most: IntArray,
    limit: FloatArray,
    upper: FloatArray,
    lower: FloatArray,
    upper_age: IntArray,
    lower_age: IntArray,
    shown: NDArray[np.int8],
    learned: IntArray,
    spread: FloatArray,
    latched: NDArray[np.int8],
    side: NDArray[np.int8],
    onset: IntArray,
) -> tuple[NDArray[np.uint8], FloatArray, NDArray[np.int8], IntArray]:
    """Sums of full blocks, and the verdict of every stream."""
    n = limit.shape[0]
    p = n // seen.shape[0]
    for r in range(rows.shape[0]):
        for j in range(p):
            i = rows[r] * p + j
            shown[i] = not np.isnan(z[r, j])
            if shown[i] == 0:
                continue
            charted = learned[i] >= learn
            if learned[i] < most[i] and not (charted and held[r]):
                spread[i] += min(z[r, j] * z[r, j], OUTLIER * OUTLIER)
                learned[i] += 1
            if not charted:
                continue
            value = min(max(z[r, j] / scale[r, j], -CLIP), CLIP)
            # A sum that leaves zero began with the block, not at its end.
            if upper[i] == 0:
                upper_age[i] = length[r] - 1
            if lower[i] == 0:
                lower_age[i] = length[r] - 1
            upper[i] = min(max(0.0, upper[i] + value - k - allowance[r, j]), CAP * limit[i])
            lower[i] = min(max(0.0, lower[i] - value - k - allowance[r, j]), CAP * limit[i])
    phase = np.empty(n, dtype=np.uint8)
    statistic = np.empty(n)
    direction = np.empty(n, dtype=np.int8)
    age = np.empty(n, dtype=np.int64)
    for i in range(n):
        upper_age[i] = upper_age[i] + 1 if upper[i] > 0 else 0
        lower_age[i] = lower_age[i] + 1 if lower[i] > 0 else 0
        statistic[i] = max(upper[i], lower[i])
        sign, since = 0, 0
        if upper[i] >= lower[i] and upper[i] > 0:
            sign, since = 1, upper_age[i]
        elif lower[i] > 0:
            sign, since = -1, lower_age[i]
        speaks = seen[i // p] and shown[i] == 1
        phase[i], direction[i], age[i] = conclude(i, speaks, statistic[i], sign, since, limit[i], latched, side, onset)
        if learned[i] < learn and phase[i] == QUIET:
            phase[i] = LEARNING
    return phase, statistic, direction, age
