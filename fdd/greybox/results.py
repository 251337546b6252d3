"""What a fit gives back, in the manner of statsmodels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from fdd.greybox import simulate
from fdd.greybox.identifiability import Flat, Known, identified, reservations, strongly_correlated
from fdd.greybox.likelihood import Data, FilterPath, Likelihood
from fdd.greybox.scale import Prior, chain, from_scale, to_scale
from fdd.greybox.simulate import Forecast
from fdd.models.declare import ComponentModel

FloatArray = NDArray[np.float64]
MOSTLY_PRIOR = 0.5  # share of a prior's variance that the data must take away to count as the source
SCHEMA = 2


@dataclass(frozen=True, slots=True, eq=False)
class Trial:
    """One search: from where, to where, how good (negative log posterior)."""

    start: FloatArray
    theta: FloatArray
    value: float
    evaluations: int
    converged: bool
    reason: str


@dataclass(frozen=True)
class FitResult:
    """Estimates with their uncertainty; natural scale and units of the parameter table unless said.

    Attributes
    ----------
    params, bse, tvalues : by symbol; ``bse`` is NaN for fixed parameters, infinite for those at a bound or not told
    cov, cov_scale : covariance of all parameters (n_p, n_p), natural and transform scale; zero for fixed ones
    llf, aic, bic, nobs : log-likelihood (prior left out), information criteria, measured values used
    unidentifiable : parameters that take part in a direction in which the likelihood is flat
    flat, known : those directions, in words, too; products of such parameters that the data tell all the same
    at_bound : parameters that ended on a bound
    trials : one row a search
    errors, huber : what the errors were taken from; the bound of a robust likelihood, infinite otherwise
    prediction : how the filter went from sample to sample, as it was chosen
    warnings : what the data and the optimum suggest to look at
    """

    model_name: str
    model_version: str
    options: Mapping[str, Any]
    params: dict[str, float]
    bse: dict[str, float]
    cov: FloatArray
    cov_scale: FloatArray
    llf: float
    nobs: int
    free: tuple[str, ...]
    penalty: float
    converged: bool
    reason: str
    unidentifiable: tuple[str, ...]
    at_bound: tuple[str, ...]
    gradient: dict[str, float]
    warnings: tuple[str, ...]
    errors: str
    trials: tuple[Trial, ...]
    priors: Mapping[str, Prior]
    start: Mapping[str, float]
    span: tuple[tuple[float, float], ...]
    flat: tuple[Flat, ...] = ()
    known: tuple[Known, ...] = ()
    prediction: str = ""
    huber: float = math.inf
    model: ComponentModel | None = None
    likelihood: Likelihood | None = None

    @classmethod
    def build(
        cls, *, likelihood: Likelihood, values: FloatArray, free: NDArray[np.int64], llf: float, penalty: float,
        gradient: FloatArray, fisher: FloatArray, observed: FloatArray | None, scatter: FloatArray | None,
        at_bound: NDArray[np.bool_], trials: Sequence[Trial], converged: bool, reason: str,
        priors: Mapping[str, Prior], start: Mapping[str, float], wanted: str,
    ) -> FitResult:  # fmt: skip
        """Standard errors and their reservations, from the information at the optimum."""
        model = likelihood.model
        names = model.symbols["parameters"]
        rows = [model.parameters[k] for k in free]
        found = identified(fisher, observed, at_bound, rows, values[free])
        inner, kind = found.covariance, "observed" if found.observed else "fisher"
        if scatter is not None:
            inner, kind = inner @ scatter @ inner, "sandwich"
        cov_scale = np.zeros((len(names), len(names)))
        cov_scale[np.ix_(free, free)] = inner
        slope = chain(model, values)
        cov = cov_scale * np.outer(slope, slope)
        bse = {name: math.nan for name in names}
        bound = tuple(names[k] for k, on in zip(free, at_bound, strict=True) if on)
        for k in free:
            told = names[k] not in found.untold and names[k] not in bound
            bse[names[k]] = math.sqrt(max(cov[k, k], 0.0)) if told else math.inf
        warnings = [*likelihood.warnings, *reservations(found, bound, converged, reason, wanted, kind)]
        records = likelihood.records
        return cls(
            model_name=model.name,
            model_version=model.version,
            options=dict(model.options),
            params={name: float(v) for name, v in zip(names, values, strict=True)},
            bse=bse,
            cov=cov,
            cov_scale=cov_scale,
            llf=llf,
            nobs=sum(int(np.isfinite(d.y).sum()) for d in records),
            free=tuple(names[k] for k in free),
            penalty=penalty,
            converged=converged,
            reason=reason,
            unidentifiable=found.untold,
            flat=found.flat,
            known=found.known,
            at_bound=bound,
            gradient={names[k]: float(g) for k, g in zip(free, gradient, strict=True)},
            warnings=tuple(warnings),
            errors=kind,
            trials=tuple(trials),
            priors=dict(priors),
            start=dict(start),
            span=tuple((float(d.t[0]), float(d.t[-1])) for d in records),
            prediction=likelihood.prediction(),
            huber=likelihood.huber,
            model=model,
            likelihood=likelihood,
        )

    # Numbers
    @property
    def values(self) -> FloatArray:
        """All parameters (n_p,), in the model's order."""
        return np.array(list(self.params.values()))

    @property
    def tvalues(self) -> dict[str, float]:
        """Estimates over their standard errors."""
        return {k: self.params[k] / s if 0 < s < math.inf else math.nan for k, s in self.bse.items()}

    @property
    def pvalues(self) -> dict[str, float]:
        """Two-sided, normal: probability of such an estimate if the parameter were zero."""
        return {k: float(2 * stats.norm.sf(abs(t))) for k, t in self.tvalues.items()}

    @property
    def aic(self) -> float:
        """Akaike's criterion; NaN for a maximum a posteriori estimate, which does not maximise the likelihood."""
        if self.priors:
            return math.nan
        return 2 * len(self.free) - 2 * self.llf

    @property
    def bic(self) -> float:
        """Schwarz's criterion; NaN for a maximum a posteriori estimate."""
        if self.priors:
            return math.nan
        return len(self.free) * math.log(self.nobs) - 2 * self.llf

    @property
    def correlation(self) -> FloatArray:
        """Correlation of the estimates on the transform scale, (n_p, n_p); NaN for those without error."""
        sd = np.sqrt(np.diag(self.cov_scale))
        with np.errstate(all="ignore"):
            return np.asarray(self.cov_scale / np.outer(sd, sd))

    def conf_int(self, alpha: float = 0.05) -> dict[str, tuple[float, float]]:
        """Intervals that are symmetric on the transform scale, natural units; infinite for what is not told."""
        z = float(stats.norm.isf(alpha / 2))
        out = {}
        for k, q in enumerate(self._model().parameters):
            s = math.sqrt(max(self.cov_scale[k, k], 0.0))
            if not math.isfinite(self.bse[q.symbol]):
                edge = self.bse[q.symbol]
                out[q.symbol] = (-edge, edge)
                continue
            theta = to_scale(q, self.params[q.symbol])
            out[q.symbol] = (from_scale(q, theta - z * s), from_scale(q, theta + z * s))
        return out

    # Text
    def summary(self) -> str:
        """A table of the estimates and what to know about them."""
        head = [
            f"{self.model_name} {self.model_version}  log-likelihood {self.llf:.4f}  {self._criteria()}",
            *self._posterior(),
            f"{self.nobs} measured values, {len(self.free)} parameters, "
            f"{'converged' if self.converged else 'NOT CONVERGED'} ({self.reason}), {len(self.trials)} search(es), "
            f"errors from the {self.errors}{'' if self.errors == 'sandwich' else ' information'}",
            *([f"robust: innovations bounded at {self.huber:g} standard deviations"] if self.huber < math.inf else []),
            *([f"prediction: {self.prediction}"] if self.prediction else []),
            "",
            f"{'parameter':<14}{'estimate':>14}{'std err':>12}{'t':>9}{'P>|t|':>8}  unit",
        ]
        units = {q.symbol: q.unit for q in self.model.parameters} if self.model is not None else {}
        t, p = self.tvalues, self.pvalues
        rows = []
        for name, value in self.params.items():
            if name not in self.free:
                note = f"{'fixed':>12}{'':>17}"
            elif name in self.unidentifiable:
                note = f"{'not identified':>29}"
            elif name in self.at_bound:
                note = f"{'at its bound':>29}"
            else:
                note = f"{self.bse[name]:>12.4g}{t[name]:>9.2f}{p[name]:>8.3f}"
            rows.append(f"{name:<14}{value:>14.6g}{note}  {units.get(name, '')}")
        together = strongly_correlated(self.correlation, tuple(self.params))
        rows += ["", "estimates that move together (correlation): " + together] if together else []
        return "\n".join([*head, *rows, *(["", *(f"! {w}" for w in self.warnings)] if self.warnings else [])])

    def _criteria(self) -> str:
        if self.priors:
            return "(AIC and BIC are those of maximum likelihood and not told: there are priors)"
        return f"AIC {self.aic:.2f}  BIC {self.bic:.2f}"

    def _posterior(self) -> list[str]:
        """What a maximum a posteriori estimate rests on beside the data."""
        if not self.priors:
            return []
        told = ", ".join(f"{s} {prior.words()}" for s, prior in self.priors.items())
        lines = [f"maximum a posteriori: log posterior {self.llf - self.penalty:.4f}; priors {told}"]
        mostly = [s for s in self.priors if self.learned(s) < MOSTLY_PRIOR]
        return [*lines, f"known mainly from the prior: {', '.join(mostly)}"] if mostly else lines

    def learned(self, symbol: str) -> float:
        """Share of a prior's variance that the data took away, 0 to 1; 1 without a prior, 0 for what is not told."""
        if symbol not in self.priors:
            return 1.0
        prior, error = self.priors[symbol], self.bse[symbol]
        sd = prior.sd * (self.params[symbol] if prior.log else 1.0)
        return max(0.0, 1.0 - (error / sd) ** 2) if math.isfinite(error) else 0.0

    # Plain data
    def to_dict(self) -> dict[str, Any]:
        """Plain data (JSON) with model version and data span; :meth:`from_dict` takes it back."""
        number = {math.inf: "inf", -math.inf: "-inf"}
        finite = {k: (None if math.isnan(v) else number.get(v, v)) for k, v in self.bse.items()}
        return {
            "schema": SCHEMA,
            "model": self.model_name,
            "model_version": self.model_version,
            "options": dict(self.options),
            "params": dict(self.params),
            "bse": finite,
            "cov": self.cov.tolist(),
            "cov_scale": self.cov_scale.tolist(),
            "llf": self.llf,
            "nobs": self.nobs,
            "free": list(self.free),
            "penalty": self.penalty,
            "converged": self.converged,
            "reason": self.reason,
            "unidentifiable": list(self.unidentifiable),
            "at_bound": list(self.at_bound),
            "gradient": dict(self.gradient),
            "warnings": list(self.warnings),
            "errors": self.errors,
            "priors": {k: [v.mean, v.sd, v.log] for k, v in self.priors.items()},
            "flat": [{"powers": dict(f.powers), "words": f.words} for f in self.flat],
            "known": [{"words": f.words, "value": f.value, "error": f.error} for f in self.known],
            "start": dict(self.start),
            "span": [list(s) for s in self.span],
            "prediction": self.prediction,
            "huber": self.huber if math.isfinite(self.huber) else None,
            "trials": [
                {"start": t.start.tolist(), "theta": t.theta.tolist(), "value": t.value, "evaluations": t.evaluations,
                 "converged": t.converged, "reason": t.reason}
                for t in self.trials
            ],
        }  # fmt: skip

    @classmethod
    def from_dict(
        cls, document: Mapping[str, Any], model: ComponentModel | None = None, data: Data | Sequence[Data] | None = None
    ) -> FitResult:
        """Take back what :meth:`to_dict` gave; with model and data the methods that filter work again.

        Raises
        ------
        ValueError : of another schema, or of another model or version than the one given
        """
        if document.get("schema") != SCHEMA:
            raise ValueError(
                f"fit result has schema {document.get('schema')!r}, this program reads {SCHEMA}; fit again"
            )
        made = (document["model"], document["model_version"])
        if model is not None and made != (model.name, model.version):
            raise ValueError(
                f"fit result is of {made[0]} {made[1]}, the model given is {model.name} {model.version}; fit again"
            )
        huber = document.get("huber") or math.inf
        likelihood = None
        if model is not None and data is not None:
            likelihood = Likelihood(model, [data] if isinstance(data, Data) else list(data), huber=huber)
        special = {"inf": math.inf, "-inf": -math.inf}
        return cls(
            model_name=made[0],
            model_version=made[1],
            options=document["options"],
            params=dict(document["params"]),
            bse={k: math.nan if v is None else special.get(v, v) for k, v in document["bse"].items()},
            cov=np.array(document["cov"]),
            cov_scale=np.array(document["cov_scale"]),
            llf=document["llf"],
            nobs=document["nobs"],
            free=tuple(document["free"]),
            penalty=document["penalty"],
            converged=document["converged"],
            reason=document["reason"],
            unidentifiable=tuple(document["unidentifiable"]),
            at_bound=tuple(document["at_bound"]),
            gradient=dict(document["gradient"]),
            warnings=tuple(document["warnings"]),
            errors=document["errors"],
            trials=tuple(
                Trial(**{**t, "start": np.array(t["start"]), "theta": np.array(t["theta"])}) for t in document["trials"]
            ),
            priors={k: Prior(*v) for k, v in document["priors"].items()},
            flat=tuple(Flat(**f) for f in document["flat"]),
            known=tuple(Known(**f) for f in document["known"]),
            start=dict(document["start"]),
            span=tuple((s[0], s[1]) for s in document["span"]),
            prediction=document.get("prediction", ""),
            huber=huber,
            model=model,
            likelihood=likelihood,
        )

    # What the filter saw
    @property
    def records(self) -> list[Data]:
        """The records it was fitted to."""
        return self._likelihood().records

    def paths(self, data: Data | None = None) -> list[FilterPath]:
        """Predictions, innovations and states at the estimates, a record each; on other data where given."""
        return self._likelihood(data).paths(self.values)

    def predict(self, k: int = 1, data: Data | None = None) -> FloatArray:
        """Outputs predicted k samples ahead, (N, n_y); see :func:`fdd.greybox.simulate.predict`."""
        return simulate.predict(self._one(data), self.values, k)

    def simulate(self, data: Data | None = None) -> FloatArray:
        """Outputs from start value and inputs alone, (N, n_y)."""
        return simulate.simulate(self._one(data), self.values)

    def forecast(self, rows: Sequence[int], steps: int, data: Data | None = None) -> Forecast:
        """Distributions of states and outputs 1 to ``steps`` samples after rows; see :func:`simulate.forecast`."""
        return simulate.forecast(self._one(data), self.values, rows, steps)

    def sample(
        self, row: int, steps: int, count: int, data: Data | None = None, seed: int = 0
    ) -> tuple[FloatArray, FloatArray]:
        """Drawn paths of states and outputs from the filtered state at a row; see :func:`simulate.sample`."""
        return simulate.sample(self._one(data), self.values, row, steps, count, seed)

    def smooth(self, data: Data | None = None) -> tuple[FloatArray, FloatArray]:
        """Smoothed states (N, n) and covariances (N, n, n)."""
        return simulate.smooth(self._one(data), self.values)

    def trials_table(self) -> str:
        """The optima of all searches, best first."""
        rows = sorted(enumerate(self.trials, 1), key=lambda row: row[1].value)
        head = f"{'search':>7}{'neg. log-lik.':>18}{'above best':>13}{'evaluations':>13}  ended"
        return "\n".join([head] + [
            f"{i:>7}{t.value:>18.6f}{t.value - rows[0][1].value:>13.4f}{t.evaluations:>13}  {t.reason}"
            for i, t in rows
        ])  # fmt: skip

    def _model(self) -> ComponentModel:
        if self.model is None:
            raise ValueError("this result was loaded without its model; give it to from_dict")
        return self.model

    def _likelihood(self, data: Data | None = None) -> Likelihood:
        if data is not None:
            return Likelihood(self._model(), data, huber=self.huber)
        if self.likelihood is None:
            raise ValueError("this result was loaded without its data; give data")
        return self.likelihood

    def _one(self, data: Data | None) -> Likelihood:
        """The likelihood of one record: that given, or the first of the fit."""
        return self._likelihood(data if data is not None else self.records[0])
