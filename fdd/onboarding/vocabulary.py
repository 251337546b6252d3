"""What the words in a point's name mean: the field's terms and abbreviations in the languages plants are named in.

Lists follow common building-automation naming: Project Haystack tags, Brick classes, ISA-5.1 instrument letters, words
of VDI 3814 and BACtwin, and the notation of the grey-box literature (``Ti``, ``Ta``, ``Ph``). A *facet* is one thing
that a name says of its point; a name has as many as it has.
"""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Mapping
from functools import lru_cache

# Parts of words of at least four letters: they also count inside compounds (Aussentemperatur).
_STEMS: Mapping[str, tuple[str, ...]] = {
    "temperature": ("temp", "temperatur", "celsius", "fahrenheit"),
    "flow": ("flow", "durchfluss", "volumenstrom", "massenstrom", "debit", "caudal", "portata", "debiet", "flode",
             "gennemstromning", "volstrom"),
    "mass": ("massflow", "massenstrom", "mass_flow"),
    "power": ("power", "leistung", "puissance", "potencia", "potenza", "vermogen", "effekt", "watt", "consumption",
              "demand", "verbrauch"),
    "energy": ("energy", "energie", "energia", "arbeit", "zahlerstand", "meterreading"),
    "pressure": ("pressure", "press", "druck", "pression", "presion", "pressione", "tryk", "tryck"),
    "static": ("static",),
    "difference": ("differenz", "difference", "deltat", "spreizung", "delta"),
    "irradiance": ("irradi", "solar", "global", "strahlung", "rayonnement", "radiacion", "radiazione", "straling",
                   "insolation", "pyranometer", "sonne", "globstral"),
    "humidity": ("humid", "feuchte", "humedad", "umidita", "fugt", "fukt", "vochtigheid"),
    "dewpoint": ("dewpoint", "dewpt", "taupunkt"),
    "wetbulb": ("wetbulb", "feuchtkugel"),
    "wind": ("wind",),
    "illuminance": ("illumin", "helligkeit", "beleuchtung", "luminos"),
    "co2": ("carbondioxide",),
    "position": ("position", "stellung", "opening", "offnung", "ouverture", "percent", "stellsignal"),
    "command": ("command", "signal", "control", "output"),
    "feedback": ("feedback", "ruckmeldung"),
    "speed": ("speed", "drehzahl", "vitesse", "velocidad", "frequen"),
    "status": ("status", "betrieb", "state", "running", "enable", "etat", "estado", "meldung"),
    "setpoint": ("setpoint", "setpnt", "sollwert", "consigne", "consigna", "setpt"),
    "alarm": ("alarm", "fault", "storung", "truth", "label", "warning"),
    "limit": ("limit",),
    "outdoor": ("outdoor", "outside", "aussen", "extern", "exterior", "exterieur", "ambient", "weather", "wetter",
                "buiten", "udetemp", "utetemp", "esterna"),
    "room": ("room", "zone", "indoor", "inside", "raum", "innen", "interieur", "interior", "ambiance", "ruimte",
             "rumtemp", "innetemp", "office", "kitchen", "bedroom", "living", "bath", "corridor", "classroom",
             "children", "hall", "lounge", "building", "gebaude", "batiment", "attic", "cellar", "wohn", "kuche",
             "space", "lecture"),
    "supply": ("supply", "vorlauf", "depart", "impulsion", "mandata", "aanvoer", "fremlob", "framledning", "discharge",
               "supl", "zuluft", "dsch", "disch", "soufflage"),
    "return": ("return", "rucklauf", "retour", "retorno", "ritorno", "retur", "abluft", "reprise"),
    "mixed": ("mixed", "misch", "melange"),
    "exhaust": ("exhaust", "fortluft", "extract"),
    "inlet": ("inlet", "entering", "eintritt", "entree", "entrada", "ingresso", "incoming"),
    "outlet": ("outlet", "leaving", "austritt", "sortie", "salida", "uscita", "outgoing"),
    "primary": ("primar", "primaire", "district", "fernwarme"),
    "secondary": ("secondar", "sekundar", "secondaire", "secundario"),
    "chilled": ("chilled", "kaltwasser", "eaufroide", "evaporator", "verdampfer", "chwater"),
    "condenser": ("condens", "kondensator", "kuhlwasser", "tower"),
    "tower": ("tower", "kuhlturm"),
    "hotside": ("hotside", "warmside", "heissseite"),
    "air": ("air", "luft"),
    "water": ("water", "wasser"),
    "heating": ("heating", "heater", "heiz", "chauff", "calef", "riscald", "heat", "reheat", "warme", "varme",
                "radiator"),
    "cooling": ("cooling", "kuhl", "refroid", "cool", "koeling"),
    "valve": ("valve", "ventil", "vanne", "valvula", "valvola", "klep", "coil"),
    "damper": ("damper", "klappe", "volet", "spjald", "spjall"),
    "fan": ("fan", "ventilator", "lufter", "blower"),
    "pump": ("pump", "pompe", "bomba"),
    "chiller": ("chiller", "kaltemaschine", "compressor", "starter", "verdichter"),
    "gain": ("electric", "light", "plug", "appliance", "occupan", "strom"),
    "boiler": ("boiler", "kessel", "chaudiere"),
    "hotwater": ("domestic", "brauchwasser", "warmwasser", "trinkwarm"),
    "exchanger": ("exchanger", "tauscher", "echangeur", "substation", "ubergabe"),
    "wall": ("wall", "floor", "surface", "slab", "wand"),
    "load": ("load", "kalteleistung", "tonnage"),
    "efficiency": ("kwton", "efficien", "wirkungsgrad"),
    "metering": ("meter", "zahler", "compteur"),
}  # fmt: skip

