"""Damaged and hostile files of each format: read whole, or refused in one sentence before they cost time or memory."""

import contextlib
import io
import os
import re
import struct
import time
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import h5py
import numpy as np
import openpyxl
import pandas
import pyarrow.parquet
import pytest
import scipy.io

from smajax.errors import InputError
from smajax.recordings.read import read_recording, read_recordings
from smajax.recordings.recognition.recognise import recognise
from tests.fuzz.samples import COLUMNS, MATRIX, ROWS, SAMPLES, UNITS, VECTORS, Sample

# Seconds of processor time in which a small file is refused.
AT_ONCE = 5.0
SHEET = "xl/worksheets/sheet1.xml"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def refused(name: str, content: bytes, **options: object) -> str:
    """The sentence with which a file is refused at once, by the reader and by the import."""
    Path(name).write_bytes(content)
    begin = time.process_time()
    with pytest.raises(InputError) as refusal:
        read_recordings(name, **options)
    with contextlib.suppress(InputError):
        recognise(Path(name), {}, {})
    assert time.process_time() - begin < AT_ONCE
    assert str(refusal.value).startswith(name)
    return str(refusal.value)


def changed_workbook(change: Callable[[dict[str, bytes]], object], sample: Sample = SAMPLES["xlsx"][0]) -> bytes:
    """A workbook after a change of its parts."""
    with zipfile.ZipFile(io.BytesIO(sample.content)) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    change(parts)
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in parts.items():
            archive.writestr(name, part)
    return stream.getvalue()


def replaced(pattern: bytes, new: bytes) -> Callable[[dict[str, bytes]], object]:
    def change(parts: dict[str, bytes]) -> None:
        assert re.search(pattern, parts[SHEET])
        parts[SHEET] = re.sub(pattern, new, parts[SHEET], count=1)

    return change


@pytest.mark.parametrize("dimension", [b'ref="A1:C4"', b'ref="A1"', b'ref="A1:XFD1048576"', b'ref="B2:B3"', None])
def test_all_rows_of_a_sheet_are_read_whatever_its_dimension_says(dimension):
    new = b"" if dimension is None else b"<dimension " + dimension + b"/>"
    Path("wire.xlsx").write_bytes(changed_workbook(replaced(rb"<dimension[^>]*>", new)))
    recording = read_recording("wire.xlsx")
    np.testing.assert_allclose(
        recording.channels["current"], COLUMNS["current [A]"], rtol=1e-14
    )  # 16 digits are written


def last_row(number: int) -> Callable[[dict[str, bytes]], object]:
    return replaced(rb'<row r="13"', f'<row r="{number}"'.encode())


HOSTILE_ENTITIES = (
    b'<!DOCTYPE a [<!ENTITY a "'
    + b"x" * 1000
    + b'">'
    + b"".join(
        f'<!ENTITY a{k} "{f"&a{k - 1 if k > 1 else chr(0)};".replace(chr(0), "") * 20}">'.encode() for k in range(1, 9)
    )
    + b"]>"
)
WORKBOOKS: dict[str, tuple[Callable[[dict[str, bytes]], object], str]] = {
    "row beyond the last": (last_row(2_000_000_000), "row 2000000000 is not one of 1 to 1048576"),
    "row without a number": (replaced(b'<row r="13"', b'<row r="last"'), "not readable as a workbook"),
    "row of number 0": (last_row(0), "row 0 is not one of 1 to 1048576"),
    "row out of order": (last_row(5), "row 5 comes after row 12"),
    "repeated row": (last_row(12), "row 12 comes after row 12"),
    "column beyond the last": (replaced(b'r="C13"', b'r="ZZZ13"'), "row 13 has 18278 columns, above 16384"),
    "cell of another row": (replaced(b'r="C13"', b'r="C2"'), "a cell of row 2 is in row 13"),
    "no sheet": (lambda parts: parts.pop(SHEET), "there is no part for its sheet 'run 1'"),
    "entities": (replaced(b"<worksheet", HOSTILE_ENTITIES + b"<worksheet"), f"its part '{SHEET}' has a document type"),
    "no element": (lambda parts: parts.update({SHEET: b"<!-- " + b"x" * 2**18 + b" -->"}), "does not begin with an element"),
    "compression": (
        lambda parts: parts.update({SHEET: parts[SHEET] + b" " * 2**25}),
        f"its part '{SHEET}' of ",
    ),
    "long digits": (replaced(b"<v>0.1</v>", b"<v>" + b"1" * 5000 + b"</v>"), "not readable as a workbook"),
}  # fmt: skip


