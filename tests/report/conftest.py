"""Every report that a test renders here is read for what cannot be so."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.report.lint import watching


@pytest.fixture(scope="session", autouse=True)
def reports_are_read() -> Iterator[None]:
    """No report may contradict itself."""
    with watching():
        yield
