"""Writing of tables of numbers as .csv or .parquet files."""

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError

# Rows that are turned into text at a time, which bounds the memory; the size has no effect on the file.
_ROWS_WRITTEN_AT_ONCE = 65536


def write_table(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Write a table of columns (rows,) by header, completely or not at all.

    Raises:
        InputError: for another ending than .csv, .txt or .parquet, or if the file cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        if path.suffix.lower() == ".parquet":
            _write_parquet(part, columns)
        elif path.suffix.lower() in (".csv", ".txt"):
            _write_csv(part, columns)
        else:
            raise InputError(f"{path}: recordings are written as .csv or .parquet: choose one of these endings")
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
    finally:
        part.unlink(missing_ok=True)


def _write_csv(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(next(iter(columns.values()))), _ROWS_WRITTEN_AT_ONCE):
            texts = [map(repr, column[start : start + _ROWS_WRITTEN_AT_ONCE].tolist()) for column in columns.values()]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def _write_parquet(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    from smajax.recordings.readers.parquet import pyarrow_parquet

    parquet = pyarrow_parquet(path)
    import pyarrow

    parquet.write_table(pyarrow.table(dict(columns)), path)
