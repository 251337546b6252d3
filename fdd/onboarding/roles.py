"""Which points play which role of which model: by what names and tags say, within a piece of equipment.

A role is a quantity and what its name must, should and must not say. Points are put to roles by one optimal assignment
for each model and each group of points that belong together (Kuhn 1955, by ``scipy``). Where names leave it open which
end of a stream is which, the temperatures themselves say it: heat goes from hot to cold.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from fdd.onboarding.guess import Sureness
from fdd.onboarding.quantity import Found
from fdd.onboarding.vocabulary import words


@dataclass(frozen=True, slots=True)
class Role:
    """What a point's name must say for a role: one facet of each of ``need``, none of ``never``; ``likes`` count more.

    ``shared`` roles (the weather, the sun) may be played by points of other equipment.
    """

    si: str
    need: tuple[frozenset[str], ...] = ()
    never: frozenset[str] = frozenset()
    likes: frozenset[str] = frozenset()
    shared: bool = False
    optional: bool = False


def _role(si: str, *need: str, never: str = "", likes: str = "", shared: bool = False, optional: bool = False) -> Role:
    sets = tuple(frozenset(n.split("|")) for n in need)
    return Role(si, sets, frozenset(never.split()), frozenset(likes.split()), shared, optional)


_NOT_MEASURED = frozenset({"setpoint", "alarm", "limit", "wetbulb", "dewpoint"})
_OUTDOOR = _role("degC", "outdoor", never="supply return room mixed", likes="outdoor", shared=True)
_SUN = _role("W/m2", "irradiance", never="wall", shared=True)
_WATER = "outdoor room chilled condenser air mixed"

MODELS: Mapping[str, Mapping[str, Role]] = {
    "air_handler": {
        "T_out": replace(_OUTDOOR, likes=frozenset({"outdoor", "air"})),
        "T_return": _role("degC", "return", never="water hotside supply chilled condenser", likes="air"),
        "T_mixed": _role("degC", "mixed", never="water", likes="air"),
        "T_supply": _role("degC", "supply", never="water hotside return chilled condenser", likes="air"),
        "damper": _role("1", "damper", never="return exhaust", likes="outdoor position command feedback"),
        "fan": _role("1", "fan", never="return exhaust", likes="supply speed"),
        "cool": _role("1", "cooling", never="fan damper pump", likes="valve position command"),
        "heat": _role("1", "heating", never="fan damper pump", likes="valve position command"),
    },
    "heat_exchanger": {
        "T_hot_in": _role("degC", "hotside|primary", "inlet|supply", never=_WATER + " coldside secondary"),
        "T_hot_out": _role("degC", "hotside|primary", "outlet|return", never=_WATER + " coldside secondary"),
        "T_cold_in": _role("degC", "coldside|secondary", "inlet|return", never=_WATER + " hotside primary"),
        "T_cold_out": _role("degC", "coldside|secondary", "outlet|supply", never=_WATER + " hotside primary"),
        "m_flow_hot": _role("kg/s", "hotside|primary", never="coldside secondary air"),
        "m_flow_cold": _role("kg/s", "coldside|secondary", never="hotside primary air"),
    },
    "gordon_ng": {
        "T_chi": _role("degC", "chilled", "inlet|return", never="condenser outlet", likes="inlet water"),
        "T_cho": _role("degC", "chilled", "outlet|supply", never="condenser inlet", likes="outlet water"),
        "T_cdi": _role("degC", "condenser", "inlet|supply", never="chilled outlet fan", likes="inlet water"),
        "T_cdo": _role("degC", "condenser", "outlet|return", never="chilled inlet fan", likes="outlet water"),
        "flow_ch": _role("kg/s", never="condenser air heating hotside", likes="chilled water"),
        "power": _role("W", "chiller|power", never="pump fan tower command load heating", likes="chiller power"),
    },
    "radiator": {
        "T_supply": _role("degC", "supply|inlet", never="outdoor room chilled condenser air mixed return hotside "
                          "primary", likes="heating supply", shared=True),
        "T_return": _role("degC", "return|outlet", never="outdoor room chilled condenser air mixed supply",
                          likes="heating"),
        "m_flow": _role("kg/s", never="hotside coldside primary secondary chilled condenser air", likes="heating"),
        "T_room": _role("degC", "room", never="outdoor supply return air", shared=True),
    },
    "zone": {
        "T_out": _OUTDOOR,
        "I_solar": _SUN,
        "P_heat": _role("W", "heating|power|room", never="pump fan cooling chiller gain load",
                        likes="heating room", shared=True),
        "T_room": _role("degC", never="outdoor supply return mixed inlet outlet hotside coldside chilled condenser "
                      "primary secondary exchanger wall boiler heating hotwater", likes="room"),
    },
    "pump": {
        "speed": _role("1", "pump", "speed|command|position"),
        "m_flow": _role("kg/s", never="air", likes="pump"),
        "dp_pump": _role("Pa", "pump|difference|pressure", never="static air", likes="pump difference"),
        "P_el": _role("W", "pump", likes="power"),
    },
}  # fmt: skip

NO_SUN = "I_solar"
"""The one role of a zone that may stay open."""

_STREAM_ENDS = {
    "heat_exchanger": (("T_hot_in", "T_hot_out"), ("T_cold_out", "T_cold_in")),
    "gordon_ng": (("T_chi", "T_cho"), ("T_cdo", "T_cdi")),
    "radiator": (("T_supply", "T_return"),),
}
"""Pairs of which the first is the warmer one while the machine runs."""


@dataclass(frozen=True)
class Part:
    """A piece of equipment of the draft: ``roles`` maps each to a point's name."""

    name: str
    model: str
    roles: Mapping[str, str]
    sureness: Mapping[str, Sureness]
    why: Mapping[str, str] = field(default_factory=dict)
    missing: tuple[str, ...] = ()


