"""Rows of a recording at which a simulation may begin: from there a plant that starts anew does what it did."""

import dataclasses
from collections.abc import Mapping

import jax
import numpy as np

from smajax.errors import InputError
from smajax.numerics.stored_programs import stored
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import Simulation, simulate_inputs
from smajax.simulation.status import SimulationStatus

# Largest difference of a martensite fraction from that of a start: it changes a stroke by about 1 %.
_NEAR_FRACTION = 0.01
# K. A wire that is this much warmer counts as a start that is as far away as the whole recording. Chosen by trial.
_WARM = 10.0
# Starts that are tried, and their least distance as a share of the rows: each takes a simulation. Chosen by trial.
_MOST_TRIED = 20
_LEAST_DISTANCE = 0.005


class StartRows:
    """Rows at which a simulation may begin, by a plant's own values.

    Args:
        plant: The plant.
        recording: The recording.
        tolerances: Largest RMS difference, SI, of each channel between a simulation that starts at a row and that of
            the whole recording.

    Raises:
        InputError: If the simulation fails.
    """

    def __init__(self, plant: Plant, recording: Recording, tolerances: Mapping[str, float]):
        self._plant, self._recording, self._tolerances = plant, recording, dict(tolerances)
        self._inputs: Inputs = discretise(plant, recording)
        self._whole: Simulation = simulate_inputs(plant, self._inputs)
        if int(self._whole.status) != SimulationStatus.done:
            raise InputError(
                f"{recording.name}: the simulation with the rig's values fails, so that no rest is found: correct the "
                "rig, or name a recording for each part"
            )
        start, rows = _starts(plant, self._inputs), len(recording)
        pairs = zip(jax.tree.leaves(self._whole.state.fractions), jax.tree.leaves(start.fractions), strict=True)
        changes = [np.abs(np.asarray(a) - np.asarray(b)).reshape(rows, -1).max(axis=1) for a, b in pairs]
        difference = np.asarray(self._whole.state.temperature) - np.asarray(start.temperature)
        self._warmth: np.ndarray = np.abs(difference).reshape(rows, -1).max(axis=1)
        self._candidates: np.ndarray = np.flatnonzero(np.all([c < _NEAR_FRACTION for c in changes], axis=0))

    def nearest(self, row: int, lowest: int, highest: int) -> int | None:
        """Return the row nearest to another one at which a simulation may begin.

        Args:
            row: The row.
            lowest: First row of the search.
            highest: Last row of the search.

        Returns:
            The row; ``None`` if there is none.
        """
        inside = self._candidates[(self._candidates >= lowest) & (self._candidates <= highest)]
        tried: list[int] = []
        distance = np.abs(inside - row) / len(self._recording) + self._warmth[inside] / _WARM
        for candidate in inside[np.argsort(distance, kind="stable")]:
            if any(abs(candidate - other) < _LEAST_DISTANCE * len(self._recording) for other in tried):
                continue
            if self._follows(int(candidate)):
                return int(candidate)
            tried.append(int(candidate))
            if len(tried) == _MOST_TRIED:
                return None
        return None

    def _follows(self, row: int) -> bool:
        """Whether a simulation from a row on is that of the whole recording, within the tolerances."""
        inputs = discretise(self._plant, rows_of(self._recording, row, len(self._recording)))
        padded = inputs.pad(len(self._inputs.time), len(self._inputs.sample_indices))
        response = simulate_inputs(self._plant, padded)
        count = len(self._recording) - row
        for channel, tolerance in self._tolerances.items():
            anew, before = (np.asarray(r.channels[channel]) for r in (response, self._whole))
            if not np.sqrt(np.mean((anew[:count] - before[row:]) ** 2)) <= tolerance:
                return False
        return True


def rows_of(recording: Recording, first: int, last: int) -> Recording:
    """Return rows of a recording, up to but without ``last``, whose times begin at 0.

    Args:
        recording: The recording.
        first: The first row.
        last: End of the rows.
    """
    time = recording.time[first:last] - recording.time[first]
    channels = {channel: values[first:last] for channel, values in recording.channels.items()}
    return dataclasses.replace(recording, time=time, channels=channels)


@stored
def _starts(plant: Plant, inputs: Inputs) -> State:
    """States from which the plant would start at each sample."""
    return jax.vmap(plant.init)(inputs.sample_signals)
