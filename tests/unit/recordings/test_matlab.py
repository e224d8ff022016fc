"""MATLAB files: vectors, structs and matrices of version 5 by scipy and of version 7.3 by h5py."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import scipy.io

from smajax.errors import InputError
from smajax.recordings.read import read_recording
from smajax.recordings.recording import Recording

TIME, CURRENT, STROKE = np.arange(5.0), np.linspace(0.0, 2.0, 5), np.linspace(0.0, 3.0, 5)
COLUMNS = ("time [s]", "current [A]", "displacement [mm]")
MATRIX = np.column_stack([TIME, CURRENT, STROKE])
VECTORS = {"time": TIME, "current": CURRENT, "displacement": STROKE}
UNITS = {"time": "s", "current": "A", "displacement": "mm"}


def write_5(path: Path, variables: dict[str, Any]) -> None:
    scipy.io.savemat(path, variables, do_compression=True)


def write_73(path: Path, variables: dict[str, Any]) -> None:
    """Writes what MATLAB writes for save(..., '-v7.3'): arrays with their dimensions reversed, structs as groups."""

    def write(group: h5py.Group, name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, part in value.items():
                write(group.create_group(name) if name not in group else group[name], key, part)
            group[name].attrs["MATLAB_class"] = np.bytes_("struct")
            return
        if isinstance(value, np.ndarray) and value.dtype == object:  # cells: references to data of their own
            cells = [group.file.create_dataset(f"#refs#/{name}{k}", data=cell).ref for k, cell in enumerate(value.flat)]
            references = group.create_dataset(name, value.T.shape, h5py.ref_dtype)
            references[...] = np.array(cells, object).reshape(value.T.shape)
            references.attrs["MATLAB_class"] = np.bytes_("cell")
            return
        codes = np.array([[ord(c)] for c in value], np.uint16) if isinstance(value, str) else None
        data = codes if codes is not None else np.atleast_2d(np.asarray(value, float)).T
        group.create_dataset(name, data=data).attrs["MATLAB_class"] = np.bytes_(
            "char" if codes is not None else "double"
        )

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, value in variables.items():
            write(file, name, value)
    content = path.read_bytes()
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + content[128:])


WRITERS = {"version 5": write_5, "version 7.3": write_73}


@pytest.fixture(params=WRITERS)
def read(request, tmp_path, monkeypatch):
    """Writes variables to wire.mat in each version, and reads them."""
    monkeypatch.chdir(tmp_path)

    def call(variables: dict[str, Any], **options: Any) -> Recording:
        WRITERS[request.param](Path("wire.mat"), variables)
        return read_recording("wire.mat", **options)

    return call


def assert_is_the_recording(recording: Recording) -> None:
    np.testing.assert_array_equal(recording.time, TIME)
    np.testing.assert_array_equal(recording.channels["current"], CURRENT)
    np.testing.assert_allclose(recording.channels["displacement"], STROKE / 1000, rtol=1e-15)


LAYOUTS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "vectors": ({**VECTORS, "units": UNITS}, {}),
    "struct with its units": ({"run": {**VECTORS, "units": UNITS}}, {}),
    "one struct of two": ({"run1": VECTORS, "run2": {"time": TIME}, "units": UNITS}, {"variable": "run1"}),
    "struct in a struct": ({"log": {"a": VECTORS, "b": {"time": TIME}}, "units": UNITS}, {"variable": "log.a"}),
    "only matrix": ({"data": MATRIX}, {"columns": COLUMNS}),
    "matrix with one channel a row": ({"data": MATRIX.T}, {"columns": COLUMNS}),
    "matrix next to vectors": ({"data": MATRIX, "k": 3.0}, {"columns": COLUMNS}),
    "one matrix of two": ({"raw": MATRIX + 1, "data": MATRIX}, {"columns": COLUMNS, "variable": "data"}),
    "matrix of a struct": ({"run": {"data": MATRIX}}, {"columns": COLUMNS, "variable": "run.data"}),
    "column left out": ({"data": np.column_stack([MATRIX, TIME])}, {"columns": (*COLUMNS, "-")}),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_gives_the_same_recording(read, layout):
    variables, options = LAYOUTS[layout]
    assert_is_the_recording(read(variables, **options))


def test_what_was_chosen_is_noted(read):
    notes = read({"data": MATRIX.T}, columns=COLUMNS).notes
    assert notes[0] == "the columns of variable 'data' were read" and notes[1].startswith("the rows of variable 'data'")


CELLS = np.empty((1, 2), object)
CELLS[0, :] = [TIME, CURRENT]
REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any], str]] = {
    "no names": ({"data": MATRIX}, {}, "wire.mat: variable 'data': the matrix has 5 rows and 3 columns without names: set columns ="),
    "other number of names": ({"data": MATRIX}, {"columns": COLUMNS[:2]}, "variable 'data': the matrix has 5 rows and 3 columns, and 2 columns are named: name every column"),
    "two matrices": ({"raw": MATRIX, "data": MATRIX}, {"columns": COLUMNS}, "name one of them, as in variable = "),
    "two structs": ({"run1": VECTORS, "run2": VECTORS}, {}, "there is no vector, and the structs are run1, run2: name one of them, as in variable = \"run1\""),
    "misspelt variable": ({"data": MATRIX, "k": 1.0}, {"columns": COLUMNS, "variable": "date"}, "there is no variable 'date' (did you mean 'data'?): it has data, k, so correct variable"),
    "misspelt field": ({"run": {"data": MATRIX}}, {"columns": COLUMNS, "variable": "run.date"}, "variable 'run' has no field 'date' (did you mean 'data'?)"),
    "names of vectors": ({**VECTORS, "units": UNITS}, {"columns": COLUMNS}, "columns name those of a matrix, and the file has no single matrix: leave columns out"),
    "bad cell of a matrix": ({"data": np.where(MATRIX == 1.5, np.nan, MATRIX)}, {"columns": COLUMNS}, "wire.mat: row 4, column 'current [A]': the value is not finite: correct it, or leave such rows out"),
    "cells": ({"A": CELLS, "B": CELLS}, {}, "wire.mat: variables A, B are cell arrays, the first of 1 x 2: save the vectors of one recording under the names of their channels, as in MATLAB by temperature = A{1}; strain = B{1}; save('run1.mat', 'temperature', 'strain')"),
    "cells of a struct": ({"run": {"T": CELLS, "k": TIME}}, {"variable": "run.T"}, "variable 'run.T' is a cell array of "),
    "cells next to vectors": ({**VECTORS, "temperature": CELLS, "units": {**UNITS, "temperature": "degC"}}, {}, "variable 'temperature' is a cell array of 1 x 2: save"),
    "text": ({"note": "a b", **VECTORS}, {"variable": "note"}, "variable 'note': its values are not real numbers (type "),
    "struct as a channel": ({**VECTORS, "force": {"x": TIME}, "units": {**UNITS, "force": "N"}}, {}, "variable 'force': this is a struct and not a vector: name it by variable = \"force\""),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_the_option(read, fault):
    variables, options, sentence = REFUSED[fault]
    with pytest.raises(InputError) as refusal:
        read(variables, **options)
    assert str(refusal.value).startswith("wire.mat: ") and sentence in str(refusal.value)


def test_bad_rows_of_a_matrix_are_dropped(read):
    recording = read({"data": np.where(MATRIX == 1.5, np.nan, MATRIX)}, columns=COLUMNS, drop_bad_rows=True)
    assert recording.time.tolist() == [0.0, 1.0, 4.0]


def opaque(name: str, class_name: str) -> bytes:
    """The variable of an object as MATLAB writes it to version 5: flags of class 17, and three names."""

    def element(kind: int, data: bytes) -> bytes:
        return np.array([kind, len(data)], "<u4").tobytes() + data + bytes(-len(data) % 8)

    names = b"".join(element(1, text.encode()) for text in (name, "MCOS", class_name))
    return element(14, element(6, np.array([17, 0], "<u4").tobytes()) + names)


@pytest.mark.parametrize(
    ("class_name", "cure"),
    [("timetable", "t = seconds(x.Time - x.Time(1))"), ("timeseries", "x.Data of a timeseries x")],
)
def test_objects_of_version_5_are_refused_where_they_are_needed(tmp_path, monkeypatch, class_name, cure):
    monkeypatch.chdir(tmp_path)
    scipy.io.savemat("head.mat", {})
    head = Path("head.mat").read_bytes()[:128]
    Path("wire.mat").write_bytes(head + opaque("log", class_name))
    with pytest.raises(InputError) as refusal:
        read_recording("wire.mat")
    message = str(refusal.value)
    assert message.startswith(f"wire.mat: variable 'log': this is a {class_name}, which only MATLAB can decode: ")
    assert cure in message
    scipy.io.savemat("vectors.mat", {**VECTORS, "units": UNITS})
    Path("wire.mat").write_bytes(Path("vectors.mat").read_bytes() + opaque("log", class_name))
    assert_is_the_recording(read_recording("wire.mat", ignore=["log"]))


def test_objects_of_version_73_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_73(Path("wire.mat"), {"log": np.arange(6.0)})
    with h5py.File("wire.mat", "a") as file:
        file["log"].attrs["MATLAB_class"] = np.bytes_("table")
        file["log"].attrs["MATLAB_object_decode"] = 3
    with pytest.raises(
        InputError, match="this is a table, which only MATLAB can decode: .* or write it with writetable"
    ):
        read_recording("wire.mat")


def test_a_missing_package_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_73(Path("wire.mat"), VECTORS)
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    with pytest.raises(InputError, match=r'need h5py: run pip install "smajax\[io\]", or save it with'):
        read_recording("wire.mat")
