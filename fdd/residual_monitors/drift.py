"""Parameter drift: a CUSUM on estimates that come with their own standard errors."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fdd.residual_monitors.chart import Feed, Verdicts, per_stream
from fdd.residual_monitors.cusum import Cusum
from fdd.residual_monitors.run_length import limit_for


class Drift(Cusum):
    r"""Two-sided CUSUM on (estimate - reference) / standard error.

    For parameters re-estimated now and then from separate data: a chiller's regression by the week, a re-identified
    component. Between estimates nothing is seen. Samples of a filter: ``score``, which needs no re-estimation.

    Equations
        .. math:: z_t = (\hat\theta_t - \theta_0) / \mathrm{se}_t

        The reference's own error is the same in every z; ``reference_ratio`` widens the limits for it.

    Parameters
    ----------
    limit, k, head_start : see :class:`Cusum`
    reference : shape (n,), baseline values, the parameters' unit
    most_error : shape (n,), a standard error above this says that the data do not show the parameter: nothing is seen
    """

    kind = "drift"
    feed = Feed.ESTIMATES

    def __init__(
        self,
        limit: ArrayLike,
        *,
        reference: ArrayLike = 0.0,
        most_error: ArrayLike = np.inf,
        k: ArrayLike = 0.5,
        head_start: float = 0.0,
    ) -> None:
        super().__init__(limit, k=k, head_start=head_start)
        self.reference = per_stream(reference, self.n, "reference")
        self.most_error = per_stream(most_error, self.n, "most_error")
        if not np.all(np.isfinite(self.reference)) or not np.all(self.most_error > 0):
            raise ValueError("drift chart: references must be finite and most_error positive")

    @classmethod
    def design(  # type: ignore[override]  # a sibling's options
        cls,
        arl: ArrayLike,
        *,
        reference: ArrayLike = 0.0,
        most_error: ArrayLike = np.inf,
        reference_ratio: float = 0.0,
        k: float = 0.5,
        head_start: float = 0.0,
    ) -> Drift:
        """A chart with these mean numbers of estimates between false alarms.

        ``reference_ratio`` is the standard error of the reference over that of one estimate.
        """
        limit = limit_for("cusum", arl, k=k, head_start=head_start, shift_sd=reference_ratio)
        return cls(limit, reference=reference, most_error=most_error, k=k, head_start=head_start)

    def update_estimates(self, estimate: ArrayLike, error: ArrayLike) -> Verdicts:
        """Take new estimates and their standard errors, shape (n,), in the parameters' unit; NaN: no new estimate."""
        value = np.asarray(estimate, dtype=np.float64)
        se = np.asarray(error, dtype=np.float64)
        told = np.isfinite(value) & (se > 0) & (se <= self.most_error) & np.isfinite(se)
        return self.update(np.where(told, (value - self.reference) / np.where(told, se, 1.0), np.nan))
