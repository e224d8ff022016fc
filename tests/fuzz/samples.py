"""Small valid files of each format, which the mutations begin with, and the options that each is read with."""

import dataclasses
import io
import json
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import nptdms
import numpy as np
import openpyxl
import pyarrow
import pyarrow.parquet
import scipy.io
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from smajax.recordings.column_mapping import ChannelMap

ROWS = 12
TIME = np.arange(ROWS) * 0.5
CURRENT = np.linspace(0.1, 0.6, ROWS)
STROKE = np.linspace(0.0, 3.0, ROWS)
COLUMNS = {"time [s]": TIME, "current [A]": CURRENT, "displacement [mm]": STROKE}
VECTORS = {"time": TIME, "current": CURRENT, "displacement": STROKE}
UNITS = {"time": "s", "current": "A", "displacement": "mm"}
MATRIX = np.column_stack([TIME, CURRENT, STROKE])
START = 1_700_000_000_000_000_000


@dataclasses.dataclass(frozen=True)
class Sample:
    """A valid file.

    Attributes:
        suffix: Ending of its name.
        content: Its bytes.
        options: Arguments of ``read_recordings``.
    """

    suffix: str
    content: bytes
    options: Mapping[str, Any] = dataclasses.field(default_factory=dict)


def _csv(delimiter: str = ",", decimal: str = ".", encoding: str = "utf-8", end: str = "\n") -> bytes:
    rows = [delimiter.join(COLUMNS)]
    rows += [delimiter.join(f"{value:.3f}".replace(".", decimal) for value in row) for row in MATRIX]
    return end.join([*rows, ""]).encode(encoding)


def _stamped_csv() -> bytes:
    rows = [f"2024-03-01 12:00:{k // 2:02d}.{5 * (k % 2)},{c:.3f},{d:.3f}" for k, (_, c, d) in enumerate(MATRIX)]
    return "\n".join([",".join(["time", *list(COLUMNS)[1:]]), *rows, ""]).encode()


