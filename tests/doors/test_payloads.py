"""Single payloads that once stopped, blinded or robbed the service: each is refused by its door, in words, in time."""

from __future__ import annotations

import gzip
import json
import resource
import time as clock
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fdd import limits
from fdd.config import ConfigError
from fdd.config.load import parse_site
from fdd.expressions import ExpressionError, compile_expression
from fdd.limits import LimitError, json_within, name_within
from fdd.records import Batch, Sample
from fdd.units import UnitError, conversion, density, seconds
from ingest import live
from ingest.history import History, read_answer
from ingest.live import Inbox, Letter
from ingest.message import MalformedMessage, Message, decode, encode
from ingest.mqtt.payload import bare_value, json_object
from ingest.sequence import CONFIRMATIONS, NEAR, Ledger
from ingest.source import Context, Refused, make_source, options_type


def numbered(seq: int, stream: str = "plant", end: bool = False) -> bytes:
    return encode(Batch.of([Sample("T", seq, float(seq))]), publisher=stream, run="r", seq=seq, end=end)


def peak_bytes() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


# ---- JSON


@pytest.mark.parametrize("opening", [b"[", b'{"a":', b'[{"a":[1,'])
def test_json_nested_200_000_deep_is_refused(opening: bytes) -> None:
    for read in (decode, lambda p: json_within(p, limits.MESSAGE_BYTES)):
        with pytest.raises((MalformedMessage, LimitError), match="nested deeper than 20"):
            read(opening * 200_000)


def test_brackets_within_texts_are_no_depth() -> None:
    assert json_within(json.dumps({"a": "[" * 500 + '\\"{' * 100}).encode(), 10_000) == {"a": "[" * 500 + '\\"{' * 100}


@pytest.mark.parametrize("text", ["\u0000", "\ud800", "a\u202eb", "a\nb", "x" * 257])
def test_what_cannot_be_printed_is_no_name(text: str) -> None:
    with pytest.raises(LimitError):
        name_within(text, "a name")


# ---- messages


def test_names_times_times_that_the_values_do_not_fill_are_not_spread_out() -> None:
    table = {"v": 1, "names": ["a"] * 9_000, "time": [1] * 90_000, "value": [1.0]}
    before = peak_bytes()
    with pytest.raises(MalformedMessage, match="1 values for a table of 90000 times and 9000 names"):
        decode(json.dumps(table).encode())
    assert peak_bytes() - before < 50_000_000  # spread out they are 800 million samples


def test_a_message_beyond_its_bounds_is_refused_with_the_bound() -> None:
    many = {"v": 1, "names": [f"n{i}" for i in range(limits.MESSAGE_NAMES + 1)], "time": [], "value": []}
    with pytest.raises(MalformedMessage, match=f"at most {limits.MESSAGE_NAMES}"):
        decode(json.dumps(many).encode())
    with pytest.raises(MalformedMessage, match=f"at most {limits.MESSAGE_BYTES}"):
        decode(b" " * (limits.MESSAGE_BYTES + 1))


@pytest.mark.parametrize(
    "fields", [b'"value": %s' % (b"9" * 400), b'"value": 1, "t": 1e300', b'"value": 1, "t": ' + b"9" * 400]
)
def test_mqtt_numbers_beyond_any_float_or_time_are_malformed(fields: bytes) -> None:
    with pytest.raises(MalformedMessage):
        json_object("t", b"{" + fields + b"}", 1, value_key="value", time_key="t", time_unit="ns")


def test_mqtt_bare_text_of_a_megabyte_is_malformed() -> None:
    with pytest.raises(MalformedMessage, match="characters"):
        bare_value("t", b"9" * 1_000_000, 1)


# ---- sequence


def taken(ledger: Ledger, *numbers: int) -> list[bool]:
    return [ledger.take(Message(Batch.of([]), "plant", "r", n)) for n in numbers]


def test_a_number_of_two_to_the_62_is_no_message() -> None:
    with pytest.raises(MalformedMessage, match="seq"):
        decode(numbered(1).replace(b'"seq":1', b'"seq":4611686018427387904'))


def test_one_far_number_does_not_make_a_stream_repeated_for_ever() -> None:
    ledger = Ledger()
    assert all(taken(ledger, 1, 2, 3, 2**52, 4, 5, 6))
    assert ledger.last == {"plant/r": 6}
    assert (ledger.repeated, ledger.far) == (0, 1)


