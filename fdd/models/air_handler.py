"""Air handler: mixing box, heating coil, cooling coil and fan, while it runs and while it stands.

Air of two streams mixes by damper position, passes the heating coil, the fan and the cooling coil. While the fan stands
the sections settle towards their surroundings, and hot water that leaks through a closed heating valve warms them: what
a control hides by day (the cooling coil makes up for the leak) shows when the fan stops, and by day as cold water that
does not do what it used to. Humidity and water temperatures are rarely measured; the slow state ``c`` stands for what
they do to the cooling coil.

Equations, with w the fan's speed (0 while it stands), T_r return, T_o outdoor
    share of outdoor air  s(d) = s_min + (s_max - s_min) logistic((d - d_mid)/d_width)
    mixed section         dT_m = w/tau_m (T_r + s (T_o - T_r) - T_m) + (T_x - T_m)/tau_mx
                                 + k_h (T_h - T_m) + k_s (T_s - T_m)
    heating coil          dT_h = g v_h (T_hw - T_h) - (r e_h w + k_0) (T_h - T_m)
    supply section        dT_s = w/tau_s (T_a + f w^2 - e_c (T_a - T_cw) - T_s) + (T_y - T_s)/tau_sy
    air after heating     T_a = T_m + e_h (T_h - T_m)
    cooling coil          e_c = 1 - exp(-N),  1/N = 1/(n_w v_c exp(c)) + sqrt(w)/n_a,  dc = -c/tau_c
    valves                v = leak + (1 - leak) position^gamma
    surroundings          T_x = T_r + s_off (T_o - T_r) + b_off,  T_y = T_r + b_off

Sources: effectiveness of a coil by transfer units, Incropera et al. (2007), Eq. 11.35; water and air side resistance in
series, the air side with the root of the velocity, Wetter (1999), LBNL-42355; damper and valve faults as ASHRAE RP-1312
(Li & Wen 2010) makes them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fdd.models.declare import ComponentModel, Fault, Namespace, Parameter, Quantity, State
from fdd.models.functions import exp, log, logistic

OWN = "own balance, see the module"
WETTER = "Wetter (1999), LBNL-42354"
RP1312 = "Li & Wen (2010), ASHRAE RP-1312"


def air_handler() -> ComponentModel:
    """Air handler model.

    ``leak_heat``, ``leak_cool`` and the two biases are where faults show: hold them at their typical values in a
    baseline, free one at a time to ask which explains a deviation.
    """
    return ComponentModel(
        name="air_handler",
        version="1",
        title="Air handler with mixing box, coils and fan",
        states=(
            State("T_m", "degC", "mixed air section", 1.0),
            State("T_h", "degC", "heating coil", 3.0),
            State("T_s", "degC", "supply air section", 1.0),
            State("c", "1", "condition of the cooling coil: log of its transfer units against the usual", 0.3),
        ),
        inputs=(
            Quantity("T_out", "degC", "outdoor air temperature"),
            Quantity("T_return", "degC", "return air temperature"),
            Quantity("damper", "1", "outdoor air damper position"),
            Quantity("fan", "1", "supply fan speed, 0 while it stands"),
            Quantity("cool", "1", "cooling valve position"),
            Quantity("heat", "1", "heating valve position"),
        ),
        outputs=(
            Quantity("T_mixed", "degC", "mixed air temperature"),
            Quantity("T_supply", "degC", "supply air temperature"),
        ),
        parameters=PARAMETERS,
        drift=_drift,
        diffusion=lambda x, u, p: {
            "T_m": p.sigma_m + p.sigma_m_on * u.fan,
            "T_h": p.sigma_h + p.sigma_h_on * u.heat,
            "T_s": p.sigma_s + p.sigma_s_on * u.fan,
            "c": p.sigma_c,
        },
        observe=lambda x, u, p: {"T_mixed": x.T_m + p.bias_mixed, "T_supply": x.T_s + p.bias_supply},
        noise=lambda x, u, p: {"T_mixed": p.noise_mixed, "T_supply": p.noise_supply},
        start=lambda y, u, p: {"T_m": y.T_mixed, "T_h": y.T_mixed, "T_s": y.T_supply, "c": 0.0},
        valid={
            "T_out": (-40.0, 50.0),
            "T_return": (5.0, 40.0),
            "damper": (0.0, 1.0),
            "fan": (0.0, 1.2),
            "cool": (0.0, 1.0),
            "heat": (0.0, 1.0),
        },
        faults=FAULTS,
        references=(
            "Incropera, F.P. et al. (2007). Fundamentals of Heat and Mass Transfer, 6th ed., ch. 11.",
            "Wetter, M. (1999). Simulation model: finned water-air-coil without condensation. LBNL-42355.",
            "Li, S., Wen, J. (2010). ASHRAE RP-1312: tools for evaluating fault detection and diagnostic methods for "
            "air-handling units.",
        ),
    )


def _valve(position: Any, leak: Any, gamma: Any) -> Any:
    """Share of the full water flow; the power is finite in slope at the closed valve."""
    return leak + (1.0 - leak) * (exp(gamma * log(position + 1e-4)) - exp(gamma * log(1e-4)))


def _drift(x: Namespace, u: Namespace, p: Namespace) -> Mapping[str, Any]:
    share = p.s_min + (p.s_max - p.s_min) * logistic((u.damper - p.d_mid) / p.d_width)
    mixed = u.T_return + share * (u.T_out - u.T_return)
    around = u.T_return + p.b_off
    hot, cold = _valve(u.heat, p.leak_heat, p.gamma_heat), _valve(u.cool, p.leak_cool, p.gamma_cool)
    # Series of water and air side; a trickle of air keeps the root's slope finite.
    units = 1.0 / (1.0 / (p.n_cool * cold * exp(x.c)) + (u.fan + 0.01) ** 0.5 / p.n_air)
    air = x.T_m + p.e_heat * (x.T_h - x.T_m)
    after = air + p.f_fan * u.fan * u.fan - (1.0 - exp(-units)) * (air - p.T_cold)
    return {
        "T_m": u.fan / p.tau_m * (mixed - x.T_m)
        + (around + p.s_off * (u.T_out - u.T_return) - x.T_m) / p.tau_mx
        + p.k_h * (x.T_h - x.T_m)
        + p.k_s * (x.T_s - x.T_m),
        "T_h": p.g * hot * (p.T_hot - x.T_h) - (p.r * p.e_heat * u.fan + p.k_0) * (x.T_h - x.T_m),
        "T_s": u.fan / p.tau_s * (after - x.T_s) + (around - x.T_s) / p.tau_sy,
        "c": -x.c / p.tau_c,
    }


PARAMETERS = (
    Parameter("tau_m", "s", "mixed section: time constant at full speed", 60.0, 5.0, 1e3, OWN),
    Parameter("tau_s", "s", "supply section: time constant at full speed", 60.0, 5.0, 1e3, OWN),
    Parameter("s_min", "1", "share of outdoor air, damper closed", 0.1, 0.0, 0.6, RP1312, transform="logit"),
    Parameter("s_max", "1", "share of outdoor air, damper open", 0.9, 0.5, 1.1, RP1312, transform="logit"),
    Parameter("d_mid", "1", "damper position half way", 0.5, 0.1, 0.9, OWN, transform="logit"),
    Parameter("d_width", "1", "width of the damper's curve", 0.15, 0.02, 1.0, OWN),
    Parameter("f_fan", "K", "air is warmed by the fan at full speed", 1.3, 0.05, 3.0, OWN),
    Parameter("n_cool", "1", "cooling coil, water side: transfer units, valve open", 6.0, 0.1, 200.0, WETTER),
    Parameter("n_air", "1", "cooling coil, air side: transfer units at full speed", 2.0, 0.1, 30.0, WETTER),
    Parameter("gamma_cool", "1", "curve of the cooling valve", 1.0, 0.3, 4.0, OWN),
    Parameter("leak_cool", "1", "share of the cold water that passes the closed valve", 1e-4, 1e-6, 1.0, RP1312),
    Parameter("T_cold", "degC", "chilled water temperature", 7.0, 2.0, 15.0, OWN, transform="identity"),
    Parameter("e_heat", "1", "air side effectiveness of the heating coil", 0.4, 0.05, 0.95, WETTER, transform="logit"),
    Parameter("g", "1/s", "hot water flow, valve open, over the coil's heat capacity", 0.02, 1e-4, 1.0, OWN),
    Parameter("r", "1/s", "air flow at full speed over the coil's heat capacity", 0.02, 1e-4, 1.0, OWN),
    Parameter("gamma_heat", "1", "curve of the heating valve", 2.0, 0.5, 8.0, OWN),
    Parameter("leak_heat", "1", "share of the hot water that passes the closed valve", 1e-4, 1e-6, 1.0, RP1312),
    Parameter("T_hot", "degC", "hot water temperature", 60.0, 30.0, 90.0, OWN, transform="identity"),
    Parameter("k_0", "1/s", "heating coil to its section, fan standing", 2e-4, 1e-6, 0.1, OWN),
    Parameter("k_h", "1/s", "section warmed by the heating coil, fan standing", 5e-4, 1e-7, 0.1, OWN),
    Parameter("k_s", "1/s", "section cooled by the supply section", 3e-4, 1e-7, 0.1, OWN),
    Parameter("tau_mx", "s", "mixed section to its surroundings", 1.5e4, 300.0, 1e6, OWN),
    Parameter("tau_sy", "s", "supply section to its surroundings", 6e3, 300.0, 1e6, OWN),
    Parameter("s_off", "1", "outdoor air's share in the surroundings", 0.1, 0.0, 1.0, OWN, transform="logit"),
    Parameter("b_off", "K", "surroundings warmer than return air by", -0.5, -10.0, 10.0, OWN, transform="identity"),
    Parameter("tau_c", "s", "how long the cooling coil's condition lasts", 7200.0, 300.0, 1e6, OWN),
    Parameter("bias_mixed", "K", "error of the mixed air sensor", 0.0, -20.0, 20.0, RP1312, transform="identity"),
    Parameter("bias_supply", "K", "error of the supply air sensor", 0.0, -20.0, 20.0, RP1312, transform="identity"),
    Parameter(
        "sigma_m", "K/s^0.5", "process noise of the mixed section, fan standing", 0.01, 1e-5, 1.0, OWN, kind="noise"
    ),
    Parameter("sigma_m_on", "K/s^0.5", "the same, added by the running fan", 0.1, 1e-5, 3.0, OWN, kind="noise"),
    Parameter(
        "sigma_h", "K/s^0.5", "process noise of the heating coil, valve closed", 0.01, 1e-5, 1.0, OWN, kind="noise"
    ),
    Parameter("sigma_h_on", "K/s^0.5", "the same, added by the open valve", 0.1, 1e-5, 5.0, OWN, kind="noise"),
    Parameter(
        "sigma_s", "K/s^0.5", "process noise of the supply section, fan standing", 0.01, 1e-5, 1.0, OWN, kind="noise"
    ),
    Parameter("sigma_s_on", "K/s^0.5", "the same, added by the running fan", 0.05, 1e-5, 3.0, OWN, kind="noise"),
    Parameter(
        "sigma_c", "1/s^0.5", "how fast the cooling coil's condition changes", 2e-3, 1e-6, 0.1, OWN, kind="noise"
    ),
    Parameter("noise_mixed", "K", "measurement noise of the mixed air temperature", 0.1, 1e-3, 3.0, OWN, kind="noise"),
    Parameter(
        "noise_supply", "K", "measurement noise of the supply air temperature", 0.1, 1e-3, 3.0, OWN, kind="noise"
    ),
)

FAULTS = (
    Fault(
        "heating valve leaks",
        "hot water passes the closed heating valve; the cooling coil works against it",
        {"leak_heat": 1, "innovation:T_supply": 1, "innovation:T_mixed": 1},
        (
            "with the heating valve closed and the fan off, feel both pipes of the heating coil",
            "compare mixed and supply air temperature with both valves closed",
            "check the valve's seat, the actuator's stroke and whether it closes against the pump's pressure",
        ),
    ),
    Fault(
        "cooling valve leaks",
        "chilled water passes the closed cooling valve",
        {"leak_cool": 1, "innovation:T_supply": -1},
        ("with the cooling valve closed, feel both pipes of the cooling coil", "check seat and stroke of the valve"),
    ),
    Fault(
        "cooling coil fouled or short of cold water",
        "the cooling valve opens farther than it used to for the same work",
        {"n_cool": -1, "innovation:T_supply": 1},
        (
            "check the chilled water's temperature and pressure",
            "look at the coil's fins and the filter",
            "check the strainer",
        ),
    ),
    Fault(
        "heating coil fouled or short of hot water",
        "the heating valve opens farther than it used to for the same work",
        {"g": -1, "innovation:T_supply": -1},
        ("check the hot water's temperature and pressure", "check strainer and air vent of the coil"),
    ),
    Fault(
        "outdoor air damper stuck or leaking",
        "the mixed air is not what the damper's position says",
        {"d_mid": 0, "s_min": 0, "innovation:T_mixed": 0},
        ("watch the damper through a full stroke", "check linkage and actuator"),
    ),
    Fault(
        "mixed air sensor biased",
        "the mixed air sensor reads wrong by a constant",
        {"bias_mixed": 1, "innovation:T_mixed": 1},
        ("compare with return air, dampers in full recirculation",),
    ),
    Fault(
        "supply air sensor biased",
        "the supply air sensor reads wrong by a constant",
        {"bias_supply": 1, "innovation:T_supply": 1},
        ("compare with mixed air, valves closed and fan running, less the fan's warming",),
    ),
)
