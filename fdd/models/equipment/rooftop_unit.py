"""Rooftop unit and fan coil: the air handler's rows, without a steady form of water coils.

A rooftop unit cools by compressor stages and heats by gas or electricity: ``cool`` and ``heat`` are the shares that are
asked for. A fan coil has no mixing box: its entering air stands for the mixed air.
"""

from __future__ import annotations

from dataclasses import replace

from fdd.models.equipment.air_handler import FAULTS, ROLES, ROWS
from fdd.models.expectation import EquipmentModel, Role, Row

ROOFTOP_UNIT = EquipmentModel("rooftop_unit", "Rooftop unit", ROLES, ROWS, FAULTS)

_NAMES = ("Entering_Air_Temperature_Sensor", "Return_Air_Temperature_Sensor", "entering air temp sensor")
_LEFT = ("damper", "damper_return", "damper_exhaust", "fan_return", "T_return", "T_out", "p_static", "p_static_set")


def _fan_coil_roles() -> tuple[Role, ...]:
    kept = (r for r in ROLES if r.symbol not in _LEFT)
    entering = {"meaning": "air that enters the coils", "names": _NAMES, "sd": 0.6}
    return tuple(replace(r, **entering) if r.symbol == "T_mixed" else r for r in kept)  # type: ignore[arg-type]


def _fits(row: Row) -> bool:
    return not set(row.needs) & set(_LEFT)


_ROWS = tuple(r for r in ROWS if _fits(r))
_TOLD = {cause for r in _ROWS for cause in (*r.high_causes, *r.low_causes)}
FAN_COIL = EquipmentModel(
    "fan_coil",
    "Fan coil",
    _fan_coil_roles(),
    tuple(
        replace(
            r,
            high_causes=tuple(c for c in r.high_causes if "outdoor" not in c),
            low_causes=tuple(c for c in r.low_causes if "outdoor" not in c),
        )
        for r in _ROWS
    ),
    tuple(f for f in FAULTS if f.name in _TOLD and "outdoor" not in f.name),
)
