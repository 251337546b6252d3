"""Layout: nothing runs out of the page or the window, no picture is lost, whatever the names are."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Iterator
from html import unescape
from pathlib import Path
from typing import Any

import pytest

from fdd.report.content import ComponentInfo, gather
from fdd.report.render import render_html
from fdd.store.sqlite import SqliteStore

from . import plant

LONG = "Lüftungsanlage_Nord_Untergeschoss_Wärmerückgewinnungsregister_0815_primärseitig"
CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


@pytest.fixture(scope="module")
def html(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A month with findings of every kind, one of them with names that have no place to break."""
    store = SqliteStore(tmp_path_factory.mktemp("layout") / "store.sqlite")
    info = plant.full(store)
    outputs = {"T_return": (f"{LONG}.T_return", "degC", LONG)}
    parameters = {"H": ("W/K^n", LONG)}
    named = ComponentInfo(LONG, LONG, outputs, parameters, location=LONG)
    info = plant.site(components={**info.components, "radiator-2": named})
    stale = plant.alarm("radiator-3", {}, causes=[{"meaning": LONG, "for": [LONG]}], key="radiator-3@m")
    stale["evidence"] = {"kind": "model", "charts": {}}
    stale["checks"] = [f"{LONG}: {LONG}"]
    store.put("alarm", stale["key"], stale)
    page = render_html(gather(store, info))
    store.close()
    return page


@pytest.fixture(scope="module")
def pages(html: str) -> list[Any]:
    try:
        import weasyprint
    except (ImportError, OSError) as problem:
        pytest.skip(f"WeasyPrint cannot be loaded: {problem}")
    return list(weasyprint.HTML(string=html).render().pages)


def boxes(box: Any) -> Iterator[Any]:
    yield box
    for child in getattr(box, "children", ()):
        yield from boxes(child)


def outside(pages: list[Any]) -> list[str]:
    """Texts and pictures that end beyond the right or the lower edge of their page's content."""
    found = []
    for number, page in enumerate(pages, 1):
        sheet = page._page_box
        right, low = sheet.content_box_x() + sheet.width, sheet.content_box_y() + sheet.height
        (body,) = [c for c in sheet.children if type(c).__name__ == "BlockBox"]
        for box in boxes(body):
            if not hasattr(box, "text") and not hasattr(box, "replacement"):
                continue
            if box.position_x + box.width > right + 0.5 or box.position_y + box.height > low + 0.5:
                found.append(f"page {number}: {getattr(box, 'text', 'a picture')}")
    return found


def test_nothing_runs_out_of_a_printed_page(pages: list[Any]) -> None:
    assert outside(pages) == []


def test_the_search_for_what_runs_out_finds_it() -> None:
    weasyprint = pytest.importorskip("weasyprint", exc_type=(ImportError, OSError))
    wide = "<style>@page { size: A4 }</style><p style='white-space: nowrap'>" + 40 * "not broken "
    assert outside(weasyprint.HTML(string=wide).render().pages) != []


def test_every_picture_is_printed(html: str, pages: list[Any]) -> None:
    printed = [b for p in pages for b in boxes(p._page_box) if hasattr(b, "replacement")]
    assert len(printed) == html.count("<img ") > 6
    assert all(b.width > 100 for b in printed)


def test_a_finding_takes_two_printed_pages(pages: list[Any]) -> None:
    """One of words, one of evidence, where names are of usual length."""
    begins = {name: i for i, p in reversed(list(enumerate(pages))) for name in p.anchors if name.startswith("finding-")}
    first = next(i for name, i in begins.items() if "substation-hx" in name)
    second = next(i for name, i in begins.items() if "radiator-2" in name)
    assert second - first <= 2


SEARCH = """<script>addEventListener("load", () => {
  const frame = document.querySelector("iframe"), page = frame.contentDocument, width = frame.clientWidth;
  const out = [...page.querySelectorAll("body *")].filter(e => e.getBoundingClientRect().right > width + 1);
  const cut = [...page.querySelectorAll("td, dd, p, h1, h2, h3, li, div, section")]
    .filter(e => e.scrollWidth > e.clientWidth + 1);
  const words = e => e.tagName + ": " + e.textContent.slice(0, 60);
  document.body.dataset.found = JSON.stringify([...out, ...cut].map(words));
})</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
@pytest.mark.parametrize("width", [390, 768, 1280])
def test_nothing_runs_out_of_a_window(html: str, width: int, tmp_path: Path) -> None:
    assert found_in_window(html, width, tmp_path) == []


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on this machine")
def test_the_search_in_a_window_finds_what_runs_out(tmp_path: Path) -> None:
    assert found_in_window("<p style='width: 500px'>wide", 390, tmp_path) == ["P: wide"]


def found_in_window(html: str, width: int, folder: Path) -> list[str]:
    """What is cut off or ends beyond the right edge of a window of this width (a browser's own is never so narrow)."""
    page = folder / "page.html"
    frame = json.dumps(html).replace("</", "<\\/")
    page.write_text(
        f"<meta charset=utf-8><body style='margin:0'><iframe style='border:0;width:{width}px;height:9000px'></iframe>"
        f"<script>document.querySelector('iframe').srcdoc = {frame}</script>{SEARCH}",
        encoding="utf-8",
    )
    command = [str(CHROMIUM), "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--dump-dom"]
    command += [f"--user-data-dir={folder / 'profile'}", "--virtual-time-budget=20000", page.as_uri()]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'<body[^>]*data-found="([^"]*)"', done.stdout)
    assert found, "the page was not loaded"
    result: list[str] = json.loads(unescape(found[1]))
    return result
