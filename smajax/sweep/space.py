"""The space of designs: what varies, between which ends, and the designs that are drawn from it."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import qmc

from smajax.recording import Floats

SAMPLINGS = ("grid", "latin-hypercube", "sobol")
_POINTS = 5


@dataclass(frozen=True)
class Axis:
    """One parameter that varies, in its internal ``unit``: over a range, evenly or (``log``) by equal factors, or over ``values``.

    On a grid a range has ``points`` points, its ends among them. A ``whole`` range has whole ends and whole numbers only.
    """

    name: str
    unit: str
    lower: float
    upper: float
    log: bool = False
    points: int = _POINTS
    values: tuple[float, ...] = ()
    whole: bool = False

    def at(self, share: Floats) -> Floats:
        """Values at shares of the axis in [0, 1], an array of the same shape; of listed ones each has an equal part of it."""
        if self.values:
            return np.asarray(self.values)[np.minimum((share * len(self.values)).astype(int), len(self.values) - 1)]
        if self.whole and not self.log:  # an equal part for each number
            return np.minimum(self.lower + np.floor(share * (self.upper - self.lower + 1.0)), self.upper)
        along = self.lower * (self.upper / self.lower) ** share if self.log else self.lower + (self.upper - self.lower) * share
        return np.clip(np.rint(along) if self.whole else along, self.lower, self.upper)

    def share(self, value: Floats) -> Floats:
        """The inverse of ``at`` on a range."""
        if self.log:
            return np.log(value / self.lower) / math.log(self.upper / self.lower)
        return (value - self.lower) / (self.upper - self.lower)

    def grid(self) -> Floats:
        """The axis' points on a grid, in their order."""
        if self.values:
            return np.asarray(self.values)
        points = self.at(np.linspace(0.0, 1.0, self.points))
        return np.unique(points) if self.whole else points


def draw(axes: Sequence[Axis], sampling: str, count: int, seed: int) -> Floats:
    """Designs, shape ``(m, axes)``, in internal units: ``count`` of them, on a grid the product of the axes' points.

    Sobol points are scrambled, and a power of two of them is the most even.
    """
    if sampling == "grid":
        return np.array(list(itertools.product(*(axis.grid() for axis in axes))), dtype=np.float64)
    if sampling == "sobol":
        share = _sobol(len(axes), count, seed)
    else:
        share = qmc.LatinHypercube(len(axes), rng=np.random.default_rng(seed)).random(count)
    return to_designs(axes, share)


def to_designs(axes: Sequence[Axis], share: Floats) -> Floats:
    """Designs of shares in [0, 1], both of shape ``(m, axes)``."""
    return np.column_stack([axis.at(share[:, k]) for k, axis in enumerate(axes)])


def _sobol(axes: int, count: int, seed: int) -> Floats:
    sampler = qmc.Sobol(axes, rng=np.random.default_rng(seed))
    return sampler.random_base2(max(0, math.ceil(math.log2(count))))[:count]


def pick_and_freeze(axes: Sequence[Axis], base: int, seed: int) -> Floats:
    """The designs that Sobol indices are made of, shape ``((axes + 2) * base, axes)``: A, B, and for each axis A with B's column.

    Saltelli et al., Computer Physics Communications 181 (2010) 259; ``base`` is a power of two.
    """
    both = _sobol(2 * len(axes), base, seed)
    one, other = both[:, : len(axes)], both[:, len(axes) :]
    mixed = []
    for k in range(len(axes)):
        column = one.copy()
        column[:, k] = other[:, k]
        mixed.append(column)
    return to_designs(axes, np.concatenate([one, other, *mixed]))


def as_values(axes: Sequence[Axis], designs: Floats) -> Mapping[str, Floats]:
    """The columns of designs by name."""
    return {axis.name: designs[:, k] for k, axis in enumerate(axes)}
