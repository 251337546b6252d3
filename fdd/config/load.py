"""From YAML text to a checked :class:`Site`, every error with its line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from fdd.config.former import modernised
from fdd.config.schema import Site
from fdd.limits import SITE_FILE_BYTES, SITE_FILE_DEPTH, SITE_FILE_ENTRIES, UNPRINTABLE
from fdd.tables import ConfigError, SourceOptions, suggestion

Loc = tuple[str | int, ...]
_SUFFIXES = {"parquet": {".parquet", ".pq"}, "excel": {".xlsx", ".xls", ".xlsm", ".xlsb", ".ods"}}
# Blanks and dashes that may stand before the first word of a line.
_INDENTED = 200


def load_site(path: Path | str) -> Site:
    """Read and check a site file, without network and without the data.

    Raises
    ------
    ConfigError : unreadable file, YAML syntax, unknown key, wrong value, unknown point, unit that does not fit.
    """
    path = Path(path)
    try:
        with path.open("rb") as opened:
            text = opened.read(SITE_FILE_BYTES + 1).decode()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("", 0, f"cannot be read ({error})", "Check the path.", file=str(path)) from None
    return parse_site(text, folder=path.resolve().parent, file=str(path))


def parse_site(text: str, *, folder: Path | None = None, file: str = "") -> Site:
    """The site in a YAML text; ``folder`` is what relative paths start from.

    Raises
    ------
    ConfigError : as :func:`load_site`.
    """
    if len(text) > SITE_FILE_BYTES:
        problem = f"is longer than {SITE_FILE_BYTES} bytes"
        raise ConfigError("", 0, problem, "Is this the site file, and not its data?", file=file)
    tree = _yaml(text, file)
    table = _Plain(tree, file).table()
    if "source" in table and "sources" in table:
        raise _located(tree, ("source",), "both 'source' and 'sources' are given", "Keep 'sources', a list.", file)
    if "source" in table:
        table = {("sources" if k == "source" else k): v for k, v in table.items()}
    table, former = modernised(table)
    try:
        table["sources"] = tuple(_sources(tree, table.get("sources"), file))
        if "operator" in table:
            table["operator"] = _operator(tree, table["operator"], file)
        site = Site.model_validate(table)
    except ValidationError as error:
        raise _config_error(error, tree, (), file) from None
    return site.located(folder or Path.cwd(), former)


def with_data(site: Site, path: Path | str) -> Site:
    """The same site fed from a file instead of its own sources: CSV, workbook or Parquet by the file's name.

    A file source in the site keeps its options (time format, missing values) and takes the new path.
    """
    from ingest.source import options_type

    kind = next((k for k, suffixes in _SUFFIXES.items() if Path(path).suffix.lower() in suffixes), "csv")
    own = next((s for s in site.sources if s.kind == kind), None)
    path = Path(path).resolve()
    options = (
        own.model_copy(update={"path": path})
        if own
        else options_type(kind).model_validate({"kind": kind, "path": path})
    )
    options = options.model_copy(update={"name": site.sources[0].label if site.sources else kind})
    points = {n: p.model_copy(update={"source": ""}) for n, p in site.points.items()}
    return site.model_copy(update={"sources": (options,), "points": points})


def _require_shallow(text: str, file: str) -> None:
    """Refuse in no time what takes a YAML parser minutes: brackets or dashes within each other by the thousand.

    Raises
    ------
    ConfigError : deeper than any site, counting brackets in texts and comments along.
    """
    for number, line in enumerate(text.splitlines(), 1):
        depth = max(line.count("[") - line.count("]"), line.count("{") - line.count("}"))
        marks = len(line) - len(line.lstrip(" -?:&*!"))
        if depth > SITE_FILE_DEPTH or marks > _INDENTED:
            raise ConfigError("", number, f"is nested deeper than {SITE_FILE_DEPTH} levels", "", file=file)


def _yaml(text: str, file: str) -> CommentedMap:
    _require_shallow(text, file)
    try:
        tree = YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError("", line, _yaml_problem(error), _yaml_remedy(error), file=file) from None
    except (YAMLError, ValueError, TypeError, ArithmeticError, AttributeError, LookupError) as error:
        # A date or number that YAML recognises and Python has none of comes out as one of Python's own.
        raise ConfigError("", 0, f"is no YAML ({error!s:.200})", "Put names and dates in quotes.", file=file) from None
    except RecursionError:
        raise ConfigError("", 0, f"is nested deeper than {SITE_FILE_DEPTH} levels", "", file=file) from None
    if not isinstance(tree, CommentedMap):
        raise ConfigError("", 1, "holds no keys", "Start with 'name: My building'.", file=file)
    return tree


def _yaml_problem(error: MarkedYAMLError) -> str:
    return f"is no YAML: {(error.problem or '').strip().splitlines()[0]}" if error.problem else "is no YAML"


def _yaml_remedy(error: MarkedYAMLError) -> str:
    problem = error.problem or ""
    if "'%'" in problem:
        return 'Put per cent in quotes: "%".'
    if "'`'" in problem:
        return "Put an expression that starts with a backtick in quotes."
    if "expected ',' or" in problem:
        return "Close the bracket, and put a text that holds [ ] { } or a comma in quotes."
    if "duplicate key" in problem:
        return "Keep one of the two."
    return "Check indentation, colons and quotes on this line and the one before."


class _Plain:
    """Ordinary dicts, lists and scalars; ruamel's keep formatting that nothing here needs.

    What a name (``*anchor``) repeats is written out: it counts as often as it stands there.
    """

    def __init__(self, tree: CommentedMap, file: str) -> None:
        self._tree, self._file = tree, file
        self._entries = 0

    def table(self) -> dict[str, Any]:
        """The whole tree.

        Raises
        ------
        ConfigError : too deep, too long, a number that is none here.
        """
        for k in self._tree:
            self._printable(str(k), ())
        return {str(k): self._plain(v, (str(k),)) for k, v in self._tree.items()}

    def _printable(self, text: str, loc: Loc) -> None:
        found = UNPRINTABLE.search(text.replace("\n", " ").replace("\t", " "))
        if found:
            problem = f"holds the character U+{ord(found.group()):04X}, which cannot be printed"
            raise _located(self._tree, loc, problem, "Take it out.", self._file)

    def _plain(self, node: Any, loc: Loc) -> Any:
        self._entries += 1
        if len(loc) > SITE_FILE_DEPTH or self._entries > SITE_FILE_ENTRIES:
            bound = f"{SITE_FILE_DEPTH} levels and {SITE_FILE_ENTRIES} entries"
            raise _located(self._tree, loc[:1], f"is nested too deeply or too long; at most {bound}", "", self._file)
        if isinstance(node, Mapping):
            for k in node:
                self._printable(str(k), loc)
            return {str(k): self._plain(v, (*loc, str(k))) for k, v in node.items()}
        if isinstance(node, list):
            return [self._plain(v, (*loc, i)) for i, v in enumerate(node)]
        if isinstance(node, bool) or node is None:
            return node
        if isinstance(node, int) and abs(node) >= 2**63:
            problem, remedy = "is a whole number beyond 64 bits", "Put it in quotes if it is a name."
            raise _located(self._tree, loc, problem, remedy, self._file)
        if isinstance(node, str):
            self._printable(node, loc)
        for kind in (int, float, str):
            if isinstance(node, kind):
                return kind(node)
        return str(node)


def _sources(tree: CommentedMap, table: Any, file: str) -> Iterator[SourceOptions]:
    from ingest.source import kinds, options_type

    if table is None:
        return
    key = "source" if "source" in tree else "sources"
    single = isinstance(table, dict)
    if not isinstance(table, list | dict):
        raise _located(tree, (key,), f"{table!r:.60} is no source", "Give 'kind' and its keys below it.", file)
    for i, options in enumerate([table] if single else table):
        loc: Loc = (key,) if single else (key, i)
        if not isinstance(options, dict) or "kind" not in options:
            raise _located(tree, loc, "the source has no 'kind'", f"Kinds are {', '.join(kinds())}.", file)
        kind = str(options["kind"])
        if kind not in kinds():
            problem = f"no source is of kind {kind!r}"
            raise _located(tree, (*loc, "kind"), problem, suggestion(kind, list(kinds())), file)
        try:
            yield options_type(kind).model_validate(options)
        except ValidationError as error:
            raise _config_error(error, tree, loc, file) from None


def _operator(tree: CommentedMap, table: Any, file: str) -> SourceOptions:
    from ingest.zenoh.options import OperatorOptions

    try:
        return OperatorOptions.model_validate(table)
    except ValidationError as error:
        raise _config_error(error, tree, ("operator",), file) from None


def _config_error(error: ValidationError, tree: CommentedMap, prefix: Loc, file: str) -> ConfigError:
    found = [_one(details, tree, prefix, file) for details in error.errors()]
    found.sort(key=lambda e: e.line)
    found[0].others = tuple(found[1:])
    return found[0]


def _one(details: Any, tree: CommentedMap, prefix: Loc, file: str) -> ConfigError:
    context = details.get("ctx") or {}
    loc: Loc = (*prefix, *_existing(tree, prefix, details["loc"], details["type"] == "missing"))
    if details["type"] == "refused":
        more = tuple(str(context["key"]).split(".")) if context["key"] else ()
        return _located(tree, _resolve(tree, loc, more), context["problem"], context["remedy"], file)
    if details["type"] == "missing":
        return _located(tree, loc, "is missing", "Add it.", file)
    value = details.get("input")
    shown = "" if isinstance(value, dict | list) else f" (it is {value!r:.100})"
    return _located(tree, loc, f"{details['msg'][0].lower()}{details['msg'][1:]}{shown}", "", file)


def _existing(tree: Any, prefix: Loc, loc: Loc, missing: bool) -> Loc:
    """Pydantic's place without the names of union members, which stand in no file."""
    node: Any = tree
    for part in prefix:
        node = _child(node, part)
    kept: list[str | int] = []
    for i, part in enumerate(loc):
        last = missing and i == len(loc) - 1
        if last or (isinstance(node, CommentedMap | CommentedSeq) and _has(node, part)):
            kept.append(part)
            node = _child(node, part)
    return tuple(kept)


