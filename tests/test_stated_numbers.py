"""Numbers that documents state stand here as literals: a changed constant fails beside its sentence."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdd.chiller_eiv.drift import CLEAR_SIGNAL
from fdd.residual_monitors import flatline
from fdd.service.alarms import life
from fdd.service.engine import engine, recent
from fdd.service.filtering import framing
from fdd.service.monitoring import baseline_uncertainty

DOCS = Path(__file__).resolve().parents[1] / "docs"
HOUR = 3_600_000_000_000

STATED = [
    ("alarms.md", "until its own evidence has been gone for a day", life.GRACE, 24 * HOUR),
    ("alarms.md", "comes back within a week", life.FLAPPING, 168 * HOUR),
    ("alarms.md", "must be quiet for 6 h", life.QUIET, 6 * HOUR),
    ("alarms.md", "and so on to ten days", life.QUIET_MOST, 240 * HOUR),
    ("charts.md", "never\n  below twice the longest run seen", flatline.LONGEST, 2.0),
    ("charts.md", "six equal readings in a row", flatline.LEAST, 6),
    ("charts.md", "is granted a relative standard error of 1 %", baseline_uncertainty.MODEL_ERROR, 0.01),
    ("architecture.md", "what the last ten days said", recent.BLOCKS * recent.BLOCK, 240 * HOUR),
]


@pytest.mark.parametrize(("page", "sentence", "constant", "stated"), STATED, ids=[s for _, s, _, _ in STATED])
def test_constant_is_what_the_page_says(page: str, sentence: str, constant: float, stated: float) -> None:
    text = (DOCS / page).read_text(encoding="utf-8")
    assert sentence in text, f"docs/{page} no longer says {sentence!r}: change this row with it"
    assert constant == stated


def test_constants_that_only_code_states() -> None:
    # Five samples of a leap of the clock confirm it; an alarm is diagnosed anew for nine of the ten remembered days.
    assert framing.CONFIRMATIONS == 5
    assert engine.REMEMBERED == 216 * HOUR
    # A week's own scatter must leave four times what the errors of its readings explain.
    assert CLEAR_SIGNAL == 4.0
