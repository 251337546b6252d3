"""The port every source of samples plugs into, and the register of kinds.

A source is built without arguments, then ``configure`` (values only, no network), ``open`` (from a position, or from
the start), ``batches`` until it ends, ``close``. Names in its batches are the source's own (columns, topics);
:mod:`ingest.mapping` makes points in SI of them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, ClassVar, Protocol, runtime_checkable

from fdd.records import Batch, JsonObject
from fdd.tables import SourceOptions


class NotReady(RuntimeError):  # noqa: N818 - a state of the world, not a mistake
    """The source cannot be opened now; trying again later may work."""


class Refused(RuntimeError):  # noqa: N818
    """The source cannot be opened at all as configured; the text says what to change."""


@dataclass(frozen=True, slots=True)
class Context:
    """What a source must know of the site.

    Attributes
    ----------
    zone : IANA zone of local times that name none themselves
    columns : the source's names that points are mapped from; empty means all
    folder : where relative paths start
    """

    zone: str = "UTC"
    columns: tuple[str, ...] = ()
    folder: Path = field(default_factory=Path)


@runtime_checkable
class Source(Protocol):
    """A stream of batches that can be resumed."""

    options: ClassVar[type[SourceOptions]]
    """Its keys. A source that needs what is not always installed lists the modules as ``needs``."""

    def configure(self, options: Any, context: Context) -> None:
        """Check values; touches no network and no file. Raises Refused."""

    def open(self, position: JsonObject | None = None) -> None:
        """Start after ``position``, None from the beginning. Raises NotReady (try again) or Refused (give up)."""

    def batches(self) -> Iterator[Batch]:
        """Batches in order, each with the position after it.

        A source with an end (file, finished stream) ends; a live one goes on until ``stop`` and yields an empty batch
        when nothing came for about a second, so that the caller can look after other things.
        """

    def position(self) -> JsonObject:
        """Where the source stands after the last batch that was yielded."""

    def counters(self) -> dict[str, int]:
        """What was rejected or odd so far, by reason."""

    def notes(self) -> list[str]:
        """The first few rejections in words (line numbers, messages), for people."""

    def stop(self) -> None:
        """End ``batches`` soon; may be called from another thread."""

    def close(self) -> None:
        """Give up resources; may be called twice."""


ENTRY_POINTS = "hvac_fdd.sources"

_REGISTER: dict[str, str] = {}


def register(kind: str, place: str) -> None:
    """Make a source known: ``place`` is ``module:class``, imported when it is first asked for.

    Raises
    ------
    ValueError : the kind is taken.
    """
    if kind in _REGISTER:
        raise ValueError(f"source kind {kind!r} is already registered by {_REGISTER[kind]}; choose another name")
    _REGISTER[kind] = place


for _kind, _place in {
    "csv": "ingest.csv:CsvSource",
    "excel": "ingest.csv:ExcelSource",
    "parquet": "ingest.csv:ParquetSource",
    "zenoh": "ingest.zenoh:ZenohSource",
    "mqtt": "ingest.mqtt:MqttSource",
    "bacnet": "ingest.bacnet:BacnetSource",
    "plant": "fdd.plant.source:PlantSource",
}.items():
    register(_kind, _place)
for _entry in entry_points(group=ENTRY_POINTS):
    register(_entry.name, _entry.value)


def kinds() -> tuple[str, ...]:
    """Every registered kind."""
    return tuple(sorted(_REGISTER))


def source_class(kind: str) -> type[Source]:
    """The class of a kind.

    Raises
    ------
    Refused : unknown kind, or one whose module is not installed.
    """
    if kind not in _REGISTER:
        raise Refused(f"no source is of kind {kind!r}; kinds are {', '.join(kinds())}")
    module, _, name = _REGISTER[kind].partition(":")
    try:
        found: type[Source] = getattr(import_module(module), name)
    except ImportError as error:
        raise Refused(f"source kind {kind!r} cannot be used here ({error}); install what it needs") from error
    return found


def missing_modules(kind: str) -> list[str]:
    """Modules that a kind needs and that are not installed here."""
    return [m for m in getattr(source_class(kind), "needs", ()) if not _installed(m)]


def _installed(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError:  # a package above it is not there
        return False


def options_type(kind: str) -> type[SourceOptions]:
    """The table of keys of a kind."""
    return source_class(kind).options


def make_source(options: SourceOptions, context: Context) -> Source:
    """A configured source, not yet open."""
    source = source_class(options.kind)()
    source.configure(options, context)
    return source
