"""Thermal cycles of one recording, grouped by the stress under which they ran."""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from smajax.errors import InputError
from smajax.properties.branch_properties import Tangent
from smajax.properties.cycle_rows import temperature_noise, unpaired_branches
from smajax.properties.thermal_cycles import Cycle, analyse_cycles
from smajax.recordings.recording import Recording

# Temperatures are smoothed where their noise from row to row is above this (K), over so many rows: unsmoothed, such
# noise moves the fitted lines by kelvins. Chosen by trial; tests/unit/properties/test_properties.py holds both.
_NOISY = 0.5
_SMOOTHED_ROWS = 9
# A cycle runs under one stress where most of its rows lie within this share of it plus so many Pa: what a dead weight
# or a slow controller of the force keeps. Chosen by trial.
_CONSTANT_SHARE = 0.1
_CONSTANT_OFFSET = 5e6
_CONSTANT_ROWS = 0.9
# Cycles run under the same stress where their medians differ by less than this share plus so many Pa. Chosen by trial.
_SAME_SHARE = 0.02
_SAME_OFFSET = 2e6


@dataclasses.dataclass(frozen=True)
class StressGroup:
    """The cycles of a recording under one stress.

    Attributes:
        recording: The recording.
        smooth: Rows of the running median of the temperatures.
        cycles: The cycles under this stress; none where no cycle of the recording can be analysed.
        refused: A sentence for each cycle that cannot be analysed; all of them in the recording's first group.
        stress: The stress (Pa), ``None`` where it was not recorded.
        unpaired: Branches that are in no cycle, see ``unpaired_branches``; all of them in the recording's first group.
    """

    recording: Recording
    smooth: int
    cycles: list[Cycle]
    refused: list[str]
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
        recording: A recording with temperature and strain, and with stress where there is one.
        smooth: Rows of the running median of the temperatures, an odd number; by default 9 where their noise is
            above 0.5 K, else 1.
        tangent: The line along the transformation, see ``analyse_cycles``.
        progress: Called with the name of each cycle before it is analysed.

    Returns:
        The groups in the order of the cycles, at least one. What cannot be analysed is a sentence in a group, not an
        error.
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
        return [StressGroup(recording, smooth, [], [str(error)], None)]
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
) -> tuple[list[tuple[float, list[Cycle]]], list[str]]:
    """Stresses with their cycles, in order, and a sentence for each cycle in which the stress changes."""
    levels: list[tuple[float, list[Cycle]]] = []
    changing = []
    for cycle in cycles:
        stress = recording.channels["stress"][cycle.rows[0] : cycle.rows[1] + 1]
        median = float(np.median(stress))
        if np.mean(_near(stress, median, _CONSTANT_SHARE, _CONSTANT_OFFSET)) < _CONSTANT_ROWS:
            changing.append(
                f"{recording.name}, cycle {cycle.number} (rows {cycle.rows[0] + 1} to {cycle.rows[1] + 1}): its stress "
                "goes from "
                f"{np.min(stress) / 1e6:.4g} to {np.max(stress) / 1e6:.4g} MPa: hold one stress throughout a cycle"
            )
            continue
        same = next((level for level in levels if _near(level[0], median, _SAME_SHARE, _SAME_OFFSET)), None)
        if same is None:
            levels.append((median, [cycle]))
        else:
            same[1].append(cycle)
    return levels, changing


def _near(stress: np.ndarray | float, level: float, share: float, offset: float) -> np.ndarray:
    return np.abs(stress - level) <= share * abs(level) + offset