def _resolve(tree: CommentedMap, loc: Loc, more: tuple[str, ...]) -> Loc:
    """Names may hold dots (``hx.T_in``): join parts until the file knows them."""
    node: Any = tree
    for part in loc:
        node = _child(node, part)
    found: list[str | int] = []
    rest = list(more)
    while rest:
        length = next((n for n in range(len(rest), 1, -1) if _child(node, ".".join(rest[:n])) is not None), 1)
        name: str | int = ".".join(rest[:length])
        if isinstance(node, CommentedSeq) and str(name).isdigit():
            name = int(name)
        found.append(name)
        node, rest = _child(node, name), rest[length:]
    return (*loc, *found)


def _has(node: CommentedMap | CommentedSeq, part: str | int) -> bool:
    return part in node if isinstance(node, CommentedMap) else isinstance(part, int) and part < len(node)


def _child(node: Any, part: str | int) -> Any:
    if isinstance(node, CommentedMap):
        return node.get(part)
    if isinstance(node, CommentedSeq) and isinstance(part, int) and part < len(node):
        return node[part]
    return None


def _located(tree: CommentedMap, loc: Loc, problem: str, remedy: str, file: str) -> ConfigError:
    node: Any = tree
    line = tree.lc.line + 1
    for part in loc:
        if not isinstance(node, CommentedMap | CommentedSeq):
            break
        try:
            place = node.lc.key(part) if isinstance(node, CommentedMap) else node.lc.item(part)
        except (KeyError, IndexError, TypeError):
            break
        line, node = place[0] + 1, _child(node, part)
    return ConfigError(".".join(map(str, loc)), line, problem, remedy, file=file)