def test_a_far_number_of_a_stream_not_heard_before_is_overcome_by_those_that_follow() -> None:
    ledger = Ledger()
    assert all(taken(ledger, 2**52, *range(1, 20)))
    assert ledger.last == {"plant/r": 19}


def test_a_publisher_that_was_away_for_long_is_counted_from_where_it_stands() -> None:
    ledger = Ledger()
    assert all(taken(ledger, 1, *range(10 * NEAR, 10 * NEAR + 20)))
    assert ledger.last == {"plant/r": 10 * NEAR + 19}
    assert ledger.lost == 10 * NEAR + CONFIRMATIONS - 1 - 1 - CONFIRMATIONS


# ---- history


def test_a_history_that_repeats_itself_is_asked_no_further() -> None:
    history, asked = History("plant/r", 10), []
    for i in (1, 2, 3):
        history.keep(numbered(i, end=i == 3))

    def ask(have: Mapping[str, int]) -> list[tuple[str, bytes]]:
        asked.append(dict(have))
        return [("", history.answer(b"{}"))]  # whatever the reader has

    box = Inbox(10, True, ask)
    assert [v for b in box.batches() for v in b.value.tolist()] == [1.0, 2.0, 3.0]
    assert len(asked) == 2


def test_invented_streams_share_one_wait_and_do_not_hold_up_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live, "_STRANGERS_SECONDS", 0.5)
    box = Inbox(1000, True, lambda _have: [])
    for i in range(40):
        box.receive(Letter(numbered(50, stream=f"invented {i}")))
    box.receive(Letter(numbered(1, end=True)))
    begun = clock.monotonic()
    got = [v for b in box.batches() for v in b.value.tolist()]
    assert got[-1] == 1.0
    assert clock.monotonic() - begun < 10.0  # half a second each would be 20


@pytest.mark.parametrize(
    "answer", [b"[" * 200_000, b'{"stream": "\\ud800"}', b'{"stream": "s"}' + b"\n" * 20_000, b"x" * 9_000_000]
)
def test_answers_beyond_their_bounds_are_malformed(answer: bytes) -> None:
    with pytest.raises(MalformedMessage):
        read_answer(answer)


@pytest.mark.parametrize("question", [b'{"have": {"plant/r": 1e400}}', b"[" * 200_000, b'{"have": {"plant/r": "x"}}'])
def test_a_history_answers_any_question(question: bytes) -> None:
    history = History("plant/r", 10)
    history.keep(numbered(1))
    assert len(read_answer(history.answer(question))[1]) == 1


# ---- units, expressions, the site file


@pytest.mark.parametrize(
    "unit", ["m**9**9**9", "m" * 100, "0x" + "f" * 400, "m**1e9", "m²³", "0*m", "kg**-99", "m**(9**9)"]
)
def test_units_that_no_plant_has_are_refused_at_once(unit: str) -> None:
    begun = clock.process_time()
    with pytest.raises(UnitError):
        conversion(unit)
    assert clock.process_time() - begun < 1.0


@pytest.mark.parametrize("read", [seconds, density])
@pytest.mark.parametrize("text", ["1.2.3 min", "1e308 days", "9" * 400 + " s", "-" * 100_000])
def test_durations_and_fluids_that_are_none_are_refused(read: Callable[[str], float], text: str) -> None:
    with pytest.raises(UnitError):
        read(text)


@pytest.mark.parametrize(
    "text",
    [
        " + ".join(["a"] * 990),
        "-" * 100_000 + "1",
        "0x" + "f" * 400,
        "(" * 5_000,
        "a ** " * 200 + "2",
        "a." * 900 + "b",
        "9 ** 9 ** 9 ** 9 [m]",
    ],
)
def test_expressions_too_deep_or_too_long_are_refused_at_once(text: str) -> None:
    begun = clock.process_time()
    with pytest.raises(ExpressionError):
        compile_expression(text, {"a": "m"})
    assert clock.process_time() - begun < 1.0


def test_a_sum_of_a_hundred_points_is_an_expression() -> None:
    points = {f"p{i}": "W" for i in range(100)}
    total = compile_expression(" + ".join(points), points)
    assert total({p: np.array([1.0]) for p in points}) == [100.0]


