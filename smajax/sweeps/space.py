"""The space of designs: the axes, and the designs that are drawn from them."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from smajax.recordings.recording import Floats

SAMPLINGS = ("grid", "latin-hypercube", "sobol")
# Points of a range on a grid where the file names no number.
DEFAULT_POINTS = 5


@dataclass(frozen=True)
class Axis:
    """One parameter that varies, in its internal unit.

    Args:
        name: Name of the parameter.
        unit: Its internal unit.
        lower: Lower end of the range.
        upper: Upper end of the range.
        log: Whether the range is covered by equal factors; evenly if not.
        points: Points of the range on a grid, both ends among them.
        values: Listed values, which stand for the range.
        whole: Whether the parameter is a whole number; then the ends are whole, too.
    """

    name: str
    unit: str
    lower: float
    upper: float
    log: bool = False
    points: int = DEFAULT_POINTS
    values: tuple[float, ...] = ()
    whole: bool = False

    def at(self, share: Floats) -> Floats:
        """Return the values at shares of the axis in [0, 1], an array of the same shape.

        Each listed value, and each number of a whole axis without ``log``, has an equal part of [0, 1].
        """
        if self.values:
            return np.asarray(self.values)[np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)]
        if self.whole and not self.log:
            return np.minimum(self.lower + np.floor(share * (self.upper - self.lower + 1.0)), self.upper)
        along = (
            self.lower * (self.upper / self.lower) ** share
            if self.log
            else self.lower + (self.upper - self.lower) * share
        )
        return np.clip(np.rint(along) if self.whole else along, self.lower, self.upper)

    def share(self, value: Floats) -> Floats:
        """Return the shares of values of a range: the inverse of ``at``."""
        if self.log:
            return np.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def grid(self) -> Floats:
        """Return the axis' points on a grid in ascending order, or the listed values in theirs."""
        if self.values:
            return np.asarray(self.values)
        points = self.at(np.linspace(0.0, 1.0, self.points))
        return np.unique(points) if self.whole else points


def draw_designs(axes: Sequence[Axis], sampling: str, count: int, seed: int) -> Floats:
    """Draw designs from the space.

    Args:
        axes: Axes of the space.
        sampling: ``grid``, ``latin-hypercube`` or ``sobol`` (scrambled; a power of two of points is the most even).
        count: Number of designs; on a grid it is the product of the axes' points instead.
        seed: Seed of the random numbers.

    Returns:
        Designs in internal units, shape ``(m, axes)``.
    """
    if sampling == "grid":
        return np.array(list(itertools.product(*(axis.grid() for axis in axes))), dtype=np.float64)
    if sampling == "sobol":
        shares = _sobol_points(len(axes), count, seed)
    else:
        shares = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    return to_designs(axes, shares)


def to_designs(axes: Sequence[Axis], shares: Floats) -> Floats:
    """Return the designs at shares in [0, 1], both of shape ``(m, axes)``."""
    return np.column_stack([axis.at(shares[:, k]) for k, axis in enumerate(axes)])


def _sobol_points(axes: int, count: int, seed: int) -> Floats:
    sampler = qmc.Sobol(axes, rng=np.random.default_rng(seed))
    return sampler.random_base2(max(0, math.ceil(math.log2(count))))[:count]


def pick_and_freeze(axes: Sequence[Axis], base: int, seed: int) -> Floats:
    """Return the designs that Sobol indices are estimated from: A, B, and for each axis A with B's column.

    Source: saltelli2010, section 2.

    Args:
        axes: Axes of the space.
        base: Rows of A and of B, a power of two.
        seed: Seed of the random numbers.

    Returns:
        Designs, shape ``((axes + 2) * base, axes)``.
    """
    both = _sobol_points(2 * len(axes), base, seed)
    a, b = both[:, : len(axes)], both[:, len(axes) :]
    mixed = []
    for k in range(len(axes)):
        column = a.copy()
        column[:, k] = b[:, k]
        mixed.append(column)
    return to_designs(axes, np.concatenate([a, b, *mixed]))
