"""How much of each cell of a section's grid is wire.

The shares are constants, since the square around a wire scales with it; they are computed once and exactly. A cell that
the wire's edge cuts conducts along ``LANES`` parallel lanes, of each of which the part inside the wire is known.
"""

import functools
from typing import NamedTuple

import numpy as np

# Parallel lanes through a cell, and heights at which the area of a cell inside the circle is sampled; chosen by trial,
# tests/unit/actuators/test_cross_section.py holds them.
LANES = 8
_AREA_SAMPLES = 256


class WireShares(NamedTuple):
    """Shares of each cell that are wire.

    Attributes:
        area: Of its area, shape ``(c, r)``.
        left, right, lower, upper: Of each lane through that half of the cell, shape ``(c, r, LANES)``.
    """

    area: np.ndarray
    left: np.ndarray
    right: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


@functools.cache
def circle_shares(cells: int) -> WireShares:
    """Return the shares of ``cells`` by ``cells`` cells in the square around a circle."""
    edges = np.linspace(-1.0, 1.0, cells + 1)
    middles = 0.5 * (edges[1:] + edges[:-1])

    def inside(low: np.ndarray, high: np.ndarray, lanes: int) -> np.ndarray:
        """Part inside the circle of lanes from ``low`` to ``high``, at ``lanes`` heights a row: (column, row, lane)."""
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
    """Return the shares on a grid of ``shape`` with the wires' squares placed in it.

    Args:
        cells: Cells across a wire. wires: For each wire, the column in which its square begins, and whether it is only
        an outer half (``Columns.wires``). row: The row in which the squares begin. shape: Numbers of columns and rows.
    """
    whole = circle_shares(cells)
    placed = [np.zeros((*shape, *part.shape[2:])) for part in whole]
    for start, is_half in wires:
        for grid, part in zip(placed, whole, strict=True):
            part = part[cells // 2 :] if is_half else part
            grid[start : start + len(part), row : row + cells] = part
    return WireShares(*placed)
