"""Three straight lines that meet, laid along a branch of a thermal cycle: along its cold rows, its transformation, and its hot rows.

All three are laid at once, by least squares in the strain with both corners free, so that no row has to be called plateau or transformation
beforehand. Many redrawings of a branch are laid together: arrays are (draws, rows).
"""

from typing import NamedTuple

import numpy as np

_PLACES, _MORE_PLACES = 24, 64  # where a corner is tried first, in redrawings that have another beginning, and without
_REFINED = 8
_RIDGE = 1e-13
_LARGEST_STEP = 0.1  # of the way from the coldest row to the hottest, in one refinement


class Lines(NamedTuple):
    """Corners (draws, 2) in degC, the lines' coefficients (draws, 4) over ``columns``, and the sums of squared residuals (draws,)."""

    corners: np.ndarray
    along: np.ndarray
    squares: np.ndarray

    def strain(self, temperature: np.ndarray) -> np.ndarray:
        """The strain (draws, rows) on the lines."""
        return np.einsum("drk,dk->dr", columns(temperature, self.corners), self.along)

    @property
    def slopes(self) -> np.ndarray:
        """Slopes of the cold line, the transformation's and the hot line (draws, 3), 1/K."""
        return np.cumsum(self.along[:, 1:], axis=1)


def lay(temperature: np.ndarray, strain: np.ndarray, near: np.ndarray | None = None) -> Lines:
    """The lines of least squares through rows (draws, rows): the better of those begun at the best of many places and at ``near`` (2,)."""
    cold, reach = np.min(temperature, axis=1)[:, None], np.ptp(temperature, axis=1)[:, None]
    share = (temperature - cold) / reach
    found = _refined(share, strain, _best_places(share, strain, _MORE_PLACES if near is None else _PLACES))
    if near is not None:
        again = _refined(share, strain, np.clip((near - cold) / reach, 0.0, 1.0))
        better = (again.squares < found.squares)[:, None]
        found = Lines(*(np.where(better if a.ndim > 1 else better[:, 0], b, a) for a, b in zip(found, again, strict=True)))
    slopes = found.along[:, 1:] / reach
    level = found.along[:, :1] - slopes[:, :1] * cold
    return Lines(cold + reach * found.corners, np.hstack([level, slopes]), found.squares)


def columns(temperature: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """A straight line and what bends it at each corner, (draws, rows, 4)."""
    bends = np.maximum(temperature[:, :, None] - corners[:, None, :], 0.0)
    return np.concatenate([np.ones_like(bends[:, :, :1]), temperature[:, :, None], bends], axis=2)


def _refined(t: np.ndarray, e: np.ndarray, corners: np.ndarray) -> Lines:
    """Gauss and Newton's steps; of all corners on the way the best are kept."""
    best = Lines(corners, *_along(t, e, corners))
    inside = np.partition(t, (1, -2), axis=1)[:, [1, -2]]
    now = best
    for _ in range(_REFINED):
        lines = columns(t, now.corners)
        bends = -now.along[:, None, 2:] * (t[:, :, None] > now.corners[:, None, :])
        left = e - np.einsum("drk,dk->dr", lines, now.along)
        moved = _solved(np.concatenate([lines, bends], axis=2), left)[:, 4:]
        corners = now.corners + np.clip(moved, -_LARGEST_STEP, _LARGEST_STEP)
        corners = np.sort(np.clip(corners, inside[:, :1], inside[:, 1:]), axis=1)
        now = Lines(corners, *_along(t, e, corners))
        better = now.squares < best.squares
        best = Lines(*(np.where(better[:, None] if a.ndim > 1 else better, a, b) for a, b in zip(now, best, strict=True)))
    return best


def _along(t: np.ndarray, e: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    lines = columns(t, corners)
    along = _solved(lines, e)
    return along, np.sum((e - np.einsum("drk,dk->dr", lines, along)) ** 2, axis=1)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Least squares of a stack by normal equations of scaled columns; the ridge keeps columns that vanish from spoiling the others."""
    sizes = np.sqrt(np.sum(matrix**2, axis=1)) + 1e-300
    scaled = matrix / sizes[:, None, :]
    turned = np.swapaxes(scaled, 1, 2)
    gram = turned @ scaled + _RIDGE * np.eye(matrix.shape[2])
    first = np.linalg.solve(gram, turned @ right[:, :, None])
    again = np.linalg.solve(gram, turned @ (right[:, :, None] - scaled @ first))  # takes back what rounding lost
    return (first + again)[:, :, 0] / sizes


def _best_places(t: np.ndarray, e: np.ndarray, count: int) -> np.ndarray:
    """The best pair of corners (draws, 2) among places spread over the rows."""
    places = np.quantile(t, np.linspace(0.04, 0.96, count), axis=1).T
    bends = np.maximum(t[:, :, None] - places[:, None, :], 0.0)
    base, _ = np.linalg.qr(np.stack([np.ones_like(t), t], axis=2))
    back = np.swapaxes(base, 1, 2)
    left, bent = e[:, :, None] - base @ (back @ e[:, :, None]), bends - base @ (back @ bends)
    gram, toward = np.swapaxes(bent, 1, 2) @ bent, (np.swapaxes(bent, 1, 2) @ left)[:, :, 0]
    first, second = np.triu_indices(count, 1)
    a, b, c = gram[:, first, first], gram[:, first, second], gram[:, second, second]
    below = a * c - b * b
    u, v = toward[:, first], toward[:, second]
    explained = np.where(below > 1e-9 * a * c, (c * u**2 - 2 * b * u * v + a * v**2) / np.maximum(below, 1e-300), -1.0)
    best = np.argmax(explained, axis=1)
    rows = np.arange(len(t))
    return np.stack([places[rows, first[best]], places[rows, second[best]]], axis=1)
