"""New baselines under running filters: no sample missed, the same bytes however the stream was cut or interrupted."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fdd.records import Baseline, Batch, Rows
from fdd.residual_monitors.chart import Phase
from fdd.service.baselines.versions import accept, roll_back
from fdd.service.daemon.checkpoint import Checkpoint, Rebase, decode, encode
from fdd.service.daemon.daemon import Daemon
from fdd.service.engine.engine import Engine, EngineError, Outputs
from fdd.store.sqlite import SqliteStore
from tests.service.conftest import Truth, baselines, plan
from tests.service.test_engine import verdicts

DAY = 288


def moved(share: float = 0.05, **more: object) -> Baseline:
    """The south room's baseline with another thermal resistance, and some colour to be taken out."""
    old = baselines()["south"]
    innovation = {"T_room": {"mean": 0.02, "sd": 1.05, "ar": [0.1, 0.02], "lag1": 0.1, "samples": 10**9}}
    parameters = {**old.parameters, "R_ia": old.parameters["R_ia"] * (1 + share)}
    return replace(old, version=2, parameters=parameters, innovation=innovation, **more)  # type: ignore[arg-type]


def of(outputs: Outputs, measurement: str, series: str) -> Rows:
    (rows,) = [r for r in outputs.rows if r.measurement == measurement]
    which = rows.series == rows.names.index(series)
    return replace(rows, series=rows.series[which], time=rows.time[which],
                   fields={k: v[which] for k, v in rows.fields.items()})  # fmt: skip


def test_no_frame_is_missed_and_the_other_room_does_not_notice(healthy: Truth) -> None:
    plain, swapped = Engine(plan(), baselines()), Engine(plan(), baselines())
    half = 7 * DAY
    expected = [plain.step(healthy.batch(0, half)), plain.step(healthy.batch(half))]
    found = [swapped.step(healthy.batch(0, half))]
    swapped.rebase({"south": moved()})
    found.append(swapped.step(healthy.batch(half)))
    assert swapped.versions == {"south": 2, "north": 1}
    for measurement, series in (("predictions", "south/T_room"), ("charts", "south/T_room:cusum")):
        assert of(found[1], measurement, series).time.tolist() == of(expected[1], measurement, series).time.tolist()
    z = of(found[1], "predictions", "south/T_room").fields["innovation"]
    assert np.isfinite(z).all()
    for name in ("charts", "predictions"):
        series = "north/T_room" if name == "predictions" else "north/R_ia:score"
        ours, theirs = of(found[1], name, series), of(expected[1], name, series)
        assert all(ours.fields[k].tobytes() == theirs.fields[k].tobytes() for k in ours.fields)


def test_the_new_parameters_are_those_the_filter_predicts_with(healthy: Truth) -> None:
    site = replace(plan(), learning=0)  # what the two would learn from different weeks is not the same
    late, fresh = Engine(site, baselines()), Engine(site, {**baselines(), "south": moved()})
    half = 7 * DAY
    late.step(healthy.batch(0, half))
    late.rebase({"south": moved()})
    a, b = late.step(healthy.batch(half)), fresh.step(healthy.batch(0))
    last = of(a, "predictions", "south/T_room")
    whole = of(b, "predictions", "south/T_room")
    n = 5 * DAY  # a day and more after the change the two filters have the same memory
    assert last.fields["predicted"][-n:] == pytest.approx(whole.fields["predicted"][-n:], abs=1e-6)
    assert last.fields["sd"][-n:] == pytest.approx(whole.fields["sd"][-n:], rel=1e-6)


def test_score_charts_start_again_and_innovation_charts_go_on(faulty: Truth) -> None:
    e = Engine(plan(), baselines())
    alarms = e.step(faulty.batch(0, 8 * DAY)).alarms
    assert {a.component for a in alarms} == {"south"}
    before = e.export_state()["charts"]["families"]
    e.rebase({"south": moved()})
    after = e.export_state()["charts"]["families"]
    days, quick, scores = range(3)
    assert np.array_equal(before[quick]["chart"]["upper"], after[quick]["chart"]["upper"])
    symbols = 3
    assert after[scores]["chart"]["upper"][:symbols].max() == 0
    assert after[scores]["chart"]["lower"][:symbols].max() == 0
    assert np.array_equal(before[scores]["chart"]["upper"][symbols:], after[scores]["chart"]["upper"][symbols:])
    assert not after[days]["coefficients"][0].any()  # how the new model's errors move nobody has seen yet
    assert np.array_equal(after[days]["coefficients"][1], before[days]["coefficients"][1])
    assert np.array_equal(after[days]["squares"], before[days]["squares"])
    assert e.alarms.of("south") is not None


def test_state_carries_its_baselines(healthy: Truth) -> None:
    whole, first = Engine(plan(), baselines()), Engine(plan(), baselines())
    for e in (whole, first):
        e.step(healthy.batch(0, 5 * DAY))
        e.rebase({"south": moved()})
        e.step(healthy.batch(5 * DAY, 6 * DAY))
    again = Engine(plan(), {**baselines(), "north": replace(baselines()["north"], version=9)})
    again.restore_state(decode(encode(first.export_state())))
    assert again.versions == {"south": 2, "north": 1}
    rest = healthy.batch(6 * DAY)
    assert verdicts([again.step(rest)]) == verdicts([whole.step(rest)])