# Whole words only, for they are too short to be sought inside others.
_WORDS: Mapping[str, tuple[str, ...]] = {
    "temperature": ("t", "tt", "te", "tmp", "temp", "temps", "tf", "tc", "tin", "tout", "ti", "ta", "to", "yti", "tz",
                    "tr", "ts", "tm", "text", "tint", "text", "oat", "sat", "rat", "mat", "dat", "zat", "lat", "eat",
                    "oatemp", "satemp", "chwst", "chwrt", "cwst", "cwrt", "hwst", "hwrt", "ewt", "lwt", "zn", "znt"),
    "flow": ("ft", "vdot", "mdot", "q", "v", "qv", "qm", "gpm", "cfm", "fm"),
    "mass": ("mdot", "qm"),
    "power": ("p", "kw", "pwr", "pel", "ph", "phea", "pth", "pow", "w"),
    "energy": ("kwh", "mwh", "e", "wh"),
    "pressure": ("pt", "pdt", "psi", "kpa", "stat", "pres", "static"),
    "difference": ("dt", "dp"),
    "irradiance": ("ps", "isol", "ghi", "dni", "dhi", "g", "i", "rad", "sun", "sol", "igh", "irr"),
    "humidity": ("rh", "hum"),
    "dewpoint": ("dp", "dew"),
    "wetbulb": ("wb",),
    "co2": ("co2",),
    "position": ("pos", "pct", "vlv", "mv", "opn"),
    "command": ("cmd", "sig", "out", "cv"),
    "feedback": ("fbk", "fb"),
    "speed": ("spd", "vfd", "vsd", "hz", "rpm"),
    "status": ("sts", "stat", "ss", "run", "on", "onoff", "stg", "stage", "mode", "occ", "occupied", "en"),
    "setpoint": ("sp", "spt", "stp", "stpt", "set"),
    "alarm": ("alm",),
    "outdoor": ("oa", "oat", "ta", "osa", "out", "ext", "text", "tout", "ude", "ute", "amb", "to", "wx", "ao"),
    "room": ("in", "ti", "tin", "yti", "int", "tint", "rm", "zn", "zat", "tz", "znt", "rum"),
    "supply": ("sup", "sa", "sat", "da", "dat", "vl", "chwst", "cwst", "hwst", "spl", "fwd", "flw", "zul", "lat",
               "supl", "chws", "hws", "cws", "cdws"),
    "return": ("ret", "ra", "rat", "rl", "chwrt", "cwrt", "hwrt", "rtn", "abl", "rtrn",
               "chwr", "hwr", "cwr", "cdwr"),
    "mixed": ("ma", "mat", "mix"),
    "exhaust": ("ea", "exh", "ex"),
    "inlet": ("ewt", "ent", "inl", "ein", "eat"),
    "outlet": ("lwt", "lvg", "aus"),
    "primary": ("pri", "prim", "dh"),
    "secondary": ("sec", "sek", "secd"),
    "chilled": ("chw", "chwst", "chwrt", "ch", "chws", "chwr", "evap", "eva", "ev"),
    "condenser": ("cw", "cdw", "cws", "cwr", "cwst", "cwrt", "cond", "cd", "con"),
    "hotside": ("hot", "warm"),
    "coldside": ("cold", "kalt", "cool"),
    "air": ("sa", "ra", "ma", "oa", "ea", "da", "air", "luft", "sat", "rat", "mat", "dat", "oat"),
    "water": ("hw", "chw", "cw", "hws", "hwr", "wtr", "hwst", "hwrt", "ewt", "lwt"),
    "heating": ("htg", "hc", "ph", "phea", "hea", "hw", "ht", "rh", "hcv", "hws", "hwr", "hwst", "hwrt"),
    "cooling": ("clg", "cc", "ccv", "clng"),
    "valve": ("vlv", "hcv", "ccv"),
    "damper": ("dmpr", "dmp", "dpr", "oad"),
    "fan": ("sf", "rf", "ef", "fan"),
    "pump": ("pmp", "chwp", "cwp"),
    "chiller": ("chlr", "comp"),
    "gain": ("el", "elec", "gain", "occ"),
    "exchanger": ("hx", "hex", "wt", "phe", "wue"),
    "north": ("n",),
    "load": ("tons", "ton", "qe", "qch"),
    "efficiency": ("cop", "eer", "kwton"),
    "metering": ("mtr",),
}  # fmt: skip