@pytest.mark.parametrize("fault", WORKBOOKS)
def test_damaged_workbooks_are_refused(fault):
    change, sentence = WORKBOOKS[fault]
    assert sentence in refused("wire.xlsx", changed_workbook(change))


@pytest.mark.parametrize("part", [name for name in zipfile.ZipFile(io.BytesIO(SAMPLES["xlsx"][0].content)).namelist()])
def test_a_workbook_without_one_of_its_parts_is_read_whole_or_refused(part):
    Path("wire.xlsx").write_bytes(changed_workbook(lambda parts: parts.pop(part)))
    with contextlib.suppress(InputError):
        assert len(read_recording("wire.xlsx")) == ROWS


def test_a_missing_sheet_among_others_is_named():
    content = changed_workbook(lambda parts: parts.pop("xl/worksheets/sheet2.xml"), SAMPLES["xlsx"][1])
    assert "there is no part for its sheet 'run 2'" in refused("wire.xlsx", content, sheet="all")


def test_sheets_with_different_columns_are_imported_one_by_one():
    def change(parts: dict[str, bytes]) -> None:
        parts["xl/worksheets/sheet2.xml"] = re.sub(
            rb'<c r="C\d+".*?</c>', b"", parts["xl/worksheets/sheet2.xml"], flags=re.DOTALL
        )

    Path("wire.xlsx").write_bytes(changed_workbook(change, SAMPLES["xlsx"][1]))
    sentence = "wire.xlsx: sheet 'run 2' has other columns than 'run 1': import them one by one, each named by --sheet"
    with pytest.raises(InputError, match=sentence):
        recognise(Path("wire.xlsx"), {}, {"sheet": ("all",)})
    assert len(recognise(Path("wire.xlsx"), {}, {"sheet": ("run 2",)}).columns) == 2


def test_a_part_that_states_a_huge_size_is_refused_before_it_is_unpacked():
    content = bytearray(changed_workbook(lambda parts: None))
    directory = content.index(b"PK\1\2")
    content[directory + 24 : directory + 28] = struct.pack("<I", 2**32 - 2)  # the size of the first part
    assert "GiB, above the limit" in refused("wire.xlsx", bytes(content))


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(name: str, *content: bytes, class_number: int = 6, shape: tuple[int, ...] = (3, 1)) -> bytes:
    """The data element of an array of version 5."""
    flags, dimensions = struct.pack("<II", class_number, 0), struct.pack(f"<{len(shape)}i", *shape)
    return element(14, element(6, flags) + element(5, dimensions) + element(1, name.encode()) + b"".join(content))


def compressed(data: bytes) -> bytes:
    packed = zlib.compress(data)
    return struct.pack("<II", 15, len(packed)) + packed


def version_5(*elements: bytes) -> bytes:
    return SAMPLES["mat5"][0].content[:128] + b"".join(elements)


NUMBERS = element(9, struct.pack("<3d", 0, 1, 2))
TIME = matrix("time", NUMBERS)
DEEP = matrix("", NUMBERS)
for _ in range(200):
    DEEP = matrix(
        "", element(5, struct.pack("<i", 8)), element(1, b"a".ljust(8, b"\0")), DEEP, class_number=2, shape=(1, 1)
    )
ARRAYS: dict[str, tuple[bytes, str]] = {
    "type of numbers": (matrix("current", element(65, bytes(24))), "it is damaged"),
    "type of numbers, compressed": (compressed(matrix("current", element(65, bytes(24)))), "it is damaged"),
    "matrix as numbers": (matrix("current", element(14, b"")), "it is damaged"),
    "fewer numbers": (matrix("current", element(9, bytes(8))), "another number of values than its shape (3, 1)"),
    "length beyond the end": (struct.pack("<II", 14, 2**31) + TIME[8:], "it is damaged"),
    "inner length beyond the end": (matrix("current", struct.pack("<II", 9, 2**30)), "it is damaged"),
    "negative shape": (matrix("current", NUMBERS, shape=(-3, -1)), "an array has no shape"),
    "no shape": (matrix("current", NUMBERS, shape=()), "an array has no shape"),
    "huge shape": (matrix("current", NUMBERS, shape=(2**31 - 1, 2**31 - 1)), "it is damaged"),
    "huge compressed shape": (compressed(matrix("current", NUMBERS, shape=(2**31 - 1, 1))), "above the limit of 2 GiB"),
    "compressed data cut": (compressed(matrix("current", NUMBERS))[:-9], "not readable as MATLAB data"),
    "compressed data changed": (compressed(TIME)[:-1] + b"\1", "not readable as MATLAB data"),
    "length above that of compressed data": (compressed(struct.pack("<II", 14, 2**30 - 9) + TIME[8:]), "not readable as MATLAB data"),
    "compressed element in another": (compressed(compressed(TIME)), "a compressed data element of type 15"),
    "bomb": (compressed(struct.pack("<II", 14, 2**31 - 16) + matrix("current")[8:] + bytes(2**22)), "above the limit of 2 GiB"),
    "deep structs": (DEEP, "structs are nested more than 32 times"),
    "deep compressed structs": (compressed(matrix("current", DEEP[8:])), "it is damaged"),
    "names of fields": (matrix("units", element(5, struct.pack("<i", -1)), element(1, b"a"), class_number=2, shape=(1, 1)), "names of a struct's fields are damaged"),
}  # fmt: skip


