"""The analysis of several recordings of thermal cycles: groups by stress, means, and start values of a law."""

import dataclasses
from collections.abc import Callable, Sequence

from smajax.errors import InputError
from smajax.files.parameter_sets import Entry
from smajax.properties.branch_properties import Tangent
from smajax.properties.refused_cycles import RefusedCycle, merge_refusals
from smajax.properties.start_values import StressLevel, make_start_values
from smajax.properties.stress_levels import StressGroup, analyse_recording
from smajax.properties.thermal_cycles import Value, mean_properties
from smajax.recordings.recording import Recording

_CHANNELS = ("temperature", "strain", "stress")


@dataclasses.dataclass(frozen=True)
class CycleAnalysis:
    """The properties of the thermal cycles of one or more recordings.

    Attributes:
        groups: The cycles by recording and stress, in the order of the recordings.
        tangent: The line along the transformation.
    """

    groups: tuple[StressGroup, ...]
    tangent: Tangent

    @property
    def levels(self) -> list[StressLevel]:
        """Mean properties at each stress of each recording, without groups that have no cycle."""
        return [StressLevel(g.recording.name, g.stress, mean_properties(g.cycles)) for g in self.groups if g.cycles]

    @property
    def means(self) -> dict[str, Value]:
        """Mean properties over all cycles, by the names in ``thermal_cycles.PROPERTY_NAMES``."""
        return mean_properties([cycle for group in self.groups for cycle in group.cycles])

    @property
    def refused(self) -> list[RefusedCycle]:
        """The cycles that cannot be analysed, with their reasons."""
        return [refusal for group in self.groups for refusal in group.refused]

    def start_values(self, model: str = "brinson") -> dict[str, Entry]:
        """Make start values of a material law, see ``start_values.make_start_values``.

        Args:
            model: The material law.

        Returns:
            Entries of a parameter set by parameter name, in internal units.

        Raises:
            InputError: A stress was not recorded, or the transformation strain is too small.
        """
        return make_start_values(self.levels, model)


def analyse_recordings(
    recordings: Sequence[Recording],
    *,
    smooth: int | None = None,
    tangent: Tangent = "lines",
    progress: Callable[[str], None] = lambda text: None,
) -> CycleAnalysis:
    """Analyse the thermal cycles of recordings, and group them by stress.

    Args:
        recordings: Recordings with the channels temperature and strain, and with stress if it was measured.
        smooth: Rows of the running median of the temperatures, an odd number; by default as their noise requires.
        tangent: The line along the transformation: ``lines`` or ``steepest``.
        progress: Called with the name of each cycle before it is analysed.

    Returns:
        The groups; one that cannot be analysed has the reasons.

    Raises:
        InputError: A recording is given twice or lacks a channel, or no cycle of any recording can be analysed.
    """
    if not recordings:
        raise InputError("there is no recording to analyse: give at least one with temperature and strain")
    for k, recording in enumerate(recordings):
        missing = [c for c in ("temperature", "strain") if c not in recording.channels]
        if missing:
            raise InputError(
                f"{recording.name} has no channel {missing[0]}: thermal cycles need temperature and strain"
            )
        if any(other is recording for other in recordings[:k]):
            raise InputError(
                f"{recording.name}: this recording is given twice, so its cycles would count twice: give each one once"
            )
    groups = [
        group
        for recording in map(_with_note, recordings)
        for group in analyse_recording(recording, smooth=smooth, tangent=tangent, progress=progress)
    ]
    analysis = CycleAnalysis(tuple(groups), tangent)
    if not any(group.cycles for group in groups):
        raise InputError("; ".join(merge_refusals(analysis.refused)))
    return analysis


def _with_note(recording: Recording) -> Recording:
    """The recording with a note on its channels that thermal cycles do not need."""
    unused = [channel for channel in recording.channels if channel not in _CHANNELS]
    if not unused:
        return recording
    note = f"recorded and not used, since thermal cycles have {', '.join(_CHANNELS)}: {', '.join(unused)}"
    return dataclasses.replace(recording, notes=(*recording.notes, note))
