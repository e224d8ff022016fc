"""Variables of a MATLAB file of any version: the kind and the values of each one."""

import abc
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from smajax.errors import InputError

# What is said where the bytes of a file do not have its format.
DAMAGED = "it is damaged"

Kind = Literal["numbers", "text", "struct", "object", "other"]


@dataclass(frozen=True)
class MatVariable:
    """What a variable is.

    Attributes:
        kind: Real numbers, a text, a struct, an object of a class that only MATLAB decodes, or another.
        shape: Its shape in MATLAB.
        class_name: Class in MATLAB, such as ``double`` or ``timetable``.
    """

    kind: Kind
    shape: tuple[int, ...]
    class_name: str

    @property
    def is_cells(self) -> bool:
        """Whether it is a cell array."""
        return self.class_name == "cell"

    @property
    def is_vector(self) -> bool:
        """Whether it has at most one dimension above 1."""
        return sum(size > 1 for size in self.shape) <= 1 and self.size > 0

    @property
    def is_matrix(self) -> bool:
        """Whether it is a matrix with several rows and columns."""
        return self.kind == "numbers" and len(self.shape) == 2 and min(self.shape) > 1

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape, dtype=float))


class MatVariables(abc.ABC):
    """Variables of a file; those of a struct have names like ``run.current``."""

    @abc.abstractmethod
    def children(self, name: str = "") -> dict[str, MatVariable]:
        """Return the variables of the file, or the fields of a struct, by the last part of their names.

        Args:
            name: Name of the struct; empty for the file.
        """

    @abc.abstractmethod
    def values(self, name: str) -> np.ndarray:
        """Return the values of a variable with real numbers, in the shape that it has in MATLAB.

        Args:
            name: Name of the variable.
        """

    @abc.abstractmethod
    def text(self, name: str) -> str:
        """Return the value of a variable with a text.

        Args:
            name: Name of the variable.
        """


def cells_error(path: Path, variables: Mapping[str, MatVariable]) -> InputError:
    """Return the error of cell arrays, of which each cell may be a vector of another recording.

    Args:
        path: The file.
        variables: The cell arrays.
    """
    names = list(variables)
    shape = " x ".join(str(size) for size in variables[names[0]].shape)
    listed = f"variable '{names[0]}' is a cell array of {shape}" if len(names) == 1 else ""
    listed = listed or f"variables {', '.join(names)} are cell arrays, the first of {shape}"
    pairs = list(zip(("temperature", "strain"), names[-2:], strict=False))
    vectors = "".join(f"{channel} = {name}{{1}}; " for channel, name in pairs)
    saved = ", ".join(f"'{channel}'" for channel, _ in pairs)
    cure = f"save the vectors of one recording under the names of their channels, as in MATLAB by {vectors}"
    cure += f"save('run1.mat', {saved})"
    return InputError(f"{path}: {listed}: {cure}", code="mat-cells", cure=cure)


def object_error(place: str, variable: MatVariable) -> InputError:
    """Return the error of a variable that only MATLAB can decode.

    Args:
        place: The file and the variable.
        variable: The variable.
    """
    problem = f"this is a {variable.class_name}, which only MATLAB can decode"
    cure = "save its columns as vectors, as in t = seconds(x.Time - x.Time(1)) of a timetable x"
    if variable.class_name == "timeseries":
        cure = "save time = x.Time and force = x.Data of a timeseries x as vectors"
    if variable.class_name == "table":
        cure = "save its columns as vectors, as in force = x.force of a table x, or write it with writetable"
    return InputError(f"{place}: {problem}: {cure}", code="mat-object", cure=cure)
