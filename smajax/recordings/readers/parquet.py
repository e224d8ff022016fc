"""Reader of Parquet files, whose columns are named like the headers of a CSV file."""

import datetime
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table, file_sha256, number_error, refuse_if_too_large, row_error
from smajax.recordings.readers.header_rows import replaced_headers
from smajax.recordings.readers.time_stamps import ROWS_WITH_STAMPS, StampColumn, find_stamps, seconds_of_times

# Name that pandas gives the index of a DataFrame without a name.
_INDEX = re.compile(r"__index_level_\d+__")


@final
class ParquetTable(Table):
    """Columns of a Parquet file; the first record is row 1.

    Args:
        path: The file.
        options: Options of reading.
    """

    first_row = 1

    def __init__(self, path: Path, options: ReadOptions):
        self.path = path
        self._decimal = options.decimal
        import pyarrow.parquet

        try:
            self._file = pyarrow.parquet.ParquetFile(path)
        except Exception as error:  # pyarrow raises many types of errors for damaged files
            raise InputError(
                f"{path}: the file is not readable as Parquet ({first_line(error)}): write it again, or use CSV"
            ) from None
        names = [str(name).strip() for name in self._file.schema_arrow.names]
        self.headers: tuple[str, ...] = replaced_headers(path, names, options)
        self.stamps: Mapping[int, StampColumn] = self._find_stamps(options)
        index = [k for k in self.stamps if _INDEX.fullmatch(self.headers[k])]
        if index:
            self.implied_time: int | None = index[0]
            self.headers = tuple("time" if k == index[0] else header for k, header in enumerate(self.headers))

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers."""
        rows = self._file.metadata.num_rows
        refuse_if_too_large(self.path, rows, len(indices))
        if not rows:
            raise InputError(f"{self.path}: the table has columns and no rows: record at least two rows of data")
        return self.unwrap_stamps(indices, [self._column(index, lenient) for index in indices])

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _find_stamps(self, options: ReadOptions) -> dict[int, StampColumn]:
        """Return readers of the columns with dates, durations, times of day, or texts that are time stamps."""
        import pyarrow

        types = pyarrow.types
        stamps: dict[int, StampColumn] = {}
        for index, field in enumerate(self._file.schema_arrow):
            kind = field.type
            if types.is_temporal(kind):
                stamps[index] = StampColumn(None, datetime.time() if types.is_time(kind) else datetime.date.min)
            elif types.is_string(kind) or types.is_large_string(kind):
                texts = self._first_texts(index)
                column = find_stamps([[text and text.strip()] for text in texts], options.time_format).get(0)
                stamps |= {index: column} if column else {}
        return stamps

    def _first_texts(self, index: int) -> list[str | None]:
        name = self._file.schema_arrow.names[index]
        try:
            batch = next(self._file.iter_batches(batch_size=ROWS_WITH_STAMPS, columns=[name]), None)
        except Exception:  # a damaged column is named when it is read
            return []
        return [] if batch is None else batch.column(0).to_pylist()

    def _read(self, index: int) -> Any:
        """Return a column of pyarrow, which in a damaged file may have fewer values than the table has rows."""
        rows = self._file.metadata.num_rows
        try:
            values = self._file.read(columns=[self._file.schema_arrow.names[index]]).column(0)
            problem = f"it has {len(values)} values, and the table {rows} rows" if len(values) != rows else ""
        except Exception as error:  # as above: the damage may be in the pages of the column
            values, problem = None, first_line(error)
        if problem:
            place = f"{self.path}: column '{self.headers[index]}'"
            raise InputError(f"{place}: the values cannot be read ({problem}): write the file again, or use CSV")
        return values

    def _column(self, index: int, lenient: bool) -> np.ndarray:
        import pyarrow

        types, kind = pyarrow.types, self._file.schema_arrow.field(index).type
        stamps = self.stamps.get(index)
        is_text = types.is_string(kind) or types.is_large_string(kind)
        if stamps is not None and is_text:
            texts = [text.strip() if text else "" for text in self._read(index).to_pylist()]
            seconds = [stamps.seconds(text) for text in texts]
            if None in seconds and not lenient:
                row = seconds.index(None)
                place = f"{self.path}: row {row + 1}, column '{self.headers[index]}'"
                raise number_error(place, texts[row], self._decimal)
            return np.array([np.nan if second is None else second for second in seconds])
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or stamps is not None):
            place = f"{self.path}: column '{self.headers[index]}'"
            raise InputError(f"{place}: the values are of type {kind} and not numbers: store them as float64")
        values = self._read(index)
        if stamps is not None:
            numbers = _seconds(values, kind)
        else:
            numbers = np.array(values.cast(pyarrow.float64(), safe=False).to_numpy(), float)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            cell = f"row {bad[0] + 1}, column '{self.headers[index]}'"
            raise row_error(f"{self.path}: {cell}: the cell is blank or not finite")
        numbers[bad] = np.nan
        return numbers


def _seconds(values: Any, kind: Any) -> np.ndarray:
    """Return dates and times of day of pyarrow in seconds since the first one, and durations in seconds."""
    import pyarrow

    if pyarrow.types.is_time(kind):
        unit = "s" if str(kind).endswith("[s]") else str(kind)[-3:-1]
        width = pyarrow.int32() if pyarrow.types.is_time32(kind) else pyarrow.int64()
        values = values.cast(width).cast(pyarrow.int64()).cast(pyarrow.duration(unit))
    times = values.to_numpy()
    seconds = seconds_of_times(times if times.dtype.kind in "mM" else times.astype("datetime64[ns]"))
    readable = np.flatnonzero(np.isfinite(seconds))
    return seconds - seconds[readable[0]] if readable.size and not pyarrow.types.is_duration(kind) else seconds
