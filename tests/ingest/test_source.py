"""The register of sources, and the how-to's example, which is run as it stands."""

from __future__ import annotations

import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from ingest.source import Context, Refused, Source, kinds, options_type, source_class

HOWTO = Path(__file__).resolve().parents[2] / "docs" / "howto" / "add-a-source.md"


@pytest.fixture
def diary(tmp_path: Path) -> dict[str, Any]:
    (code,) = re.findall(r"```python\n(.*?)```", HOWTO.read_text(encoding="utf-8"), flags=re.DOTALL)
    path = tmp_path / "diary.py"
    path.write_text(code, encoding="utf-8")
    return runpy.run_path(str(path))


def test_the_example_resumes_after_every_batch_and_counts_what_it_rejects(
    diary: dict[str, Any], tmp_path: Path
) -> None:
    (tmp_path / "d.txt").write_text("1 T 20.5\nnonsense\n2 T 21.5\n")
    options = diary["DiaryOptions"].model_validate({"kind": "diary", "path": "d.txt"})

    def run(position: Any = None) -> tuple[list[float], list[Any], dict[str, int]]:
        source = diary["DiarySource"]()
        source.configure(options, Context(folder=tmp_path))
        source.open(position)
        batches = list(source.batches())
        return [v for b in batches for v in b.value.tolist()], [b.position for b in batches], source.counters()

    values, positions, counters = run()
    assert values == [20.5, 21.5]
    assert counters == {"line not understood": 1}
    assert [run(p)[0] for p in positions] == [[21.5], [21.5], []]


def test_the_example_is_a_source(diary: dict[str, Any]) -> None:
    assert isinstance(diary["DiarySource"](), Source)


@pytest.mark.parametrize("kind", kinds())
def test_every_registered_source_follows_the_port(kind: str) -> None:
    made = source_class(kind)()
    assert isinstance(made, Source)
    fields = options_type(kind).model_fields
    assert "kind" in fields
    assert all(field.description for field in fields.values())


def test_unknown_kind_names_the_known_ones() -> None:
    with pytest.raises(Refused, match="kinds are bacnet, csv"):
        source_class("fax")
