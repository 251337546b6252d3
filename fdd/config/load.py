"""From YAML text to a checked :class:`Site`, every error with its line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from fdd.config.base import ConfigError, SourceOptions, suggestion
from fdd.config.schema import Site

Loc = tuple[str | int, ...]
_SUFFIXES = {"parquet": {".parquet", ".pq"}, "excel": {".xlsx", ".xls", ".xlsm", ".xlsb", ".ods"}}


def load_site(path: Path | str) -> Site:
    """Read and check a site file, without network and without the data.

    Raises
    ------
    ConfigError : unreadable file, YAML syntax, unknown key, wrong value, unknown point, unit that does not fit.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError("", 0, f"cannot be read ({error})", "Check the path.", file=str(path)) from None
    return parse_site(text, folder=path.resolve().parent, file=str(path))


def parse_site(text: str, *, folder: Path | None = None, file: str = "") -> Site:
    """The site in a YAML text; ``folder`` is what relative paths start from.

    Raises
    ------
    ConfigError : as :func:`load_site`.
    """
    tree = _yaml(text, file)
    table = _plain(tree)
    if "source" in table and "sources" in table:
        raise _located(tree, ("source",), "both 'source' and 'sources' are given", "Keep 'sources', a list.", file)
    if "source" in table:
        table = {("sources" if k == "source" else k): v for k, v in table.items()}
    try:
        table["sources"] = tuple(_sources(tree, table.get("sources"), file))
        if "operator" in table:
            table["operator"] = _operator(tree, table["operator"], file)
        site = Site.model_validate(table)
    except ValidationError as error:
        raise _config_error(error, tree, (), file) from None
    return site.located(folder or Path.cwd())


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


def _yaml(text: str, file: str) -> CommentedMap:
    try:
        tree = YAML(typ="rt").load(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else 0
        raise ConfigError("", line, _yaml_problem(error), _yaml_remedy(error), file=file) from None
    except YAMLError as error:
        raise ConfigError("", 0, f"is no YAML ({error})", "", file=file) from None
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


def _plain(node: Any) -> Any:
    """Ordinary dicts, lists and scalars; ruamel's keep formatting that nothing here needs."""
    if isinstance(node, Mapping):
        return {str(k): _plain(v) for k, v in node.items()}
    if isinstance(node, list):
        return [_plain(v) for v in node]
    if isinstance(node, bool) or node is None:
        return node
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
    shown = "" if isinstance(value, dict | list) else f" (it is {value!r})"
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
