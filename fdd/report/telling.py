"""Puts codes into words: messages, alarms in one line, and whole documents for people.

The one place where what the engine has found becomes sentences. What people wrote is never touched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from fdd.evidence import AlarmKind, ChartEvidence, ChartKind, JsonObject, Message, parts_of
from fdd.records import Alarm
from fdd.report.language import Language, language
from fdd.report.site import ComponentInfo, SiteInfo

ALL = "all"
"""Stands for a symbol in the name of a chart that watches all measurements together."""
SURE, LIKELY = 0.95, 0.5
"""A place's likeliest cause is told without a doubt, or as most likely, from these likelihoods on."""


def _nowhere() -> SiteInfo:
    return SiteInfo("", "UTC", 0.0, {})


@dataclass(frozen=True)
class Speaker:
    """Says what was found on a site in its language; without a site, symbols stand for themselves.

    ``keys`` keeps the keys of alarms, which people type; a report says whose alarm it is.
    """

    site: SiteInfo = field(default_factory=_nowhere)
    keys: bool = True

    @property
    def language(self) -> Language:
        """The site's catalogue."""
        return language(self.site.language)

    def say(self, message: Message, component: str) -> str:
        """A message about a component, in words."""
        if message.code == "declared":
            return self.language.declared(message["text"])
        said = {name: self._argument(name, value, component) for name, value in message.arguments}
        return self.language.message(message.code).format(**said)

    def _argument(self, name: str, value: Any, component: str) -> Any:
        if isinstance(value, Message):
            return self.say(value, component)
        info = self.site.component(component)
        match name:
            case "symbol":
                return self.symbol(value, info)
            case "symbols":
                return ", ".join(self.symbol(s, info) for s in value)
            case "points":
                return ", ".join(self._point(p) for p in value)
            case "point":
                return self._point(value)
            case "component":
                return self.site.component(value).title
            case "alarm":
                return self._alarm(value)
            case "chart":
                return self.language.words("the_chart", chart=self.chart(value))
            case _:
                return value

    def symbol(self, symbol: str, info: ComponentInfo) -> str:
        """What a symbol stands for, with its article; the symbol where nobody has said."""
        meaning = info.meaning(symbol)
        return symbol if meaning == symbol else self.language.words("the_symbol", meaning=self._meaning(symbol, info))

    def _meaning(self, symbol: str, info: ComponentInfo) -> str:
        return self.language.declared(info.meaning(symbol))

    def _point(self, point: str) -> str:
        for info in self.site.components.values():
            for symbol, output in info.outputs.items():
                if output.point == point and output.meaning:
                    meaning = self._meaning(symbol, info)
                    return self.language.words("the_point", meaning=meaning, title=info.title, point=point)
        return point

    def _alarm(self, key: str) -> str:
        component = key.partition("@")[0].partition(":")[0]
        if self.keys or component not in self.site.components:
            return key
        return self.language.words("the_alarm", title=self.site.components[component].title)

    def chart(self, name: str) -> str:
        """A chart by what it does and what it watches."""
        symbol, kind = parts_of(name)
        return self.chart_of(symbol, kind, self.site.component(name.rpartition("/")[0]))

    def chart_of(self, symbol: str, kind: ChartKind, info: ComponentInfo) -> str:
        """A kind of chart, and the symbol that it watches."""
        title = self.language.chart(kind)
        if kind is ChartKind.STEADY:
            return title
        what = self.language.words("all") if symbol == ALL else self._meaning(symbol, info)
        return self.language.words("chart_of", title=title, what=what)

    def sides(self, charts: Sequence[ChartEvidence], info: ComponentInfo) -> str:
        """What is higher and what is lower; empty where charts give no side."""
        parts = []
        for side, word in ((1, "higher"), (-1, "lower")):
            which = [self._meaning(c.symbol, info) for c in charts if c.direction == side]
            if which:
                parts.append(self.language.words(word, what=self.listed(which)))
        return f", {self.language.words('and')} ".join(parts)

    def listed(self, items: Sequence[str]) -> str:
        """One, two and three; each once."""
        unique = list(dict.fromkeys(items))
        if len(unique) < 2:
            return "".join(unique)
        return f"{', '.join(unique[:-1])} {self.language.words('and')} {unique[-1]}"

    def line(self, alarm: Alarm) -> str:
        """An alarm in one line, for lists: what departs and the likeliest cause, or why it was not diagnosed."""
        line = self._line(alarm)
        if alarm.evidence.not_diagnosed is None:
            return line
        why = self.say(alarm.evidence.not_diagnosed, alarm.component)
        return self.language.words("line_not_diagnosed", line=line, why=why)

    def _line(self, alarm: Alarm) -> str:
        words, charts = self.language.words, list(alarm.evidence.charts.values())
        if not alarm.causes:
            return self._departs(alarm, charts)
        first = alarm.causes[0]
        cause = self.say(first.meaning, alarm.component)
        seen = [self.say(m, alarm.component) for m in first.speaks_for]
        if alarm.evidence.kind is AlarmKind.MODEL:
            return words("line_model", seen="; ".join(seen))
        if alarm.evidence.kind is AlarmKind.PLACE:
            likely = first.likelihood or 0.0
            code = "line_sure" if likely >= SURE else "line_most_likely" if likely >= LIKELY else "line_perhaps"
            return words(code, cause=cause, seen=self._strongest(alarm, charts))
        if first.name == "frozen":
            hours = max((c.unchanged_seconds or 0.0 for c in charts), default=0.0) / 3600
            return words("line_frozen", cause=cause, hours=hours)
        if any(c.kind in (ChartKind.CLUSTER, ChartKind.WEEKLY) for c in charts) and seen:
            return seen[0]
        return words("line_likely", cause=cause, departs=self._departs(alarm, charts))

    def _departs(self, alarm: Alarm, charts: Sequence[ChartEvidence]) -> str:
        sides = self.sides(charts, self.site.component(alarm.component))
        return self.language.words("line_departs", sides=sides) if sides else self.language.words("line_nothing")

    def _strongest(self, alarm: Alarm, charts: Sequence[ChartEvidence]) -> str:
        """What the strongest row says; what the bank says is told by the cause."""
        told = [c for c in charts if c.words is not None]
        strongest = max(told, key=lambda c: (c.kind is ChartKind.ROW, c.statistic), default=None)
        if strongest is None or strongest.words is None:
            return self._departs(alarm, charts)
        return self.say(strongest.words, alarm.component)

    def stored(self, alarm: Alarm) -> JsonObject:
        """An alarm as the store keeps it: codes, and the line that lists and dashboards show."""
        return {**alarm.document(), "summary": self.summary(alarm)}

    def summary(self, alarm: Alarm) -> str:
        """The line with the component's name before it."""
        return f"{alarm.component}: {self.line(alarm)}"

    def told(self, alarm: Alarm) -> JsonObject:
        """An alarm as a document for people: words in place of codes."""
        document: JsonObject = self._words(alarm.document(), alarm.component)
        return {**document, "summary": self.summary(alarm)}

    def _words(self, value: Any, component: str) -> Any:
        if isinstance(value, dict):
            if set(value) == {"code", "arguments"}:
                return self.say(Message.read(value), component)
            return {k: self._words(v, component) for k, v in value.items()}
        return [self._words(v, component) for v in value] if isinstance(value, list) else value
