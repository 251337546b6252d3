"""CSV and Parquet in the ways strangers write them; every oddity has a defined, counted outcome."""

from __future__ import annotations

import gzip
import time as clock
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest

from fdd.records import Batch, Quality
from ingest.csv import CsvOptions, CsvSource, ExcelOptions, ExcelSource, ParquetOptions, ParquetSource
from ingest.source import Context, Refused


def utc(text: str) -> int:
    moment = datetime.fromisoformat(text).replace(tzinfo=UTC)
    return int(moment.timestamp()) * 10**9


def source_of(path: Path, columns: tuple[str, ...] = (), zone: str = "UTC", **options: Any) -> CsvSource:
    source = CsvSource()
    source.configure(
        CsvOptions.model_validate({"kind": "csv", "path": path.name} | options), Context(zone, columns, path.parent)
    )
    return source


def write(folder: Path, text: str, name: str = "data.csv", encoding: str = "utf-8") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def read(source: Any, position: Any = None) -> list[Batch]:
    source.open(position)
    return list(source.batches())


def series(batches: list[Batch], name: str) -> list[tuple[int, float]]:
    return [
        (int(t), float(v))
        for b in batches
        for p, t, v in zip(b.point, b.time, b.value, strict=True)
        if b.names[p] == name
    ]


def one(folder: Path, text: str, columns: tuple[str, ...] = ("a",), **options: Any) -> tuple[list[Batch], CsvSource]:
    source = source_of(write(folder, text), columns, **options)
    return read(source), source


def test_plain_file_needs_no_options(tmp_path: Path) -> None:
    got, source = one(tmp_path, "Timestamp,a,b\n2024-01-01 00:00,1.5,2\n2024-01-01 00:05,,3\n", ("b", "a"))
    assert series(got, "b") == [(utc("2024-01-01 00:00"), 2.0), (utc("2024-01-01 00:05"), 3.0)]
    assert np.isnan(series(got, "a")[1][1])
    assert source.counters() == {}


def test_european_file_with_semicolons_decimal_commas_and_day_first(tmp_path: Path) -> None:
    text = "# export\nDatum;Vorlauf °C;Leistung\n05.02.2024 14:26;61,5;1.234,5\n06.02.2024 14:26;n/a;0,5\n"
    source = source_of(
        write(tmp_path, text, encoding="latin-1"),
        ("Vorlauf °C", "Leistung"),
        encoding="latin-1",
        decimal=",",
        thousands=".",
        comment="#",
        time={"column": "Datum", "day_first": True, "zone": "Europe/Berlin"},
    )
    got = read(source)
    assert series(got, "Leistung") == [(utc("2024-02-05 13:26"), 1234.5), (utc("2024-02-06 13:26"), 0.5)]
    assert series(got, "Vorlauf °C")[0][1] == 61.5


def test_american_time_is_not_guessed_but_asked_for(tmp_path: Path) -> None:
    text = "Datetime,a\n8/9/2007 0:00,1\n8/9/2007 0:01,2\n"
    with pytest.raises(Refused, match="day_first"):
        one(tmp_path, text)
    got, _ = one(tmp_path, text, time={"column": "Datetime", "day_first": False}, zone="America/Chicago")
    assert series(got, "a")[0] == (utc("2007-08-09 05:00"), 1.0)


def test_date_and_time_in_two_columns_with_a_format(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "D,T,a\n31.12.24,23:55,1\n", time={"columns": ["D", "T"], "format": "%d.%m.%y %H:%M"})
    assert series(got, "a") == [(utc("2024-12-31 23:55"), 1.0)]


def test_offset_in_the_text_wins_over_the_zone(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "time,a\n2018-05-01 00:00:00-05:00,1\n", zone="Asia/Tokyo")
    assert series(got, "a") == [(utc("2018-05-01 05:00"), 1.0)]


def test_count_since_an_origin_is_exact(tmp_path: Path) -> None:
    rows = "".join(f"{i / 12:.15g},{i}\n" for i in range(2000))
    got, _ = one(tmp_path, "t,a\n" + rows, time={"column": "t", "unit": "h", "origin": "2009-02-05 14:26"})
    start = utc("2009-02-05 14:26")
    assert [t for t, _ in series(got, "a")] == [start + i * 300 * 10**9 for i in range(2000)]