@pytest.mark.parametrize("fault", ARRAYS)
def test_damaged_arrays_of_matlab_are_refused(fault):
    array, sentence = ARRAYS[fault]
    units = matrix_of_units()
    message = refused("wire.mat", version_5(TIME, array, units) if b"units" not in array else version_5(TIME, array))
    assert sentence in message or "another number of values" in message, message


def matrix_of_units() -> bytes:
    stream = io.BytesIO()
    scipy.io.savemat(stream, {"units": UNITS})
    return stream.getvalue()[128:]


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("options", [{}, {"do_compression": True}, {"format": "4"}], ids=["5", "7", "4"])
def test_variables_of_matlab_are_those_that_scipy_reads(seed, options):
    """Vectors and matrices of all types of numbers, structs, texts, cells and complex numbers."""
    from smajax.recordings.readers.mat4 import Mat4Variables
    from smajax.recordings.readers.mat5 import Mat5Variables

    random = np.random.default_rng(seed)
    is_4 = options.get("format") == "4"
    types = (
        ("f8", "f4", "i4", "i2", "u2", "u1") if is_4 else ("f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")
    )

    def array() -> np.ndarray:
        shape = tuple(random.integers(0, 5, size=2 if is_4 else random.integers(1, 4)))
        return (random.random(shape) * 100).astype(random.choice(types))

    variables = {f"v{k}": array() for k in range(5)} | {"t": "text mm", "c": np.array([[1 + 2j, 3]])}
    if not is_4:
        cells = np.empty((1, 2), object)
        cells[0, :] = [array(), "x"]
        variables |= {"s": {"a": array(), "b": {"c": array(), "t": "µm"}}, "cells": cells, "n": "°C"}
    scipy.io.savemat("wire.mat", variables, **options)
    expected = scipy.io.loadmat("wire.mat")
    file = (Mat4Variables if is_4 else Mat5Variables)(Path("wire.mat"))
    found = file.children()
    assert set(found) == set(variables)
    for name in (name for name in variables if name.startswith("v")):
        assert found[name].kind == "numbers" and found[name].shape == expected[name].shape
        np.testing.assert_array_equal(file.values(name), expected[name])
    assert file.text("t") == "text mm" and found["c"].kind == "other"
    if not is_4:
        struct_value = expected["s"][0, 0]
        np.testing.assert_array_equal(file.values("s.a"), struct_value["a"])
        np.testing.assert_array_equal(file.values("s.b.c"), struct_value["b"][0, 0]["c"])
        assert (file.text("s.b.t"), file.text("n"), found["cells"].is_cells) == ("µm", "°C", True)


def test_files_that_matlab_wrote_are_read_as_scipy_reads_them():
    """The files of scipy's own tests, of many versions and systems, which its package has."""
    from smajax.recordings.readers.mat import _open

    paths = sorted((Path(scipy.io.__file__).parent / "matlab" / "tests" / "data").glob("test*.mat"))
    if not paths:
        pytest.skip("this scipy was installed without its tests")
    compared = 0
    for path in paths:
        if "hdf5" in path.name:
            continue
        with warnings.catch_warnings():  # SciPy 1.18 announces another class of sparse matrices
            warnings.simplefilter("ignore", DeprecationWarning)
            file, expected = _open(path), scipy.io.loadmat(path)
        for name, variable in file.children().items():
            if variable.kind == "numbers":
                assert variable.shape == expected[name].shape
                np.testing.assert_array_equal(file.values(name), expected[name])
                compared += 1
    assert compared > 25


