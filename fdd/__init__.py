"""Fault detection and diagnosis for installed HVAC plant."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fdd.greybox.fit import fit as fit
    from fdd.greybox.likelihood import Data as Data

__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    """``from fdd import fit, Data, models``, loaded when first asked for, so that the command line starts fast."""
    if name == "fit":
        from fdd.greybox.fit import fit

        return fit
    if name == "Data":
        from fdd.greybox.likelihood import Data

        return Data
    raise AttributeError(f"module 'fdd' has no attribute {name!r}")
