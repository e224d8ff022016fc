"""Design space: its axes, and the sampling of designs from it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from smajax.recordings.recording import Floats
from smajax.sweeps.schema import DEFAULT_POINTS


@dataclass(frozen=True)
class Axis:
    """Parameter that varies in a sweep, with its range in internal units.

    Attributes:
        name: Name of the parameter, such as ``wire.diameter``.
        unit: Its internal unit.
        lower: Lower end of the range.
        upper: Upper end of the range.
        log: Whether the range is divided on a logarithmic scale; on a linear scale if not.
        points: Number of points on a grid, with both ends.
        values: Listed values, which replace the range.
        whole: Whether the parameter is a whole number; then both ends are whole numbers.
        labels: Names of the listed values, which are then their indices; empty for numbers.
        catalogue: Name of the wire whose stock diameters the listed values are; empty for other axes.
    """

    name: str
    unit: str
    lower: float
    upper: float
    log: bool = False
    points: int = DEFAULT_POINTS
    values: tuple[float, ...] = ()
    whole: bool = False
    labels: tuple[str, ...] = ()
    catalogue: str = ""

    def at(self, share: Float[np.ndarray, " designs"]) -> Float[np.ndarray, " designs"]:
        """Return the values at shares of the axis.

        Each listed value, and each number of a whole axis without ``log``, has an equal part of [0, 1].

        Args:
            share: Shares in [0, 1], shape ``(designs,)``.

        Returns:
            Values in the internal unit, shape ``(designs,)``.
        """
        if self.values:
            return np.asarray(self.values)[np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)]
        if self.whole and not self.log:
            return np.minimum(self.lower + np.floor(share * (self.upper - self.lower + 1.0)), self.upper)
        values = (
            self.lower * (self.upper / self.lower) ** share
            if self.log
            else self.lower + (self.upper - self.lower) * share
        )
        return np.clip(np.rint(values) if self.whole else values, self.lower, self.upper)

    def share(self, value: Floats | np.float64) -> Floats | np.float64:
        """Return the shares, 0 to 1, of values of a range; the inverse of ``at``."""
        if self.log:
            return np.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def grid(self) -> Float[np.ndarray, " points"]:
        """Return the points of the axis on a grid in ascending order, or the listed values in their own order."""
        if self.values:
            return np.asarray(self.values)
        points = self.at(np.linspace(0.0, 1.0, self.points))
        return np.unique(points) if self.whole else points


def draw_designs(axes: Sequence[Axis], sampling: str, count: int, seed: int) -> Float[np.ndarray, "designs axes"]:
    """Draw designs from the space.

    Args:
        axes: Axes of the space.
        sampling: ``grid``, ``latin-hypercube`` or ``sobol`` (scrambled; most even for a power of two of designs).
        count: Number of designs; without effect on a grid, which has the product of the axes' points.
        seed: Seed of the random numbers.

    Returns:
        Designs in internal units, shape ``(designs, axes)``.
    """
    if sampling == "grid":
        points = np.meshgrid(*(axis.grid() for axis in axes), indexing="ij", copy=False)
        return np.stack([values.ravel() for values in points], axis=-1).astype(np.float64)
    if sampling == "sobol":
        shares = _sobol_points(len(axes), count, seed)
    else:
        from scipy.stats import qmc  # slow to import, and not needed to read a file

        shares = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    return to_designs(axes, shares)


def to_designs(axes: Sequence[Axis], shares: Float[np.ndarray, "designs axes"]) -> Float[np.ndarray, "designs axes"]:
    """Return the designs at shares of the axes.

    Args:
        axes: Axes of the space.
        shares: Shares in [0, 1], shape ``(designs, axes)``.

    Returns:
        Designs in internal units, shape ``(designs, axes)``.
    """
    return np.column_stack([axis.at(shares[:, k]) for k, axis in enumerate(axes)])


def _sobol_points(axes: int, count: int, seed: int) -> Float[np.ndarray, "designs axes"]:
    """Scrambled Sobol points in [0, 1)."""
    from scipy.stats import qmc  # slow to import, and not needed to read a file

    sampler = qmc.Sobol(axes, rng=np.random.default_rng(seed))
    return sampler.random_base2(max(0, math.ceil(math.log2(count))))[:count]


def pick_and_freeze(axes: Sequence[Axis], base: int, seed: int) -> Float[np.ndarray, "designs axes"]:
    """Draw the designs for estimates of Sobol indices: A, B, and for each axis A with its column taken from B.

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
