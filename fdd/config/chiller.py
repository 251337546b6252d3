"""Chillers in the site file: equipment with ``model: gordon_ng``, whose options are the keys of ``docs/chiller.md``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

from fdd.chiller_eiv.config import ChillerConfig, config_of_table
from fdd.chiller_eiv.errors import RAW_UNITS
from fdd.chiller_eiv.model import ChillerError
from fdd.config.schema import CHILLER, Equipment, Site
from fdd.models.declare import Quantity

MEANINGS: Mapping[str, str] = {
    "T_cdi": "condenser water entering",
    "T_cdo": "condenser water leaving",
    "T_chi": "chilled water entering",
    "T_cho": "chilled water leaving",
    "flow_ch": "chilled water flow",
    "flow_cd": "condenser water flow",
    "load": "cooling load of a heat meter",
    "power": "electrical power",
    "auxiliary": "power of auxiliaries on the same meter",
    "speed": "relative compressor speed",
    "T_sat_cd": "saturation temperature in the condenser",
    "T_sat_ev": "saturation temperature in the evaporator",
    "T_liquid": "liquid line temperature",
    "T_discharge": "discharge temperature of the compressor",
    "T_oil": "oil temperature",
    "subcooling": "subcooling of the liquid, where T_liquid is not given",
    "superheat": "superheat of the discharge gas, where T_discharge is not given",
    "drive_ch": "speed, power or command of the chilled water pump, in any unit",
    "drive_cd": "speed, power or command of the condenser water pump, in any unit",
    "others": "how many other machines run on the same water",
}
ROLES = tuple(Quantity(symbol, unit, MEANINGS[symbol]) for symbol, unit in RAW_UNITS.items())
"""What a chiller's ``inputs`` may name."""


def is_chiller(equipment: Equipment) -> bool:
    """Whether a piece of equipment is monitored as a chiller and not by a filter."""
    return equipment.model == CHILLER


def chiller_config(site: Site, name: str) -> ChillerConfig:
    """A chiller's declaration: its options, errors from the sensors, price from the tariffs, its share of the budget.

    Raises
    ------
    ChillerError : an unknown or missing option, or a value that is refused
    """
    equipment = site.equipment[name]
    table: dict[str, Any] = {"currency": site.tariffs.currency, **equipment.options}
    if site.tariffs.electricity is not None:
        table.setdefault("price", site.tariffs.electricity)
    given: Any = table.get("errors", {})
    if not isinstance(given, Mapping):
        raise ChillerError(
            f"chiller {name!r}: errors is a table of quantity: {{random, relative, slow}}; got {given!r}"
        )
    table["errors"] = {**_sensor_errors(site, equipment), **given}
    try:
        return _within_budget(site, name, config_of_table(name, table))
    except (TypeError, AttributeError, ValueError) as error:  # a value of another kind than the key takes
        raise ChillerError(f"chiller {name!r}: {error}") from None


def _sensor_errors(site: Site, equipment: Equipment) -> dict[str, dict[str, float]]:
    """Random errors that the points' ``sensor_sd`` declares, by quantity, in SI."""
    found = {quantity: site.points[point].sensor_sd_si for quantity, point in equipment.inputs.items()}
    return {quantity: {"random": sd} for quantity, sd in found.items() if sd is not None and quantity in RAW_UNITS}


def chillers_share(site: Site) -> float:
    """The part of the site's false-alarm budget that chillers take, by the weights of all equipment."""
    own = sum(e.weight for e in site.equipment.values() if is_chiller(e))
    return own / site.weights if own else 0.0


def _within_budget(site: Site, name: str, config: ChillerConfig) -> ChillerConfig:
    """The chiller's false alarms cut to its share of the site's; what its options say is left as it is."""
    options = site.equipment[name].options
    share = site.false_alarms_per_year * site.equipment[name].weight / site.weights
    cut = min(1.0, share / false_alarms(config))
    if "residual_false_alarms" not in options:
        config = replace(config, residual_false_alarms=cut * config.residual_false_alarms)
    if "false_alarms" not in (options.get("drift") or {}):
        config = replace(config, drift=replace(config.drift, false_alarms=cut * config.drift.false_alarms))
    return config


def false_alarms(config: ChillerConfig) -> float:
    """What all of a chiller's charts together may give a year [1/a]."""
    return config.drift.false_alarms + config.residual_false_alarms


def missing_roles(config: ChillerConfig, inputs: Mapping[str, str]) -> list[Quantity]:
    """Quantities without which the chiller cannot be studied."""
    return [q for q in ROLES if q.symbol in config.quantities() and q.symbol not in inputs]


def unknown_errors(config: ChillerConfig) -> Iterator[Quantity]:
    """Quantities that are needed but whose sensor error nobody has given."""
    known = config.instruments.errors
    yield from (q for q in ROLES if q.symbol in config.quantities() and q.symbol not in known)
