"""Shares of the cells of a section's grid that are wire.

The shares are constants, since the square around a wire scales with it; they are computed once. A cell that the edge of
the wire cuts conducts along ``LANES`` parallel lanes, each of which is partly inside the wire.
"""

import functools
from typing import NamedTuple

import numpy as np

# Parallel lanes through a cell; chosen by trial, tests/unit/actuators/test_cross_section.py holds it.
LANES = 8
# Heights at which the area of a cell inside the circle is sampled; chosen by trial, the same test holds it.
_AREA_SAMPLES = 256


class WireShares(NamedTuple):
    """Shares of each cell that are wire.

    Attributes:
        area: Shares of the cells' areas, shape ``(c, r)``.
        left: Shares of the lanes through the left halves of the cells, shape ``(c, r, LANES)``.
        right: Shares of the lanes through the right halves, of the same shape.
        lower: Shares of the lanes through the lower halves, of the same shape.
        upper: Shares of the lanes through the upper halves, of the same shape.
    """

    area: np.ndarray
    left: np.ndarray
    right: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@functools.cache
def circle_shares(cells: int) -> WireShares:
    """Compute the shares of the cells in the square around a circle.

    Args:
        cells: Number of cells across the circle.

    Returns:
        The shares, for ``c = r = cells``.
    """
    edges = np.linspace(-1.0, 1.0, cells + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])

    def inside(low: np.ndarray, high: np.ndarray, lanes: int) -> np.ndarray:
        """Shares inside the circle of lanes from ``low`` to ``high``, shape ``(column, row, lanes)``."""
        height = (edges[:-1, None] + (edges[1] - edges[0]) * (np.arange(lanes) + 0.5) / lanes)[None]
        chord = np.sqrt(1.0 - height**2)
        covered = np.minimum(high[:, None, None], chord) - np.maximum(low[:, None, None], -chord)
        return np.maximum(covered, 0.0) / (high - low)[:, None, None]

    area = inside(edges[:-1], edges[1:], _AREA_SAMPLES).mean(axis=2)
    area = np.where(area < 1.0, area * (1.0 + _area_correction(area)), area)
    left, right = inside(edges[:-1], middles, LANES), inside(middles, edges[1:], LANES)
    return WireShares(area, left, right, left.transpose(1, 0, 2), right.transpose(1, 0, 2))


def _area_correction(area: np.ndarray) -> float:
    """Relative correction of the cut cells that makes the areas add up to the circle's."""
    cut = area[area < 1.0].sum()
    return (np.pi / 4.0 * area.size - area.sum()) / cut


def place_shares(cells: int, wires: tuple[tuple[int, bool], ...], row: int, shape: tuple[int, int]) -> WireShares:
    """Compute the shares of the cells of a section's grid, in which the squares around the wires are placed.

    Args:
        cells: Number of cells across a wire.
        wires: For each wire, the column in which its square begins, and whether only its outer half is in the grid
            (``Columns.wires``).
        row: The row in which the squares begin.
        shape: Numbers of columns and rows of the grid.
    """
    circle = circle_shares(cells)
    grids = [np.zeros((*shape, *part.shape[2:])) for part in circle]
    for start, is_half in wires:
        for grid, part in zip(grids, circle, strict=True):
            part = part[cells // 2 :] if is_half else part
            grid[start : start + len(part), row : row + cells] = part
    return WireShares(*grids)
