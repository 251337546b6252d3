"""Equipment that is watched by physical expectations from its first day; one file a kind."""

from __future__ import annotations

from collections.abc import Mapping

from fdd.models.equipment.air_handler import AIR_HANDLER
from fdd.models.expectation import EquipmentModel

KINDS: Mapping[str, EquipmentModel] = {m.name: m for m in (AIR_HANDLER,)}
"""Every kind by the name a site file gives as ``model``."""
