"""Choice of the sheets of a workbook, or the groups of a TDMS file, that are read."""

from collections.abc import Sequence
from pathlib import Path

from smajax.errors import InputError, suggestion
from smajax.recordings.read_options import ALL_SHEETS, ReadOptions


def choose_sheets(
    path: Path, options: ReadOptions, names: Sequence[str], filled: Sequence[str], kind: str
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the names of the sheets that are named, of all with rows, or of the first; and a note on those left out.

    Args:
        path: The file, for messages.
        options: Options of reading.
        names: Names of the sheets in the file.
        filled: Names of those with rows.
        kind: What they are, "sheet" or "group".

    Raises:
        InputError: If a sheet is missing.
    """
    chosen = options.sheet
    if chosen == (ALL_SHEETS,) and ALL_SHEETS not in names:
        chosen = tuple(filled)
    for name in chosen:
        if name not in names:
            hint = suggestion(name, names)
            raise InputError(f"{path}: there is no {kind} '{name}'{hint}: it has {', '.join(names)}")
    chosen = chosen or (names[0],)
    others = [name for name in filled if name not in chosen]
    if not others or options.sheet:
        return chosen, ()
    return chosen, (
        f"{kind} '{chosen[0]}' was read, and not {', '.join(others)}: name others, or all, by sheet (--sheet)",
    )
