"""What a file really is, by its first bytes, so that a wrong kind or encoding is told in words."""

from __future__ import annotations

from pathlib import Path

_OLE = b"\xd0\xcf\x11\xe0"
_ENCODINGS = {b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


def nature(path: Path) -> str:
    """``parquet``, ``excel``, ``gzip``, ``zip``, ``utf-16``, ``json``, ``xml`` or, for all else, ``text``."""
    with path.open("rb") as file:
        head = file.read(4096)
    if head.startswith(b"PAR1"):
        return "parquet"
    if head.startswith(b"PK"):
        office = any(part in head for part in (b"[Content_Types].xml", b"xl/", b"mimetype", b"_rels/"))
        return "excel" if office else "zip"
    if head.startswith(_OLE):
        return "excel"
    if head.startswith(b"\x1f\x8b"):
        return "gzip"
    if head[:2] in _ENCODINGS:
        return _ENCODINGS[head[:2]]
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith((b"{", b"[")):
        return "json"
    return "xml" if start.startswith((b"<?xml", b"<!DOCTYPE", b"<html")) else "text"


REMEDIES = {
    "parquet": "it is a Parquet file; set kind: parquet, or name it .parquet",
    "excel": "it is a workbook; set kind: excel, or name it .xlsx",
    "gzip": "it is compressed; name it .csv.gz",
    "zip": "it is a zip archive; unpack it",
    "utf-16": "it is written in utf-16; set encoding: utf-16",
    "json": "it is JSON; export it as CSV, or let fdd init read it if it is a Haystack grid",
    "xml": "it is XML or a web page; export it as CSV",
}
