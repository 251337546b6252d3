"""The page about the schema says what the schema says."""

from __future__ import annotations

from pathlib import Path

from fdd.store.influx_setup import HOURLY_DAYS, RAW_DAYS
from fdd.store.schema import DOCUMENT_KINDS, MAX_NAME, MAX_SERIES, MEASUREMENTS

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "schema.md").read_text()


def test_page_has_every_field_with_unit_and_meaning() -> None:
    for m in MEASUREMENTS.values():
        section = PAGE.split(f"### {m.name}\n")[1].split("\n#")[0]
        assert f"One series: `{m.series}`. How many: {m.bound}." in section
        table = [line for line in section.splitlines() if line.startswith("| `")][: len(m.fields)]
        assert table == [f"| `{f.name}` | {f.unit} | {f.meaning} | {f.hourly} |" for f in m.fields]


def test_page_has_every_kind_of_document_and_the_limits() -> None:
    for kind, meaning in DOCUMENT_KINDS.items():
        assert f"| `{kind}` | {meaning} |" in PAGE
    assert f"1 to {MAX_NAME} " in PAGE
    assert f"({MAX_SERIES // 1000} 000;" in PAGE
    assert f"| {RAW_DAYS} days |" in PAGE
    assert f"| {HOURLY_DAYS} days |" in PAGE
