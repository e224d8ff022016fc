"""Responses of fitted plants to their recordings, and the error of the time steps."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from smajax.fitting.result import Response
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation import run
from smajax.simulation.inputs import discretise
from smajax.simulation.status import SimulationStatus
from smajax.simulation.step_size import default_step


def simulate_responses(
    plants: Sequence[Plant],
    recordings: Sequence[Recording],
    roles: Sequence[str],
    channels: Sequence[str],
    interpolation: str,
    step: float | None,
) -> tuple[list[Response], dict[str, float]]:
    """Simulate each recording with its plant, and measure the error of the time steps.

    All are laid on grids of one length, so that they share one compiled program. A simulation that fails raises
    nothing: its response has the status.

    Args:
        plants: One plant a recording.
        recordings: The recordings.
        roles: ``train`` or ``holdout``, one a recording.
        channels: Observed channels.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``.
        step: Longest step in s; the plants' default if not given.

    Returns:
        The responses, and by channel the RMS change (SI) when the first half of the first recording is simulated with
        half the step; 0 for recordings without a clock.
    """
    laid_out = [
        discretise(p, r, interpolation=interpolation, step=step) for p, r in zip(plants, recordings, strict=True)
    ]
    grid, samples = max(len(i.time) for i in laid_out), max(len(i.sample_indices) for i in laid_out)
    results = [run.simulate_inputs(p, i.pad(grid, samples)) for p, i in zip(plants, laid_out, strict=True)]
    responses = []
    for result, recording, role in zip(results, recordings, roles, strict=True):
        model = {c: np.asarray(v)[: len(recording)] for c, v in result.channels.items()}
        responses.append(Response(recording, role, model, SimulationStatus(int(result.status))))
    first = recordings[0]
    count = len(first) // 2
    if not first.has_clock or count < 2:
        return responses, dict.fromkeys(channels, 0.0)
    half = dataclasses.replace(
        first, time=first.time[:count], channels={c: v[:count] for c, v in first.channels.items()}
    )
    pieces = np.maximum(1, np.ceil(np.diff(half.time) / (step or default_step(plants[0])) - 1e-9))
    fine_step = float(np.max(np.diff(half.time) / pieces)) / 2
    inputs = discretise(plants[0], half, interpolation=interpolation, step=fine_step)
    if len(inputs.time) <= grid:
        inputs = inputs.pad(grid, samples)
    fine = run.simulate_inputs(plants[0], inputs).channels
    change = {c: np.asarray(fine[c])[:count] - responses[0].model[c][:count] for c in channels}
    return responses, {c: float(np.sqrt(np.mean(v**2))) for c, v in change.items()}
