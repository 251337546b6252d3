"""Which variants of a model are worth trying on a site's data, where its file leaves the choice."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

STANDS = 30.0  # s: samples further apart than this say nothing of water that passes in seconds


@dataclass(frozen=True, slots=True)
class Structure:
    """A variant to try: options beside those of the site, and in words what it is."""

    options: Mapping[str, Any]
    words: str
    contains: tuple[str, ...] = ()
    """Words of the variants that are this one with parameters left out."""


ROOMS = {
    "Ti": (),
    "TiTe": ("Ti",),
    "TiTh": ("Ti",),
    "TiTeTh": ("Ti", "TiTe", "TiTh"),
}


def structures(
    model: str, said: Collection[str], parameters: Collection[str], step: float, usual: Mapping[str, float]
) -> tuple[Structure, ...]:
    """Variants of a model in order of their size; empty where the site or the model leaves nothing to choose.

    Parameters
    ----------
    model : name of the model
    said : options and parameters that the site file names: who names one that a variant is about has chosen
    parameters : symbols of the variant that the site's own options make
    step : of the frames [s]
    usual : median of each input while the machine may be judged, SI
    """
    if model == "heat_exchanger":
        return _exchanger(said, parameters, step, usual)
    if model == "radiator" and not {"form", "sections", "surroundings", *parameters} & set(said):
        return tuple(
            Structure({"sections": n, "surroundings": False}, f"{n} section{'s' * (n > 1)}, heat to the room")
            for n in (1, 2)
        )
    if model == "zone" and not {"nodes", *parameters} & set(said):
        return tuple(Structure({"nodes": nodes}, nodes, inner) for nodes, inner in ROOMS.items())
    return ()


def _exchanger(
    said: Collection[str], parameters: Collection[str], step: float, usual: Mapping[str, float]
) -> tuple[Structure, ...]:
    if {"dynamics", "compartments", "metal", *parameters} & set(said) or step < STANDS:
        return ()
    flows = {key: float(f"{max(usual[f'm_{key}'], 1e-4):.2g}") for key in ("flow_hot", "flow_cold")}
    words = f"quasi-steady outlets: water passes in seconds, and samples {step:g} s apart do not tell its mass"
    return (Structure({"dynamics": "quasi-steady", **flows}, words),)