def _written(suffix: str, write: Callable[[Path], Any]) -> bytes:
    """Return what a function writes to a path."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"wire{suffix}"
        write(path)
        if path.is_dir():  # a bag of ROS 2
            path = next(path.glob(f"*{suffix}"))
        return path.read_bytes()


def _mat(variables: dict[str, Any], **options: Any) -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, variables, **options)
    return stream.getvalue()


def _mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in VECTORS.items():
            chunks = {"chunks": (1, 6), "compression": "gzip"} if name == "current" else {}
            file.create_dataset(name, data=values[None, :], **chunks).attrs["MATLAB_class"] = np.bytes_("double")
        units = file.create_group("units")
        units.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, unit in UNITS.items():
            codes = np.array([[ord(c)] for c in unit], np.uint16)
            units.create_dataset(name, data=codes).attrs["MATLAB_class"] = np.bytes_("char")
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + content[128:])


def _parquet(**options: Any) -> bytes:
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(COLUMNS), stream, **options)
    return stream.getvalue()


def _xlsx(sheets: int = 1) -> bytes:
    book = openpyxl.Workbook()
    book.remove(book.active)
    for number in range(sheets):
        sheet = book.create_sheet(f"run {number + 1}")
        sheet.append(list(COLUMNS))
        for row in MATRIX.tolist():
            sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return stream.getvalue()


def _tdms(path: Path) -> None:
    wave = {"wf_increment": 0.5, "wf_start_offset": 0.0, "wf_start_time": np.datetime64("2024-03-01T12:00:00")}
    with nptdms.TdmsWriter(path) as writer:
        for part in (slice(0, 6), slice(6, ROWS)):
            writer.write_segment(
                [
                    nptdms.ChannelObject("Bench", "current", CURRENT[part], properties={"unit_string": "A", **wave}),
                    nptdms.ChannelObject(
                        "Bench", "displacement", STROKE[part], properties={"unit_string": "mm", **wave}
                    ),
                ]
            )


def _mcap(compression: CompressionType) -> bytes:
    stream = io.BytesIO()
    writer = Writer(stream, compression=compression, enable_crcs=False)
    writer.start()
    schema = writer.register_schema("bench", "jsonschema", b'{"type": "object"}')
    channel = writer.register_channel("/drive", "json", schema)
    for k, (_, current, stroke) in enumerate(MATRIX.tolist()):
        stamp = START + k * 500_000_000
        writer.add_message(channel, stamp, json.dumps({"current": current, "stroke": stroke}).encode(), stamp)
    writer.finish()
    return stream.getvalue()


def _bag(path: Path, version: int) -> None:
    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    message = store.types["geometry_msgs/msg/Vector3"]
    writer = Writer1(path) if version == 1 else Writer2(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connection = writer.add_connection("/drive", message.__msgtype__, typestore=store)
        for k, (_, current, stroke) in enumerate(MATRIX.tolist()):
            content = message(x=current, y=stroke, z=0.0)
            encode = store.serialize_ros1 if version == 1 else store.serialize_cdr
            writer.write(connection, START + k * 500_000_000, encode(content, message.__msgtype__))


def _mapping(current: str, stroke: str) -> dict[str, Any]:
    return {
        "mapping": {
            "current": ChannelMap(f"/drive.{current}", "A"),
            "displacement": ChannelMap(f"/drive.{stroke}", "mm"),
        }
    }


def _make_samples() -> dict[str, list[Sample]]:
    rows = [dict(zip(COLUMNS, row, strict=True)) for row in MATRIX.tolist()]
    lines = "".join(json.dumps(row) + "\n" for row in rows).encode()
    columns = json.dumps({name: values.tolist() for name, values in COLUMNS.items()}).encode()
    structs = {"run": {**VECTORS, "units": UNITS}}
    names = {"columns": tuple(COLUMNS)}
    bag = _mapping("x", "y")
    return {
        "csv": [
            Sample(".csv", _csv()),
            Sample(".csv", _csv(";", ",", end="\r\n"), {"delimiter": ";", "decimal": ","}),
            Sample(".csv", _csv(encoding="utf-16")),
            Sample(".csv", _stamped_csv()),
            Sample(".csv", b"a title\n" + _csv(), {"skip_rows": 1}),
        ],
        "json": [Sample(".jsonl", lines), Sample(".json", columns), Sample(".json", json.dumps(rows).encode())],
        "mat4": [
            Sample(".mat", _mat(VECTORS, format="4"), {"mapping": {n: ChannelMap(n, u) for n, u in UNITS.items()}}),
            Sample(".mat", _mat({"data": MATRIX}, format="4"), names),
        ],
        "mat5": [
            Sample(".mat", _mat({**VECTORS, "units": UNITS})),
            Sample(".mat", _mat({**VECTORS, "units": UNITS}, do_compression=True)),
            Sample(".mat", _mat(structs)),
            Sample(".mat", _mat(structs, do_compression=True)),
            Sample(".mat", _mat({"data": MATRIX, "k": 3}), names),
        ],
        "mat73": [Sample(".mat", _written(".mat", _mat73))],
        "parquet": [
            Sample(".parquet", _parquet()),
            Sample(".parquet", _parquet(compression="none", use_dictionary=False)),
            Sample(".parquet", _parquet(compression="zstd", data_page_version="2.0")),
        ],
        "xlsx": [Sample(".xlsx", _xlsx()), Sample(".xlsx", _xlsx(2), {"sheet": "all"})],
        "tdms": [Sample(".tdms", _written(".tdms", _tdms))],
        "mcap": [Sample(".mcap", _mcap(kind), _mapping("current", "stroke")) for kind in CompressionType],
        "bag": [Sample(".bag", _written(".bag", lambda path: _bag(path, 1)), bag)],
        "db3": [Sample(".db3", _written(".db3", lambda path: _bag(path, 2)), bag)],
    }


SAMPLES: Mapping[str, list[Sample]] = _make_samples()
