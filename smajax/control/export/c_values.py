"""Values of a C program that is written from a trace: scalar expressions, and views of flat arrays."""

from typing import Any, Literal, NamedTuple

import numpy as np

Kind = Literal["real", "int", "flag"]
C_TYPES = {"real": "smajax_real", "int": "int", "flag": "int"}
# Whole numbers up to this size are written without a cast: they are exact in single precision, too.
_MAX_PLAIN_INTEGER = 1000.0


class CValue(NamedTuple):
    """A value of a C program.

    Attributes:
        text: Expression of a scalar, which may be used as an operand as it is; or the name of a flat array.
        shape: Shape in the trace.
        kind: Kind of number.
        index: Positions of its elements in the flat array, shape ``(size,)``; ``None`` if all are the same scalar.
        number: Its value if it is a constant scalar.
        sources: Names of the members of the state on which it depends.
        offset: Expression that is added to the positions; empty for 0.
    """

    text: str
    shape: tuple[int, ...]
    kind: Kind
    index: np.ndarray | None = None
    number: Any = None
    sources: frozenset[str] = frozenset()
    offset: str = ""

    @property
    def size(self) -> int:
        """Number of elements."""
        return int(np.prod(self.shape, dtype=int))

    @property
    def variable(self) -> str:
        """Name of the variable or array whose value, element or elements it is."""
        return self.text.partition("[")[0]

    @property
    def steps(self) -> tuple[int, int] | None:
        """First position and distance of the positions; ``None`` if they are not evenly spaced."""
        if self.index is None or self.index.size < 2:
            return (0 if self.index is None or not self.index.size else int(self.index[0])), 0
        distances = np.diff(self.index)
        return (int(self.index[0]), int(distances[0])) if np.all(distances == distances[0]) else None

    @property
    def is_whole_array(self) -> bool:
        """Whether it is a flat array from its first to its last element in their order."""
        return self.index is not None and self.steps == (0, 1 if self.size > 1 else 0)

    def has_same_places(self, other: "CValue") -> bool:
        """Return whether another value has the same positions."""
        if self.index is None or other.index is None:
            return self.index is None and other.index is None
        return np.array_equal(self.index, other.index)

    def element(self, place: int) -> str:
        """Return the expression of one element by its position in the value."""
        return self.text if self.index is None else f"{self.text}[{_sum(self.offset, str(int(self.index[place])))}]"

    def element_at(self, counter: str) -> str:
        """Return the expression of the element at a counter of a loop; the positions have to be evenly spaced."""
        if self.index is None:
            return self.text
        assert self.steps is not None
        first, distance = self.steps
        times = counter if distance == 1 else f"{distance} * {counter}" if distance else ""
        return f"{self.text}[{_sum(self.offset, str(first) if first or not times else '', times)}]"

    def broadcast(self, shape: tuple[int, ...]) -> "CValue":
        """Return the value with its axes of length 1 repeated; a scalar stays one.

        Args:
            shape: Shape of the result.
        """
        if self.shape in ((), shape):
            return self
        return self.view(shape, np.broadcast_to(np.arange(self.size).reshape(self.shape), shape))

    def view(self, shape: tuple[int, ...], places: np.ndarray) -> "CValue":
        """Return some of the elements as a value of another shape.

        Args:
            shape: Shape of the result.
            places: Positions of the elements in this value, of that shape.
        """
        if self.index is None:
            return self._replace(shape=shape)
        flat = self.index[np.asarray(places).ravel()]
        view = self._replace(shape=shape, index=flat)
        if len(flat) == 1 and not shape:
            return CValue(view.element(0), shape, self.kind, sources=self.sources)
        return view


def _sum(*parts: str) -> str:
    """A sum of expressions without those that are 0."""
    terms = [part for part in parts if part and part != "0"]
    return " + ".join(terms) if terms else "0"


def kind_of_dtype(dtype: Any) -> Kind:
    """Return the kind of number of a data type."""
    return {"b": "flag", "f": "real"}.get(np.dtype(dtype).kind, "int")  # pyright: ignore[reportReturnType]


def constant_scalar(value: Any) -> CValue:
    """Return a finite constant as a value.

    Args:
        value: A number, an integer or a flag, which may have any shape of one element.
    """
    number = np.asarray(value).reshape(())[()]
    kind = kind_of_dtype(np.asarray(value).dtype)
    if kind != "real":
        return CValue(str(int(number)), np.shape(value), kind, number=number)
    plain = float(number).is_integer() and 0.0 <= float(number) <= _MAX_PLAIN_INTEGER
    text = str(int(number)) if plain else f"(smajax_real){float(number)!r}"
    return CValue(text, np.shape(value), kind, number=number)
