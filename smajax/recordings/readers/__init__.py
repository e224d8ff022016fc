"""Readers of files as tables of numbers, by file name extension.

CSV and text, JSON, MATLAB .mat, Parquet, Excel .xlsx, TDMS, ROS bags and MCAP.

Each format has one module with a subclass of ``Table``; it is imported when a file of that format is opened.
"""

from pathlib import Path

from smajax.errors import InputError
from smajax.recordings.paths import check_name, similar_name, unreadable
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table

TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".log")
JSON_SUFFIXES = (".jsonl", ".ndjson", ".json")
TOPIC_SUFFIXES = (".mcap", ".bag", ".db3")
SUFFIXES = (
    *TEXT_SUFFIXES[:2],
    ".mat",
    ".parquet",
    ".xlsx",
    *JSON_SUFFIXES,
    ".tdms",
    *TOPIC_SUFFIXES,
    *TEXT_SUFFIXES[2:],
)


def open_tables(path: Path, options: ReadOptions) -> list[Table]:
    """Open a file as tables, one for each sheet that is read: read the headers, but not yet the numbers.

    Args:
        path: The file.
        options: Options of reading.

    Raises:
        InputError: If the file is missing, or cannot be read as a table.
    """
    check_file(path)
    suffix = path.suffix.lower()
    try:
        if suffix in TEXT_SUFFIXES:
            from smajax.recordings.readers.csv import CsvTable

            return [CsvTable(path, options)]
        if suffix == ".xlsx":
            from smajax.recordings.readers.xlsx import open_sheets

            return [*open_sheets(path, options)]
        if suffix in JSON_SUFFIXES:
            from smajax.recordings.readers.json import JsonTable

            return [JsonTable(path, options)]
        if suffix == ".mat":
            from smajax.recordings.readers.mat import MatTable

            return [MatTable(path, options)]
        if suffix == ".parquet":
            from smajax.recordings.readers.parquet import ParquetTable

            return [ParquetTable(path, options)]
        if suffix == ".tdms":
            from smajax.recordings.readers.tdms import open_groups

            return [*open_groups(path, options)]
        if suffix in TOPIC_SUFFIXES:
            from smajax.recordings.readers.topics import TopicTable

            if options.columns is not None:
                cure = "map its fields under [channels] in the rig"
                problem = f"columns cannot be named in files ending in {suffix}, which name their fields"
                raise InputError(f"{path}: {problem}: {cure}", code="columns-named", cure=cure)

            return [TopicTable(path, options)]
    except OSError as error:
        raise unreadable(path, error) from None
    raise AssertionError(f"no reader of {suffix}")


def check_file(path: Path) -> None:
    """Refuse a path without a file, an empty file, and a file of another kind.

    Args:
        path: The file.

    Raises:
        InputError: If there is no such recording.
    """
    check_name(path)
    try:
        if not path.exists():
            raise InputError(f"{path}: there is no such file{similar_name(path)}: check the path")
        if not path.is_file():
            kind = "a folder" if path.is_dir() else "not a regular file"
            raise InputError(f"{path}: this is {kind}: name a recording, a file ending in {', '.join(SUFFIXES)}")
        if path.stat().st_size == 0:
            cure = "record a header like 'time [s],current [A]' and rows of numbers"
            raise InputError(f"{path}: the file is empty: {cure}")
    except OSError as error:
        raise unreadable(path, error) from None
    if path.suffix.lower() not in SUFFIXES:
        cure = f"save the recording as {', '.join(SUFFIXES)}"
        raise InputError(f"{path}: files ending in '{path.suffix}' are not read: {cure}")


__all__ = ["SUFFIXES", "Table", "check_file", "open_tables"]
