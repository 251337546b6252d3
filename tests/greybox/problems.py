"""The oracle problems as component models, in the units of their sources (time in hours where the source says so)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from fdd.models.declare import ComponentModel, Parameter, Quantity, State
from fdd.models.functions import exp, gpow


def _q(symbols: str) -> tuple[Quantity, ...]:
    return tuple(Quantity(s, "1", s) for s in symbols.split())


def _states(**sd: float) -> tuple[State, ...]:
    return tuple(State(s, "1", s, v) for s, v in sd.items())


def log_parameter(symbol: str, typical: float, lower: float = 1e-10, upper: float = 1e10, **more: Any) -> Parameter:
    return Parameter(symbol, "1", symbol, typical, lower, upper, "oracle", **more)


def identity(symbol: str, typical: float, lower: float = -1e6, upper: float = 1e6, **more: Any) -> Parameter:
    return Parameter(symbol, "1", symbol, typical, lower, upper, "oracle", "identity", **more)


def declared(name: str, **more: Any) -> ComponentModel:
    return ComponentModel(name=name, version="1", title=name, **more)


def constant_start(**values: float) -> Any:
    def start(y: Any, u: Any, p: Any) -> Mapping[str, Any]:
        return values

    return start


def radiator() -> ComponentModel:
    n, k = 1.3, 4.18

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        g1, g2 = gpow(x.T1 - x.Tl, n), gpow(x.T2 - x.Tl, n)
        return {
            "T1": k * u.q / (p.Cr * x.A) * (u.Tf - 2 * x.T1 + x.T2) - p.Hr / p.Cr * g1,
            "T2": k * u.q / (p.Cr * (1 - x.A)) * (x.T1 - x.T2) - p.Hr / p.Cr * g2,
            "Tl": p.Hr / p.Cl * x.A * g1 + p.Hr / p.Cl * (1 - x.A) * g2 - p.Bl / p.Cl * (x.Tl - u.Ta),
            "A": p.a * u.q - p.b * x.A,
        }

    return declared(
        "radiator",
        states=_states(T1=1.0, T2=1.0, Tl=1.0, A=0.1),
        inputs=_q("Tf Ta q"),
        outputs=_q("Tr"),
        parameters=tuple(
            log_parameter(s, v)
            for s, v in dict(Cr=30.1, Hr=9, Cl=9, Bl=97.3, a=0.075, b=6, sT=0.5, sL=0.7, sA=0.06, r=0.05).items()
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"T1": p.sT, "T2": p.sT, "Tl": p.sL, "A": p.sA},
        observe=lambda x, u, p: {"Tr": x.T2},
        noise=lambda x, u, p: {"Tr": p.r},
        start=constant_start(T1=45.0, T2=40.0, Tl=26.0, A=0.5),
    )


def building() -> ComponentModel:
    ps = pn = 0.1
    aen, kj = 0.9, 3.6  # 1 W = 3.6 kJ/h

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        return {
            "Tis": (
                p.Bus * (u.Tus - x.Tis) + p.Bb * (u.Tb - x.Tis) + p.Bn * (x.Tin - x.Tis) + p.Bas * (x.Tas - x.Tis)
                + kj * u.Prs + kj * p.Aes * (1 - ps) * u.Is
            ) / p.Cis,
            "Tas": (p.Bas * (x.Tis - x.Tas) + kj * ps * p.Aes * u.Is) / p.Cas,
            "Tin": (
                p.Bun * (u.Tun - x.Tin) + p.Bb * (u.Tb - x.Tin) + p.Bn * (x.Tis - x.Tin) + p.Ban * (x.Tan - x.Tin)
                + kj * u.Prn + kj * u.Pec + kj * aen * (1 - pn) * u.In
            ) / p.Cin,
            "Tan": (p.Ban * (x.Tin - x.Tan) + kj * pn * aen * u.In) / p.Can,
        }  # fmt: skip

    values = dict(
        Bus=12.65, Bb=32.39, Bn=38.95, Bas=542.18, Bun=28.35, Ban=624.34, Cis=421.28, Cas=1531.85, Cin=810.19,
        Can=3314.74, Aes=1.67, s_air=0.08, s_flo=0.03, r_s=0.02, r_n=0.025,
    )  # fmt: skip
    return declared(
        "building",
        states=_states(Tis=0.5, Tas=1.0, Tin=0.5, Tan=1.0),
        inputs=_q("Tus Tun Tb Is In Prs Prn Pec"),
        outputs=_q("Yis Yin"),
        parameters=tuple(log_parameter(s, v) for s, v in values.items()),
        drift=drift,
        diffusion=lambda x, u, p: {"Tis": p.s_air, "Tas": p.s_flo, "Tin": p.s_air, "Tan": p.s_flo},
        observe=lambda x, u, p: {"Yis": x.Tis, "Yin": x.Tin},
        noise=lambda x, u, p: {"Yis": p.r_s, "Yin": p.r_n},
        start=constant_start(Tis=14.0, Tas=13.5, Tin=13.0, Tan=12.5),
    )


def heat_exchanger() -> ComponentModel:
    n, cp = 3, 4.186

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        U = 1 / (1 / (p.Ch * u.mh**p.y) + 1 / (p.Cc * u.mc**p.y))
        h = [u.Thin, x.Th1, x.Th2, x.Th3]
        c = [u.Tcin, x.Tc1, x.Tc2, x.Tc3]
        out = {}
        for i in range(1, n + 1):
            j = n + 1 - i
            d = 0.5 * (h[i - 1] + h[i]) - 0.5 * (c[j - 1] + c[j])
            out[f"Th{i}"] = n * u.mh / p.Mh * (h[i - 1] - h[i]) - U / (p.Mh * cp) * d
            out[f"Tc{j}"] = n * u.mc / p.Mc * (c[j - 1] - c[j]) + U / (p.Mc * cp) * d
        return out

    values = dict(Mh=5, Mc=5.5, Ch=6, Cc=5.5, y=0.8, sh=0.06, sc=0.05, rh=0.08, rc=0.06)
    return declared(
        "heat exchanger",
        states=_states(Th1=2.0, Th2=2.0, Th3=2.0, Tc1=2.0, Tc2=2.0, Tc3=2.0),
        inputs=_q("mh mc Thin Tcin"),
        outputs=_q("Tho Tco"),
        parameters=tuple(log_parameter(s, v) for s, v in values.items()),
        drift=drift,
        diffusion=lambda x, u, p: {f"T{s}{i}": p.sh if s == "h" else p.sc for s in "hc" for i in (1, 2, 3)},
        observe=lambda x, u, p: {"Tho": x.Th3, "Tco": x.Tc3},
        noise=lambda x, u, p: {"Tho": p.rh, "Tco": p.rc},
        start=constant_start(Th1=66.0, Th2=60.0, Th3=55.0, Tc1=38.0, Tc2=43.0, Tc3=48.0),
    )


KERNEL_PROBLEMS = {"radiator": radiator, "building": building, "heat_exchanger": heat_exchanger}
SUBSTEPS = {"radiator": 4, "building": None, "heat_exchanger": 2}
METHODS: dict[str, Any] = {"radiator": "rk4", "building": "exact", "heat_exchanger": "rk4"}


def ctsm_wall() -> ComponentModel:
    """Problem A: two wall temperatures and a heat flux; S is a variance."""
    return declared(
        "CTSM wall",
        states=_states(x1=1.0, x2=1.0),
        inputs=_q("Te Ti"),
        outputs=_q("Q"),
        parameters=tuple(
            log_parameter(s, v)
            for s, v in dict(
                G1=103.94, H1=0.96509, H2=2.0215, G2=49.320, H3=0.50929, s1=7.3779e-8, s2=2.6951e-9, S=0.010330
            ).items()
        ),
        drift=lambda x, u, p: {
            "x1": (-(1 / p.H1 + 1 / p.H2) * x.x1 + x.x2 / p.H2 + u.Te / p.H1) / p.G1,
            "x2": (x.x1 / p.H2 - (1 / p.H2 + 1 / p.H3) * x.x2 + u.Ti / p.H3) / p.G2,
        },
        diffusion=lambda x, u, p: {"x1": p.s1, "x2": p.s2},
        observe=lambda x, u, p: {"Q": (u.Ti - x.x2) / p.H3},
        noise=lambda x, u, p: {"Q": p.S**0.5},
        start=constant_start(x1=13.134, x2=25.330),
    )


def ou2d() -> ComponentModel:
    """Problem B: parameters as logarithms, except mu."""
    return declared(
        "OU 2-D",
        states=_states(x1=math.sqrt(0.1), x2=math.sqrt(0.1)),
        inputs=_q("u"),
        outputs=_q("y1 y2"),
        parameters=tuple(
            identity(s, v) for s, v in dict(lth=1.8, mu=2.9, lal=0.5, ls1=0.3, ls2=-1, lr1=-12, lr2=-2).items()
        ),
        drift=lambda x, u, p: {"x1": exp(p.lth) * (p.mu + u.u - x.x1), "x2": exp(p.lal) * (x.x1 - x.x2)},
        diffusion=lambda x, u, p: {"x1": exp(p.ls1), "x2": exp(p.ls2)},
        observe=lambda x, u, p: {"y1": x.x1, "y2": x.x2},
        noise=lambda x, u, p: {"y1": exp(p.lr1), "y2": exp(p.lr2)},
        start=constant_start(x1=3.0, x2=3.0),
    )


def ou1d() -> ComponentModel:
    """Problem C."""
    return declared(
        "OU 1-D",
        states=_states(x=0.1),
        inputs=_q("u"),
        outputs=_q("y"),
        parameters=(
            identity("th", 2.0, 0.01, 100),
            identity("mu", 2.0, -50, 50),
            identity("lsx", math.log(0.5), -10, 5),
            identity("lsy", math.log(0.05), -10, 5),
        ),
        drift=lambda x, u, p: {"x": p.th * (p.mu + u.u - x.x)},
        diffusion=lambda x, u, p: {"x": exp(p.lsx)},
        observe=lambda x, u, p: {"y": x.x},
        noise=lambda x, u, p: {"y": exp(p.lsy)},
        start=constant_start(x=3.0),
    )


def id_building() -> ComponentModel:
    """Problem D: 17 parameters, natural scale with log transform for B, C, A; log standard deviations."""

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        return {
            "Tis": (
                p.Bus * (u.Tu - x.Tis) + p.Bb * (u.Tb - x.Tis) + p.Bn * (x.Tin - x.Tis) + p.Bas * (x.Tas - x.Tis)
                + u.Ps + p.Aes * u.Is
            ) / p.Cis,
            "Tas": p.Bas * (x.Tis - x.Tas) / p.Cas,
            "Tin": (
                p.Bun * (u.Tu - x.Tin) + p.Bb * (u.Tb - x.Tin) + p.Bn * (x.Tis - x.Tin) + p.Ban * (x.Tan - x.Tin)
                + u.Pn + u.Pe
            ) / p.Cin,
            "Tan": p.Ban * (x.Tin - x.Tan) / p.Can,
        }  # fmt: skip

    rows = [
        ("Bus", 20, 0.1, 200),
        ("Bb", 20, 0.1, 200),
        ("Bn", 20, 0.1, 200),
        ("Bas", 400, 10, 3000),
        ("Bun", 20, 0.1, 200),
    ]
    rows += [("Ban", 400, 10, 3000), ("Cis", 600, 20, 5000), ("Cas", 2500, 100, 20000), ("Cin", 600, 20, 5000)]
    rows += [("Can", 2500, 100, 20000), ("Aes", 1, 0.01, 10)]
    noise = ("lsis", "lsas", "lsin", "lsan", "lrs", "lrn")
    return declared(
        "building D",
        states=_states(Tis=0.1, Tas=0.1, Tin=0.1, Tan=0.1),
        inputs=_q("Tu Tb Is Ps Pn Pe"),
        outputs=_q("ys yn"),
        parameters=(
            *(log_parameter(*row) for row in rows),
            *(identity(s, math.log(0.1), -12, 2, kind="noise") for s in noise),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"Tis": exp(p.lsis), "Tas": exp(p.lsas), "Tin": exp(p.lsin), "Tan": exp(p.lsan)},
        observe=lambda x, u, p: {"ys": x.Tis, "yn": x.Tin},
        noise=lambda x, u, p: {"ys": exp(p.lrs), "yn": exp(p.lrn)},
        start=constant_start(Tis=16.0, Tas=15.5, Tin=15.5, Tan=15.0),
    )


def id_radiator() -> ComponentModel:
    """Problem E."""

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        d1, d2 = (x.T1 - x.Tl) ** 1.3, (x.T2 - x.Tl) ** 1.3
        return {
            "T1": 4.18 * u.q / (p.Cr * x.A) * (u.Tf - 2 * x.T1 + x.T2) - p.Hr / p.Cr * d1,
            "T2": 4.18 * u.q / (p.Cr * (1 - x.A)) * (x.T1 - x.T2) - p.Hr / p.Cr * d2,
            "Tl": p.Hr / p.Cl * x.A * d1 + p.Hr / p.Cl * (1 - x.A) * d2 - p.Bl / p.Cl * (x.Tl - u.Ta),
            "A": p.a * u.q - p.b * x.A,
        }

    rows = [("Cr", 40, 5, 200), ("Hr", 8, 0.5, 100), ("Cl", 25, 1, 200), ("Bl", 90, 5, 1000), ("a", 0.05, 0.005, 1)]
    rows += [("b", 2.2, 0.1, 50)]
    return declared(
        "radiator E",
        states=_states(T1=0.1, T2=0.1, Tl=0.1, A=1e-3),
        inputs=_q("q Tf Ta"),
        outputs=_q("y"),
        parameters=(
            *(log_parameter(*row) for row in rows),
            identity("ls1", math.log(0.2), -10, 2, kind="noise"),
            identity("lsy", math.log(0.1), -10, 2, kind="noise"),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {"T1": exp(p.ls1), "T2": exp(p.ls1), "Tl": 0.1, "A": 0.02},
        observe=lambda x, u, p: {"y": x.T2},
        noise=lambda x, u, p: {"y": exp(p.lsy)},
        start=constant_start(T1=45.0, T2=38.0, Tl=26.0, A=0.32),
    )


def armadillo() -> ComponentModel:
    """Problem F, time in days."""
    values = dict(Ro=0.0176, Ri=0.002, Cw=170, Ci=19, s_w=0.5, s_v=0.03)
    return declared(
        "armadillo",
        states=_states(Tw=0.1, Ti=0.1),
        inputs=_q("T_ext P_hea"),
        outputs=_q("T_int"),
        parameters=(*(log_parameter(s, v) for s, v in values.items()), identity("Tw0", 26.6, 0, 40, kind="initial")),
        drift=lambda x, u, p: {
            "Tw": (u.T_ext - x.Tw) / (p.Ro * p.Cw) + (x.Ti - x.Tw) / (p.Ri * p.Cw),
            "Ti": (x.Tw - x.Ti) / (p.Ri * p.Ci) + u.P_hea / p.Ci,
        },
        diffusion=lambda x, u, p: {"Tw": p.s_w, "Ti": 0.0},
        observe=lambda x, u, p: {"T_int": x.Ti},
        noise=lambda x, u, p: {"T_int": p.s_v},
        start=lambda y, u, p: {"Tw": p.Tw0, "Ti": 26.701},
    )


def flexhouse(kind: str) -> ComponentModel:
    """Problem G: Ti, TiTe, TiTh, TiTeTh of Bacher and Madsen (2011); e11 is a log variance, p a log sd."""
    envelope, heater = "Te" in kind, "Th" in kind
    nodes = ["Ti", *(["Te"] if envelope else []), *(["Th"] if heater else [])]
    sd = {"Ti": 0.1, "Te": 5.0, "Th": 5.0}
    values = {"Ci": 1.0, "Aw": 6.0}
    values |= {"Ce": 3.0, "Rie": 1.0, "Rea": 4.0} if envelope else {"Ria": 5.0}
    values |= {"Ch": 0.1, "Rih": 1.0} if heater else {}

    def drift(x: Any, u: Any, p: Any) -> Mapping[str, Any]:
        loss = (x.Te - x.Ti) / (p.Ci * p.Rie) if envelope else (u.Ta - x.Ti) / (p.Ci * p.Ria)
        heat = (x.Th - x.Ti) / (p.Ci * p.Rih) if heater else u.Ph / p.Ci
        out = {"Ti": loss + heat + p.Aw * u.Ps / p.Ci}
        if envelope:
            out["Te"] = (x.Ti - x.Te) / (p.Ce * p.Rie) + (u.Ta - x.Te) / (p.Ce * p.Rea)
        if heater:
            out["Th"] = (x.Ti - x.Th) / (p.Ch * p.Rih) + u.Ph / p.Ch
        return out

    return declared(
        kind,
        states=_states(**{s: sd[s] for s in nodes}),
        inputs=_q("Ta Ps Ph"),
        outputs=_q("yTi"),
        parameters=(
            *(log_parameter(s, v, v * 1e-4, v * 1e3) for s, v in values.items()),
            *(identity(f"p{i + 1}{i + 1}", -2.0, -30, 10, kind="noise") for i in range(len(nodes))),
            identity("e11", -5.0, -30, 10, kind="noise"),
        ),
        drift=drift,
        diffusion=lambda x, u, p: {s: exp(getattr(p, f"p{i + 1}{i + 1}")) for i, s in enumerate(nodes)},
        observe=lambda x, u, p: {"yTi": x.Ti},
        noise=lambda x, u, p: {"yTi": exp(p.e11 / 2)},
        start=lambda y, u, p: {"Ti": y.yTi, "Te": 15.0, "Th": y.yTi} if heater and envelope else {
            s: (15.0 if s == "Te" else y.yTi) for s in nodes
        },
    )  # fmt: skip
