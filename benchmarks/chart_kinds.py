"""Every chart of ``fdd/residual_monitors`` by its name, found by introspection, for benchmarks and checks."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from functools import cache
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import fdd.residual_monitors as package
from fdd.residual_monitors.chart import Chart, Feed


@cache
def charts() -> MappingProxyType[str, type[Chart]]:
    """Kind to class, for every chart.

    Raises
    ------
    ValueError
        Where two classes claim one name.
    """
    found: dict[str, type[Chart]] = {}
    for module in sorted(m.name for m in pkgutil.iter_modules(package.__path__)):
        for _, cls in inspect.getmembers(importlib.import_module(f"{package.__name__}.{module}"), inspect.isclass):
            if not issubclass(cls, Chart) or inspect.isabstract(cls):
                continue
            if found.setdefault(cls.kind, cls) is not cls:
                raise ValueError(f"charts {found[cls.kind].__name__} and {cls.__name__} are both called {cls.kind!r}")
    return MappingProxyType(dict(sorted(found.items())))


def make(kind: str, arl: ArrayLike, **options: Any) -> Chart:
    """A chart of this kind for as many streams as ``arl`` has entries; see its ``design``.

    Raises
    ------
    ValueError
        For an unknown kind.
    """
    if kind not in charts():
        raise ValueError(f"there is no chart {kind!r}; there are {', '.join(charts())}")
    return charts()[kind].design(arl, **options)


def warm_up() -> None:
    """Compile every chart's kernels, so that the first sample does not wait for it."""
    for cls in charts().values():
        chart = cls.design(np.full(1, 1e4))
        nothing = np.full(chart.n, np.nan)
        if cls.feed is Feed.SCORES:
            chart.update_scores(nothing[:, None], nothing[:, None, None])  # type: ignore[attr-defined]
        else:
            chart.update(nothing)
