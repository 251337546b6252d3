"""Equipment that is watched by physical expectations from its first day; one file a kind."""

from __future__ import annotations

from collections.abc import Mapping

from fdd.models.equipment.air_handler import AIR_HANDLER
from fdd.models.equipment.boiler import BOILER
from fdd.models.equipment.heat_pump import HEAT_PUMP
from fdd.models.equipment.rooftop_unit import FAN_COIL, ROOFTOP_UNIT
from fdd.models.equipment.vav_box import VAV_BOX
from fdd.models.equipment.water_side import COOLING_TOWER, PUMP_LOOP
from fdd.models.expectation import EquipmentModel

_ALL = (AIR_HANDLER, ROOFTOP_UNIT, FAN_COIL, VAV_BOX, BOILER, HEAT_PUMP, COOLING_TOWER, PUMP_LOOP)
KINDS: Mapping[str, EquipmentModel] = {m.name: m for m in _ALL}
"""Every kind by the name a site file gives as ``model``."""