def bomb() -> str:
    lines = ["name: S", "a: &a [x, x, x, x, x, x, x, x, x, x]"]
    lines += [f"{chr(b)}: &{chr(b)} [{', '.join([f'*{chr(b - 1)}'] * 10)}]" for b in range(ord("b"), ord("k"))]
    return "\n".join(lines)


@pytest.mark.parametrize(
    "text",
    [
        "name: S\nsources: 5",
        "name: S\nsources: [5]",
        "name: S\nstep: 0x" + "f" * 400,
        "name: S\npoints: " + "[" * 5_000,
        "name: S\npoints: " + "- " * 50_000,
        "name: S\npoints: " + "{a: " * 5_000,
        "name: S\n" + "? " * 5_000,
        bomb(),
        "name: &a [*a]",
        'name: "\\ud800"',
        "name: ../..",
        "name: 2001-99-99",
        "[]",
        "name: S\nsource: -",
    ],
)
def test_site_files_that_are_none_are_refused_in_words(text: str) -> None:
    begun = clock.process_time()
    with pytest.raises(ConfigError) as refused:
        parse_site(text)
    assert clock.process_time() - begun < 2.0
    assert len(str(refused.value)) < 2_000


def test_a_password_in_the_address_of_a_store_is_refused_and_not_printed() -> None:
    with pytest.raises(ConfigError) as refused:
        parse_site("name: S\nstore: {kind: influx, url: 'http://u:hunter2@h', org: o, bucket: b, token_env: T}")
    assert "token_file" in str(refused.value)
    assert "hunter2" not in str(refused.value)


# ---- files


def read_file(kind: str, folder: Path, name: str) -> tuple[int, dict[str, int]]:
    source = make_source(
        options_type(kind).model_validate({"kind": kind, "path": name}), Context("UTC", ("T",), folder)
    )
    source.open(None)
    return sum(len(b) for b in source.batches()), source.counters()


def test_a_gzipped_line_without_end_costs_no_memory(tmp_path: Path) -> None:
    piece = b"1" * 10_000_000
    with gzip.open(tmp_path / "a.csv.gz", "wb", compresslevel=1) as out:
        out.write(b"time,T\n2026-01-01 00:00,1\n")
        for _ in range(30):
            out.write(piece)
    before, begun = peak_bytes(), clock.process_time()
    rows, counts = read_file("csv", tmp_path, "a.csv.gz")
    assert (rows, counts["file cut short"]) == (1, 1)
    assert peak_bytes() - before < 100_000_000
    assert clock.process_time() - begun < 2.0


def test_a_small_parquet_file_of_forty_million_rows_is_refused(tmp_path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    table = pa.table({"time": pa.array(np.zeros(1_000_000, dtype=np.int64)), "T": pa.array(np.zeros(1_000_000))})
    with pq.ParquetWriter(tmp_path / "a.parquet", table.schema) as out:
        for _ in range(40):
            out.write_table(table)
    begun = clock.process_time()
    with pytest.raises(Refused, match="unpack it first"):
        read_file("parquet", tmp_path, "a.parquet")
    assert clock.process_time() - begun < 1.0


def test_a_quotation_mark_that_is_never_closed_costs_its_own_line_alone(tmp_path: Path) -> None:
    rows = [f"2026-01-01 00:{m:02d},{m}" for m in range(20)]
    rows[7] = '2026-01-01 00:07,"7'
    (tmp_path / "a.csv").write_text("time,T\n" + "\n".join(rows) + "\n")
    found, _ = read_file("csv", tmp_path, "a.csv")
    assert found >= 19


def test_parquet_damaged_in_the_middle_ends_with_a_count(tmp_path: Path) -> None:
    path = tmp_path / "a.parquet"
    times = pd.date_range("2026-01-01", periods=5_000, freq="1min", tz="UTC")
    pd.DataFrame({"time": times, "T": np.random.default_rng(1).random(5_000)}).to_parquet(
        path, write_page_checksum=True
    )
    data = bytearray(path.read_bytes())
    data[len(data) // 2 : len(data) // 2 + 50] = b"\xff" * 50
    path.write_bytes(data)
    _, counts = read_file("parquet", tmp_path, "a.parquet")
    assert sum(counts.values()) > 0