def test_large_counts_keep_their_nanoseconds(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "t,a\n1700000000000,1\n", time={"column": "t", "unit": "ms"})
    assert series(got, "a") == [(1_700_000_000_000_000_000, 1.0)]


def test_file_without_time_column_takes_start_and_step(tmp_path: Path) -> None:
    time = {"start": "2024-01-01 00:00", "step": "15 min"}
    got, _ = one(tmp_path, "a\n" + "".join(f"{i}\n" for i in range(10)), time=time, batch_rows=3)
    assert [t for t, _ in series(got, "a")] == [utc("2024-01-01 00:00") + i * 900 * 10**9 for i in range(10)]
    assert len(got) == 4


def test_file_without_header(tmp_path: Path) -> None:
    path = write(tmp_path, "#1\ndouble dat(2, 3)\n0, 372.3, 362.9\n900, 371.8, 362.7\n")
    options = {"skip_rows": 2, "header": False, "columns": ["s", "a", "b"], "time": {"column": "s", "unit": "s"}}
    source = CsvSource()
    source.configure(CsvOptions.model_validate({"kind": "csv", "path": path, **options}), Context("UTC", ("a",)))
    got = read(source)
    assert series(got, "a") == [(0, 372.3), (900 * 10**9, 371.8)]


def test_long_format(tmp_path: Path) -> None:
    text = "time,point,value\n2024-01-01 00:00,a,1\n2024-01-01 00:00,b,2\n2024-01-01 00:01,a,x\n"
    got, source = one(tmp_path, text, (), long={"point": "point", "value": "value"})
    assert series(got, "b") == [(utc("2024-01-01 00:00"), 2.0)]
    assert np.isnan(series(got, "a")[1][1])
    assert source.counters() == {"value is no number": 1}


def test_words_for_on_and_off_are_numbers_and_sentinels_are_missing(tmp_path: Path) -> None:
    text = "time,a,b\n2024-01-01 00:00,On,Bad\n2024-01-01 00:01,off,1\n2024-01-01 00:02,broken,-9999\n"
    got, source = one(tmp_path, text, ("a", "b"), missing=["Bad", -9999])
    np.testing.assert_array_equal([v for _, v in series(got, "a")], [1.0, 0.0, np.nan])
    np.testing.assert_array_equal([v for _, v in series(got, "b")], [np.nan, 1.0, np.nan])
    assert source.counters() == {"value is no number": 1}


def test_missing_column_is_refused_with_close_matches(tmp_path: Path) -> None:
    with pytest.raises(Refused, match=r"no column 'Supply Temp'.*Did you mean 'Supply Temperature'"):
        one(tmp_path, "time,Supply Temperature\n2024-01-01,1\n", ("Supply Temp",))


def test_missing_file_encoding_and_time_are_refused_in_words(tmp_path: Path) -> None:
    source = source_of(tmp_path / "nowhere.csv")
    with pytest.raises(Refused, match=r"no file .*nowhere\.csv"):
        source.open()
    with pytest.raises(Refused, match="set encoding"):
        read(source_of(write(tmp_path, "time,Vorlauf °C\n", encoding="latin-1")))
    with pytest.raises(Refused, match="no column looks like the time"):
        one(tmp_path, "x,a\n1,2\n")
    with pytest.raises(Refused, match="no header line"):
        one(tmp_path, "")


def test_wrong_lines_are_counted_with_their_numbers_and_the_rest_is_read(tmp_path: Path) -> None:
    text = "time,a\n2024-01-01 00:00,1\n2024-01-01 00:01\n2024-01-01 00:02,3,4\nnonsense,5\n2024-01-01 00:04,6\n"
    got, source = one(tmp_path, text)
    assert [v for _, v in series(got, "a")] == [1.0, 6.0]
    assert source.counters() == {"line has the wrong number of fields": 2, "time not understood": 1}
    assert "line 3" in source.notes()[0]
    assert "line 4" in source.notes()[1]


def test_file_cut_in_its_last_line_is_counted(tmp_path: Path) -> None:
    got, source = one(tmp_path, "time,a,b\n2024-01-01 00:00,1,2\n2024-01-01 00:0", ("a", "b"))
    assert [v for _, v in series(got, "a")] == [1.0]
    assert source.counters() == {"last line cut short": 1}
    assert "line 3" in source.notes()[0]


