"""Lengths of grids that recordings share."""

import numpy as np
import pytest

from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.padding import pad_together, padded_length
from tests.support import plants


@pytest.mark.parametrize("count", [0, 1, 7, 8, 15, 16, 17, 1000, 6001, 6144, 6145, 123_457, 10_000_000])
def test_a_length_grows_by_an_eighth_at_most(count):
    length = padded_length(count)
    assert count <= length <= 1.125 * count
    assert padded_length(length) == length


def test_there_are_eight_lengths_in_a_doubling():
    assert len({padded_length(count) for count in range(4097, 8193)}) == 8


def recording(rows: int) -> Recording:
    time = 0.02 * np.arange(rows)
    return plants.recording({"current": 0.2 + 0.1 * np.sin(time)}, time)


def test_recordings_of_similar_length_get_grids_of_one_length():
    plant = plants.dead_weight()
    alone = [pad_together([discretise(plant, recording(rows))])[0] for rows in (990, 1000, 1010)]
    assert len({(len(grid.time), len(grid.sample_indices)) for grid in alone}) == 1


def test_a_padded_grid_ends_as_the_recording_does():
    plant = plants.dead_weight()
    grids = [discretise(plant, recording(rows)) for rows in (500, 700)]
    for grid, padded in zip(grids, pad_together(grids), strict=True):
        points = len(grid.time)
        np.testing.assert_array_equal(padded.time[:points], grid.time)
        np.testing.assert_array_equal(padded.time[points:], grid.time[-1])
        after = np.asarray(padded.after[points - 1 :])
        np.testing.assert_array_equal(after, np.broadcast_to(grid.after[-1], after.shape))