def parts(found: Sequence[Found]) -> tuple[list[Part], list[Part]]:
    """Equipment whose every role is played, and what came near and lacks one or two roles."""
    usable = [f for f in found if f.quantity and not f.facets & _NOT_MEASURED and _varies(f)]
    whole: list[Part] = []
    near: list[Part] = []
    for group, members in _groups(usable).items():
        for model in MODELS:
            if model == "zone":
                done = _zones(group, members, usable)
            else:
                part = _assigned(group, model, members, usable)
                done = [part] if part else []
            whole += [p for p in done if not p.missing]
            near += [p for p in done if p.missing]
    whole = _distinct(_without_shadows(whole))
    taken = {p.roles[r] for p in whole for r in p.roles}
    near = [p for p in near if len(p.missing) <= 2 and len(p.roles) >= 2 and not set(p.roles.values()) <= taken]
    return whole, near


def _varies(f: Found) -> bool:
    seen = f.series.values[np.isfinite(f.series.values)]
    return not len(seen) or f.quantity in ("position", "speed", "status") or bool(np.ptp(seen) > 0)


def _groups(found: Sequence[Found]) -> dict[str, list[Found]]:
    """Points that belong together: by their tags' equipment, or by what stands before a sign in their names."""
    groups: dict[str, list[Found]] = {}
    for f in found:
        groups.setdefault(f.series.group or prefix(f.series.title or f.series.name), []).append(f)
    sizes = Counter({g: len(m) for g, m in groups.items()})
    if len(groups) == 1:
        return {next(iter(groups)): list(found)}
    own = {g: m for g, m in groups.items() if g and sizes[g] > 1}
    return {**own, "": list(found)}


def prefix(name: str) -> str:
    """The part of a name that stands before its last sign of a hierarchy: ``AHU-1/SAT``, ``s7.hx.T_hot_out``."""
    head = re.split(r"[./:|>\\]", name)
    return ".".join(h.strip() for h in head[:-1])


def score(f: Found, role: Role) -> float:
    """How well a point fits a role; 0 where it cannot play it."""
    if f.si != role.si or f.facets & role.never:
        return 0.0
    if not all(f.facets & need for need in role.need):
        return 0.0
    return 1.0 + len(role.need) + 0.5 * len(f.facets & role.likes) - 0.1 * len(f.facets - role.likes)


def _assigned(group: str, model: str, members: Sequence[Found], everything: Sequence[Found]) -> Part | None:
    roles = MODELS[model]
    outside = [f for f in everything if f not in members]
    points = [*members, *outside]
    table = np.zeros((len(roles), len(points)))
    for i, role in enumerate(roles.values()):
        for j, f in enumerate(points):
            if j < len(members):
                table[i, j] = score(f, role)
            elif role.shared:
                kin = set(words(group)) & set(words(f.series.title or f.series.name))
                table[i, j] = score(f, role) * (0.6 if kin else 0.5)
    row, column = linear_sum_assignment(-table)
    names = list(roles)
    mapped = {names[i]: points[j] for i, j in zip(row, column, strict=True) if table[i, j] > 0}
    own = sum(f in members for f in mapped.values())
    if own < 2:
        return None
    missing = tuple(n for n, r in roles.items() if n not in mapped and not r.optional)
    sureness = {n: _sure(n, mapped[n], table[names.index(n)], points) for n in mapped}
    mapped, why = _by_physics(model, mapped)
    sureness |= dict.fromkeys(why, "likely")
    return Part(_label(group, model), model, {n: f.series.name for n, f in mapped.items()}, sureness, why, missing)


def _sure(
    role: str, f: Found, scores: np.ndarray[tuple[int], np.dtype[np.float64]], points: Sequence[Found]
) -> Sureness:
    best = float(scores[points.index(f)])
    rivals = sum(1 for s, p in zip(scores, points, strict=True) if s > best - 0.45 and p is not f and s > 0)
    if f.sureness == "unsure":
        return "unsure"
    return "sure" if rivals == 0 and best >= 1.9 else "likely" if rivals <= 1 else "unsure"


