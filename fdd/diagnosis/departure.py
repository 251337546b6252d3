"""How a component departs from its baseline, as numbers: what diagnosis ranks causes by, and what costs follow from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fdd.records import FloatArray, JsonObject
from fdd.residual_monitors.information import Change, change


@dataclass(frozen=True, slots=True)
class Departure:
    """What has been seen of one component since the onset of an alarm.

    Attributes
    ----------
    symbols : physical parameters, (n_p,)
    values : their values on the baseline, natural scale
    score, information : sums over the time, (n_p,) and (n_p, n_p), on the estimation scale
    spread : standard deviation of a block's standardised score on healthy data, 1 where the model is true, (n_p,)
    baseline : covariance granted to the baseline's parameters, (n_p, n_p)
    outputs : measured outputs, (n_y,)
    innovation, count : sums and numbers of standardised innovations, (n_y,)
    jump : the largest single innovation around the onset [standard deviations], (n_y,)
    """

    symbols: tuple[str, ...]
    values: FloatArray
    score: FloatArray
    information: FloatArray
    spread: FloatArray
    baseline: FloatArray
    outputs: tuple[str, ...]
    innovation: FloatArray
    count: FloatArray
    jump: FloatArray

    @property
    def mean(self) -> FloatArray:
        """Mean standardised innovation of each output; 0 where nothing was seen."""
        return np.asarray(self.innovation / np.maximum(self.count, 1.0))

    def changes(self) -> Change:
        """How far each parameter has moved, alone or together with the others, on the estimation scale."""
        return change(self.score, self.information, self.baseline, self.spread)

    def document(self) -> JsonObject:
        """For the alarm's evidence: every parameter that can be told apart, and every output."""
        found = self.changes()
        told = np.isfinite(found.joint_error)
        return {
            "parameters": {
                s: {"change": float(found.joint[j]), "standard_error": float(found.joint_error[j])}
                for j, s in enumerate(self.symbols)
                if told[j]
            },
            "outputs": {
                s: {"mean": float(self.mean[j]), "count": int(self.count[j]), "jump": float(self.jump[j])}
                for j, s in enumerate(self.outputs)
            },
        }


@dataclass(frozen=True, slots=True)
class Operation:
    """Hourly means of a component's inputs and outputs over the last day, by symbol, each (hours,), SI."""

    hours: Mapping[str, FloatArray]

    def __len__(self) -> int:
        return min((len(v) for v in self.hours.values()), default=0)
