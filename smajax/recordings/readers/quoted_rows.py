"""Rows of text that are in quotation marks as a whole, as some programs export a table that was a single column."""

import csv
from collections.abc import Sequence

# Share of the first rows that have to be so; titles above the table and blank rows need not.
_SHARE = 0.5
QUOTED_ROWS_NOTE = "every row is in quotation marks as a whole, which were taken off"


def are_rows_quoted(lines: Sequence[str], delimiter: str) -> bool:
    """Return whether most rows are a single cell in quotation marks, in which the delimiter divides further cells.

    Args:
        lines: The first rows.
        delimiter: Character between cells.
    """
    filled = [line for line in lines if line.strip()]
    return sum(_is_quoted(line, delimiter) for line in filled) > _SHARE * len(filled)


def divide_row(line: str, delimiter: str, quoted: bool) -> list[str]:
    """Return the cells of a row, without white space at their ends.

    Args:
        line: The row, without its end.
        delimiter: Character between cells; a space stands for one or more.
        quoted: Whether rows are in quotation marks as a whole.

    Raises:
        csv.Error: If the row cannot be divided.
    """
    if quoted and _is_quoted(line, delimiter):
        line = next(csv.reader([line], delimiter=delimiter))[0]
    if delimiter == " ":  # columns that are aligned by spaces have several between two cells
        return [cell.strip() for cell in next(csv.reader([line.strip()], delimiter=" ", skipinitialspace=True), [""])]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [""])]


def _is_quoted(line: str, delimiter: str) -> bool:
    text = line.strip()
    if not (text.startswith('"') and text.endswith('"')):
        return False
    try:
        cells = next(csv.reader([text], delimiter=delimiter))
    except csv.Error:
        return False
    return len(cells) == 1 and delimiter in cells[0]
