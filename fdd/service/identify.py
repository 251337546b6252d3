"""Baselines by maximum likelihood: from a history to the parameters a component's filter runs on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from fdd.greybox.fit import fit
from fdd.greybox.likelihood import Data
from fdd.greybox.results import FitResult
from fdd.records import NANOSECONDS, Baseline, FloatArray, JsonObject
from fdd.service.filters import FilterGroup
from fdd.service.history import History, Run, runs
from fdd.service.plan import Component, Plan


class IdentifyError(ValueError):
    """A history from which a component cannot be identified; the text says why and what to do."""


# Fewer samples than this for each parameter leave more to chance than to the plant.
SAMPLES_PER_PARAMETER = 10


def identify(
    plan: Plan,
    component: Component,
    history: History,
    *,
    version: int = 1,
    start: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> tuple[Baseline, FitResult]:
    """Fit one component to a healthy history.

    Raises
    ------
    IdentifyError
        There is too little usable data.
    """
    found = runs(plan, component, history)
    n, needed = sum(len(r.time) for r in found), SAMPLES_PER_PARAMETER * len(component.model.parameters)
    if n < needed:
        raise IdentifyError(
            f"{component.name}: {n} usable frames in {len(history)}, at least {needed} are needed for "
            f"{len(component.model.parameters)} parameters; give a longer span, or check that "
            f"{', '.join((*component.inputs, *component.outputs))} have data there"
            + (f" and that the gate {component.when!r} is open" if component.when else "")
        )
    result = fit(component.model, [_data(r) for r in found], start=start)
    baseline = Baseline(
        component=component.name,
        version=version,
        model=component.model.name,
        model_version=component.model.version,
        options=dict(component.model.options),
        parameters={k: float(v) for k, v in result.params.items()},
        standard_errors={k: float(v) for k, v in result.bse.items()},
        covariance=np.asarray(result.cov_scale).tolist(),
        start=int(found[0].time[0]),
        end=int(found[-1].time[-1]),
        samples=n,
        log_likelihood=float(result.llf),
        innovation={},
        diagnostics={
            "converged": result.converged,
            "unidentifiable": list(result.unidentifiable),
            "at_bound": list(result.at_bound),
        },
    )
    statistics = innovation_statistics(plan, component, baseline, history)
    return replace(baseline, innovation=statistics), result


def _data(run: Run) -> Data:
    return Data(t=(run.time - run.time[0]) / NANOSECONDS, u=run.u, y=run.y)


def standardised_innovations(plan: Plan, component: Component, baseline: Baseline, history: History) -> FloatArray:
    """What the engine would feed the component's charts over a history, shape (m, n_outputs), NaN where nothing."""
    group = FilterGroup([component], {component.name: baseline}, plan.columns, hold=plan.hold, max_gap=plan.max_gap)
    steps = [group.step(t, row).standardised[0] for t, row in zip(history.time.tolist(), history.values, strict=True)]
    return np.array(steps)


def innovation_statistics(
    plan: Plan, component: Component, baseline: Baseline, history: History
) -> dict[str, JsonObject]:
    """Mean, spread and lag-one autocorrelation of each output's standardised innovations on the baseline.

    The spread is the larger of the standard deviation and the interquartile one: heavy shoulders or heavy tails, a
    chart that is fed with these values keeps its promise only if neither is understated.
    """
    z = standardised_innovations(plan, component, baseline, history)
    found: dict[str, JsonObject] = {}
    for quantity, column in zip(component.model.outputs, z.T, strict=True):
        seen = column[np.isfinite(column)]
        low, high = np.percentile(seen, [25, 75])
        both = np.isfinite(column[1:]) & np.isfinite(column[:-1])
        found[quantity.symbol] = {
            "mean": float(seen.mean()),
            "sd": float(max(seen.std(), (high - low) / 1.349)),
            "lag1": float(np.corrcoef(column[1:][both], column[:-1][both])[0, 1]),
            "samples": len(seen),
        }
    return found
