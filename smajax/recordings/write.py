"""Writing of tables of numbers as .csv and .parquet files."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError
from smajax.recordings.paths import replacing

# Rows that are formatted at a time, which limits the memory; the number has no effect on the file.
_ROWS_WRITTEN_AT_ONCE = 65536


def write_table(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    """Write a table, completely or not at all.

    Args:
        path: The file, which ends in .csv, .txt or .parquet.
        columns: Arrays, shape ``(rows,)``, by header.

    Raises:
        InputError: For another ending, or if the file cannot be written.
    """
    with replacing(path) as part:
        if path.suffix.lower() == ".parquet":
            _write_parquet(part, columns)
        elif path.suffix.lower() in (".csv", ".txt"):
            _write_csv(part, columns)
        else:
            raise InputError(f"{path}: recordings are written as .csv or .parquet: choose one of these endings")


def _write_csv(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(columns) + "\n")
        for start in range(0, len(next(iter(columns.values()))), _ROWS_WRITTEN_AT_ONCE):
            texts = [map(repr, column[start : start + _ROWS_WRITTEN_AT_ONCE].tolist()) for column in columns.values()]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def _write_parquet(path: Path, columns: Mapping[str, NDArray[np.float64]]) -> None:
    import pyarrow.parquet

    pyarrow.parquet.write_table(pyarrow.table(dict(columns)), path)
