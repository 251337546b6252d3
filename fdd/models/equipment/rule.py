"""A rule of a site's own as equipment with one row: an expression that is zero, or at most zero, where all is well."""

from __future__ import annotations

from typing import Literal

import numpy as np

from fdd.models.expectation import Day, EquipmentFault, EquipmentModel, Residual, Role, Row, Term

Side = Literal["above", "below", "either"]


def rule_model(
    name: str, unit: str, tolerance: float, side: Side, held: float, says: str, checks: tuple[str, ...] = ()
) -> EquipmentModel:
    """The declaration of a rule.

    Parameters
    ----------
    tolerance : what may remain for good [unit]: two standard deviations
    side : where the expression leaves zero when something is wrong
    held : how long its condition must have held [s]
    says : what it then means
    """
    sign = -1.0 if side == "below" else 1.0

    def residual(v: Day) -> Residual:
        value = v["value"]
        return np.where(v.held(np.isfinite(value), held), sign * value, np.nan), {"tolerance": 1.0}

    row = Row(
        name,
        ("value",),
        residual,
        "the site's own rule",
        high=says,
        low=says if side == "either" else "",
        high_causes=(name,),
        low_causes=(name,) if side == "either" else (),
        terms=(Term("tolerance", tolerance / 2, "what may remain for good"),),
        sd=tolerance / 4,
        unit=unit,
        inequality=side != "either",
    )
    fault = EquipmentFault(name, "rule", says, checks)
    return EquipmentModel("rule", f"Rule {name}", (Role("value", unit, says, required=True),), (row,), (fault,))
