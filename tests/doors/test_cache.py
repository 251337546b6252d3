"""What lies in the cache is run as machine code: nobody else may put it there."""

from __future__ import annotations

from pathlib import Path

import pytest

from fdd.greybox.kernels import CacheError, cache_folder


def test_a_cache_folder_that_others_may_write_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FDD_CACHE", str(tmp_path / "cache"))
    assert cache_folder() == tmp_path / "cache" / "kernels"
    assert cache_folder().stat().st_mode & 0o077 == 0
    for open_to_all in (tmp_path / "cache" / "kernels", tmp_path / "cache"):
        open_to_all.chmod(0o777)
        with pytest.raises(CacheError, match="FDD_CACHE"):
            cache_folder()
        open_to_all.chmod(0o700)
    assert cache_folder().exists()