_PHRASES = {
    "set point": "setpoint", "dew point": "dewpoint", "wet bulb": "wetbulb", "hot water": "hw", "chilled water": "chw",
    "condenser water": "cdw", "cooling water": "cdw", "cooling tower": "tower", "outside air": "oa", "per ton": "kwton",
    "kw ton": "kwton", "carbon dioxide": "co2", "m flow": "mdot", "v flow": "vdot", "mass flow": "mdot",
    "hot side": "hot", "cold side": "cold", "domestic hw": "domestic", "domestic hot": "domestic", "out air": "oa",
    "outdoor air": "oa", "return air": "ra air", "supply air": "sa air", "mixed air": "ma air",
    "discharge air": "da air", "exhaust air": "ea air", "oat": "oat", "percent load": "partload", "to room": "room",
}  # fmt: skip


def plain(text: str) -> str:
    """Lower case without accents; ø and ß in letters."""
    swapped = text.replace("ø", "o").replace("Ø", "O").replace("ß", "ss").replace("æ", "ae").replace("Æ", "Ae")
    decomposed = unicodedata.normalize("NFKD", swapped)
    return "".join(c for c in decomposed if not unicodedata.combining(c)).lower()


def words(name: str) -> list[str]:
    """A name's words, phrases joined: ``SuplAirTempSp`` gives supl, air, temp, sp."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z][a-z])|(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])", " ", name)
    spaced = re.sub(r"(?<=[A-Za-z]{2})(?=\d)", " ", spaced) if "co2" not in name.lower() else spaced
    text = " ".join(re.findall(r"[a-z0-9]+", plain(spaced)))
    for phrase, joined in _PHRASES.items():
        text = re.sub(rf"\b{phrase}\b", joined, text)
    return text.split()


@lru_cache(maxsize=8192)
def facets(name: str) -> frozenset[str]:
    """All that a name says; ``in`` and ``out`` are ends of a stream where the name speaks of one."""
    found = {facet for word in words(name) for facet in _of_word(word)}
    whole = re.sub(r"[^a-z0-9]", "", plain(name))
    found |= {facet for facet, known in _WORDS.items() if whole in known and len(whole) > 1}
    return frozenset(_settled(found, set(words(name))))


@lru_cache(maxsize=8192)
def _of_word(word: str) -> frozenset[str]:
    found = {facet for facet, known in _WORDS.items() if word in known}
    if found or len(word) < 3:
        return frozenset(found)
    return frozenset(f for f, stems in _STEMS.items() if any(s in word for s in stems if len(s) < len(word) + 1))


_STREAMS = frozenset({"chilled", "condenser", "hotside", "coldside", "primary", "secondary", "water", "exchanger"})


def _settled(found: set[str], said: set[str]) -> set[str]:
    """Short words of two meanings, decided by the others in the name."""
    stream = bool(found & _STREAMS)
    if "out" in said and stream:
        found = (found - {"outdoor", "command"}) | {"outlet"}
    if "in" in said and stream:
        found = (found - {"room"}) | {"inlet"}
    if "temperature" in found and "dp" in said:
        found = (found - {"difference"}) | {"dewpoint"}
    if "out" in said and ("temperature" in found or "air" in found):
        found -= {"command"}
    if found & {"temperature", "flow", "pressure"} and "power" in found and said & {"p", "w"}:
        found -= {"power"} if found & {"temperature", "flow"} else {"pressure"}
    if {"coldside", "outlet", "exchanger"} <= found:
        found |= {"supply"}
    if "damper" in found:
        found -= {"flow"}
    if "gain" in found and not found & {"power", "energy"}:
        found -= {"gain"}
    if "air" in found and "irradiance" in found and not said & {"sun", "solar", "rad"}:
        found -= {"irradiance"}
    return found
