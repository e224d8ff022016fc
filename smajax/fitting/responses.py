"""Responses of plants to the recordings of a fit, and the error of the time steps."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from smajax.fitting.result import Response
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation import run
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.padding import pad_together
from smajax.simulation.physical_limits import without_impossible_rows
from smajax.simulation.status import SimulationStatus
from smajax.simulation.step_size import default_step

# A row that is a whole number of steps long up to this share of a step gets no further step: rounding of times.
_ROUNDING = 1e-9


def simulate_responses(
    plants: Sequence[Plant],
    recordings: Sequence[Recording],
    roles: Sequence[str],
    channels: Sequence[str],
    interpolation: str | None,
    step: float | None,
) -> tuple[list[Response], dict[str, float]]:
    """Simulate each recording with its plant, and measure the error of the time steps.

    All recordings get grids of one length, so that they share one compiled program. A simulation that fails does not
    raise: its response has the status, and no values from the first state on that no wire has.

    Args:
        plants: One plant for each recording.
        recordings: The recordings.
        roles: ``train`` or ``holdout`` for each recording.
        channels: Observed channels.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plants' default if not given.

    Returns:
        The responses, and by channel the RMS change (SI) when the first half of the first recording is simulated with
        half the step; 0 where each row is one step, as for recordings without a clock.
    """
    inputs = [discretise(p, r, interpolation=interpolation, step=step) for p, r in zip(plants, recordings, strict=True)]
    padded = pad_together(inputs)
    results = [run.simulate_inputs(p, i) for p, i in zip(plants, padded, strict=True)]
    responses = []
    for result, recording, role in zip(results, recordings, roles, strict=True):
        model = {c: np.asarray(v)[: len(recording)] for c, v in result.channels.items()}
        model = without_impossible_rows(model, np.asarray(result.possible)[: len(recording)])
        responses.append(Response(recording, role, model, SimulationStatus(int(result.status))))
    errors = _discretisation_errors(plants[0], responses[0], channels, interpolation, step, padded[0])
    return responses, errors


def start_responses(
    plant: Plant,
    recordings: Sequence[Recording],
    observe: Sequence[str],
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str | None = None,
    step: float | None = None,
) -> list[Response]:
    """Simulate all recordings with the start values, as where a fit failed.

    Args:
        plant: The plant with the start values.
        recordings: The training recordings.
        observe: Observed channels.
        holdout: The holdout recordings.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plant's default if not given.

    Returns:
        The responses; one whose simulation fails has the status.
    """
    everything = [*recordings, *holdout]
    roles = ["train"] * len(recordings) + ["holdout"] * len(holdout)
    plants = [plant] * len(everything)
    return simulate_responses(plants, everything, roles, observe, interpolation, step)[0]


def _discretisation_errors(
    plant: Plant,
    response: Response,
    channels: Sequence[str],
    interpolation: str | None,
    step: float | None,
    longest: Inputs,
) -> dict[str, float]:
    """RMS change (SI) of each channel on the first half of a recording with half the step.

    ``longest`` is a grid of the compiled program, which is used where the finer grid fits.
    """
    recording = response.recording
    count = len(recording) // 2
    longest_step = step or default_step(plant)
    if not recording.has_clock or count < 2 or math.isinf(longest_step):
        return dict.fromkeys(channels, 0.0)
    half = dataclasses.replace(
        recording, time=recording.time[:count], channels={c: v[:count] for c, v in recording.channels.items()}
    )
    pieces = np.maximum(1, np.ceil(np.diff(half.time) / longest_step - _ROUNDING))
    fine_step = float(np.max(np.diff(half.time) / pieces)) / 2
    inputs = discretise(plant, half, interpolation=interpolation, step=fine_step)
    fits = len(inputs.time) <= len(longest.time)
    inputs = inputs.pad(len(longest.time), len(longest.sample_indices)) if fits else pad_together([inputs])[0]
    fine = run.simulate_inputs(plant, inputs).channels
    changes = {c: np.asarray(fine[c])[:count] - response.model[c][:count] for c in channels}
    return {c: float(np.sqrt(np.mean(v**2))) for c, v in changes.items()}
