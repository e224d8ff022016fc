"""Whether a wire transforms on recordings, and starts at which it does where it does not at the values of its rig.

Where nothing transforms, no parameter of the transformations changes the model, and no gradient leads to values at
which something does.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smajax.fitting.problem import Problem
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation import run
from smajax.simulation.inputs import discretise
from smajax.simulation.padding import pad_together
from smajax.simulation.status import SimulationStatus

# A wire whose martensite fraction changes by less than this share does not transform: of a usual transformation strain
# of 4 % it is a strain of 0.02 %, as large as a thermal strain of 20 K.
_MIN_CHANGE = 5e-3
# Free parameters whose estimates need a transformation.
_ENDS = tuple(f"material.{phase}_{end}" for phase in ("austenite", "martensite") for end in ("start", "finish"))
_SHIFTS = ("material.austenite_shift", "material.martensite_shift")
_OTHERS = tuple(
    f"material.{key}"
    for key in ("clausius_clapeyron_austenite", "clausius_clapeyron_martensite", "max_transformation_strain")
)


class TransformationGap(NamedTuple):
    """How far a wire is from its transformation on recordings.

    Attributes:
        is_martensite: Whether the wire stays martensite; otherwise it stays austenite.
        kelvin: Least distance in K of a row from the temperature at which the other phase starts, under its stress.
        start: Temperature at which the other phase starts at zero stress, degC.
        temperature: Highest temperature of a wire that stays martensite, lowest of one that stays austenite, degC.
        displacements: Range in K by which all transformation temperatures together may change so that the recorded
            temperatures and stresses are among them.
    """

    is_martensite: bool
    kelvin: float
    start: float
    temperature: float
    displacements: tuple[float, float]

    def sentence(self, recordings: Sequence[Recording], values: str) -> str:
        """Say that the wire does not transform, why, and which way its temperatures would have to go.

        Args:
            recordings: The recordings.
            values: The values in words, such as "these start values".
        """
        names = recordings[0].name if len(recordings) == 1 else f"these {len(recordings)} recordings"
        start = "A_s" if self.is_martensite else "M_s"
        side, row, way = ("above", "hottest", "lower") if self.is_martensite else ("below", "coldest", "higher")
        phase = "martensite" if self.is_martensite else "austenite"
        return (
            f"At {values} this wire does not transform on {names} and stays {phase}: {start} lies {self.kelvin:.0f} K "
            f"{side} the {row} row ({start} is {self.start:.4g} degC at zero stress, the {row} row has "
            f"{self.temperature:.4g} degC): {way} transformation temperatures are needed, unless the recording has "
            "no transformation."
        )


def needs_transformation(names: Sequence[str]) -> bool:
    """Return whether a parameter is free that only a transformation determines.

    Args:
        names: Names of the free parameters.
    """
    return any(name in (*_ENDS, *_SHIFTS, *_OTHERS) for name in names)


def transformation_gap(
    plants: Sequence[Plant],
    recordings: Sequence[Recording],
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str | None = None,
    step: float | None = None,
) -> TransformationGap | None:
    """Simulate recordings and find how far the wire is from transforming.

    Args:
        plants: One plant for each recording.
        recordings: The recordings.
        holdout: Further recordings of the fit, which give the length of the grid only, so that the program is the one
            that simulates the responses of the fit.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plants' default if not given.

    Returns:
        The distance; ``None`` if the wire transforms on a recording, or a simulation fails.
    """
    grids = [
        discretise(plant, recording, interpolation=interpolation, step=step)
        for plant, recording in zip([*plants, *[plants[0]] * len(holdout)], [*recordings, *holdout], strict=True)
    ]
    padded = pad_together(grids)
    gaps = []
    for plant, recording, inputs in zip(plants, recordings, padded[: len(recordings)], strict=True):
        response = run.simulate_inputs(plant, inputs)
        martensite = np.asarray(response.state.fractions.martensite)
        if int(response.status) != SimulationStatus.done or np.max(np.ptp(martensite, axis=0)) > _MIN_CHANGE:
            return None
        state = (np.asarray(response.state.temperature), np.asarray(response.state.stress), martensite)
        gaps.append(_gap(plant, recording, *state))
    return min(gaps, key=lambda gap: gap.kelvin)


def _gap(
    plant: Plant, recording: Recording, temperature: np.ndarray, stress: np.ndarray, martensite: np.ndarray
) -> TransformationGap:
    """Distance from the transformation along a simulation in which the martensite fraction does not change."""
    law = plant.effective_material
    austenite_start = float(law.austenite_start + law.austenite_shift)
    austenite_finish = float(law.austenite_finish + law.austenite_shift)
    martensite_start = float(law.forward_start)
    martensite_finish = float(law.martensite_finish + law.martensite_shift)
    slope_austenite = float(law.clausius_clapeyron_austenite)
    slope_martensite = float(law.clausius_clapeyron_martensite)
    measured = [v for c, v in recording.channels.items() if c.partition("_")[0] == "stress"]
    highest = max([float(np.max(stress)), *(float(np.nanmax(v)) for v in measured)])
    # Where stress-induced martensite starts at a higher stress than zero, that part of the stress raises nothing.
    threshold = float(getattr(law, "detwinning_start_stress", 0.0))
    is_martensite = bool(np.mean(martensite) > 0.5)
    if is_martensite:
        kelvin = np.min(austenite_start + stress / slope_austenite - temperature)
    else:
        kelvin = np.min(temperature - martensite_start - np.maximum(stress - threshold, 0.0) / slope_martensite)
    coldest, hottest = float(np.min(temperature)), float(np.max(temperature))
    raised = max(highest, 0.0) / min(slope_austenite, slope_martensite)
    return TransformationGap(
        is_martensite,
        float(kelvin),
        austenite_start if is_martensite else martensite_start,
        hottest if is_martensite else coldest,
        (coldest - raised - max(austenite_finish, martensite_start), hottest - min(martensite_finish, austenite_start)),
    )


def displacement_direction(problem: Problem) -> np.ndarray:
    """Return the change of a problem's vector by 1 K in all its free transformation temperatures, shape ``(p,)``.

    Args:
        problem: The problem.
    """
    shifts = [name for name in (u.name for u in problem.unknowns) if name in _SHIFTS]
    moved = []
    for unknown in problem.unknowns:
        # A free shift moves both ends of its transformation already.
        shift = f"{unknown.name.rpartition('_')[0]}_shift"
        moved.append(unknown.name in _SHIFTS or (unknown.name in _ENDS and shift not in shifts))
    return np.where(moved, 1.0 / np.array([u.scale for u in problem.unknowns]), 0.0)
