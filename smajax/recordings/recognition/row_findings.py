"""Options of reading and findings by the place of header, units and data."""

from collections.abc import Sequence

from smajax.errors import shortened
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recognition.findings import Finding
from smajax.recordings.recognition.rows import RowRoles


def header_findings(
    rows: Sequence[Sequence[str]], roles: RowRoles, options: ReadOptions, fixed: Sequence[str]
) -> tuple[ReadOptions, tuple[Finding, ...], bool]:
    """Return the options with skipped rows, header and names, what was found, and whether the columns have names.

    Args:
        rows: Texts of the cells of the first rows of the file.
        roles: Where header, units and data are, counted from the first row of the file.
        options: Options of reading.
        fixed: Names of the options that the caller gave.
    """
    if options.columns is not None:
        findings = () if "skip_rows" in fixed else _skipped(roles.data if roles.header is None else roles.header)
        skip = options.skip_rows if "skip_rows" in fixed else roles.data if roles.header is None else roles.header
        return options.replace(skip_rows=skip), (*findings, Finding("header", "as named", "names were given")), True
    if roles.header is None:
        names = tuple(f"column {k + 1}" for k in range(roles.width))
        reason = f"row {roles.data + 1}, the first with values, has no row of names above it"
        options = options.replace(skip_rows=roles.data, header=False, columns=names)
        return options, (*_skipped(roles.data), Finding("header", "none", reason)), False
    header = rows[roles.header]
    findings = (*_skipped(roles.header), _header_finding(roles.header, header), *_units(rows, roles))
    if roles.is_adjacent() and len(header) == roles.width and _are_distinct(header):
        skipped = options.replace(skip_rows=roles.header)
        needs_option = roles.units is None and options.units_row is not None
        return (skipped.replace(units_row=None) if needs_option else skipped), findings, True
    names = unique_names(header, roles.width, rows[roles.units] if roles.units is not None else ())
    options = options.replace(skip_rows=roles.data, header=False, columns=names, units_row=False)
    return options, (*findings, _renamed_finding(roles, header)), True


def unique_names(header: Sequence[str], width: int, units: Sequence[str] = ()) -> tuple[str, ...]:
    """Return a different name for each column: its header and unit, with a number where it is blank or repeated.

    Args:
        header: Texts of the row of headers.
        width: Number of columns.
        units: Texts of the row of units; empty without any.
    """
    names: list[str] = []
    for k in range(width):
        name = header[k].strip() if k < len(header) else ""
        unit = units[k].strip("[]()<> ") if k < len(units) else ""
        name = f"{name} [{unit}]" if name and unit and "[" not in name else name
        names.append(name if name and name not in names else f"{name} column {k + 1}".strip())
    return tuple(names)


def _skipped(count: int) -> tuple[Finding, ...]:
    if not count:
        return ()
    rows = "row 1 is" if count == 1 else f"rows 1 to {count} are"
    return (Finding("title", f"{count} row{'s' * (count > 1)} skipped", f"{rows} not part of the table"),)


def _header_finding(row: int, header: Sequence[str]) -> Finding:
    example = next(text for text in header if text.strip())
    return Finding("header", f"row {row + 1}", f"it has names such as '{shortened(example)}' above the numbers")


def _units(rows: Sequence[Sequence[str]], roles: RowRoles) -> tuple[Finding, ...]:
    if roles.units is None:
        return ()
    texts = [text for text in rows[roles.units] if text.strip()]
    return (Finding("units", f"row {roles.units + 1}", f"its cells are units such as {texts[0]}"),)


def _renamed_finding(roles: RowRoles, header: Sequence[str]) -> Finding:
    """Return the finding on names that have to be given, as the reader cannot take them from the file."""
    if len(header) != roles.width:
        reason = f"the header has {len(header)} cells and the rows {roles.width}"
    elif not _are_distinct(header):
        reason = "a name is blank or is there twice"
    else:
        reason = f"other rows are between the header and row {roles.data + 1}, where the data begin"
    return Finding("names", "given by columns", reason)


def _are_distinct(header: Sequence[str]) -> bool:
    """Return whether all names differ and none is blank, but for a first one of row numbers."""
    names = list(header) if header[0].strip() else list(header[1:])
    return all(name.strip() for name in names) and len(set(names)) == len(names)
