"""Who asks is who the transport says; what they asked stands in a trail that cannot be changed unseen."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from fdd.config import ConfigError
from fdd.config.load import parse_site
from fdd.service.alarms.authority import ROLES, Authority, CommandError
from fdd.service.alarms.book import Command
from fdd.service.daemon.commands import A_MINUTE, WAITING, Desk
from fdd.service.daemon.trail import Head, Trail, TrailError, read, verify
from ingest.zenoh import OperatorOptions
from ingest.zenoh.session import ask, open_session
from tests.doors.daemons import Feed, Site, ring
from tests.ports import free_port

PEOPLE = "users_file: users, people: {anna: {role: clear}, bert: {role: acknowledge}, carl: {role: read}}"


class AtTheDesk:
    """A desk with three people, and what was carried out."""

    def __init__(self, folder: Path) -> None:
        (folder / "users").write_text("anna:a\nbert:b\ncarl:c\n")
        for name in ("anna", "bert", "carl"):
            (folder / f"{name}.password").write_text(name[0])
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        text = f"name: s\noperator: {{listen: ['{self.endpoint}'], {PEOPLE}}}"
        self.folder, self.site = folder, parse_site(text, folder=folder)
        self.desk = Desk(self.site, Authority.of(self.site))
        self.done: list[Command] = []
        self.refused: list[tuple[str, str]] = []

    def session(self, name: str) -> Any:
        options = OperatorOptions(connect=(self.endpoint,), user=name, password_file=Path(f"{name}.password"))
        return open_session(options, self.folder)

    def serve(self) -> None:
        def obey(command: Command) -> tuple[str, None]:
            self.done.append(command)
            return "done", None

        self.desk.serve(5, lambda _every: [], obey, lambda who, why: self.refused.append((who, why)))

    def asked(self, session: Any, key: str, payload: bytes = b"") -> list[dict[str, Any]]:
        """Ask from a thread, serve from here."""
        from concurrent.futures import ThreadPoolExecutor
        from time import monotonic, sleep

        with ThreadPoolExecutor(1) as pool:
            waiting, end = pool.submit(ask, session, key, payload, 3.0), monotonic() + 10.0
            while not waiting.done() and monotonic() < end:
                self.serve()
                sleep(0.01)
        return [json.loads(answer) for answer in waiting.result()]


@pytest.fixture
def at_the_desk(tmp_path: Path) -> Iterator[AtTheDesk]:
    found = AtTheDesk(tmp_path)
    yield found
    found.desk.close()


def test_a_person_commands_at_the_own_key_alone_and_in_the_own_role(at_the_desk: AtTheDesk) -> None:
    key, bert = at_the_desk.desk.key, at_the_desk.session("bert")
    clear, take = b'{"action": "clear", "alarm": "k"}', b'{"action": "acknowledge", "alarm": "k"}'
    assert at_the_desk.asked(bert, key)[0]["alarms"] == []
    assert at_the_desk.asked(bert, f"{key}/as/bert", take)[0]["outcome"] == "done"
    assert (
        "role acknowledge; to clear an alarm takes role clear"
        in at_the_desk.asked(bert, f"{key}/as/bert", clear)[0]["outcome"]
    )
    assert at_the_desk.asked(bert, f"{key}/as/anna", clear) == []  # the transport lets nobody use another's key
    assert at_the_desk.asked(bert, f"{key}/as/*", clear) == []
    assert "KEY/as/NAME" in at_the_desk.asked(bert, key, clear)[0]["outcome"]
    forged = b'{"action": "acknowledge", "alarm": "k", "by": "anna"}'
    assert "leave 'by' out" in at_the_desk.asked(bert, f"{key}/as/bert", forged)[0]["outcome"]
    assert [(c.actor, c.action) for c in at_the_desk.done] == [("bert", "acknowledge")]
    assert [who for who, _ in at_the_desk.refused] == ["bert", "", "bert"]
    bert.close()


@pytest.mark.parametrize("payload", [b"[" * 15_000, b"x" * 30_000, b'{"action": "clear", "alarm": "\\u0000"}', b"\xff"])
def test_what_no_command_is_is_answered_and_never_obeyed(at_the_desk: AtTheDesk, payload: bytes) -> None:
    anna = at_the_desk.session("anna")
    answer = at_the_desk.asked(anna, f"{at_the_desk.desk.key}/as/anna", payload)
    assert answer[0]["outcome"].startswith("refused: ")
    assert at_the_desk.done == []
    anna.close()


def test_whoever_asks_without_end_is_refused_and_fills_no_memory(at_the_desk: AtTheDesk) -> None:
    class Question:
        person, payload, parameters = "anna", b"", {}

        def __init__(self) -> None:
            self.said = b""

        def answer(self, payload: bytes) -> None:
            self.said = payload

    questions = [Question() for _ in range(10_000)]
    for q in questions:
        at_the_desk.desk._take(q)  # type: ignore[arg-type]
    assert at_the_desk.desk.dropped == 10_000 - WAITING
    for _ in range(20):
        at_the_desk.serve()
    said = [q.said for q in questions if q.said]
    assert len(said) == WAITING
    assert sum(b"questions in a minute" in s for s in said) == WAITING - A_MINUTE


def test_people_whom_nothing_identifies_are_refused() -> None:
    with pytest.raises(ConfigError, match="nothing says who they are"):
        parse_site("name: s\noperator: {listen: ['tcp/127.0.0.1:1'], people: {anna: {role: clear}}}")
    with pytest.raises(ConfigError, match="cannot stand in a key"):
        parse_site("name: s\noperator: {connect: ['tcp/127.0.0.1:1'], people: {'a/*': {role: clear}}}")


def test_without_people_nobody_commands_over_the_network() -> None:
    with pytest.raises(CommandError, match=r"operator\.people"):
        Authority().permit("anna", "acknowledge")
    for role in ROLES:
        may = Authority({"p": role})
        allowed = {a for a in ("acknowledge", "shelve", "clear", "turn back") if _may(may, a)}
        assert len(allowed) == {"read": 0, "acknowledge": 2, "clear": 3, "approve": 4}[role]


def _may(authority: Authority, action: str) -> bool:
    try:
        authority.permit("p", action)
    except CommandError:
        return False
    return True


# ---- the trail


def told(folder: Path, lines: int = 5) -> Trail:
    trail = Trail(folder / "a.jsonl")
    for i in range(lines):
        trail.add({"what": "clear", "who": "anna", "alarm": f"k{i}"}, entry=10 + i)
    return trail


def test_a_trail_is_continued_and_a_replayed_entry_adds_no_second_line(tmp_path: Path) -> None:
    told(tmp_path).close()
    again = told(tmp_path)
    assert again.head.lines == 5
    again.add({"what": "refused"})
    assert verify(again.path) == again.head
    assert [line["line"] for line in read(again.path)] == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize("how", ["changed", "taken out", "added", "swapped", "cut short", "rubbish"])
def test_a_trail_that_was_tampered_with_is_found_out(tmp_path: Path, how: str) -> None:
    trail = told(tmp_path)
    lines = trail.path.read_text().splitlines()
    match how:
        case "changed":
            lines[2] = lines[2].replace("anna", "bert")
        case "taken out":
            del lines[2]
        case "added":
            lines.insert(2, lines[1])
        case "swapped":
            lines[1], lines[2] = lines[2], lines[1]
        case "cut short":
            del lines[-1]
        case _:
            lines[3] = "[" * 100_000
    trail.path.write_text("\n".join(lines) + "\n")
    with pytest.raises(TrailError):
        verify(trail.path, Head(trail.head.lines, trail.head.seal))
    again = Trail(trail.path)  # the service goes on, and says so
    assert bool(again.problem) == (how != "cut short")
    again.add({"what": "clear"})


def test_a_line_that_a_crash_cut_in_half_goes(tmp_path: Path) -> None:
    trail = told(tmp_path)
    whole = trail.path.read_bytes()
    trail.path.write_bytes(whole + b'{"what": "cle')
    again = Trail(trail.path)
    assert (again.problem, again.head.lines) == ("", 5)
    again.add({"what": "clear"})
    assert verify(trail.path).lines == 6


def test_commands_are_in_the_trail_once_across_crashes(tmp_path: Path) -> None:
    from fdd.service.daemon.commands import submit

    site = Site(tmp_path)
    daemon = site.start()
    key = ring(daemon)
    submit(site.store, Command(key, "acknowledge", "anna", 5, "on my way", None, "cli"))
    submit(site.store, Command("never", "clear", "bert", 6, "", None, "cli"))
    for _ in range(3):
        daemon.run(Feed())  # type: ignore[arg-type]
        daemon = site.restarted()
    lines = [(x["what"], x["who"], x["outcome"][:7]) for x in read(site.trail.path)]
    assert lines == [("acknowledge", "anna", "done"), ("clear", "bert", "refused")]
    known = Head(**{k: daemon.status()["trail"][k] for k in ("lines", "seal")})
    assert verify(site.trail.path, known).lines == 2
    site.stop()
    shutil.rmtree(tmp_path)
