"""Reader of Parquet files, whose columns are named like the headers of a CSV file; needs pyarrow, the extra ``io``."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, final

import numpy as np

from smajax.errors import InputError, first_line
from smajax.recordings.readers.base import Table, file_sha256, refuse_if_too_large, row_error


def pyarrow_parquet(path: Path, instead: str = ", or use CSV") -> Any:
    """Return pyarrow's Parquet module.

    Args:
        path: The file, for the message.
        instead: Alternative for the user, as the end of the sentence.

    Raises:
        InputError: If pyarrow is not installed.
    """
    try:
        import pyarrow.parquet
    except ImportError:
        raise InputError(f'{path}: Parquet files need pyarrow: run pip install "smajax[io]"{instead}') from None
    return pyarrow.parquet


@final
class ParquetTable(Table):
    """Columns of a Parquet file; the first record is row 1."""

    first_row = 1

    def __init__(self, path: Path):
        self.path = path
        parquet = pyarrow_parquet(path)
        try:
            self._file = parquet.ParquetFile(path)
        except Exception as error:  # pyarrow raises many types of errors for damaged files
            raise InputError(
                f"{path}: the file is not readable as Parquet ({first_line(error)}): write it again, or use CSV"
            ) from None
        self.headers: tuple[str, ...] = tuple(str(name).strip() for name in self._file.schema_arrow.names)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return columns of numbers."""
        rows = self._file.metadata.num_rows
        refuse_if_too_large(self.path, rows, len(indices))
        if not rows:
            raise InputError(f"{self.path}: the table has columns and no rows: record at least two rows of data")
        return [self._column(index, lenient) for index in indices]

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _column(self, index: int, lenient: bool) -> np.ndarray:
        import pyarrow

        place = f"{self.path}: column '{self.headers[index]}'"
        kind = self._file.schema_arrow.field(index).type
        if not (pyarrow.types.is_integer(kind) or pyarrow.types.is_floating(kind) or pyarrow.types.is_decimal(kind)):
            raise InputError(f"{place}: the values are of type {kind} and not numbers: store them as float64")
        try:
            values = (
                self._file.read(columns=[self._file.schema_arrow.names[index]])
                .column(0)
                .cast(pyarrow.float64(), safe=False)
            )
        except Exception as error:  # as above: the damage may be in the pages of the column
            raise InputError(
                f"{place}: the values cannot be read ({first_line(error)}): write the file again, or use CSV"
            ) from None
        numbers = np.array(values.to_numpy(), float)
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            cell = f"row {bad[0] + 1}, column '{self.headers[index]}'"
            raise row_error(f"{self.path}: {cell}: the cell is blank or not finite")
        numbers[bad] = np.nan
        return numbers
