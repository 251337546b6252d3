"""Mutants of valid payloads against every decoder, reader and parser: nothing but the door's own error may come out.

A target is what a door reads, some valid examples of it, and the errors that it may answer with. A mutant is an example
with bytes flipped, cut out, repeated or replaced by what breaks parsers: enormous numbers, deep nesting, halves of
surrogate pairs, powers of powers. A case that takes longer than :data:`HANG_SECONDS` is interrupted and counted.
"""

from __future__ import annotations

import gzip
import io
import random
import resource
import signal
import tempfile
import time as clock
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType

HANG_SECONDS = 1.0
_WORDS = (
    *(b"0", b"-1", b"1e308", b"1e999", b"-1e-999", b"9" * 400, b"0x" + b"f" * 400, b"9223372036854775808", b"NaN"),
    *(b"null", b"Infinity", b"true", b'"\\ud800"', b'"\\u0000"', b"\x00", b"\xff\xfe", b"\xed\xa0\x80", b"\xc2\xb2"),
    *(
        b"[",
        b"{",
        b"[" * 300,
        b'{"a":' * 300,
        b"(" * 300,
        b"-" * 3000,
        b"]",
        b"}",
        b",",
        b":",
        b'"',
        b"'",
        b"`",
        b"**9",
    ),
    *(b"\n", b"\r", b"\t", b";", b"*a", b"&a ", b"!!", b"<<: ", b"%", b"../", b"1/0", b"2**62", b"4611686018427387904"),
    *(b"1.2.3", b"[K]", b"degC"),
)
# YAML is parsed at some 150 kB a second: more would measure the length of the file.
_SITE_BYTES = 60_000


@dataclass(frozen=True)
class Target:
    """A door: what reads a payload, valid payloads, and the errors that are its answer to bad ones."""

    name: str
    read: Callable[[bytes], object]
    examples: Sequence[bytes]
    errors: tuple[type[Exception], ...]
    most_bytes: int = 300_000


@dataclass
class Outcome:
    """What became of a target's cases."""

    cases: int = 0
    refused: int = 0
    crashes: dict[str, bytes] = field(default_factory=dict)
    crashed: int = 0
    hangs: int = 0
    slowest: float = 0.0
    grown_bytes: int = 0

    @property
    def held(self) -> bool:
        """Whether nothing came out but answers and the door's own errors, each in time."""
        return not self.crashed and not self.hangs


class _HangError(BaseException):
    """The alarm clock rang; no door catches it."""


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    def ring(_number: int, _frame: FrameType | None) -> None:
        raise _HangError

    before = signal.signal(signal.SIGVTALRM, ring)
    signal.setitimer(signal.ITIMER_VIRTUAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0.0)
        signal.signal(signal.SIGVTALRM, before)


def mutant(example: bytes, others: Sequence[bytes], chance: random.Random, most_bytes: int) -> bytes:
    """An example with one to eight wounds, cut to so many bytes."""
    data = bytearray(example)
    for _ in range(chance.choice((1, 1, 1, 2, 3, 8))):
        at, end = sorted((chance.randrange(len(data) + 1), chance.randrange(len(data) + 1)))
        match chance.randrange(7):
            case 0 if data:
                data[chance.randrange(len(data))] = chance.randrange(256)
            case 1:
                data[at : at + chance.randrange(1, 16)] = b""
            case 2:
                data[at:end] = b""
            case 3:
                data[at : at + chance.randrange(0, 6)] = chance.choice(_WORDS)
            case 4:
                data[at:at] = chance.choice(_WORDS)
            case 5:
                data[at:at] = data[at : at + 2000] * chance.choice((1, 2, 50))
            case _:
                other = chance.choice(others)
                data[at:at] = other[chance.randrange(len(other) + 1) :][:200]
    return bytes(data[:most_bytes])


