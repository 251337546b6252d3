"""Clusters of steady points at like drivers: the unit that a chiller is judged by.

Neighbouring steady points share their slow errors, so that ten of them know little more than one. Points that follow
one another at the same load, entering temperatures and pump drives become one cluster, whose readings are their means.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fdd.chiller_eiv.errors import RAW_UNITS
from fdd.chiller_eiv.steady_state import SteadyPoints
from fdd.records import NANOSECONDS, FloatArray, IntArray, JsonObject

HOUR = 3600 * NANOSECONDS
LONGEST = 12 * HOUR
"""A cluster ends after this long."""
GAP = 2 * HOUR
"""... or when no point has come for this long."""
ALIKE: Mapping[str, float] = {"T_cdi": 0.75, "T_cho": 0.5, "T_chi": 0.75}
"""Temperatures of one cluster stay within this of its mean [K]."""
ALIKE_SHARE: Mapping[str, float] = {"load": 0.05, "flow_ch": 0.05, "flow_cd": 0.05, "drive_ch": 0.05, "drive_cd": 0.05}
"""Flows and drives stay within this share of its mean, the load within this share of the rated load [1]."""


@dataclass(frozen=True)
class Clusters:
    """Clusters in order of time.

    Attributes
    ----------
    start, end : shape (n,) [ns]
    points : shape (n,), steady points in each
    raw : mean readings, shape (n,) each, units of ``errors.RAW_UNITS``
    """

    start: IntArray
    end: IntArray
    points: IntArray
    raw: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return len(self.start)

    def select(self, which: IntArray) -> Clusters:
        """Some of them."""
        return Clusters(
            self.start[which], self.end[which], self.points[which], {k: v[which] for k, v in self.raw.items()}
        )


@dataclass
class Clustering:
    """Makes clusters of points that come one by one.

    Parameters
    ----------
    rated_load : [W]
    """

    rated_load: float
    _rows: list[dict[str, float]] = field(default_factory=list)
    _start: int = 0
    _end: int = 0

    def add(self, end: int, length: int, row: Mapping[str, float]) -> Clusters | None:
        """Take a steady point.

        Parameters
        ----------
        end, length : of its window [ns]
        row : its readings and ``load`` [W]

        Returns
        -------
        The cluster that the point has ended, if any
        """
        done = None
        if self._rows and not self._alike(end, row):
            done = self._close()
        if not self._rows:
            self._start = end - length
        self._rows.append({k: float(v) for k, v in row.items() if np.isfinite(v)})
        self._end = end
        return done

    def tick(self, time: int) -> Clusters | None:
        """The cluster that has ended because no point has come for long, if any."""
        return self._close() if self._rows and time - self._end > GAP else None

    def finish(self) -> Clusters | None:
        """The cluster that is open at the end of the data."""
        return self._close() if self._rows else None

    def _alike(self, end: int, row: Mapping[str, float]) -> bool:
        if end - self._end > GAP or end - self._start > LONGEST:
            return False
        mean = _mean(self._rows)
        for k, width in ALIKE.items():
            if k in row and k in mean and abs(row[k] - mean[k]) > width:
                return False
        for k, share in ALIKE_SHARE.items():
            scale = self.rated_load if k == "load" else abs(mean.get(k, 0.0))
            if k in row and k in mean and abs(row[k] - mean[k]) > share * scale:
                return False
        return True

    def _close(self) -> Clusters:
        mean, n = _mean(self._rows), len(self._rows)
        self._rows = []
        return Clusters(
            np.array([self._start], dtype=np.int64),
            np.array([self._end], dtype=np.int64),
            np.array([n], dtype=np.int64),
            {k: np.array([v]) for k, v in mean.items()},
        )

    def export_state(self) -> JsonObject:
        """Plain data."""
        return {"rows": [dict(r) for r in self._rows], "start": self._start, "end": self._end}

    def restore_state(self, state: JsonObject) -> None:
        """Continue where :meth:`export_state` stood."""
        self._rows = [{k: float(v) for k, v in r.items()} for r in state["rows"]]
        self._start, self._end = int(state["start"]), int(state["end"])


def _mean(rows: list[dict[str, float]]) -> dict[str, float]:
    names = {k for r in rows for k in r}
    return {k: float(np.mean([r[k] for r in rows if k in r])) for k in (*RAW_UNITS, "load") if k in names}


def point_rows(points: SteadyPoints, load: FloatArray) -> list[dict[str, float]]:
    """Each point's readings with its load [W]; a reading that was not there is left out."""
    return [
        {**{k: float(v[i]) for k, v in points.raw.items() if np.isfinite(v[i])}, "load": float(load[i])}
        for i in range(len(points))
    ]


def cluster(points: SteadyPoints, load: FloatArray, length: int, rated_load: float) -> Clusters:
    """Clusters of the points of a whole history; the same as one by one.

    Parameters
    ----------
    load : shape (n,), of each point [W]
    length : of a point's window [ns]
    """
    clustering = Clustering(rated_load)
    found = [clustering.add(int(t), length, r) for t, r in zip(points.time, point_rows(points, load), strict=True)]
    return join_clusters([c for c in (*found, clustering.finish()) if c is not None])


def join_clusters(parts: list[Clusters]) -> Clusters:
    """Clusters of several spans as one; a quantity that not all have is NaN where it is missing."""
    if not parts:
        none = np.zeros(0, dtype=np.int64)
        return Clusters(none, none, none, {})
    names = [k for k in (*RAW_UNITS, "load") if any(k in p.raw for p in parts)]
    names = list(dict.fromkeys(names))
    return Clusters(
        np.concatenate([p.start for p in parts]),
        np.concatenate([p.end for p in parts]),
        np.concatenate([p.points for p in parts]),
        {k: np.concatenate([p.raw.get(k, np.full(len(p), np.nan)) for p in parts]) for k in names},
    )
