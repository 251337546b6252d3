"""Replay of files: CSV, workbooks and Parquet."""

from ingest.csv.excel import ExcelSource
from ingest.csv.options import CsvOptions, ExcelOptions, LongOptions, ParquetOptions, TimeOptions
from ingest.csv.parquet import ParquetSource
from ingest.csv.source import CsvSource

__all__ = [
    "CsvOptions",
    "CsvSource",
    "ExcelOptions",
    "ExcelSource",
    "LongOptions",
    "ParquetOptions",
    "ParquetSource",
    "TimeOptions",
]
