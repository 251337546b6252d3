"""State and journal entries as bytes: dicts, lists, JSON scalars and arrays, without pickle."""

from __future__ import annotations

import io
import json
from dataclasses import asdict, dataclass
from typing import Any, get_args

import numpy as np

from fdd.records import Baseline, Batch, JsonObject
from fdd.service.alarms.book import Action, Command

_COLUMNS = {"point": np.int32, "time": np.int64, "value": np.float64, "quality": np.uint8}


@dataclass(frozen=True, slots=True)
class Rebase:
    """New baselines that were put in force between two batches."""

    baselines: tuple[Baseline, ...]


@dataclass(frozen=True, slots=True)
class TurnBack:
    """Event time set back to ``time`` [ns] by a person, after a clock was wrong; ``key`` is that of its document."""

    time: int
    by: str = ""
    key: str = ""


Entry = Batch | Command | Rebase | TurnBack


class DamagedError(ValueError):
    """Bytes that are no state and no entry; the text says why."""


def encode(tree: JsonObject) -> bytes:
    """A tree of dicts, lists, JSON scalars and arrays as bytes, without pickle."""
    arrays: list[np.ndarray[Any, Any]] = []

    def reference(value: object) -> object:
        if isinstance(value, np.ndarray):
            arrays.append(value)
            return {"__array__": len(arrays) - 1}
        if isinstance(value, np.generic):
            return value.item()
        raise TypeError(f"state holds a {type(value).__name__}; only arrays and JSON values can be kept")

    text = json.dumps(tree, default=reference)
    buffer = io.BytesIO()
    named = {str(i): a for i, a in enumerate(arrays)}
    np.savez(buffer, allow_pickle=False, tree=np.frombuffer(text.encode(), dtype=np.uint8), **named)
    return buffer.getvalue()


def decode(data: bytes) -> JsonObject:
    """The tree that :func:`encode` wrote.

    Raises
    ------
    DamagedError : it did not write these bytes.
    """
    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as archive:

            def resolve(value: JsonObject) -> Any:
                return archive[str(value["__array__"])] if "__array__" in value else value

            tree = json.loads(archive["tree"].tobytes().decode(), object_hook=resolve)
    except Exception as error:  # NumPy, zip, zlib and JSON have many kinds for what is damaged
        raise DamagedError(f"no state ({type(error).__name__}: {error!s:.200})") from None
    if not isinstance(tree, dict):
        raise DamagedError("no state: it holds no table")
    return tree


def encode_entry(entry: Entry) -> tuple[str, bytes]:
    """An entry of the journal: its kind and its bytes."""
    if isinstance(entry, Batch):
        return "batch", _encode_batch(entry)
    if isinstance(entry, Rebase):
        return "rebase", json.dumps([asdict(b) for b in entry.baselines]).encode()
    return ("turn back" if isinstance(entry, TurnBack) else "command"), json.dumps(asdict(entry)).encode()


def decode_entry(kind: str, data: bytes) -> Entry:
    """The entry that :func:`encode_entry` wrote.

    Raises
    ------
    DamagedError : it did not write these bytes.
    """
    try:
        match kind:
            case "batch":
                return _decode_batch(data)
            case "rebase":
                return Rebase(tuple(Baseline(**d) for d in json.loads(data)))
            case "turn back":
                return TurnBack(**json.loads(data))
            case "command":
                return _decode_command(data)
            case _:
                raise DamagedError(f"an entry of kind {kind!r:.60}")
    except DamagedError:
        raise
    except Exception as error:  # whatever else rubbish makes of it
        raise DamagedError(f"no {kind} ({type(error).__name__}: {error!s:.200})") from None


def _decode_command(data: bytes) -> Command:
    command = Command(**json.loads(data))
    if command.action not in get_args(Action):
        raise DamagedError(f"a command {command.action!r:.60}")
    return command


def _encode_batch(batch: Batch) -> bytes:
    """One line of JSON, then the columns one after the other; only the names that the samples speak of."""
    used, point = np.unique(batch.point, return_inverse=True)
    head = {"names": [batch.names[i] for i in used.tolist()], "position": batch.position, "samples": len(batch)}
    columns = {"point": point, "time": batch.time, "value": batch.value, "quality": batch.quality}
    parts = [np.ascontiguousarray(columns[name], dtype=kind).tobytes() for name, kind in _COLUMNS.items()]
    return b"\n".join((json.dumps(head, separators=(",", ":")).encode(), b"".join(parts)))


def _decode_batch(data: bytes) -> Batch:
    if data.startswith(b"PK"):  # schema 3 wrote them like states
        tree = decode(data)
        return Batch(**{**tree, "names": tuple(tree["names"])})
    text, _, rest = data.partition(b"\n")
    head, n = json.loads(text), 0
    columns = {}
    for name, kind in _COLUMNS.items():
        width = np.dtype(kind).itemsize * int(head["samples"])
        columns[name] = np.frombuffer(rest[n : n + width], dtype=kind)
        n += width
    batch = Batch(names=tuple(head["names"]), position=head["position"], **columns)
    lengths = {len(c) for c in columns.values()}
    if n != len(rest) or lengths != {int(head["samples"])} or (len(batch) and batch.point.max() >= len(batch.names)):
        raise DamagedError("a batch whose columns do not fit each other")
    return batch
