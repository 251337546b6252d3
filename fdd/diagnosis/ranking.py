"""Ranks what may be wrong: each fault that the model declares, by how well its signature agrees with the evidence.

A fault's signature says which parameters it moves, or which outputs it makes the filter mispredict, and to which side.
The evidence says which charts rang, and to which side. Agreement speaks for a cause, a wrong sign or silence against.
"""

from __future__ import annotations

from dataclasses import dataclass

from fdd.models.declare import ComponentModel, Fault
from fdd.records import Alarm, JsonObject


@dataclass(frozen=True, slots=True)
class Finding:
    """What a technician reads first: one sentence, causes in order of likelihood, and checks in order."""

    summary: str
    causes: tuple[JsonObject, ...]
    checks: tuple[str, ...]


def diagnose(model: ComponentModel, alarm: Alarm) -> Finding:
    """Likely causes of an alarm, ranked, with what speaks for and against each.

    Parameters
    ----------
    model : the component's declaration; its fault table gives the hypotheses
    alarm : with ``evidence["charts"]``, chart name to ``symbol`` and ``direction``
    """
    signs = {c["symbol"]: c["direction"] for c in alarm.evidence["charts"].values()}
    ranked = sorted((_judge(fault, signs) for fault in model.faults), key=lambda c: -float(c["likelihood"]))
    total = sum(float(c["likelihood"]) for c in ranked) or 1.0
    causes = tuple({**c, "likelihood": round(float(c["likelihood"]) / total, 3)} for c in ranked)
    checks = tuple(dict.fromkeys(check for cause in causes[:3] for check in cause["checks"]))
    return Finding(_summary(model, alarm, signs, causes), causes, checks)


def _judge(fault: Fault, signs: dict[str, int]) -> JsonObject:
    """Weigh one hypothesis: each sign that agrees triples its odds, each that does not divides them by three."""
    agree, against = [], []
    odds = 1.0
    for target, sign in fault.shows.items():
        symbol = target.removeprefix("innovation:")
        seen = signs.get(symbol)
        if seen is None:
            continue
        word = f"{symbol} is {'above' if seen > 0 else 'below'} what the model expects"
        if seen == sign:
            odds *= 3.0
            agree.append(word)
        else:
            odds /= 3.0
            against.append(word)
    expected = {t.removeprefix("innovation:") for t in fault.shows}
    unexplained = sorted(set(signs) - expected)
    odds /= 3.0 ** len(unexplained)
    against += [f"it does not explain {symbol}" for symbol in unexplained]
    return {
        "name": fault.name,
        "meaning": fault.meaning,
        "likelihood": odds,
        "for": agree,
        "against": against,
        "checks": list(fault.checks),
    }


def _summary(model: ComponentModel, alarm: Alarm, signs: dict[str, int], causes: tuple[JsonObject, ...]) -> str:
    meanings = {q.symbol: q.meaning for q in (*model.outputs, *model.parameters)}
    what = " and ".join(
        f"{meanings.get(symbol, symbol)} {'higher' if sign > 0 else 'lower'} than the model expects"
        for symbol, sign in signs.items()
    )
    likely = f"; most likely {causes[0]['meaning']}" if causes else ""
    return f"{alarm.component}: {what}{likely}"
