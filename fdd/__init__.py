"""Fault detection and diagnosis for installed HVAC plant."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fdd.greybox.fit import fit as fit
    from fdd.greybox.likelihood import Data as Data

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """``from fdd import fit, Data, monitor``, loaded when first asked for, so that the command line starts fast."""
    if name == "fit":
        from fdd.greybox.fit import fit

        return fit
    if name == "Data":
        from fdd.greybox.likelihood import Data

        return Data
    if name == "monitor":
        # By name: rooms below the service ask this module for the version, and must not know the service.
        return import_module("fdd.service.verbs.monitor").monitor
    raise AttributeError(f"module 'fdd' has no attribute {name!r}")
