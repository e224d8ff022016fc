"""Reader of MATLAB .mat files: vectors named like the channels, the fields of a struct, or the columns of a matrix.

The units are those in the rig file, or in a struct ``units`` of the file with one text per channel:
``units.current = 'A'``. The columns of a matrix are named by the option ``columns``; ``variable`` says which matrix or
struct is read where there are several.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import final

import numpy as np

from smajax.errors import InputError, suggestion
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import Table, file_sha256, refuse_if_too_large, row_error
from smajax.recordings.readers.mat4 import Mat4Variables
from smajax.recordings.readers.mat5 import Mat5Variables, is_version_5
from smajax.recordings.readers.mat73 import Mat73Variables, is_version_73
from smajax.recordings.readers.mat_variables import MatVariable, MatVariables, cells_error, object_error

_UNITS = "units"


@final
class MatTable(Table):
    """Vectors, or the columns of a matrix, of a MATLAB file; the first sample is row 1.

    Args:
        path: The file.
        options: Options of reading.
    """

    first_row = 1

    def __init__(self, path: Path, options: ReadOptions):
        self.path = path
        self._file: MatVariables = _open(path)
        self._matrix: str | None = None
        variables = self._without_units(self._file.children())
        if not variables:
            cure = "save one vector per channel, such as time and current"
            raise InputError(f"{path}: the file has no variables: {cure}")
        name, variable = self._chosen(variables, options)
        if variable is not None and variable.kind == "numbers":
            self._name_matrix(name, variable, options)
            return
        if options.columns is not None:
            cure = 'leave columns out, or name a matrix, as in variable = "data"'
            message = f"{path}: columns name those of a matrix, and the file has no single matrix: {cure}"
            raise InputError(message, code="columns-named", cure=cure)
        if name:
            variables = self._without_units(self._file.children(name))
        if not variables:
            raise InputError(f"{path}: the struct '{name}' has no fields: save one vector per channel, such as time")
        prefix = f"{name}." if name else ""
        self._vectors = {f"{prefix}{key}": vector for key, vector in variables.items()}
        units = self._units(prefix)
        self.headers: tuple[str, ...] = tuple(f"{key} [{units[key]}]" if key in units else key for key in variables)

    def load(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        """Return vectors, or columns of the matrix."""
        if self._matrix is not None:
            return self._load_matrix(indices, lenient)
        names = [list(self._vectors)[index] for index in indices]
        refuse_if_too_large(self.path, max((self._vectors[name].size for name in names), default=0), len(names))
        columns = [self._column(name, lenient) for name in names]
        for name, column in zip(names, columns, strict=True):
            if len(column) != len(columns[0]):
                raise InputError(
                    f"{self.path}: variable '{name}' has {len(column)} values and '{names[0]}' {len(columns[0])}: "
                    "give every channel one value per sample"
                )
        return columns

    def sha256(self) -> str:
        """Return the SHA-256 of the file in hexadecimal."""
        return file_sha256(self.path)

    def _without_units(self, variables: dict[str, MatVariable]) -> dict[str, MatVariable]:
        return {name: v for name, v in variables.items() if name != _UNITS and not name.startswith("__")}

    def _chosen(self, variables: dict[str, MatVariable], options: ReadOptions) -> tuple[str, MatVariable | None]:
        """Return the matrix or struct whose columns or fields are read; none for the vectors of the file."""
        if options.variable is not None:
            return options.variable, self._by_name(variables, options.variable)
        matrices = [name for name, v in variables.items() if v.is_matrix]
        structs = [name for name, v in variables.items() if v.kind == "struct"]
        numbers = [name for name, v in variables.items() if v.kind == "numbers"]
        objects = [name for name, v in variables.items() if v.kind == "object"]
        cells = {name: v for name, v in variables.items() if v.is_cells}
        choice = ""
        if len(variables) == 1 and (matrices or structs):
            choice = next(iter(variables))
        elif options.columns is not None and len(matrices) == 1:
            choice = matrices[0]
        elif options.columns is not None and matrices:
            cure = f'name one of them, as in variable = "{matrices[0]}" under [recording] in the rig'
            message = f"{self.path}: columns are named, and the matrices are {', '.join(matrices)}: {cure}"
            raise InputError(message, code="mat-variable", cure=cure, variable=matrices[0])
        elif not numbers and structs:
            cure = f'name one of them, as in variable = "{structs[0]}" under [recording] in the rig'
            message = f"{self.path}: there is no vector, and the structs are {', '.join(structs)}: {cure}"
            raise InputError(message, code="mat-variable", cure=cure, variable=structs[0])
        elif not numbers and cells:
            raise cells_error(self.path, cells)
        elif not numbers and objects:
            raise object_error(f"{self.path}: variable '{objects[0]}'", variables[objects[0]])
        if choice:
            self.notes = (f"the {'columns' if matrices else 'fields'} of variable '{choice}' were read",)
        return choice, variables.get(choice)

    def _by_name(self, variables: dict[str, MatVariable], name: str) -> MatVariable:
        """Return the variable of the option ``variable``, which may be a field of a struct."""
        path: list[str] = []
        variable = MatVariable("struct", (1, 1), "struct")
        for part in name.split("."):
            if path:
                variables = self._file.children(".".join(path)) if variable.kind == "struct" else {}
            if part not in variables:
                where = f"variable '{'.'.join(path)}' has no field" if path else "there is no variable"
                has = f"it has {', '.join(variables)}" if variables else "it is no struct"
                hint = suggestion(part, variables)
                raise InputError(f"{self.path}: {where} '{part}'{hint}: {has}, so correct variable")
            variable = variables[part]
            path.append(part)
        if variable.kind == "object":
            raise object_error(f"{self.path}: variable '{name}'", variable)
        if variable.is_cells:
            raise cells_error(self.path, {name: variable})
        if variable.kind not in ("numbers", "struct"):
            problem = f"its values are not real numbers (type {variable.class_name})"
            raise InputError(f"{self.path}: variable '{name}': {problem}: name a matrix or a struct by variable")
        if variable.kind == "struct" and variable.size != 1:
            problem = f"it is an array of {variable.size} structs"
            raise InputError(f"{self.path}: variable '{name}': {problem}: save one vector per field")
        return variable

    def _name_matrix(self, name: str, variable: MatVariable, options: ReadOptions) -> None:
        """Name the columns of a matrix, or its rows where only their number is that of the names."""
        place = f"{self.path}: variable '{name}'"
        shape = variable.shape if len(variable.shape) != 1 else (variable.size, 1)
        if len(shape) != 2:
            problem = f"it is an array with {len(shape)} dimensions"
            raise InputError(f"{place}: {problem}: save a matrix with one column per channel")
        size = f"the matrix has {shape[0]} rows and {shape[1]} columns"
        if options.columns is None:
            cure = 'set columns = ["time [s]", "current [A]", ...] under [recording] in the rig'
            raise InputError(f"{place}: {size} without names: {cure}", code="columns-missing", cure=cure)
        count = len(options.columns)
        if count not in shape:
            cure = "name every column, with - for one to leave out"
            message = f"{place}: {size}, and {count} columns are named: {cure}"
            raise InputError(message, code="columns-count", cure=cure)
        self._matrix, self._shape = name, shape
        self._by_rows = shape[1] != count
        if self._by_rows:
            self.notes: tuple[str, ...] = (
                *self.notes,
                f"the rows of variable '{name}' were read as columns, since it has {shape[0]} of them",
            )
        self.headers = options.columns

    def _load_matrix(self, indices: Sequence[int], lenient: bool) -> list[np.ndarray]:
        count = self._shape[1] if self._by_rows else self._shape[0]
        refuse_if_too_large(self.path, count, len(self.headers))
        values = self._file.values(self._matrix or "").reshape(self._shape)
        columns = [np.array(values[index] if self._by_rows else values[:, index], float) for index in indices]
        return [self._finite(c, self.headers[i], lenient) for i, c in zip(indices, columns, strict=True)]

    def _units(self, prefix: str) -> dict[str, str]:
        """Return the units by channel in the struct ``units`` next to the vectors, or in that of the file."""
        names = [
            n
            for n in (f"{prefix}{_UNITS}", _UNITS)
            if n.rpartition(".")[2] in self._file.children(n.rpartition(".")[0])
        ]
        if not names:
            return {}
        fields = self._file.children(names[0].rpartition(".")[0])
        is_struct = fields[_UNITS].kind == "struct" and fields[_UNITS].size == 1
        texts = self._file.children(names[0]) if is_struct else {}
        if not is_struct or any(unit.kind != "text" for unit in texts.values()):
            problem = f"variable '{names[0]}' is not a struct with one text per channel"
            raise InputError(f"{self.path}: {problem}: set units.time = 's' and so on")
        return {name: self._file.text(f"{names[0]}.{name}") for name in texts}

    def _column(self, name: str, lenient: bool) -> np.ndarray:
        place, variable = f"{self.path}: variable '{name}'", self._vectors[name]
        if variable.kind == "object":
            raise object_error(place, variable)
        if variable.kind == "struct":
            cure = f'name it by variable = "{name}" under [recording] in the rig, or save its fields as vectors'
            message = f"{place}: this is a struct and not a vector: {cure}"
            raise InputError(message, code="mat-variable", cure=cure, variable=name)
        if variable.is_cells:
            raise cells_error(self.path, {name: variable})
        if variable.kind != "numbers":
            problem = f"the values are not real numbers (type {variable.class_name})"
            raise InputError(f"{place}: {problem}: save a vector of doubles")
        if not variable.size:
            raise InputError(f"{place}: the vector is empty: record at least two samples")
        if not variable.is_vector:
            problem = f"the array of shape {variable.shape} is not a vector"
            cure = f'save one vector per channel, or set variable = "{name}" and columns = ["time [s]", ...]'
            cure += " under [recording] in the rig"
            raise InputError(f"{place}: {problem}: {cure}", code="mat-matrix", cure=cure, variable=name)
        return self._finite(np.array(self._file.values(name), float).ravel(), name, lenient)

    def _finite(self, numbers: np.ndarray, name: str, lenient: bool) -> np.ndarray:
        """Return numbers, with NaN for those that are not finite, or refuse these."""
        bad = np.flatnonzero(~np.isfinite(numbers))
        if bad.size and not lenient:
            raise row_error(f"{self.path}: row {bad[0] + 1}, column '{name}': the value is not finite")
        numbers[bad] = np.nan
        return numbers


def _open(path: Path) -> MatVariables:
    """Return the variables of a file of any version."""
    if is_version_73(path):
        return Mat73Variables(path)
    return Mat5Variables(path) if is_version_5(path) else Mat4Variables(path)