def test_a_column_of_parquet_with_fewer_values_than_rows_is_refused():
    stream = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(COLUMNS), stream, compression="none", use_dictionary=False)
    content = stream.getvalue()
    sentences = []
    for at in range(4, 500):  # the headers of the pages are among these bytes
        for value in (0, 0x7F):
            Path("wire.parquet").write_bytes(content[:at] + bytes([value]) + content[at + 1 :])
            try:
                assert len(read_recording("wire.parquet")) == ROWS
            except InputError as error:
                sentences.append(str(error))
    assert any("it has 0 values, and the table 12 rows" in text for text in sentences), sorted(set(sentences))


def test_values_of_other_files_are_not_read():
    with h5py.File("other.h5", "w") as file:
        file["current"] = VECTORS["current"]
    with h5py.File("wire.mat", "w") as file:
        file["time"] = VECTORS["time"]
        file["current"] = h5py.ExternalLink("other.h5", "current")
    assert "the values of 'current' are not in the file" in refused("wire.mat", Path("wire.mat").read_bytes())


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no pipes with names")
def test_a_soft_link_does_not_lead_to_another_file():
    Path("inside.mat").write_bytes(SAMPLES["mat73"][0].content)
    with h5py.File("other.h5", "w") as file:
        file["x"] = VECTORS["displacement"][None, :]
    with h5py.File("inside.mat", "r+") as file:
        del file["displacement"]
        file["#other"] = h5py.ExternalLink("other.h5", "/")
        file["displacement"] = h5py.SoftLink("/#other/x")
    assert "'displacement' are not in the file" in refused("inside.mat", Path("inside.mat").read_bytes())


@pytest.mark.parametrize("compressor", [["gzip"], ["gzip", "fletcher32"]], ids="-".join)
def test_a_chunk_that_inflates_to_more_than_its_values_is_refused(compressor):
    Path("chunk.mat").write_bytes(SAMPLES["mat73"][0].content)
    with h5py.File("chunk.mat", "r+") as file:
        del file["time"]
        options = {"compression": "gzip", "fletcher32": "fletcher32" in compressor}
        values = file.create_dataset("time", data=VECTORS["time"][None, :], chunks=(1, ROWS), **options)
        assert read_whole("chunk.mat", file)
        deflater = zlib.compressobj(9)
        zeros = [deflater.compress(bytes(2**20)) for _ in range(256)]
        values.id.write_direct_chunk((0, 0), b"".join([*zeros, deflater.flush()]))
    assert "does not unpack to its" in refused("chunk.mat", Path("chunk.mat").read_bytes())


def test_a_compression_that_matlab_does_not_use_is_refused():
    Path("chunk.mat").write_bytes(SAMPLES["mat73"][0].content)
    with h5py.File("chunk.mat", "r+") as file:
        del file["time"]
        file.create_dataset("time", data=VECTORS["time"][None, :], compression="lzf")
    assert "in a way that MATLAB does not use" in refused("chunk.mat", Path("chunk.mat").read_bytes())


def read_whole(name: str, file: h5py.File) -> bool:
    """Whether the times of a file that is being written are read as they are."""
    file.flush()
    Path(f"copy-{name}").write_bytes(Path(name).read_bytes())
    recording = read_recording(f"copy-{name}", required=("current",), observed=("displacement",))
    return recording.time.tolist() == VECTORS["time"].tolist()


def test_a_chunk_far_larger_than_its_values_is_refused():
    Path("chunk.mat").write_bytes(SAMPLES["mat73"][0].content)
    with h5py.File("chunk.mat", "r+") as file:
        del file["time"]
        options = {"chunks": (1, 2**22), "maxshape": (None, None), "compression": "gzip", "fillvalue": 0.0}
        file.create_dataset("time", shape=(1, ROWS), dtype="f8", **options)
    assert "a chunk of 33554432 bytes has values of 96 bytes" in refused("chunk.mat", Path("chunk.mat").read_bytes())


def test_styles_that_inflate_a_thousandfold_are_refused_at_once():
    def repeat(parts: dict[str, bytes]) -> None:
        parts["xl/styles.xml"] = parts["xl/styles.xml"].replace(
            b"<cellXfs", b"<cellXfs>" + b"<xf/>" * 500_000 + b"</cellXfs><cellXfs"
        )

    assert "its part 'xl/styles.xml'" in refused("styles.xlsx", changed_workbook(repeat))


def test_a_pipe_is_refused_without_waiting_for_its_other_end():
    from smajax.files.rig_file import read_rig

    os.mkfifo("rig.toml")
    with pytest.raises(InputError, match="rig.toml: this is not a regular file"):
        read_rig("rig.toml")