def _by_physics(model: str, mapped: Mapping[str, Found]) -> tuple[dict[str, Found], dict[str, str]]:
    """Ends of a stream changed where temperatures say that names were read the wrong way round."""
    out, why = dict(mapped), dict[str, str]()
    for warm, cold in _STREAM_ENDS.get(model, ()):
        if warm not in out or cold not in out:
            continue
        difference = _in_si(out[warm]) - _in_si(out[cold])
        seen = difference[np.isfinite(difference) & (np.abs(difference) > 1.0)]
        if len(seen) > 20 and np.mean(seen < 0) > 0.8:
            out[warm], out[cold] = out[cold], out[warm]
            why |= dict.fromkeys((warm, cold), "by its temperature: heat goes from hot to cold")
    return out, why


def _in_si(f: Found) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return f.in_si(f.series.values)


def _zones(group: str, members: Sequence[Found], everything: Sequence[Found]) -> list[Part]:
    """A zone for each temperature of a room; its heat by the words that both names share."""
    roles = MODELS["zone"]
    rooms = [f for f in members if score(f, roles["T_room"]) > 0 and f.quantity == "temperature"]
    said = [f for f in rooms if "room" in f.facets]
    # Called a room; or thermometers that are nothing else, few enough to be its sensors.
    rooms = said or (rooms if len(rooms) <= 6 else [])
    heaters = [f for f in everything if score(f, roles["P_heat"]) > 0 and f.quantity in ("power", "load")]
    in_turn = dict(zip([r.series.name for r in rooms], heaters, strict=False)) if len(rooms) == len(heaters) else {}
    found = []
    for room in rooms:
        mapped: dict[str, Found] = {"T_room": room}
        for name in ("T_out", "I_solar"):
            best = _best(roles[name], everything, room, prefer=members)
            if best is not None:
                mapped[name] = best
        heat = _heat(room, heaters, roles["P_heat"], alone=len(rooms) == 1) or in_turn.get(room.series.name)
        if heat is not None:
            mapped["P_heat"] = heat
        # Without a pyranometer a zone can still be watched, worse: the draft says that there is no sun.
        missing = tuple(n for n in roles if n not in mapped and n != NO_SUN)
        if len(mapped) < 2:
            continue
        sureness = {n: _zone_sure(n, f, everything, roles[n]) for n, f in mapped.items()}
        label = room.series.name if len(rooms) > 1 else _label(group, "zone")
        found.append(Part(label, "zone", {n: f.series.name for n, f in mapped.items()}, sureness, {}, missing))
    return found


def _best(role: Role, points: Iterable[Found], beside: Found, prefer: Sequence[Found]) -> Found | None:
    scored = [
        (score(f, role) + (0.3 if f in prefer else 0.0) + _global(f), f)
        for f in points
        if f is not beside and score(f, role) > 0
    ]
    return max(scored, key=lambda s: s[0])[1] if scored else None


def _global(f: Found) -> float:
    """Global irradiance before that on one facade."""
    said = set(words(f.series.name))
    return 0.5 * bool(said & {"global", "ghi", "horizontal"}) - 0.3 * bool(
        said & {"north", "south", "east", "west", "diffuse", "n", "e", "s", "w", "nord", "sud", "ost"}
    )


def _heat(room: Found, candidates: Sequence[Found], role: Role, *, alone: bool) -> Found | None:
    """The heater that shares a word with its room, or the only one."""
    own = set(words(room.series.name)) - {"t", "p", "temp", "temperature"}
    shared = [f for f in candidates if own & set(words(f.series.name))]
    heating = [f for f in candidates if "heating" in f.facets]
    chosen = shared or (heating if alone or len(heating) == 1 else []) or (candidates if len(candidates) == 1 else [])
    return max(chosen, key=lambda f: score(f, role)) if chosen else None


def _zone_sure(role: str, f: Found, points: Sequence[Found], what: Role) -> Sureness:
    if f.sureness == "unsure":
        return "unsure"
    if role == "T_room":
        return "sure" if "room" in f.facets else "unsure"
    rivals = [p for p in points if p is not f and score(p, what) >= score(f, what)]
    if role == "P_heat" and "heating" not in f.facets:
        return "unsure"
    return "sure" if not rivals else "likely"


def _label(group: str, model: str) -> str:
    own = re.sub(r"[^A-Za-z0-9_.-]+", "-", group).strip("-.") if group else ""
    return own or {"gordon_ng": "chiller", "zone": "house"}.get(model, model.replace("_", "-"))


def _without_shadows(whole: Sequence[Part]) -> list[Part]:
    """One part for the same outputs: the one of its own group comes before the one of the whole export."""
    kept: list[Part] = []
    seen: set[tuple[str, frozenset[str]]] = set()
    for part in whole:
        own = frozenset(v for r, v in part.roles.items() if not MODELS[part.model][r].shared)
        if any(m == part.model and own & other for m, other in seen):
            continue
        seen.add((part.model, own))
        kept.append(part)
    return kept


def _distinct(found: Sequence[Part]) -> list[Part]:
    names: Counter[str] = Counter()
    out = []
    for part in found:
        name = re.sub(r"[^A-Za-z0-9_.-]+", "-", part.name).strip("-.") or part.model
        names[name] += 1
        out.append(replace(part, name=name if names[name] == 1 else f"{name}-{names[name]}"))
    return out
