"""Responses of a rig with its own values, for checks of recordings before a fit."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation import run
from smajax.simulation.inputs import Inputs, count_steps, discretise
from smajax.simulation.padding import pad_together
from smajax.simulation.status import SimulationStatus
from smajax.simulation.step_size import wire_time_constant

# Kinds of channels whose sign and size a transformation sets.
MECHANICAL = ("displacement", "angle", "rate", "force", "torque", "stress", "strain")
# Change of the martensite fraction from which the response is that of a transformation.
_TRANSFORMS = 0.2
# Steps of a simulation beyond which a slowly sampled recording is simulated faster than it ran, and others are not
# checked, so that a check stays short. Chosen by trial.
_MAX_STEPS = 500_000
# Time between rows, in time constants of the wire, from which a faster clock changes nothing: 1 - exp(-3) is 0.95.
SETTLED = 3.0


class BenchResponse(NamedTuple):
    """Response of the rig with its own values.

    Attributes:
        channels: Modelled channels by name, shape ``(rows,)``; NaN where the simulation failed.
        temperature: Mean temperature of each wire, shape ``(rows, wires)``, degC.
        transforms: Whether a wire transforms by a fifth or more.
    """

    channels: dict[str, np.ndarray]
    temperature: np.ndarray
    transforms: bool


def bench_responses(plant: Plant, recordings: Sequence[Recording]) -> list[BenchResponse]:
    """Simulate recordings, all on grids of one length, so that they share one compiled program.

    Args:
        plant: The plant with the values of the rig.
        recordings: The recordings.
    """
    grids = [grid_of(plant, recording) for recording in recordings]
    padded = iter(pad_together([inputs for inputs in grids if inputs is not None]))
    return [
        blank_response(plant, recording) if inputs is None else response_to(plant, next(padded), len(recording))
        for recording, inputs in zip(recordings, grids, strict=True)
    ]


def grid_of(plant: Plant, recording: Recording) -> Inputs | None:
    """Return the inputs of a recording on a grid; ``None`` where it has too many steps for a check.

    A recording whose rows are far apart compared with the time constant of the wire is simulated with rows that are
    just far enough apart for the wire to follow its input.

    Args:
        plant: The plant.
        recording: The recording.
    """
    if count_steps(plant, recording) <= _MAX_STEPS:
        return discretise(plant, recording)
    if isinstance(plant.heat, PrescribedTemperature):
        return None
    spacing = float(np.median(np.diff(recording.time)))
    pace = SETTLED * wire_time_constant(plant) / spacing
    faster = dataclasses.replace(recording, time=recording.time * min(pace, 1.0))
    return discretise(plant, faster) if count_steps(plant, faster) <= _MAX_STEPS else None


def response_to(plant: Plant, inputs: Inputs, rows: int) -> BenchResponse:
    """Simulate inputs on a grid.

    Args:
        plant: The plant.
        inputs: The inputs.
        rows: Number of rows of their recording.
    """
    response = run.simulate_inputs(plant, inputs)
    failed = int(response.status) != SimulationStatus.done
    temperature = np.asarray(response.state.temperature)[:rows]
    temperature = temperature.reshape(rows, -1, temperature.shape[-1]).mean(axis=1)
    martensite = sum(np.asarray(fraction)[:rows] for fraction in response.state.fractions)
    with np.errstate(invalid="ignore"):
        transforms = bool(np.max(np.ptp(martensite, axis=0)) > _TRANSFORMS)
    channels = {c: np.full(rows, np.nan) if failed else np.asarray(v)[:rows] for c, v in response.channels.items()}
    return BenchResponse(channels, temperature, transforms and not failed)


def blank_response(plant: Plant, recording: Recording) -> BenchResponse:
    """Return a response without values.

    Args:
        plant: The plant.
        recording: The recording.
    """
    blank = np.full(len(recording), np.nan)
    return BenchResponse(
        dict.fromkeys(plant.observable, blank), np.full((len(recording), plant.mechanism.wires), np.nan), False
    )