def run(target: Target, cases: int, seed: int) -> Outcome:
    """So many mutants of a target's examples, the same ones for the same seed."""
    chance, outcome = random.Random(f"{target.name}/{seed}"), Outcome()
    for example in target.examples:
        target.read(example)  # what is valid must be read: otherwise every mutant is refused, and nothing is tested
    before = resident_peak()
    for _ in range(cases):
        payload = mutant(chance.choice(target.examples), target.examples, chance, target.most_bytes)
        begun = clock.process_time()  # a busy machine is no slow door
        try:
            with _alarm(2 * HANG_SECONDS):
                target.read(payload)
        except target.errors:
            outcome.refused += 1
        except _HangError:
            outcome.hangs += 1
            outcome.crashes.setdefault("hang", payload)
        except Exception as error:  # what the fuzzer looks for
            outcome.crashed += 1
            place = _place(error)
            if not any(place in known for known in outcome.crashes):
                outcome.crashes[f"{type(error).__name__} at {place}: {error!s:.120}"] = payload
        took = clock.process_time() - begun
        outcome.hangs += HANG_SECONDS < took < 2 * HANG_SECONDS
        outcome.slowest = max(outcome.slowest, took)
        outcome.cases += 1
    outcome.grown_bytes = resident_peak() - before
    return outcome


def _place(error: Exception) -> str:
    """File and line of the project's own code where an error came from, so that each is counted as one."""
    own = [f for f in traceback.extract_tb(error.__traceback__) if "site-packages" not in f.filename]
    return f"{Path(own[-1].filename).name}:{own[-1].lineno}"


def resident_peak() -> int:
    """The most memory this process has held so far [bytes]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


# ---- the doors

_MESSAGE = (
    b'{"v":1,"publisher":"plant","run":"9f2c","seq":17,"names":["T_supply","T_return"],'
    b'"time":[1700000000000000000,1700000060000000000],"value":[61.2,null,61.3,40.1],"quality":[0,0,1,2]}',
    b'{"v":1,"names":["a","b"],"point":[0,1,1],"time":[1700000000000000000,1,2],"value":[1,2.5,-3e4],"end":true}',
)
_UNITS = (b"degF", b"kg/s", b"W/(m2*K)", b"m**3/h", "W/m²".encode(), b"kBtu/h", b"gpm", b"J/(kg*K)", b"%", b"1/s")
_DURATIONS = (b"5 min", b"1.5 h", b"7 days", b"1e3 s")
_FLUIDS = (b"water at 70 degC", b"1035 kg/m3", b"air", b"water")
_EXPRESSIONS = (
    b'q(4186, "J/(kg*K)") * m_flow * (T_supply - T_return)',
    b"pump.speed > 20 [%] and not `boiler-1.fault`",
    b"where(T_supply - T_return > 5 [K], min(m_flow, 2 [kg/s]), 0)",
    b"-sqrt(m_flow ** 2) + 4186 [kg/s] * exp(pump.speed)",
)
_POINT_UNITS = {"m_flow": "kg/s", "T_supply": "degC", "T_return": "degC", "pump.speed": "1", "boiler-1.fault": "1"}
_SITE = (
    b"""
name: Site
zone: Europe/Copenhagen
step: 5 min
source: {kind: csv, path: a.csv, time: {column: time, format: iso}}
points:
  T: {unit: degC, range: [0, 100], missing: [-9999]}
  m: {unit: gpm, fluid: water}
  q: {expression: "m * 2", unit: kg/s}
""",
    b"""
