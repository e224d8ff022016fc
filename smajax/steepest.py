"""The tangent at the steepest place of a transformation, which one lays by hand (ASTM E3097), and where it meets the plateaus.

A place is steeper than all others by its noise, too, so the steepest piece of some rows is no estimate. A cubic is laid through the rows of
the transformation's middle part, and its steepest place there tells. Of how it bends, as much is believed as stands out of the rows'
scatter: a straight transformation stays straight. Arrays are (draws, rows), see ``tangents.py``.
"""

from typing import NamedTuple

import numpy as np

from smajax.errors import InputError
from smajax.tangents import Lines, columns

_MIDDLE = 0.8  # of the way between the three lines' corners
_SURE = 0.6  # of that part: at its ends a cubic's slope is unsure
_FEWEST = 6  # rows on it
_KNOTS = 11
_ROWS_TO_A_KNOT = 8
_AROUND = 0.75  # of the way between the corners, beyond them, where a transformation may begin and end


class Straight(NamedTuple):
    """A straight line: its slope (1/K) and the strain that it has at a temperature, (draws,) each."""

    temperature: np.ndarray
    strain: np.ndarray
    slope: np.ndarray

    def at(self, temperature: np.ndarray) -> np.ndarray:
        """The strain on the line."""
        return self.strain + self.slope * (temperature - self.temperature)

    def meets(self, other: "Straight") -> np.ndarray:
        """The temperature at which it meets another line."""
        return other.temperature + (self.at(other.temperature) - other.strain) / (other.slope - self.slope)


def refuse_few(temperature: np.ndarray, lines: Lines, kind: str) -> None:
    """Raises ``InputError`` where too few rows (1, rows) of a branch of a ``kind`` lie on its transformation's middle part."""
    count = int(np.sum(np.abs(_places(temperature, lines)) <= 1.0))
    if count < _FEWEST:
        told = f"on {kind} {count} rows lie on the transformation's middle part, fewer than the {_FEWEST} that tell where it is steepest"
        raise InputError(f"{told}: record more rows per kelvin, or take three lines (--tangent lines)")


def _places(temperature: np.ndarray, lines: Lines) -> np.ndarray:
    """Where rows lie on their transformation: from -1 to 1 on its middle part."""
    middle, half = _middle(lines)
    return (temperature - middle[:, None]) / half[:, None]


def _middle(lines: Lines) -> tuple[np.ndarray, np.ndarray]:
    """The middle of the transformation and half the length of its middle part (draws,), which in a poor draw may have none."""
    low, high = lines.corners.T
    return 0.5 * (low + high), np.maximum(0.5 * _MIDDLE * (high - low), 1e-9)


def steepest(temperature: np.ndarray, strain: np.ndarray, lines: Lines) -> Straight:
    """The tangents of branches at the steepest places of their transformations; where no cubic can be laid, the three lines' own."""
    middle, half = _middle(lines)
    place = _places(temperature, lines)
    taken = np.abs(place) <= 1.0
    count = taken.sum(axis=1)
    powers, level = np.where(taken[:, :, None], place[:, :, None] ** np.arange(4), 0.0), np.where(taken, strain, 0.0)
    (line, off_line), (cubic, off_cubic) = (_laid(powers[:, :, :size], level) for size in (2, 4))
    noise = 2.0 * off_cubic / np.maximum(count - 4, 1)  # what two numbers more explain of it
    believed = np.clip(1.0 - noise / np.maximum(off_line - off_cubic, 1e-300), 0.0, 1.0)[:, None]
    along = line + believed * (cubic - line)
    vertex = -along[:, 2] / np.where(along[:, 3] == 0.0, 1e-300, 3.0 * along[:, 3])
    places = np.stack([np.clip(at, -_SURE, _SURE) for at in (-np.ones_like(vertex), vertex, np.ones_like(vertex))], axis=1)
    slopes = along[:, 1:2] + 2.0 * along[:, 2:3] * places + 3.0 * along[:, 3:] * places**2
    best = np.argmax(slopes * np.sign(line[:, 1:2]), axis=1)[:, None]
    there, slope = (np.take_along_axis(values, best, axis=1)[:, 0] for values in (places, slopes))
    tangent = middle + half * there, np.sum(along * there[:, None] ** np.arange(4), axis=1), slope / half
    own = middle, lines.strain(middle[:, None])[:, 0], lines.slopes[:, 1]
    return Straight(*(np.where(count > 4, b, a) for a, b in zip(own, tangent, strict=True)))


def _laid(powers: np.ndarray, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (draws, 4) of the polynomials of these powers through the rows, and the sums of squared residuals (draws,)."""
    size = powers.shape[2]
    base, upper = np.linalg.qr(powers)
    upper = upper + 1e-300 * np.eye(size)  # regular where a draw has too few rows, whose result is not used
    along = np.linalg.solve(upper, np.einsum("drk,dr->dk", base, strain)[:, :, None])[:, :, 0]
    off = strain - np.einsum("drk,dk->dr", powers, along)
    return np.pad(along, ((0, 0), (0, 4 - size))), np.sum(off**2, axis=1)


def course(temperature: np.ndarray, strain: np.ndarray, lines: Lines) -> tuple[np.ndarray, int]:
    """The strain (1, rows) along a branch (1, rows), smooth or with corners, and how many numbers it is made of.

    It is the three lines, and a natural cubic spline about the transformation.
    """
    low, high = lines.corners[0]
    knots = np.linspace(-_AROUND, 1.0 + _AROUND, min(_KNOTS, temperature.shape[1] // _ROWS_TO_A_KNOT))
    share = (temperature[0] - low) / (high - low)
    cubes = np.maximum(share[:, None] - knots, 0.0) ** 3
    bends = (cubes[:, :-1] - cubes[:, -1:]) / (knots[-1] - knots[:-1])
    base = np.hstack([columns(temperature, lines.corners)[0], bends[:, :-1] - bends[:, -1:]])
    sizes = np.linalg.norm(base, axis=0) + 1e-300
    along, _, rank, _ = np.linalg.lstsq(base / sizes, strain[0], rcond=1e-9)
    return ((base / sizes) @ along)[None], int(rank)
