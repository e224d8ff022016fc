"""Variables of a MATLAB file of any version: the kind and the values of each one."""

import abc
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smajax.errors import InputError

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
