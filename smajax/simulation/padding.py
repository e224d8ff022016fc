"""Grids of a few lengths, so that recordings of other lengths run on programs that are compiled already."""

from collections.abc import Sequence

from smajax.simulation.inputs import Inputs

# Lengths in each doubling. With 8, a grid grows by 6 % on average and by an eighth at most, and all recordings of a
# bench, which have similar lengths, share one program or two.
_LENGTHS_PER_DOUBLING = 8


def padded_length(count: int) -> int:
    """Return the shortest of a few lengths that is not less than a number of points.

    Args:
        count: The number of points.
    """
    spacing = 1 << max(0, count.bit_length() - _LENGTHS_PER_DOUBLING.bit_length())
    return -(-count // spacing) * spacing


def pad_together(grids: Sequence[Inputs]) -> list[Inputs]:
    """Extend grids to one of a few lengths, the same for all of them.

    Args:
        grids: Inputs on grids.
    """
    points = padded_length(max((len(grid.time) for grid in grids), default=0))
    samples = padded_length(max((len(grid.sample_indices) for grid in grids), default=0))
    return [grid.pad(points, samples) for grid in grids]
