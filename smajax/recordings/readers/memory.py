"""Reader of tables in memory: pandas (or similar) DataFrames, pyarrow tables, dictionaries and NumPy arrays.

A DataFrame is recognised by its attributes, so that pandas is never imported here. Rows count from 0, as in Python.
"""

import datetime
import hashlib
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, cast, final

import numpy as np

from smajax.errors import InputError, first_line, shortened
from smajax.recordings.readers.base import Table, refuse_if_too_large, repair_hint
from smajax.recordings.readers.time_stamps import ROWS_WITH_STAMPS, StampColumn, find_stamps, seconds_of_times
from smajax.recordings.sources import TAKES
from smajax.recordings.traced_values import is_tracing_error, traced_values_error

# Header of the times that an index of dates or durations has.
_INDEX_HEADER = "time [s]"
_NANOSECONDS_PER_SECOND = 1e9
_NUMBERS = (int, float, np.integer, np.floating)


@final
class MemoryTable(Table):
    """Columns in memory; the first row is row 0.

    Args:
        origin: Name of the object in messages, such as "the DataFrame".
        columns: Pairs of a header and its values, which are converted to arrays when they are loaded.
        time_format: Format of time stamps that are texts.
    """

    first_row = 0
    drop_option = "drop_bad_rows=True"

    def __init__(self, origin: str, columns: Sequence[tuple[Any, Any]], time_format: str | None = None):
        self.origin = origin
        if not columns:
            cure = "give it columns such as 'time [s]' and 'current [A]'"
            raise InputError(f"{origin}: there is no column: {cure}")
        self.headers: tuple[str, ...] = tuple(str(header).strip() for header, _ in columns)
        self._values = [values for _, values in columns]
        self._digest = ""
        self.stamps: Mapping[int, StampColumn] = {
            k: stamp for k, values in enumerate(self._values) if (stamp := _stamps(values, time_format))
        }

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return copies of the columns, so that later changes of the object do not change the recording."""
        rows = max(
            (len(self._values[index]) for index in indices if hasattr(self._values[index], "__len__")), default=0
        )
        refuse_if_too_large(self.origin, rows, len(indices))
        columns = [self._column(index, lenient) for index in indices]
        headers = [self.headers[index] for index in indices]
        for header, column in zip(headers, columns, strict=True):
            if len(column) != len(columns[0]):
                lengths = f"column '{header}' has {len(column)} values and '{headers[0]}' {len(columns[0])}"
                raise InputError(f"{self.origin}: {lengths}: give every column one value per row")
        if not len(columns[0]):
            raise InputError(f"{self.origin}: there are columns and no rows: record at least two rows of data")
        columns = self.unwrap_stamps(indices, columns)
        self._digest = content_sha256(headers, columns)
        return columns

    def sha256(self) -> str:
        """Return the SHA-256 of the columns that were loaded, with their headers."""
        return self._digest

    def _column(self, index: int, lenient: bool) -> np.ndarray:
        header = self.headers[index]
        place = f"{self.origin}: column '{header}'"
        values = _to_array(self._values[index], place)
        if values.ndim != 1:
            shape = "a single value" if values.ndim == 0 else f"an array of shape {values.shape}"
            raise InputError(f"{place}: this is {shape} and not a vector: give one value per row")
        if index in self.stamps and len(values):
            values = self._seconds(index, values, lenient)
        if values.dtype.kind not in "iuf" and len(values):
            raise InputError(self._type_error(header, values))
        numbers = np.array(values, float)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            problem = f"the value {numbers[bad[0]]} is not a finite number"
            cell = f"row {bad[0]}, column '{header}'"
            raise InputError(f"{self.origin}: {cell}: {problem}: {repair_hint(self.drop_option)}")
        numbers[bad] = np.nan
        return numbers

    def _seconds(self, index: int, values: np.ndarray, lenient: bool) -> np.ndarray:
        """Return time stamps as seconds since the first; NaN where there is none."""
        kind = getattr(getattr(self._values[index], "dtype", None), "kind", "")
        if values.dtype.kind == "O" and kind == "M":  # dates of pandas with a time zone
            values = np.asarray(self._values[index], dtype="datetime64[ns]")
        if values.dtype.kind in "mM":
            return seconds_of_times(values)
        stamps = self.stamps[index]
        cells = [str(cell).strip() if isinstance(cell, str | np.str_) else cell for cell in values.tolist()]
        seconds = [stamps.seconds(cell) for cell in cells]
        if None in seconds and not lenient:
            row = seconds.index(None)
            cell = f"row {row}, column '{self.headers[index]}'"
            problem = f"{shortened(repr(cells[row]))} is not a time stamp like the first"
            raise InputError(f"{self.origin}: {cell}: {problem}: {repair_hint(self.drop_option)}")
        return np.array([np.nan if second is None else second for second in seconds])

    def _type_error(self, header: str, values: np.ndarray) -> str:
        """Return the sentence for a column that does not hold real numbers, with its first such value if it has one."""
        cure = "convert it to floats in the unit of its header, as in astype(float)"
        if values.dtype.kind not in "OUST":
            return (
                f"{self.origin}: column '{header}': the values are of type {values.dtype} and not real numbers: {cure}"
            )
        others = [k for k, value in enumerate(values) if not isinstance(value, _NUMBERS) or isinstance(value, bool)]
        if not others:
            return f"{self.origin}: column '{header}': the numbers are stored as objects: {cure}"
        shown = shortened(repr(values[others[0]] if values.dtype.kind == "O" else str(values[others[0]])))
        return f"{self.origin}: row {others[0]}, column '{header}': {shown} is not a number: correct it, and {cure}"


def open_memory_table(
    source: Any,
    name: str | None = None,
    headers: Sequence[str] | None = None,
    has_time: bool = False,
    time_format: str | None = None,
) -> MemoryTable:
    """Return an object in memory as a table.

    Args:
        source: A DataFrame, a pyarrow table, a mapping of headers to values, a structured array, or with ``headers``
            an array of shape (rows, columns). An index of dates (counted from the first) or durations is a column
            ``time [s]`` unless a column is the time; another index is a column if it has a name.
        name: Name of the recording, for messages.
        headers: Headers of the columns of an array.
        has_time: Whether a column of another header is the time, so that the index is not needed.
        time_format: Format of time stamps that are texts.

    Raises:
        InputError: If the object is not a table.
    """
    kind, columns = _columns(source, headers, has_time)
    return MemoryTable(f"the {kind}" if name is None else f"{name} ({kind})", columns, time_format)


def _stamps(values: Any, time_format: str | None) -> StampColumn | None:
    """Return the reader of a column of dates, durations or time stamps; ``None`` for another column."""
    kind = getattr(getattr(values, "dtype", None), "kind", "")
    if kind and kind in "mM":
        return StampColumn(None, datetime.date.min)
    if kind and kind in "iufbc":
        return None
    try:
        cells = list(itertools.islice(values, ROWS_WITH_STAMPS))
    except TypeError:  # a single value
        return None
    cells = [cell.as_py() if hasattr(cell, "as_py") else cell for cell in cells]
    if any(isinstance(cell, np.datetime64 | np.timedelta64 | datetime.timedelta) for cell in cells):
        return StampColumn(None, datetime.date.min)
    return find_stamps([[str(c).strip() if isinstance(c, str | np.str_) else c] for c in cells], time_format).get(0)


def content_sha256(headers: Sequence[str], columns: Sequence[np.ndarray]) -> str:
    """Return the SHA-256 of columns of float64 with their headers, in hexadecimal."""
    digest = hashlib.sha256()
    for header, column in zip(headers, columns, strict=True):
        digest.update(f"{header}\n{len(column)}\n".encode())
        digest.update(np.ascontiguousarray(column, "<f8").data)
    return digest.hexdigest()


def _columns(source: Any, headers: Sequence[str] | None, has_time: bool) -> tuple[str, list[tuple[Any, Any]]]:
    """Return the kind of an object, in a word, and its columns."""
    kind, columns = "", []
    if isinstance(source, Mapping):
        kind, columns = "dictionary", list(source.items())
    elif names := getattr(getattr(source, "dtype", None), "names", None):
        kind, columns = "structured array", [(name, source[name]) for name in names]
    elif hasattr(source, "columns") and hasattr(source, "iloc"):  # pandas, where two columns may have one header
        kind, columns = "DataFrame", [(header, source.iloc[:, k]) for k, header in enumerate(source.columns)]
        columns = _index_column(source.index, columns, has_time) + columns
    elif hasattr(source, "column_names") and hasattr(source, "column"):  # pyarrow
        kind, columns = "table", [(header, source.column(k)) for k, header in enumerate(source.column_names)]
    elif hasattr(source, "columns") and hasattr(source, "get_column"):  # polars
        kind, columns = "DataFrame", [(header, source.get_column(header)) for header in source.columns]
    if kind and headers is not None:
        raise InputError(f"the {kind}: only the columns of plain arrays and text files can be named: leave out headers")
    return (kind, columns) if kind else ("array", _array_columns(source, headers))


def _array_columns(source: Any, headers: Sequence[str] | None) -> list[tuple[Any, Any]]:
    """Return the columns of an array of shape (rows, columns)."""
    array: Any = _to_array(source, "the array") if isinstance(source, list) and headers is not None else source
    shape = getattr(array, "shape", None)
    if not isinstance(shape, tuple) or not hasattr(array, "__array__"):
        raise InputError(f"a recording cannot be read from an object of type {type(source).__name__}: {TAKES}")
    if headers is None:
        cure = "add headers=['time [s]', 'current [A]', ...], or give a dictionary of columns"
        raise InputError(f"the array: its columns have no names: {cure}")
    if len(shape) != 2 or shape[1] != len(headers):
        problem = f"its shape is {shape}, and {len(headers)} columns are named"
        raise InputError(f"the array: {problem}: give it the shape (rows, {len(headers)}), or a name per column")
    return [(header, array[:, k]) for k, header in enumerate(headers)]


def _index_column(index: Any, columns: Sequence[tuple[Any, Any]], has_time: bool) -> list[tuple[Any, Any]]:
    """Return the index of a DataFrame as a column: a list of one, or of none if the index only counts the rows."""
    if getattr(index, "nlevels", 1) > 1:
        raise InputError("the DataFrame: its index has several levels: make them columns with reset_index()")
    kind = getattr(index.dtype, "kind", "O")
    if kind not in "mM":
        return [] if index.name is None else [(index.name, index)]
    if has_time or any(str(header).partition("[")[0].strip() == "time" for header, _ in columns):
        return []
    stamps = np.asarray(index, dtype="datetime64[ns]" if kind == "M" else "timedelta64[ns]")
    durations = stamps - stamps[0] if kind == "M" and len(stamps) else stamps
    return [(_INDEX_HEADER, durations / np.timedelta64(1, "ns") / _NANOSECONDS_PER_SECOND if len(stamps) else [])]


def _to_array(values: Any, place: str) -> np.ndarray:
    """Return values as an array, without a copy where possible; missing ones are NaN."""
    try:
        if np.ma.isMaskedArray(values) and values.dtype.kind in "iuf":
            return np.ma.filled(values.astype(float), np.nan)
        array = np.asarray(values)
        if array.dtype.kind == "O" and getattr(getattr(values, "dtype", None), "kind", "O") in "iuf":
            array = cast(Any, values).to_numpy(dtype=float, na_value=np.nan)  # a nullable column of pandas
    except Exception as error:  # each package has its own types of errors, as has a list of unequal lists
        if is_tracing_error(error):
            raise traced_values_error(place) from None
        raise InputError(
            f"{place}: the values are not an array ({first_line(error)}): give one number per row"
        ) from None
    return array
