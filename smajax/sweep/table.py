"""A sweep's table as Parquet, written completely or not at all, with a header that says how to make it again. Needs pyarrow."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from smajax.errors import InputError
from smajax.tables.parquet import pyarrow_parquet

KEY = b"smajax.sweep"
_HEADER = ("name", "recording", "rig", "rig_name", "sweep")


def write_table(
    path: Path, columns: Mapping[str, np.ndarray], header: Mapping[str, Any] | None = None, units: Mapping[str, str] | None = None
) -> None:
    """Write columns, each ``(m,)``; those with a unit are headed ``name [unit]``. InputError if the disk does not take the file."""
    parquet = pyarrow_parquet(path)
    import pyarrow

    units = units or {}
    names = [f"{n} [{units[n]}]" if n in units else n for n in columns]
    table = pyarrow.table([pyarrow.array(values) for values in columns.values()], names=names)
    if header is not None:
        table = table.replace_schema_metadata({KEY: json.dumps(header, sort_keys=True, ensure_ascii=False)})
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("wb") as file:
            parquet.write_table(table, file, compression="zstd")
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        cure = "make room, and run it again with --resume: what was finished is kept"
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): {cure}") from None
    finally:
        part.unlink(missing_ok=True)


def read_table(path: Path) -> dict[str, np.ndarray]:
    """The columns of a table by name, without their units. InputError if it is not whole."""
    parquet = pyarrow_parquet(path)
    try:
        table = parquet.read_table(path)
    except Exception as error:  # pyarrow raises a kind of its own for each way in which a file can be broken
        words = (str(error).splitlines() or [type(error).__name__])[0][:120]
        raise InputError(
            f"{path}: the file is not readable as Parquet ({words}): remove it, and run the sweep again with --resume"
        ) from None
    return {n.partition(" [")[0]: table.column(n).to_numpy() for n in table.column_names}


def read_header(path: Path) -> dict[str, Any]:
    """What a sweep's table says of how it was made. InputError if it is no such table."""
    parquet = pyarrow_parquet(path)
    try:
        held = parquet.read_schema(path).metadata or {}
        header = json.loads(held[KEY])
        return {name: header[name] for name in _HEADER} | header
    except Exception:  # as above; or the header is missing
        raise InputError(f"{path}: this is not a table that smajax sweep wrote: name it, or a SWEEP.toml") from None
