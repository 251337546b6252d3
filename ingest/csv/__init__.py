"""Replay of CSV and Parquet files."""

from ingest.csv.options import CsvOptions, LongOptions, ParquetOptions, TimeOptions
from ingest.csv.parquet import ParquetSource
from ingest.csv.source import CsvSource

__all__ = ["CsvOptions", "CsvSource", "LongOptions", "ParquetOptions", "ParquetSource", "TimeOptions"]