def cells_of_a_sheet(content: bytes) -> dict[str, object]:
    """The cells of the first sheet by their places, read from its XML without a package for workbooks."""
    space = "{http://schemas.openxmlformats.org/spreadsheetml/2006/main}"
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        shared = "xl/sharedStrings.xml"
        has_shared = shared in archive.namelist()
        texts = ElementTree.fromstring(archive.read(shared)).findall(f"{space}si") if has_shared else []
        sheet = ElementTree.fromstring(archive.read(SHEET))
    cells: dict[str, object] = {}
    for cell in sheet.iter(f"{space}c"):
        value = cell.findtext(f"{space}v")
        if cell.get("t") == "inlineStr":
            cells[cell.attrib["r"]] = "".join(cell.itertext())
        elif value is not None:
            is_text = cell.get("t") == "s"
            cells[cell.attrib["r"]] = "".join(texts[int(value)].itertext()) if is_text else float(value)
    return cells


@pytest.mark.parametrize("seed", range(20))
def test_sheets_are_read_as_their_xml_says(seed):
    """Sheets of random sizes with blank rows and cells, bare numbers and numbers as texts."""
    random = np.random.default_rng(seed)
    book = openpyxl.Workbook()
    names = ["time [s]", "current [A]", "displacement [mm]", "force [N]"][: random.integers(2, 5)]
    book.active.append(names)
    for row in range(2, random.integers(10, 80)):
        if random.random() < 0.1:
            continue  # a row that the file leaves out
        for column in range(1, len(names) + 1):
            number = float(row) if column == 1 else float(random.normal())
            if random.random() < 0.95:
                book.active.cell(row, column, str(number) if random.random() < 0.2 else number)
    book.save("wire.xlsx")
    cells = cells_of_a_sheet(Path("wire.xlsx").read_bytes())
    rows = max(int(re.sub("[A-Z]", "", place)) for place in cells)
    table = [[cells.get(f"{letter}{row}") for letter in "ABCD"[: len(names)]] for row in range(1, rows + 1)]
    assert [str(name) for name in table[0]] == names
    whole = [[float(cell) for cell in row] for row in table[1:] if None not in row]
    recording = read_recording("wire.xlsx", drop_bad_rows=True)
    assert len(recording) == len(whole)
    expected = np.array(whole)
    np.testing.assert_array_equal(recording.time, expected[:, 0])
    np.testing.assert_array_equal(recording.channels["current"], expected[:, 1])
    blank = next((number for number, row in enumerate(table[1:], 2) if None in row), None)
    if blank is not None:
        with pytest.raises(InputError, match=f"row {blank}, column '.*': the cell is blank"):
            read_recording("wire.xlsx")


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("suffix", [".csv", ".json", ".parquet"])
def test_tables_are_read_as_pandas_reads_them(seed, suffix):
    random = np.random.default_rng(seed)
    rows = int(random.integers(2, 300))
    scale = 10.0 ** random.integers(-2, 1)
    frame = pandas.DataFrame(
        {"time [s]": np.cumsum(random.random(rows) + 1e-3), "current [A]": scale * random.normal(size=rows)}
    )
    if suffix == ".csv":
        frame.to_csv("wire.csv", index=False, float_format=str(random.choice(["%.17g", "%.6e", "%.4f"])))
        expected = pandas.read_csv("wire.csv")
    elif suffix == ".json":
        frame.to_json("wire.json", orient=str(random.choice(["records", "columns"])), double_precision=15)
        expected = pandas.read_json("wire.json", precise_float=True)
    else:
        frame.to_parquet("wire.parquet", row_group_size=50)
        expected = pandas.read_parquet("wire.parquet")
    recording = read_recording(f"wire{suffix}")
    np.testing.assert_allclose(recording.time, expected["time [s]"], rtol=1e-14)
    np.testing.assert_allclose(recording.channels["current"], expected["current [A]"], rtol=1e-14)


@pytest.mark.parametrize("kind", SAMPLES)
def test_each_sample_is_read_with_the_values_that_another_package_wrote(kind):
    for number, sample in enumerate(SAMPLES[kind]):
        name = f"wire{number}{sample.suffix}"
        Path(name).write_bytes(sample.content)
        with warnings.catch_warnings(action="ignore"):
            recordings = read_recordings(name, required=("current",), observed=("displacement",), **sample.options)
        for recording in recordings:
            np.testing.assert_allclose(recording.time, MATRIX[:, 0], rtol=1e-9)
            np.testing.assert_allclose(recording.channels["current"], MATRIX[:, 1], atol=5e-4)
            np.testing.assert_allclose(recording.channels["displacement"], MATRIX[:, 2] / 1000, atol=5e-7)