def test_last_line_without_its_end_is_uncertain(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "time,a\n2024-01-01 00:00,21.25\n2024-01-01 00:01,21.2")
    assert got[-1].quality.tolist() == [Quality.GOOD, Quality.UNCERTAIN]


def test_gzip_and_a_gzip_cut_short(tmp_path: Path) -> None:
    rows = "".join(f"2024-01-01 {i // 60:02}:{i % 60:02},{(i * 7919) % 1000}\n" for i in range(1400))
    whole = gzip.compress(("time,a\n" + rows).encode())
    path = tmp_path / "data.csv.gz"
    path.write_bytes(whole)
    assert len(series(read(source_of(path, ("a",))), "a")) == 1400
    path.write_bytes(whole[: len(whole) // 2])
    source = source_of(path, ("a",))
    got = series(read(source), "a")
    assert 0 < len(got) < 1400
    assert source.counters()["file cut short"] == 1


def test_time_that_runs_backwards_or_stands_still_is_counted_across_batches(tmp_path: Path) -> None:
    minutes = [0, 1, 1, 2, 1, 3]
    text = "time,a\n" + "".join(f"2024-01-01 00:0{m},{m}\n" for m in minutes)
    for rows in (100, 2, 1):
        _, source = one(tmp_path, text, batch_rows=rows)
        assert source.counters() == {"row's time stands twice": 1, "row's time runs backwards": 1}, rows


class TestClockChange:
    """Europe/Copenhagen: 2024-10-27 03:00 summer time becomes 02:00; 2024-03-31 02:00 becomes 03:00."""

    AUTUMN = (
        "2024-10-27 01:30",
        "2024-10-27 02:00",
        "2024-10-27 02:30",
        "2024-10-27 02:00",
        "2024-10-27 02:30",
        "2024-10-27 03:00",
    )

    def read(self, folder: Path, times: tuple[str, ...], **time: Any) -> tuple[list[int], CsvSource]:
        text = "time,a\n" + "".join(f"{t},{i}\n" for i, t in enumerate(times))
        got, source = one(folder, text, zone="Europe/Copenhagen", time={"column": "time", **time})
        return [t for t, _ in series(got, "a")], source

    def test_an_hour_that_happens_twice_is_told_apart_by_order(self, tmp_path: Path) -> None:
        times, source = self.read(tmp_path, self.AUTUMN)
        start = utc("2024-10-26 23:30")
        assert times == [start + i * 1800 * 10**9 for i in range(6)]
        assert source.counters() == {"local time ambiguous": 4}

    @pytest.mark.parametrize("rows", [1, 2, 3, 4, 5])
    def test_order_holds_across_batches_and_after_a_restart(self, tmp_path: Path, rows: int) -> None:
        text = "time,a\n" + "".join(f"{t},{i}\n" for i, t in enumerate(self.AUTUMN))
        path = write(tmp_path, text)
        first = source_of(path, ("a",), zone="Europe/Copenhagen", batch_rows=rows)
        first.open()
        begun = next(first.batches())
        rest = read(source_of(path, ("a",), zone="Europe/Copenhagen", batch_rows=rows), begun.position)
        start = utc("2024-10-26 23:30")
        assert [t for t, _ in series([begun, *rest], "a")] == [start + i * 1800 * 10**9 for i in range(6)]

    def test_long_files_tell_the_hour_apart_for_each_point(self, tmp_path: Path) -> None:
        hours = ("01:00", "02:00", "02:00", "03:00")
        text = "time,p,v\n" + "".join(f"2024-10-27 {h},{p},1\n" for h in hours for p in "xy")
        got, _ = one(tmp_path, text, (), zone="Europe/Copenhagen", long={"point": "p", "value": "v"})
        for point in "xy":
            assert [t for t, _ in series(got, point)] == [utc("2024-10-26 23:00") + i * 3600 * 10**9 for i in range(4)]

    @pytest.mark.parametrize(("how", "first"), [("earlier", "2024-10-27 00:00"), ("later", "2024-10-27 01:00")])
    def test_it_can_be_resolved_one_way(self, tmp_path: Path, how: str, first: str) -> None:
        times, _ = self.read(tmp_path, ("2024-10-27 02:00",), ambiguous=how)
        assert times == [utc(first)]

    def test_it_can_be_rejected(self, tmp_path: Path) -> None:
        times, _ = self.read(tmp_path, self.AUTUMN, ambiguous="reject")
        assert len(times) == 2

    def test_an_hour_that_never_happens_is_rejected_and_counted(self, tmp_path: Path) -> None:
        times, source = self.read(tmp_path, ("2024-03-31 01:30", "2024-03-31 02:30", "2024-03-31 03:30"))
        assert times == [utc("2024-03-31 00:30"), utc("2024-03-31 01:30")]
        assert source.counters() == {"local time does not exist": 1}

    def test_or_shifted_to_the_end_of_the_gap(self, tmp_path: Path) -> None:
        times, _ = self.read(tmp_path, ("2024-03-31 02:30",), nonexistent="shift")
        assert times == [utc("2024-03-31 01:00")]


@pytest.mark.parametrize("stop_after", range(1, 6))
def test_resume_continues_exactly_where_it_stopped(tmp_path: Path, stop_after: int) -> None:
    for k in (1, 2):
        rows = "".join(f"2024-01-0{k} 00:{i:02},{i}\n" for i in range(25))
        write(tmp_path, "# comment\ntime,a\n" + rows, f"part{k}.csv")
    options: dict[str, Any] = {"batch_rows": 10, "comment": "#"}
    whole = series(read(source_of(tmp_path / "part*.csv", ("a",), **options)), "a")
    first = source_of(tmp_path / "part*.csv", ("a",), **options)
    first.open()
    stream = first.batches()
    begun = [next(stream) for _ in range(stop_after)]
    rest = read(source_of(tmp_path / "part*.csv", ("a",), **options), begun[-1].position)
    assert series([*begun, *rest], "a") == whole
    assert len(whole) == 50


def test_resume_after_the_end_gives_nothing_and_new_rows_are_found(tmp_path: Path) -> None:
    path = write(tmp_path, "time,a\n2024-01-01 00:00,1\n")
    position = read(source_of(path, ("a",)))[-1].position
    assert read(source_of(path, ("a",)), position) == []
    with path.open("a") as file:
        file.write("2024-01-01 00:01,2\n")
    assert [v for _, v in series(read(source_of(path, ("a",)), position), "a")] == [2.0]


def test_parquet_reads_and_resumes(tmp_path: Path) -> None:
    frame = pd.DataFrame({"when": pd.date_range("2024-01-01", periods=50, freq="5min", tz="UTC"), "a": np.arange(50.0)})
    frame.to_parquet(tmp_path / "data.parquet")
    options = ParquetOptions.model_validate(
        {"kind": "parquet", "path": "data.parquet", "time": {"column": "when"}, "batch_rows": 20}
    )

    def source() -> ParquetSource:
        made = ParquetSource()
        made.configure(options, Context("UTC", ("a",), tmp_path))
        return made

    batches = read(source())
    whole = series(batches, "a")
    assert whole == [(utc("2024-01-01") + i * 300 * 10**9, float(i)) for i in range(50)]
    assert series(read(source(), batches[0].position), "a") == whole[20:]


def test_reads_half_a_million_samples_a_second(tmp_path: Path) -> None:
    n = 20_000
    frame = pd.DataFrame({"time": pd.date_range("2024-01-01", periods=n, freq="1min")})
    for i in range(20):
        frame[f"p{i}"] = np.random.default_rng(i).normal(50, 10, n).round(3)
    frame.to_csv(tmp_path / "big.csv", index=False)
    began = clock.perf_counter()
    samples = sum(len(b) for b in read(source_of(tmp_path / "big.csv")))
    assert samples == n * 20
    # Half a million on a quiet machine; the bound leaves room for a busy one.
    assert samples / (clock.perf_counter() - began) > 100_000


@pytest.mark.parametrize(
    ("name", "column", "zone", "time", "rows"),
    [
        ("flexhouse_prbs_5min.csv", "yTi", "Europe/Copenhagen", {"column": "TimeDate"}, 1691),
        ("esb_chiller1_raw_5min.csv.gz", "Tons", "America/Chicago", {}, 12799),
        (
            "lbnl_mzvav_2_1.csv.gz",
            "AHU: Supply Air Temperature",
            "America/Chicago",
            {"column": "Datetime", "day_first": False},
            21600,
        ),
        ("dwelling_hourly.csv.gz", "Ti", "UTC", {"column": 0}, 792),
        ("armadillo_30min.csv", "T_int", "UTC", {"column": "Time", "unit": "s", "origin": "2024-01-01"}, 233),
    ],
)
def test_measured_files_are_read_whole(
    shared_data: Path, name: str, column: str, zone: str, time: dict[str, Any], rows: int
) -> None:
    source = source_of(shared_data / name, (column,), zone, time=time)
    read_rows = len(series(read(source), column))
    # The chiller file holds one row of names without a time in its midst.
    assert read_rows + source.counters().get("time not understood", 0) == rows
    assert read_rows >= rows - 1


def test_declared_order_of_day_and_month_holds_for_every_row(tmp_path: Path) -> None:
    rows = "13/02/2026 00:00,1\n02/13/2026 00:00,2\n03/02/2026 1:05:30 PM,3\n3.2.26,4\n"
    got, source = one(tmp_path, "t,a\n" + rows, time={"column": "t", "day_first": True})
    assert series(got, "a") == [
        (utc("2026-02-13 00:00"), 1.0),
        (utc("2026-02-03 13:05:30"), 3.0),
        (utc("2026-02-03 00:00"), 4.0),
    ]
    assert source.counters()["time not understood"] == 1


def test_iso_dates_in_a_file_of_the_other_kind_stay_iso(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "t,a\n2026-02-05 00:00,1\n06/02/2026 00:00,2\n", time={"column": "t", "day_first": True})
    assert [t for t, _ in series(got, "a")] == [utc("2026-02-05 00:00"), utc("2026-02-06 00:00")]


def test_file_that_contradicts_its_declared_order_is_refused_with_the_remedy(tmp_path: Path) -> None:
    days = pd.date_range("2026-02-01", "2026-02-20").strftime("%m/%d/%Y")
    text = "t,a\n" + "".join(f"{d},1\n" for d in days)
    with pytest.raises(Refused, match=r"'02/13/2026' has no month 13 .* 8 of 20 rows .*set time.day_first: false"):
        one(tmp_path, text, time={"column": "t", "day_first": True})


def test_twelve_o_clock_is_noon_or_midnight_by_its_half(tmp_path: Path) -> None:
    text = "t,a\n2/1/2026 12:30 AM,1\n2/1/2026 12:30 PM,2\n2/1/2026 11:59 p.m.,3\n"
    got, _ = one(tmp_path, text, time={"column": "t", "day_first": False})
    assert [t for t, _ in series(got, "a")] == [utc(f"2026-02-01 {h}") for h in ("00:30", "12:30", "23:59")]


def test_files_without_a_time_column_follow_one_another(tmp_path: Path) -> None:
    for name, rows in (("1.csv", "1\n2\n3\n"), ("2.csv", "4\n5\n")):
        write(tmp_path, "a\n" + rows, name)
    options: dict[str, Any] = {"kind": "csv", "path": ["1.csv", "2.csv"], "batch_rows": 2}
    options["time"] = {"start": "2026-01-01", "step": "1 h"}

    def listed() -> CsvSource:
        source = CsvSource()
        source.configure(CsvOptions.model_validate(options), Context("UTC", ("a",), tmp_path))
        return source

    got = read(listed())
    assert series(got, "a") == [(utc("2026-01-01") + i * 3600 * 10**9, i + 1.0) for i in range(5)]
    assert series(read(listed(), got[1].position), "a") == series(got[2:], "a")


def test_a_broken_line_keeps_its_place_in_a_file_without_a_time_column(tmp_path: Path) -> None:
    got, _ = one(tmp_path, "a,b\n1,1\n2\n3,3\n", time={"start": "2026-01-01", "step": "1 h"})
    assert series(got, "a") == [(utc("2026-01-01 00:00"), 1.0), (utc("2026-01-01 02:00"), 3.0)]


def workbook(path: Path, rows: list[list[Any]], sheet: str = "Trend") -> Path:
    book = openpyxl.Workbook()
    page = book.active
    assert page is not None
    page.title = sheet
    for row in rows:
        page.append(row)
    book.save(path)
    return path


def excel_of(path: Path, columns: tuple[str, ...], **options: Any) -> ExcelSource:
    source = ExcelSource()
    source.configure(ExcelOptions.model_validate({"kind": "excel", "path": path} | options), Context("UTC", columns))
    return source


def test_workbook_with_a_title_above_its_header_is_read_and_resumed(tmp_path: Path) -> None:
    day = datetime(2026, 3, 1)
    rows: list[list[Any]] = [["Exported by BMS"], ["Date", "a", "b"]]
    rows += [[day + timedelta(minutes=5 * i), 20.5 + i, "On" if i % 2 else "n/a"] for i in range(7)]
    path = workbook(tmp_path / "trend.xlsx", rows)
    options: dict[str, Any] = {"skip_rows": 1, "sheet": "Trend", "batch_rows": 3}
    got = read(excel_of(path, ("a", "b"), **options))
    assert series(got, "a") == [(utc("2026-03-01") + i * 300 * 10**9, 20.5 + i) for i in range(7)]
    np.testing.assert_array_equal([v for _, v in series(got, "b")], [np.nan, 1, np.nan, 1, np.nan, 1, np.nan])
    assert series(read(excel_of(path, ("a", "b"), **options), got[0].position), "a") == series(got[1:], "a")


def test_texts_beside_dates_in_a_workbook_are_counted(tmp_path: Path) -> None:
    rows = [["time", "a"], [datetime(2026, 3, 1), 1.0], ["no time", 2.0], ["2026-03-01 00:10", 3.0]]
    source = excel_of(workbook(tmp_path / "x.xlsx", rows), ("a",))
    assert series(read(source), "a") == [(utc("2026-03-01 00:00"), 1.0), (utc("2026-03-01 00:10"), 3.0)]
    assert source.counters() == {"time not understood": 1}


def test_a_file_that_is_not_what_its_name_says_is_told_with_the_remedy(tmp_path: Path) -> None:
    book = workbook(tmp_path / "x.xlsx", [["time", "a"], [datetime(2026, 3, 1), 1.0]]).rename(tmp_path / "x.csv")
    frame = pd.DataFrame({"time": ["2026-03-01"], "a": [1.0]})
    frame.to_parquet(tmp_path / "p.csv")
    write(tmp_path, "time,a\n", "u.csv", encoding="utf-16")
    write(tmp_path, "time,a\n", "z.csv.gz")
    write(tmp_path, '{"rows": []}', "j.csv")
    said = {
        book: "workbook; set kind: excel",
        tmp_path / "p.csv": "Parquet file; set kind: parquet",
        tmp_path / "u.csv": "encoding: utf-16",
        tmp_path / "z.csv.gz": "not compressed",
        tmp_path / "j.csv": "is JSON",
    }
    for path, words in said.items():
        with pytest.raises(Refused, match=words):
            source_of(path, ("a",)).open()


def test_one_file_a_point_is_named_by_its_file_and_put_in_order(tmp_path: Path) -> None:
    write(tmp_path, "time,value\n2026-01-01 00:00,1\n2026-01-01 00:10,2\n", "AHU.SAT.csv")
    write(tmp_path, "time,Trend log 7\n2026-01-01 00:05,3\n2026-01-01 00:15,4\n", "Room.csv")
    options = {"kind": "csv", "path": tmp_path / "*.csv", "long": {"value": 1}, "batch_rows": 2}

    def folder() -> CsvSource:
        source = CsvSource()
        source.configure(CsvOptions.model_validate(options), Context("UTC", ()))
        return source

    got = read(folder())
    assert [t for b in got for t in b.time] == [utc(f"2026-01-01 00:{m:02d}") for m in (0, 5, 10, 15)]
    assert [v for _, v in series(got, "AHU.SAT")] == [1.0, 2.0]
    assert [v for _, v in series(read(folder(), got[0].position), "Room")] == [4.0]


def test_long_file_sorted_by_point_is_put_in_order(tmp_path: Path) -> None:
    text = "time,point,value\n2026-01-01 00:00,a,1\n2026-01-01 00:05,a,2\n2026-01-01 00:00,b,3\n"
    got, _ = one(tmp_path, text, (), long={"point": "point", "value": "value"}, sorted=False)
    assert [v for b in got for v in b.value] == [1.0, 3.0, 2.0]
