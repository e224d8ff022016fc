"""Checks of a command's files before JAX is loaded, so that a wrong path or invalid TOML is reported at once."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from smajax.app.loading import exit_on_interrupt

# Suffix of the table of an earlier sweep, which may be given in place of a TOML file.
_TABLE = ".parquet"


def check_files(
    *,
    toml: Mapping[str, Path] | None = None,
    recordings: Iterable[Path | None] = (),
    out: Path | None = None,
) -> None:
    """Check that files can be read and a folder can be written, without JAX.

    Args:
        toml: TOML files by their kind in messages, such as "rig" or "controller".
        recordings: Recordings; ``None`` for one that was not given.
        out: Folder of the results.

    Raises:
        InputError: If a file is missing or cannot be read as TOML, or the folder cannot be written.
    """
    exit_on_interrupt()
    from smajax.files.result_folder import check_output_folder
    from smajax.files.toml import parse_toml, read_text
    from smajax.recordings.readers import check_file

    if out is not None:
        check_output_folder(out)
    for kind, path in (toml or {}).items():
        if path.suffix.lower() != _TABLE:
            parse_toml(read_text(path, kind), str(path))
    for path in recordings:
        if path is not None:
            check_file(path)
