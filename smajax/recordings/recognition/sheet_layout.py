"""Layout of a workbook: its sheets of one kind, and the rows before their data."""

from collections.abc import Sequence
from pathlib import Path

from smajax.errors import InputError, suggestion
from smajax.recordings.read_options import ALL_SHEETS, ReadOptions
from smajax.recordings.readers.xlsx import first_rows
from smajax.recordings.recognition.findings import Finding
from smajax.recordings.recognition.row_findings import header_findings
from smajax.recordings.recognition.rows import RowRoles, find_rows
from smajax.recordings.recognition.stamp_formats import find_time_format
from smajax.recordings.recognition.text_layout import Layout

_ROWS_LOOKED_AT = 60

Rows = list[list[str]]


def recognise_workbook(path: Path, options: ReadOptions, fixed: Sequence[str]) -> Layout:
    """Return the layout of a workbook; sheets of another layout than the first with data are left out.

    Args:
        path: The file.
        options: Options of reading.
        fixed: Names of the options that the caller gave, which stay.

    Raises:
        InputError: If no sheet has rows of numbers.
    """
    sheets = first_rows(path, _ROWS_LOOKED_AT)
    for name in options.sheet if options.sheet != (ALL_SHEETS,) else ():
        if name not in sheets:
            raise InputError(
                f"{path}: there is no sheet '{name}'{suggestion(name, sheets)}: it has {', '.join(sheets)}"
            )
    names = list(sheets) if options.sheet in ((), (ALL_SHEETS,)) else list(options.sheet)
    skipped = options.skip_rows if "skip_rows" in fixed else 0
    all_roles = {name: _roles(sheets[name], options, skipped) for name in names}
    first = next((name for name, roles in all_roles.items() if roles), None)
    if first is None:
        cure = "save the recording as a table, one row per sample"
        raise InputError(f"{path}: no row of numbers was recognised in {', '.join(names)}: {cure}")
    roles = all_roles[first]
    assert roles is not None
    alike = [name for name in names if all_roles[name] and _are_alike(sheets, first, name, roles, all_roles[name])]
    rows = _merged([_without_end(sheets[name], roles.width) for name in alike], roles)
    options, questions = find_time_format(rows[roles.data :], options, fixed)
    options, findings, named = header_findings(rows, roles, options, fixed)
    others = [name for name in sheets if name not in alike]
    if len(sheets) > 1:
        options = options.replace(sheet=tuple(alike) if others or len(alike) == 1 else (ALL_SHEETS,))
        findings = (_sheet_finding(alike, others, roles), *findings)
    return Layout(options, findings, questions, named)


def _roles(rows: Rows, options: ReadOptions, skipped: int) -> RowRoles | None:
    """Return where header, units and data are; the width is that of the widest row of data."""
    filled = [_trimmed(cells) for cells in rows[skipped:]]
    width = max((len(cells) for cells in filled), default=0)
    roles = find_rows([cells + [""] * (width - len(cells)) for cells in filled], options)
    if roles is None:
        return None

    def shifted(row: int | None) -> int | None:
        return None if row is None else row + skipped

    width = max(len(cells) for cells in filled[roles.data :])
    return RowRoles(roles.data + skipped, width, shifted(roles.header), shifted(roles.units))


def _are_alike(sheets: dict[str, Rows], first: str, name: str, roles: RowRoles, others: RowRoles | None) -> bool:
    """Return whether two sheets have their header, units and data in the same rows, and no different names."""
    if others is None or (roles.data, roles.header, roles.units) != (others.data, others.header, others.units):
        return False
    if roles.header is None:
        return roles.width == others.width
    pairs = zip(sheets[first][roles.header], sheets[name][roles.header], strict=False)
    return all(a == b or not a or not b for a, b in pairs)


def _merged(sheets: list[Rows], roles: RowRoles) -> Rows:
    """Return the rows of the first sheet with names from others where its header has a blank cell."""
    rows = [list(cells) for cells in sheets[0]]
    if roles.header is not None:
        header = rows[roles.header]
        for other in sheets[1:]:
            for k, text in enumerate(other[roles.header][: len(header)]):
                header[k] = header[k] or text
    return rows


def _without_end(rows: Rows, width: int) -> Rows:
    """Return rows of the width of the data."""
    return [(cells + [""] * width)[:width] for cells in rows]


def _trimmed(cells: list[str]) -> list[str]:
    """Return cells without the blank ones at the end."""
    width = max((k + 1 for k, cell in enumerate(cells) if cell), default=0)
    return cells[:width]


def _sheet_finding(alike: list[str], others: list[str], roles: RowRoles) -> Finding:
    names = ", ".join(f"'{name}'" for name in alike)
    reason = f"their data begin in row {roles.data + 1}" if len(alike) > 1 else "it has rows of numbers"
    if others:
        reason += f"; {', '.join(repr(name) for name in others)} left out, with another layout"
    return Finding("sheets", names, reason)
