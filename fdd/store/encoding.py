"""Documents as JSON text, with numpy arrays kept bit for bit."""

from __future__ import annotations

import base64
import json
from typing import Any

import numpy as np

from fdd.records import JsonObject
from fdd.store.schema import SchemaError

_ARRAY = "__array__"


def _plain(value: Any) -> Any:
    """What JSON has no word for: arrays with dtype and shape, numpy scalars as Python's."""
    if isinstance(value, np.ndarray):
        if value.dtype.hasobject:
            raise TypeError("an array of objects is not plain data")
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
        return {_ARRAY: data, "dtype": value.dtype.str, "shape": list(value.shape)}
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is not plain data")


def _revive(found: dict[str, Any]) -> Any:
    if _ARRAY not in found:
        return found
    array = np.frombuffer(base64.b64decode(found[_ARRAY]), dtype=np.dtype(found["dtype"]))
    return array.reshape(found["shape"]).copy()


def encode(document: JsonObject, what: str) -> str:
    """JSON text of a document of JSON values and numpy arrays; NaN and infinities are kept.

    Raises
    ------
    SchemaError : the document is no dict or holds anything else
    """
    if not isinstance(document, dict):
        raise SchemaError(f"{what}: a document is a dict, not {type(document).__name__}")
    try:
        text = json.dumps(document, default=_plain, ensure_ascii=False, separators=(",", ":"))
        text.encode()  # half of a surrogate pair is no text: no store could keep it
        return text
    except (TypeError, ValueError, RecursionError) as problem:
        raise SchemaError(f"{what}: {problem}; give dicts, lists, text, numbers and numpy arrays") from None


def decode(text: str) -> JsonObject:
    """The document of :func:`encode`; tuples have become lists."""
    document: JsonObject = json.loads(text, object_hook=_revive)
    return document
