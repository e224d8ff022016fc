"""Table of a sweep as a Parquet file, with a header that reproduces the sweep."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from smajax.errors import InputError, first_line
from smajax.files.renamed_keys import current_name

# Key of the header in the file's metadata.
KEY = b"smajax.sweep"
# Keys that a header must have.
_REQUIRED = ("name", "recording", "rig", "rig_name", "sweep")


def write_table(
    path: Path,
    columns: Mapping[str, np.ndarray],
    header: Mapping[str, Any] | None = None,
    units: Mapping[str, str] | None = None,
) -> None:
    """Write a table as a Parquet file, which appears only when it is complete.

    Args:
        path: The file.
        columns: Columns by name, shape ``(m,)`` each.
        header: JSON document for the file's metadata.
        units: Units by column; a column with a unit is called ``name [unit]``.

    Raises:
        InputError: If the file cannot be written.
    """
    import pyarrow.parquet

    units = units or {}
    names = [f"{n} [{units[n]}]" if n in units else n for n in columns]
    table = pyarrow.table([pyarrow.array(values) for values in columns.values()], names=names)
    if header is not None:
        table = table.replace_schema_metadata({KEY: json.dumps(header, sort_keys=True, ensure_ascii=False)})
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            pyarrow.parquet.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        hint = "make room, and run it again with --resume: finished chunks are kept"
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): {hint}") from None
    finally:
        part.unlink(missing_ok=True)


def read_table(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a table, shape ``(m,)`` each, by current name without the unit.

    Raises:
        InputError: If the file is not readable.
    """
    import pyarrow.parquet

    try:
        table = pyarrow.parquet.read_table(path)
    except Exception as error:  # pyarrow raises many kinds of exceptions for damaged files
        problem = f"the file is not readable as Parquet ({first_line(error)})"
        raise InputError(f"{path}: {problem}: remove it, and run the sweep again with --resume") from None
    return {current_name(n.partition(" [")[0]): table.column(n).to_numpy() for n in table.column_names}


def read_units(path: Path) -> dict[str, str]:
    """Read the units of a table by current name of the column."""
    import pyarrow.parquet

    names = pyarrow.parquet.read_schema(path).names
    parts = (name.partition(" [") for name in names if " [" in name)
    return {current_name(name): unit.removesuffix("]") for name, _, unit in parts}


def read_header(path: Path) -> dict[str, Any]:
    """Read the header of a sweep's table.

    Raises:
        InputError: If the file is not the table of a sweep.
    """
    import pyarrow.parquet

    try:
        metadata = pyarrow.parquet.read_schema(path).metadata or {}
        header = json.loads(metadata[KEY])
        return {name: header[name] for name in _REQUIRED} | header
    except Exception:  # as above; or the header is missing
        raise InputError(f"{path}: this is not a table that smajax sweep wrote: name one, or a SWEEP.toml") from None
