"""Signatures of chiller faults: what simulated machines' readings do at the same load when something is wrong.

Makes ``fdd/chiller_eiv/signatures.json``, which the service reads, so that CoolProp is needed here only:

    python -m fdd.plant.chiller_signatures fdd/chiller_eiv/signatures.json

Changes are per unit of the fault (``UNITS``) and in a machine's own measure, so that they carry over to another size:
temperatures of the condenser as a share of T_sat_cd - T_cdi, of the evaporator of T_chi - T_sat_ev, discharge superheat
of the lift, the oil temperature in kelvin, flows and power as logarithms. Machines stay apart: their mean would cancel
what a charge fault does.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from fdd.plant.chiller_cycle import Condition, CycleError, Fault, Machine, random_machine, steady_state

UNITS = {
    "non-condensable gas": Fault(gas=0.01),
    "condenser fouling": Fault(fouling_cd=0.1),
    "evaporator fouling": Fault(fouling_ev=0.1),
    "low condenser flow": Fault(flow_cd=-0.1),
    "high condenser flow": Fault(flow_cd=0.1),
    "low chilled-water flow": Fault(flow_ch=-0.1),
    "high chilled-water flow": Fault(flow_ch=0.1),
    "low charge": Fault(charge=-0.1),
    "high charge": Fault(charge=0.1),
    "oil excess": Fault(oil=0.3),
    "compressor efficiency loss": Fault(efficiency=0.05),
}
CHANGES = ("approach_cd", "T_sat_ev", "subcooling", "superheat", "T_oil", "power", "flow_ch", "flow_cd")
LOADS = (0.3, 0.5, 0.75, 1.0)
MACHINES = 14


def changes(healthy: dict[str, float], faulty: dict[str, float]) -> list[float]:
    """What a fault did to the readings, in the order of ``CHANGES`` and in the machine's own measure."""
    cd = healthy["T_sat_cd"] - healthy["T_cdi"]
    ev = healthy["T_chi"] - healthy["T_sat_ev"]
    lift = healthy["T_sat_cd"] - healthy["T_sat_ev"]

    def of(r: dict[str, float]) -> np.ndarray:
        return np.array(
            [
                (r["T_sat_cd"] - r["T_cdo"]) / cd,
                r["T_sat_ev"] / ev,
                (r["T_sat_cd"] - r["T_liquid"]) / cd,
                (r["T_discharge"] - r["T_sat_cd"]) / lift,
                r["T_oil"],
                np.log(r["power"]),
                np.log(r["flow_ch"]),
                np.log(r["flow_cd"]),
            ]
        )

    return [float(v) for v in of(faulty) - of(healthy)]


def signatures(machine: Machine, T_cdi: float, T_cho: float) -> dict[str, list[list[float]]]:
    """Every fault's changes at every load, shape (loads, changes) each."""
    found: dict[str, list[list[float]]] = {name: [] for name in UNITS}
    for load in LOADS:
        state = Condition(load=load, T_cdi=T_cdi, T_cho=T_cho)
        healthy = steady_state(machine, state)
        for name, fault in UNITS.items():
            found[name].append([float(f"{v:.3g}") for v in changes(healthy, steady_state(machine, state, fault))])
    return found


def library(machines: int = MACHINES, seed: int = 1) -> dict[str, object]:
    """Signatures of so many random machines, each at condenser and chilled-water temperatures of its own."""
    rng = np.random.default_rng(seed)
    found: list[dict[str, list[list[float]]]] = []
    while len(found) < machines:
        machine = random_machine(rng)
        try:
            found.append(signatures(machine, float(rng.uniform(18.0, 30.0)), float(rng.uniform(5.0, 10.0))))
        except CycleError:
            continue
    return {"changes": list(CHANGES), "loads": list(LOADS), "seed": seed, "machines": found}


def main() -> None:
    """Write the library where the argument says."""
    if len(sys.argv) != 2:
        raise SystemExit("usage: python -m fdd.plant.chiller_signatures fdd/chiller_eiv/signatures.json")
    Path(sys.argv[1]).write_text(json.dumps(library(), separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