name: Other
sources:
- {kind: zenoh, listen: [tcp/127.0.0.1:7447], key: 'fdd/**'}
- {kind: mqtt, host: h, topics: [a/#]}
store: {kind: influx, url: 'http://h:8086', org: o, bucket: b, token_env: T}
metrics: 127.0.0.1:9464
points: &p
  T: {unit: degC, source: zenoh}
equipment:
  room: {model: zone_1r1c, when: "T > 5 [degC]", inputs: {a: T}}
""",
)
_CSV = (
    b"time,T,flow,on\n2026-01-01 00:00,21.5,0.4,on\n2026-01-01 00:05,21.6,,off\n2026-01-01 00:10,21.7,0.5,true\n",
    b'time;T;flow;on\n2026-02-01 00:00;"21,5";0,4;1\n2026-02-02 00:05;21,6;;0\n',
    b"time\tT\tflow\ton\n2026-01-01T00:00:00Z\t21.5\t0.4\t1\n2026-01-01T00:05:00Z\t21.6\tNaN\t0\n",
)


_COMMANDS = (
    b'{"action": "shelve", "alarm": "hx@2026-03-01T10:00:00Z", "for": "8 h", "comment": "part ordered"}',
    b'{"action": "clear", "alarm": "hx@2026-03-01T10:00:00Z", "by": "anna"}',
)


def _parquet(compression: str) -> bytes:
    import pandas as pd

    out = io.BytesIO()
    times = pd.date_range("2026-01-01", periods=50, freq="5min", tz="UTC")
    pd.DataFrame({"time": times, "T": 20.0, "flow": 0.5, "on": True}).to_parquet(out, compression=compression)
    return out.getvalue()


def _workbook() -> bytes:
    import pandas as pd

    out = io.BytesIO()
    times = pd.date_range("2026-01-01", periods=50, freq="5min")
    pd.DataFrame({"time": times, "T": 20.0, "flow": 0.5, "on": True}).to_excel(out, index=False)
    return out.getvalue()


def _question(payload: bytes) -> object:
    """What the desk makes of a command before anything is journaled."""
    from fdd.service.alarms.authority import Authority
    from fdd.service.daemon.commands import command_of

    return Authority().check(command_of(payload, "anna", 1_700_000_000_000_000_000))


def _file_reader(kind: str, name: str) -> Callable[[bytes], object]:
    """Reads a file with that content through the source, as ``fdd replay`` does."""
    from ingest.source import Context, make_source, options_type

    folder = Path(tempfile.mkdtemp(prefix="fdd-doors-"))
    options = options_type(kind).model_validate({"kind": kind, "path": name})

    def read(payload: bytes) -> object:
        (folder / name).write_bytes(payload)
        source = make_source(options, Context("UTC", ("T", "flow", "on"), folder))
        source.open(None)
        return sum(len(batch) for batch in source.batches())

    return read


def targets() -> list[Target]:
    """Every door."""
    from fdd.config import ConfigError
    from fdd.config.load import parse_site
    from fdd.expressions import ExpressionError, compile_expression
    from fdd.service.alarms.authority import CommandError
    from fdd.service.daemon.commands import QuestionError
    from fdd.units import UnitError, conversion, density, seconds
    from ingest.history import History, read_answer
    from ingest.message import MalformedMessage, decode
    from ingest.mqtt.payload import bare_value, json_object
    from ingest.source import Refused

    def text(read: Callable[[str], object]) -> Callable[[bytes], object]:
        return lambda payload: read(payload.decode("utf-8", "surrogateescape"))

    def json_value(payload: bytes) -> object:
        return json_object("t", payload, 1, value_key="value", time_key="t", time_unit="s")

    def answer(payload: bytes) -> object:
        return [decode(m) for m in read_answer(payload)[1]]

    history = History("plant/9f2c", 10)
    for message in _MESSAGE:
        history.keep(message)
    answers = (history.answer(b"{}"), history.answer(b'{"have":{"plant/9f2c":1}}'))
    return [
        Target("message", decode, _MESSAGE, (MalformedMessage,)),
        Target("history answer", answer, answers, (MalformedMessage,)),
        Target("operator's question", _question, _COMMANDS, (QuestionError, CommandError, UnitError)),
        Target("history question", history.answer, (b'{"have":{"plant/9f2c":1}}', b"{}"), ()),
        Target(
            "mqtt json",
            json_value,
            (b'{"value":21.5,"t":1700000000}', b'{"value":"on","t":1.5e9}'),
            (MalformedMessage,),
        ),
        Target("mqtt value", lambda p: bare_value("t", p, 1), (b"21.5", b"on", b"-1e-3", b"null"), (MalformedMessage,)),
        Target("unit", text(conversion), _UNITS, (UnitError,)),
        Target("duration", text(seconds), _DURATIONS, (UnitError,)),
        Target("fluid", text(density), _FLUIDS, (UnitError,)),
        Target("expression", text(lambda t: compile_expression(t, _POINT_UNITS)), _EXPRESSIONS, (ExpressionError,)),
        Target("site file", text(parse_site), _SITE, (ConfigError,), _SITE_BYTES),
        Target("csv", _file_reader("csv", "a.csv"), _CSV, (Refused,)),
        Target("csv.gz", _file_reader("csv", "a.csv.gz"), tuple(gzip.compress(c) for c in _CSV), (Refused,)),
        Target("xlsx", _file_reader("excel", "a.xlsx"), (_workbook(),), (Refused,)),
        Target("parquet", _file_reader("parquet", "a.parquet"), tuple(map(_parquet, ("snappy", "zstd"))), (Refused,)),
    ]
