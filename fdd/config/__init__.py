"""The site file: one YAML text that says what the plant is, where its samples come from and what is promised.

``load_site(path)`` checks everything that needs no network and gives a frozen :class:`Site`; ``check_site(site)`` goes
on to what needs the component models. ``docs/site-file.md`` is the reference of every key.
"""

from fdd.config.check import Finding, check_site, component_model
from fdd.config.load import load_site, parse_site, with_data
from fdd.config.schema import (
    Charts,
    Equipment,
    InfluxStore,
    ParameterSpec,
    Point,
    Reidentify,
    Reports,
    Rule,
    Site,
    SqliteStore,
    Tariffs,
)
from fdd.tables import ConfigError, SourceOptions, Strict

__all__ = [
    "Charts",
    "ConfigError",
    "Equipment",
    "Finding",
    "InfluxStore",
    "ParameterSpec",
    "Point",
    "Reidentify",
    "Reports",
    "Rule",
    "Site",
    "SourceOptions",
    "SqliteStore",
    "Strict",
    "Tariffs",
    "check_site",
    "component_model",
    "load_site",
    "parse_site",
    "with_data",
]
