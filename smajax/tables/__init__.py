"""Files as tables of numbers: CSV and text, MATLAB .mat, Parquet, Excel .xlsx, told apart by the file's suffix."""

from collections.abc import Sequence
from pathlib import Path

from smajax.errors import InputError, nearest
from smajax.tables.base import Table

SUFFIXES = (".csv", ".txt", ".mat", ".parquet", ".xlsx")


def open_table(
    path: Path,
    *,
    skip_rows: int = 0,
    delimiter: str = ",",
    decimal: str = ".",
    sheet: str | None = None,
    headers: Sequence[str] | None = None,
) -> Table:
    """The table in the file at ``path``, its headers read and its numbers not yet; InputError with file and cure otherwise.

    ``delimiter`` and ``decimal`` are those of a text file, ``headers`` name its columns where it has no header row; ``sheet`` is that of
    a workbook (the first one by default).
    """
    suffix = path.suffix.lower()
    try:
        if not path.exists():
            there = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
            raise InputError(f"{path}: there is no such file{nearest(path.name, there)}: check the path")
        if not path.is_file():
            what = "a folder" if path.is_dir() else "not a regular file"
            raise InputError(f"{path}: this is {what}: name a recording, a file ending in {', '.join(SUFFIXES)}")
        if path.stat().st_size == 0:
            raise InputError(f"{path}: the file is empty: record a header like 'time [s],current [A]' and rows of numbers")
        if suffix in (".csv", ".txt"):
            from smajax.tables.csv import CsvTable

            return CsvTable(path, skip_rows, delimiter, decimal, headers)
        if headers is not None:
            raise InputError(f"{path}: only columns of text files can be named: give the file headers like 'temperature [degC]'")
        if suffix == ".mat":
            from smajax.tables.mat import MatTable

            return MatTable(path)
        if suffix == ".parquet":
            from smajax.tables.parquet import ParquetTable

            return ParquetTable(path)
        if suffix == ".xlsx":
            from smajax.tables.xlsx import XlsxTable

            return XlsxTable(path, skip_rows, decimal, sheet)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read ({error.strerror or error}): check its permissions") from None
    raise InputError(f"{path}: files ending in '{path.suffix}' are not read: save the recording as {', '.join(SUFFIXES)}")


__all__ = ["SUFFIXES", "Table", "open_table"]
