"""The chart of a chiller's vectors: evidence for any fault against health, over windows of clusters.

The statistic is the log of a likelihood ratio, the mean over windows. While the machine is healthy such a ratio exceeds
A with a probability of at most 1/A (Ville 1939), so that the limit follows from the false alarms and the independent
clusters a year alone. A window counts without its strangest cluster: one odd state is no alarm.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from fdd.chiller_eiv.causes import Named, explanations, name_cause
from fdd.chiller_eiv.clusters import Clusters, join_clusters
from fdd.chiller_eiv.vector import DIRECT, FEATURES, VectorBaseline
from fdd.records import FloatArray, IntArray, JsonObject

WINDOWS = (2, 3, 5, 9, 17, 33)
"""Clusters in a window; one of them, the strangest, does not count."""
SETTLED = 8
"""Clusters since the onset from which on a finding is renewed with every so many only."""
KEPT = 64
"""Clusters that are remembered, to date and name what stands."""


@dataclass(frozen=True)
class VectorFinding:
    """What stands behind an alarm of the vectors.

    Attributes
    ----------
    named : the cause as far as it can be named
    onset : begin of the first cluster that shows it [ns]
    clusters : judged since then
    change, sd : mean change of each feature since then and how well it is known, shape (p,)
    bias : how a sensor reads, where one is the cause, in words
    """

    named: Named
    onset: int
    clusters: int
    change: FloatArray
    sd: FloatArray
    bias: str = ""


@dataclass(frozen=True)
class VectorVerdict:
    """What the chart says after a cluster.

    Attributes
    ----------
    time : end of the cluster [ns]
    judged : whether it lies in the trained box; otherwise the chart stays as it is
    residual : of the cluster, shape (p,)
    statistic, limit : logs of likelihood ratios
    alarm : whether the chart is in alarm
    finding : what stands, while in alarm
    """

    time: int
    judged: bool
    residual: FloatArray
    statistic: float
    limit: float
    alarm: bool
    finding: VectorFinding | None


class VectorMonitor:
    """Chart of one chiller's clusters; an alarm stands until :meth:`reset`.

    Parameters
    ----------
    baseline : of the healthy machine
    false_alarms : wanted, a year [1/a]
    """

    def __init__(self, baseline: VectorBaseline, false_alarms: float) -> None:
        self.baseline = baseline
        self.limit = float(np.log(max(baseline.looks, 1.0) / false_alarms))
        self.seen = 0
        self.judged = 0
        self.reset()

    def reset(self) -> None:
        """Forget what was seen and clear the alarm."""
        self._recent: Clusters | None = None
        self._residual = np.zeros((0, len(self.baseline.layout.features)))
        self._statistic = 0.0
        self._alarm = False
        self.finding: VectorFinding | None = None
        """What stands, while in alarm."""

    def update(self, cluster: Clusters) -> VectorVerdict:
        """Take one cluster."""
        b = self.baseline
        time = int(cluster.end[0])
        raw = {k: cluster.raw.get(k, np.full(1, np.nan)) for k in {*b.layout.readings, *b.layout.drivers, "load"}}
        for k in ("T_chi", "T_cho", "flow_ch", "T_cdi", "power"):
            raw.setdefault(k, cluster.raw.get(k, np.full(1, np.nan)))
        self.seen += 1
        residual = b.residual(raw)
        judged = bool(b.judged(raw)[0])
        if judged:
            self.judged += 1
            one = Clusters(cluster.start, cluster.end, cluster.points, raw)
            last = KEPT - 1
            kept = [] if self._recent is None else [self._recent.select(np.arange(len(self._recent))[-last:])]
            self._recent = join_clusters([*kept, one])
            self._residual = np.vstack([self._residual[-last:], residual])
            self._chart()
        return VectorVerdict(time, judged, residual[0], self._statistic, self.limit, self._alarm, self.finding)

    def _chart(self) -> None:
        n = len(self._residual)
        common = self._common(np.arange(n)[-WINDOWS[-1] :])
        # Which window holds a fault is not known: the mean of their ratios is a ratio too.
        logs = [self._window(m, common) for m in WINDOWS if m <= n]
        self._statistic = max(float(np.logaddexp.reduce(logs) - np.log(len(logs))), 0.0) if logs else 0.0
        self._alarm = self._alarm or self._statistic >= self.limit
        if not self._alarm:
            return
        # Words settle soon: what stands for long is looked at again now and then.
        if self.finding is None or self.finding.clusters < SETTLED or self.judged % SETTLED == 0:
            self.finding = self._find()

    def _window(self, size: int, common: FloatArray) -> float:
        """Evidence of the newest clusters without the strangest one.

        Half the squared distance bounds it, which is enough far below the limit and once the alarm stands.
        """
        which = np.arange(len(self._residual))[-size:]
        shown = self._shown(which)
        block = np.ix_(shown, shown)
        common, scatter = common[block], self.baseline.scatter[block]
        residual = self._residual[which][:, shown]
        strange = (residual.T * np.linalg.solve(common + scatter, residual.T)).sum(0)
        which = np.delete(which, int(np.argmax(strange)))
        change, covariance = self._residual[which][:, shown].mean(0), common + scatter / len(which)
        bound = 0.5 * float(change @ np.linalg.solve(covariance, change))
        if self._alarm or bound < 0.5 * self.limit:
            return bound
        return explanations(self.baseline, self._state(which), shown).evidence(change, covariance)[0]

    def _shown(self, which: IntArray) -> IntArray:
        """Features that all of these clusters have; a sensor that is gone takes its own features along only."""
        return np.flatnonzero(np.isfinite(self._residual[which]).all(axis=0))

    def _common(self, which: IntArray) -> FloatArray:
        return self.baseline.common(self.baseline.jacobian(self._state(which)))

    def _state(self, which: IntArray) -> dict[str, float]:
        assert self._recent is not None
        found = {k: v[which] for k, v in self._recent.raw.items()}
        return {k: float(v[np.isfinite(v)].mean()) for k, v in found.items() if np.isfinite(v).any()}

    def _find(self) -> VectorFinding:
        """Since when, and what, from the clusters that share the change."""
        assert self._recent is not None
        n, b = len(self._residual), self.baseline
        everything = np.arange(n)
        shown = self._shown(everything[-WINDOWS[-1] :])
        block = np.ix_(shown, shown)
        newest = int(np.isfinite(self._residual[::-1][:, shown]).all(axis=1).cumprod().sum())
        broad = np.array([FEATURES[b.layout.features[i]][1] ** 2 for i in shown])
        common = self._common(everything)[block]
        length = _since(self._residual[n - newest :][:, shown], common, b.scatter[block], np.diag(broad))
        which = everything[n - length :]
        change = self._residual[which][:, shown].mean(0)
        covariance = self._common(which)[block] + b.scatter[block] / length
        state = self._state(which)
        e = explanations(b, state, shown)
        named = name_cause(e.names, e.evidence(change, covariance)[1])
        onset = int(self._recent.start[which[0]])
        if self.finding is not None and self.finding.onset < int(self._recent.start[0]):
            onset = self.finding.onset  # older than what is remembered
        bias = _bias(b, state, named.cause, shown, change, covariance)
        whole, sd = np.full((2, len(b.layout.features)), np.nan)
        whole[shown], sd[shown] = change, np.sqrt(np.diagonal(covariance))
        return VectorFinding(named, onset, length, whole, sd, bias)

    def export_state(self) -> JsonObject:
        """Plain data."""
        r = self._recent
        return {
            "recent": None
            if r is None
            else {"start": r.start, "end": r.end, "points": r.points, "raw": {k: v.copy() for k, v in r.raw.items()}},
            "residual": self._residual.copy(),
            "statistic": self._statistic,
            "alarm": self._alarm,
            "finding": None if self.finding is None else asdict(self.finding),
            "seen": self.seen,
            "judged": self.judged,
        }

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        r = state["recent"]
        self._recent = None
        if r is not None:
            start, end, points = (np.asarray(r[k], dtype=np.int64) for k in ("start", "end", "points"))
            self._recent = Clusters(start, end, points, {k: np.asarray(v, dtype=float) for k, v in r["raw"].items()})
        self._residual = np.asarray(state["residual"], dtype=float).reshape(-1, len(self.baseline.layout.features))
        self._statistic, self._alarm = float(state["statistic"]), bool(state["alarm"])
        self.seen, self.judged = int(state["seen"]), int(state["judged"])
        self.finding = None
        f = state["finding"]
        if f is not None:
            n = f["named"]
            named = Named(**{**n, "ranked": tuple((str(k), float(p)) for k, p in n["ranked"])})
            arrays = {k: np.asarray(f[k], dtype=float) for k in ("change", "sd")}
            self.finding = VectorFinding(**{**f, "named": named, **arrays})


def _bias(
    baseline: VectorBaseline,
    state: dict[str, float],
    cause: str,
    shown: IntArray,
    change: FloatArray,
    covariance: FloatArray,
) -> str:
    """How far a sensor is off if it alone explains the change, in words."""
    quantity = cause.removesuffix(" sensor")
    if quantity == cause or quantity not in baseline.layout.readings:
        return ""
    direction = baseline.jacobian(state)[shown, baseline.layout.readings.index(quantity)]
    weighted = np.linalg.solve(covariance, direction)
    off = float(weighted @ change) / float(weighted @ direction)
    way = "high" if off > 0 else "low"
    if quantity.startswith("T_") or quantity in DIRECT.values():
        return f", {abs(off):.2g} K too {way}"
    return f", {100 * abs(off / (state[quantity] - off)):.0f} % too {way}"


def _since(residual: FloatArray, common: FloatArray, scatter: FloatArray, any_change: FloatArray) -> int:
    """Newest clusters that share one change: the split into "healthy before, changed since" of the largest likelihood.

    Before it the mean is a slow error's, since then anything's; from cluster to cluster both scatter alike.
    """
    n = len(residual)
    broad = common + any_change
    white = np.linalg.solve(np.linalg.cholesky(scatter), residual.T).T
    since = np.arange(1, n + 1)
    total = _fit_of(white[::-1], residual[::-1], broad, scatter)[since]
    total = total + _fit_of(white, residual, common, scatter)[n - since]
    return int(since[int(np.argmax(total))])


def _fit_of(white: FloatArray, residual: FloatArray, spread: FloatArray, scatter: FloatArray) -> FloatArray:
    """Log likelihood of the first 0, 1, ... n clusters if they share a mean of this spread, shape (n + 1,).

    Terms that are the same however the clusters are split are left out.
    """
    k = np.arange(1, len(residual) + 1)[:, None]
    mean_white, mean = np.cumsum(white, axis=0) / k, np.cumsum(residual, axis=0) / k
    within = np.cumsum((white**2).sum(1)) - k[:, 0] * (mean_white**2).sum(1)
    covariance = spread + scatter / k[..., None]
    distance = (mean * np.linalg.solve(covariance, mean[..., None])[..., 0]).sum(1)
    size = np.linalg.slogdet(covariance)[1] + residual.shape[1] * np.log(k[:, 0])
    size = size - np.linalg.slogdet(scatter)[1]
    return np.concatenate([[0.0], -0.5 * (within + distance + size)])
