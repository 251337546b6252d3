from fdd.models.document import FOLDER, pages, stale
from fdd.models.registry import MODELS


def test_committed_pages_say_what_the_declarations_say():
    assert stale() == []


def test_a_changed_page_is_stale(tmp_path):
    for name, text in pages().items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert stale(tmp_path) == []
    (tmp_path / "radiator.md").write_text("old", encoding="utf-8")
    assert stale(tmp_path) == ["radiator.md"]


def test_every_model_has_a_page_that_names_its_parameters():
    for name in MODELS:
        assert (FOLDER / f"{name}.md").is_file()
