"""What was kept of the budget: counted by the engine, shown by status, metrics and dashboards."""

from __future__ import annotations

from dataclasses import replace

import pytest
from scipy.stats import poisson

from benchmarks.drifting_room import DAY, POINTS, START, Course, plan, simulate
from fdd.evidence import ChartEvidence, ChartKind
from fdd.records import NANOSECONDS, Batch, Sample
from fdd.service.alarms.book import AlarmBook, Command, Ring
from fdd.service.alarms.realised_rate import Tally, realised_rate
from fdd.service.baselines.identify import identify
from fdd.service.daemon.metrics import exposition
from fdd.service.engine.engine import Engine
from fdd.service.verbs.status import budget_told
from tests.service.test_operation import STATUS

YEAR = 365.25 * 86400.0

CHART = ChartEvidence("T", ChartKind.CUSUM)


def book_with(comments: list[str], consequences: int = 0) -> AlarmBook:
    """As many alarms cleared with these comments, one open, and consequences of the open one."""
    names = [f"c{i}" for i in range(consequences)]
    book = AlarmBook({}, {n: frozenset({"hx"}) for n in names})
    for i, comment in enumerate(comments):
        (alarm,) = book.ring(i + 1, [Ring("hx", "hx/T:cusum", None, 0, CHART)])
        book.command(Command(alarm.key, "clear", "anna", 0, comment), i + 1)
    book.ring(99, [Ring(n, f"{n}/T:cusum", None, 0, CHART) for n in ("hx", *names)])
    return book


def test_consequences_are_no_alarms_of_their_own_and_only_called_ones_are_false() -> None:
    book = book_with(["false: nothing there", "plates cleaned", "False alarm"], consequences=2)
    told = realised_rate(book.tally, book.open, 2 * YEAR, 1.0)
    assert (told["alarms"]["count"], told["judged_false"]["count"]) == (4, 2)
    assert told["alarms"]["per_year"] == 2.0
    assert told["years"] == 2.0
    # The exact interval: its ends are the means that make the count just as rare, on either side.
    assert poisson.sf(3, 2 * told["alarms"]["low"]) == pytest.approx(0.025)
    assert poisson.cdf(4, 2 * told["alarms"]["high"]) == pytest.approx(0.025)
    again = Tally()
    again.restore_state(book.tally.export_state())
    assert realised_rate(again, book.open, 2 * YEAR, 1.0) == told


def test_nothing_is_told_before_anything_was_watched() -> None:
    told = realised_rate(Tally(), (), 0.0, 1.0)
    assert told == {"promised_per_year": 1.0, "years": 0.0}
    assert "nothing was watched yet" in budget_told(told)
    assert "fdd_alarms_per_year{" not in exposition({**STATUS, "budget": told})


def test_engine_counts_the_time_in_which_charts_could_judge() -> None:
    """Fourteen days, of which two without any sample; the same after a restart."""
    history = simulate(Course(28), 4)
    end = START + 14 * DAY * NANOSECONDS
    site = replace(plan(), false_alarms_per_year=2.0)
    first = identify(site, site.components[0], history.between(None, end))[0]
    days = history.between(end, None)
    rows = [(t, r) for t, r in zip(days.time.tolist(), days.values.tolist(), strict=True)
            if not 3 <= (t - end) / NANOSECONDS / DAY < 5]  # fmt: skip
    samples = [Sample(p, t, v) for t, row in rows for p, v in zip(POINTS, row, strict=True)]
    engine = Engine(site, {"room": first})
    engine.step(Batch.of(samples[: len(samples) // 2]))
    again = Engine(site, {"room": first})
    again.restore_state(engine.export_state())
    again.step(Batch.of(samples[len(samples) // 2 :]))
    told = again.realised_rate
    assert told["promised_per_year"] == 2.0
    assert 11.0 < told["years"] * 365.25 < 12.05


def test_metrics_and_status_show_rate_and_interval() -> None:
    book = book_with(["false"])
    told = realised_rate(book.tally, book.open, YEAR / 2, 1.0)
    text = exposition({**STATUS, "budget": told})
    assert "fdd_alarms_promised_per_year 1\n" in text
    assert 'fdd_alarms{which="alarms"} 2\n' in text
    assert 'fdd_alarms_per_year{which="alarms",bound="value"} 4\n' in text
    high = next(line for line in text.splitlines() if 'which="judged_false",bound="high"' in line)
    assert float(high.split()[-1]) == pytest.approx(2 * 5.572, rel=1e-3)  # Garwood's table: 5.572 for one
    said = budget_told(told)
    assert said.startswith("2 in all: 4 a year (0.48 to 14)")
    assert said.endswith("of 183 days watched; 1 false ones a year are promised")
