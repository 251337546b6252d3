"""``fdd init``: from an export to a site file that loads, with a review of how sure each guess is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from zoneinfo import available_timezones

import numpy as np
from rich.console import Console
from rich.table import Table

from fdd.config import check_site, parse_site
from fdd.onboarding.balance import balanced
from fdd.onboarding.draft import Draft, symbol, write
from fdd.onboarding.export import ExportSource, files_of, local_times, read
from fdd.onboarding.guess import ORDER, ExportError, Guess
from fdd.onboarding.quantity import Found, Series, identified
from fdd.onboarding.roles import Part, parts
from fdd.onboarding.tags import Tagged, read_tags
from fdd.onboarding.times import clock_changes
from fdd.onboarding.vocabulary import facets, plain
from fdd.records import JsonObject
from fdd.units import UnitError, conversion

Ask = Callable[[str, str, Sequence[str]], str]
"""Asks a person: question, answer that was guessed, other answers; gives the answer."""


@dataclass(frozen=True)
class Started:
    """What came of an export."""

    path: Path
    draft: Draft
    near: Sequence[Part]
    guesses: Sequence[Guess]
    errors: Sequence[str]

    @property
    def unsure(self) -> int:
        """How many guesses a person should look at."""
        return sum(row[2] == "unsure" for row in self._rows())

    def document(self) -> JsonObject:
        """For machines."""
        names, used = self.draft.names, self.draft.used
        return {
            "site": str(self.path),
            "guesses": [_document(g) for g in (self.draft.zone, *self.guesses)],
            "columns": [
                {"column": f.series.name, "point": names[f.series.name], "quantity": f.quantity, "unit": f.unit,
                 "fluid": f.fluid, "sureness": f.sureness, "why": f.why, "others": list(f.others),
                 "used": f.series.name in used}
                for f in self.draft.found
            ],
            "equipment": [
                {"name": p.name, "model": p.model,
                 "roles": {r: {"column": c, "sureness": p.sureness[r]} for r, c in p.roles.items()}}
                for p in self.draft.parts
            ],
            "incomplete": [{"name": p.name, "model": p.model, "missing": list(p.missing)} for p in self.near],
            "errors": list(self.errors),
        }  # fmt: skip

    def _rows(self) -> list[tuple[str, str, str, str]]:
        """What was taken for what, how sure, and why: what is unsure first."""
        used = self.draft.used
        rows = [(g.key, g.value, str(g.sureness), g.why) for g in (self.draft.zone, *self.guesses)]
        rows += [
            (f.series.name, f"{f.quantity} [{f.unit}]", str(f.sureness), f.why + _or(f.others))
            for f in self.draft.found
            if f.series.name in used
        ]
        rows += [
            (f"{p.name} ({p.model})", f"{role} = {column}", str(p.sureness[role]), p.why.get(role, "by its name"))
            for p in self.draft.parts
            for role, column in p.roles.items()
        ]
        return sorted(rows, key=lambda r: [str(o) for o in ORDER].index(r[2]))

    def print(self, console: Console) -> None:
        """For people."""
        table = Table(box=None, pad_edge=False)
        for head in ("what", "taken for", "how sure", "why"):
            table.add_column(head, overflow="fold")
        for row in self._rows():
            table.add_row(*row, style="bold" if row[2] == "unsure" else None)
        console.print(table, markup=False)
        for part in self.near:
            lacking = ", ".join(part.missing)
            console.print(f"nearly: {part.name} as {part.model}; no column for {lacking}", markup=False, soft_wrap=True)
        for error in self.errors:
            console.print(error, markup=False, soft_wrap=True)
        watched = ", ".join(f"{p.name} ({p.model})" for p in self.draft.parts) or "nothing"
        console.print(f"equipment: {watched}; {self.unsure} guess(es) are unsure", markup=False, soft_wrap=True)
        console.print(f"written: {self.path}", markup=False, soft_wrap=True)


def _or(others: Sequence[str]) -> str:
    return f"; it may be {' or '.join(others)}" if others else ""


def _document(guess: Guess) -> JsonObject:
    return {"key": guess.key, "value": guess.value, "sureness": guess.sureness, "why": guess.why,
            "others": list(guess.others)}  # fmt: skip


def start(
    exports: Sequence[Path], out: Path, *, name: str | None = None, zone: str | None = None, ask: Ask | None = None
) -> Started:
    """Draft a site file from exports and write it.

    Parameters
    ----------
    exports : files and folders: tables, Haystack grids, Brick models
    out : the site file
    ask : asks a person about what is unsure; None guesses, and says so in the file and the review

    Raises
    ------
    ExportError : nothing could be read.
    """
    tables, tag_files = files_of(exports)
    tagged = [t for path in tag_files for t in read_tags(path)]
    where = _zone(zone, tagged)
    sources = read(tables, where.value, ask)
    where = _with_evidence(where, sources, ask)
    if where.value != "UTC" and zone is None and any(not s.zoned for s in sources):
        sources = read(tables, where.value, ask)
    found = identified(_columns(sources, tagged))
    found = balanced(found, parts(found)[0])
    whole, near = parts(found)
    if ask is not None:
        found = _asked(found, {c for p in whole for c in p.roles.values()}, ask)
        whole, near = parts(found)
    draft = Draft(
        name or symbol(exports[0].resolve().stem.removesuffix(".csv")),
        where, sources, found, whole, {c: str(s.keys.get("name", "")) for s in sources for c in s.values},
    )  # fmt: skip
    text = write(draft, out.parent)
    errors = [str(f) for f in check_site(parse_site(text, folder=out.resolve().parent)) if f.severity == "error"]
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(text, encoding="utf-8")
    return Started(out, draft, near, [g for s in sources for g in s.guesses], errors)


def _zone(given: str | None, tagged: Sequence[Tagged]) -> Guess:
    if given:
        if given not in available_timezones():
            raise ExportError(f"{given!r} is no time zone; use an IANA name such as Europe/Copenhagen, or UTC")
        return Guess("zone", given, "sure", "as given")
    cities = {t.zone for t in tagged if t.zone}
    if len(cities) == 1:
        city = cities.pop()
        known = sorted(z for z in available_timezones() if z.rpartition("/")[2] == city)
        if known:
            return Guess("zone", known[0], "sure", f"the tag tz: {city}")
    return Guess("zone", "UTC", "unsure", "nothing says which")


def _with_evidence(where: Guess, sources: Sequence[ExportSource], ask: Ask | None) -> Guess:
    """The zone with what the times say of it; a person is asked where they say nothing."""
    if where.sureness == "sure":
        return where
    if sources and all(s.zoned for s in sources):
        return replace(where, sureness="likely", why="times carry their offset; the zone only shows them")
    for source in sources:
        changed = clock_changes(local_times(source, where.value))
        if changed is not None:
            where = changed
            break
    if ask is not None:
        answer = ask("Time zone of the plant", where.value, ())
        return _zone(answer, ())
    return where


def _columns(sources: Sequence[ExportSource], tagged: Sequence[Tagged]) -> list[Series]:
    """The data's columns with what tags say of them; points that have no data stand for themselves."""
    known = {plain(key): t for t in tagged for key in reversed(t.keys)}
    columns: list[Series] = []
    matched: set[int] = set()
    for source in sources:
        for column, values in source.values.items():
            tag = known.get(plain(column))
            unit = source.units.get(column, "")
            if tag is None:
                columns.append(Series(column, values, unit))
                continue
            matched.add(id(tag))
            said = tag.facets | facets(column) if not tag.facets else tag.facets
            columns.append(Series(column, values, tag.unit or unit, said, tag.group, tag.title))
    if not matched:
        none = np.empty(0)
        columns += [Series(t.keys[0], none, t.unit, t.facets, t.group, t.title) for t in tagged]
    return columns


def _asked(found: Sequence[Found], used: set[str], ask: Ask) -> list[Found]:
    """Units that are unsure, of points that are used, as a person says them."""
    out = []
    for f in found:
        if f.series.name in used and f.sureness == "unsure":
            answer = ask(f"Unit of {f.series.name!r} ({f.quantity}; {f.why})", f.unit, f.others)
            try:
                conversion(answer)
            except UnitError as error:
                raise ExportError(str(error)) from None
            volume = conversion(answer).si == "m3/s" and "flow" in f.quantity
            fluid = ("air" if f.quantity == "air flow" else "water") if volume else ""
            f = replace(f, unit=answer, sureness="sure", why="as answered", others=(), fluid=fluid)
        out.append(f)
    return out
