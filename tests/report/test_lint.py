"""The reader of reports finds what was planted, and lets sound sentences pass."""

from __future__ import annotations

import pytest

from tests.report.lint import faults_in, text_of


@pytest.mark.parametrize(
    ("said", "fault"),
    [
        ("takes nan % less power", "a number that is none"),
        ("since None", "a number that is none"),
        ("UA 5.12 W/K (1.0 to 2.0)", "an estimate outside its interval"),
        ("costs 3.2 EUR (4.0 to 2.0)", "an interval the wrong way round"),
        ("130 % likely", "a share above one"),
        ("takes -2.2 % more power", "a sign against its word"),
        ("changed by <b>-4 %</b> (95 %: 1.0 to 3.0)", "an estimate outside its interval"),
    ],
)
def test_what_cannot_be_is_found(said: str, fault: str) -> None:
    (found,) = faults_in(f"<p>{said}</p>")
    assert found.startswith(fault)


@pytest.mark.parametrize(
    "said",
    [
        "takes 2.2 % less power (1.8 to 2.6)",
        "costs 0.75 EUR (95 %: 0.74 to 0.76)",
        "0.95 (0.85 to 1.04) times the alarms promised",
        "changed by -21 % (-22 to -20)",
        "95 % likely",
        "the finance officer and Nancy",
        "R 0.0052 K/W (0.0051 to 0.0053)",
    ],
)
def test_sound_sentences_pass(said: str) -> None:
    assert faults_in(f"<p>{said}</p>") == []


def test_pictures_and_styles_are_not_read() -> None:
    assert text_of("<style>a{b:nan}</style><svg><text>nan</text></svg><p>a&nbsp;b</p>").strip() == "a b"
