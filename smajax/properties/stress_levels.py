"""Thermal cycles of one recording, grouped by the stress under which they ran."""

import dataclasses
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from smajax.errors import InputError
from smajax.properties.branch_properties import Tangent
from smajax.properties.cycle_rows import temperature_noise, unpaired_branches
from smajax.properties.refused_cycles import RefusedCycle
from smajax.properties.thermal_cycles import Cycle, analyse_cycles
from smajax.recordings.recording import Recording

# Temperatures are smoothed where their noise from row to row is above this (K): without smoothing, such noise moves the
# fitted lines by kelvins. Chosen by trial; tests/unit/properties/test_properties.py holds it.
_NOISY = 0.5
# Rows of the running median with which they are smoothed; chosen by trial, held by the same tests.
_SMOOTHED_ROWS = 9
# The stress of a row is that of its cycle within this share of the cycle's median plus the offset (Pa) below: what a
# dead weight or a slow force controller achieves. Chosen by trial.
_CONSTANT_SHARE = 0.1
_CONSTANT_OFFSET = 5e6
# A cycle has one stress where it holds for at least this share of its rows. Chosen by trial.
_CONSTANT_ROWS = 0.9
# Two cycles have the same stress where their medians differ by less than this share plus the offset (Pa) below. Chosen
# by trial.
_SAME_SHARE = 0.02
_SAME_OFFSET = 2e6


@dataclasses.dataclass(frozen=True)
class StressGroup:
    """The cycles of a recording under one stress.

    Attributes:
        recording: The recording.
        smooth: Rows of the running median of the temperatures.
        cycles: The cycles under this stress; none where no cycle of the recording can be analysed.
        refused: The reason for each cycle that cannot be analysed; all of them in the recording's first group.
        stress: The stress (Pa); ``None`` where it was not recorded.
        unpaired: Branches that are in no cycle, as ``cycle_rows.unpaired_branches`` returns them; all of them in the
            recording's first group.
    """

    recording: Recording
    smooth: int
    cycles: list[Cycle]
    refused: list[RefusedCycle]
    stress: float | None
    unpaired: Sequence[tuple[int, int, bool]] = ()


def analyse_recording(
    recording: Recording,
    *,
    smooth: int | None = None,
    tangent: Tangent = "lines",
    progress: Callable[[str], None] = lambda text: None,
) -> list[StressGroup]:
    """Analyse the thermal cycles of a recording and group them by stress.

    Args:
        recording: A recording with the channels temperature and strain, and with stress if it was measured.
        smooth: Rows of the running median of the temperatures, an odd number; by default 9 where their noise is
            above 0.5 K, else 1.
        tangent: The line along the transformation: that of three lines fitted by least squares ("lines"), or the
            tangent where the transformation is steepest ("steepest").
        progress: Called with the name of each cycle before it is analysed.

    Returns:
        The groups in the order of the cycles, at least one. What cannot be analysed does not raise: a group has a
        reason.
    """
    name, temperature = recording.name, recording.channels["temperature"]
    if smooth is None:
        smooth = _SMOOTHED_ROWS if temperature_noise(temperature) > _NOISY else 1
    try:
        cycles, refused = analyse_cycles(
            name, temperature, recording.channels["strain"], smooth=smooth, tangent=tangent, progress=progress
        )
        unpaired = unpaired_branches(name, temperature, smooth=smooth)
    except InputError as error:
        return [StressGroup(recording, smooth, [], [RefusedCycle(name, error)], None)]
    if "stress" not in recording.channels:
        return [StressGroup(recording, smooth, cycles, refused, None, unpaired)]
    levels, changing = _group_by_stress(recording, cycles)
    if not levels:
        return [StressGroup(recording, smooth, [], refused + changing, None, unpaired)]
    return [
        StressGroup(recording, smooth, group, [] if k else refused + changing, stress, () if k else unpaired)
        for k, (stress, group) in enumerate(levels)
    ]


def _group_by_stress(
    recording: Recording, cycles: Sequence[Cycle]
) -> tuple[list[tuple[float, list[Cycle]]], list[RefusedCycle]]:
    """Stresses with their cycles, in order, and a reason for each cycle in which the stress changes."""
    levels: list[tuple[float, list[Cycle]]] = []
    changing = []
    for cycle in cycles:
        stress = recording.channels["stress"][cycle.rows[0] : cycle.rows[1] + 1]
        median = float(np.median(stress))
        if np.mean(_near(stress, median, _CONSTANT_SHARE, _CONSTANT_OFFSET)) < _CONSTANT_ROWS:
            error = InputError(
                f"its stress varies from {np.min(stress) / 1e6:.4g} to {np.max(stress) / 1e6:.4g} MPa: keep the stress "
                "constant throughout a cycle",
                code="stress-varies",
            )
            changing.append(RefusedCycle(recording.name, error, cycle.number, cycle.rows))
            continue
        same = next((level for level in levels if _near(level[0], median, _SAME_SHARE, _SAME_OFFSET)), None)
        if same is None:
            levels.append((median, [cycle]))
        else:
            same[1].append(cycle)
    return levels, changing


def count_stresses(stresses: Iterable[float]) -> int:
    """Count the stresses that differ by more than the scatter of a dead weight or a force controller.

    Args:
        stresses: Stresses (Pa) of cycles or of their means.
    """
    levels: list[float] = []
    for stress in sorted(stresses):
        if not levels or not _near(stress, levels[-1], _SAME_SHARE, _SAME_OFFSET):
            levels.append(stress)
    return len(levels)


def _near(stress: np.ndarray | float, level: float, share: float, offset: float) -> np.ndarray | np.bool_:
    return np.abs(stress - level) <= share * abs(level) + offset