def test_limits_follow_how_far_charts_ring_together_and_are_those_of_a_fresh_engine(healthy: Truth) -> None:
    physical = [p.symbol for p in plan().components[0].model.parameters if p.kind == "physical"]
    probation = {"score": {"weekly": dict.fromkeys(physical, 8.0), "weeks": 8.0}}
    seen = {n: replace(b, diagnostics={**b.diagnostics, "probation": probation}) for n, b in baselines().items()}
    alike = moved(diagnostics={"effective_share": 0.5, "probation": probation})
    e, fresh = Engine(plan(), seen), Engine(plan(), {**seen, "south": alike})
    before = e.step(healthy.batch(0, DAY))
    e.rebase({"south": alike})
    after, told = e.step(healthy.batch(DAY, 2 * DAY)), fresh.step(healthy.batch(0, 2 * DAY))
    for series in ("south/R_ia:score",):
        old, new, wanted = (of(o, "charts", series).fields["limit"][-1] for o in (before, after, told))
        assert new < old  # fewer charts that ring by themselves: each may ring more often
        assert new == wanted
    north = [of(o, "charts", "north/R_ia:score").fields["limit"][-1] for o in (before, after, told)]
    assert north[0] == north[1] == north[2]


def test_no_score_chart_rings_before_a_week_that_the_fit_has_not_seen(healthy: Truth) -> None:
    """Scores of a baseline without probation learn for seven days, whatever they say; then they have a limit."""
    e = Engine(plan(), baselines())
    first, later = (
        of(e.step(healthy.batch(a * DAY, b * DAY)), "charts", "south/R_ia:score") for a, b in ((0, 6), (6, 9))
    )
    assert set(first.fields["limit"]) == {500.0}
    assert set(first.fields["phase"]) <= {Phase.LEARNING, Phase.NO_DATA}
    assert later.fields["limit"][-1] < 50.0


def test_a_baseline_of_something_else_is_refused() -> None:
    e = Engine(plan(), baselines())
    with pytest.raises(EngineError, match="attic is not watched"):
        e.rebase({"attic": moved()})
    with pytest.raises(EngineError, match="fit it anew"):
        e.rebase({"south": moved(model="radiator")})
    assert e.versions == {"south": 1, "north": 1}


class Stream:
    """Batches from memory, doing something between them."""

    def __init__(self, batches: list[Batch], at: dict[int, object] | None = None) -> None:
        self._batches, self._at = batches, at or {}
        self.heard: dict[str, float] = {}

    def batches(self) -> Iterator[Batch]:
        for i, batch in enumerate(self._batches):
            if i in self._at:
                self._at[i]()  # type: ignore[operator]
            yield batch

    def counters(self) -> dict[str, int]:
        return {}


class KilledError(Exception):
    pass


def test_a_crash_after_the_change_replays_it_at_the_same_place(healthy: Truth, tmp_path: Path) -> None:
    batches = [replace(healthy.batch(d * DAY, (d + 1) * DAY), position={"day": d + 1}) for d in range(6)]

    def run(folder: Path, crash: int | None) -> tuple[bytes, list[object]]:
        folder.mkdir()
        store = SqliteStore(folder / "store.sqlite")
        for b in baselines().values():
            accept(store, b)

        def put_in_force() -> None:
            accept(store, moved())

        def roll() -> None:
            roll_back(store, "south", 1)

        def die() -> None:
            raise KilledError

        clock = iter(range(10**9, 10**9 + 10**6, 60))
        events: dict[int, object] = {2: put_in_force, 5: roll}
        first = Daemon(Engine(plan(), baselines()), store, Checkpoint(folder / "state"), save_every=2 * DAY,
                       now=lambda: float(next(clock)))  # fmt: skip
        if crash is None:
            first.run(Stream(batches, events))  # type: ignore[arg-type]
            last = first
        else:
            with pytest.raises(KilledError):
                first.run(Stream(batches[: crash + 1], {**{k: v for k, v in events.items() if k < crash}, crash: die}))  # type: ignore[arg-type]
            last = Daemon(Engine(plan(), baselines()), store, Checkpoint(folder / "state"), save_every=2 * DAY,
                          now=lambda: float(next(clock)))  # fmt: skip
            done = last.recover()["day"]
            assert done == crash
            rest = {k - done: v for k, v in events.items() if k >= done}
            last.run(Stream(batches[done:], rest))  # type: ignore[arg-type]
        last.finish()
        tables = [store.read(m).to_csv().encode() for m in ("charts", "predictions", "parameters")]
        seen = [last.engine.versions]
        store.close()
        return b"".join(tables), seen

    undisturbed = run(tmp_path / "undisturbed", None)
    assert undisturbed[1] == [{"south": 1, "north": 1}]
    for crash in (3, 4):
        assert run(tmp_path / f"crash{crash}", crash) == undisturbed


def test_the_journal_keeps_a_change_of_baselines(tmp_path: Path) -> None:
    entry = Rebase((moved(covariance=[[float("nan"), 1.0]]),))
    Checkpoint(tmp_path / "state").journal(entry)
    (back,) = Checkpoint(tmp_path / "state").entries()
    assert repr(back) == repr(entry)
