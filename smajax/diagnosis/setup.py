"""Set-up of a diagnosis: checks of the recordings, usable channels, and the rig with the effects that were found."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smajax import parameters
from smajax.diagnosis.auxiliary_channels import (
    ChannelFault,
    auxiliary_channels,
    saturation,
    with_auxiliary_channels,
    without_channels,
)
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.memory import require_diagnosis_memory
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.structure import SPREADS
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.recordings.shared_rows import refuse_copies

# Smallest number of rows of each recording: with fewer, intervals, noise and classes of effects are not reliable.
# Chosen by trial.
_MIN_ROWS = 200


class DiagnosisSetup(NamedTuple):
    """Input of a diagnosis.

    Attributes:
        problem: The problem.
        auxiliary: Auxiliary channels.
        left_out: Reasons by channel for the channels that are not used.
    """

    problem: DiagnosisProblem
    auxiliary: tuple[str, ...]
    left_out: Mapping[str, ChannelFault]


def set_up_diagnosis(rig: Rig, recordings: Sequence[Recording]) -> DiagnosisSetup:
    """Build the problem of a diagnosis, without saturated channels and with every auxiliary channel.

    The compilation of its programs starts in the background.

    Args:
        rig: The rig.
        recordings: Recordings for training, selection and holdout.

    Raises:
        InputError: If a recording cannot be used (``check_recordings``), the memory is not enough, every observed
            channel is saturated, or the rig has parameters for each recording or free start values.
    """
    if rig.fit.per_recording:
        raise InputError(
            f"{rig.path or rig.name}: a diagnosis takes one set of parameters for all recordings: "
            "move fit.per_recording to fit.free"
        )
    check_recordings(recordings, rig.plant.signals)
    require_diagnosis_memory(rig.plant, recordings, interpolation=rig.interpolation)
    saturated = _saturated_channels(rig.fit.observe, recordings)
    auxiliary, unusable = auxiliary_channels(rig.plant, rig.fit.observe, recordings)
    plant, settings = with_auxiliary_channels(rig.plant, without_channels(rig.fit, list(saturated)), auxiliary)
    problem = DiagnosisProblem(plant, recordings, settings, interpolation=rig.interpolation)
    return DiagnosisSetup(problem, auxiliary, saturated | unusable)


def check_recordings(recordings: Sequence[Recording], signals: Sequence[str]) -> None:
    """Refuse recordings that are too short or copies of each other, and training inputs that never change.

    Args:
        recordings: Recordings for training, selection and holdout.
        signals: Names of the channels that drive the plant.

    Raises:
        InputError: If a recording cannot be used.
    """
    for recording in recordings:
        if len(recording) < _MIN_ROWS:
            raise InputError(
                f"{recording.name}: {len(recording)} rows are too few for a diagnosis: at least {_MIN_ROWS} are needed"
            )
    refuse_copies(recordings)
    train = recordings[TRAIN]
    if signals and all(np.ptp(train.channels[name]) == 0.0 for name in signals):
        raise InputError(
            f"{train.name}: {' and '.join(signals)} never change{'s' * (len(signals) == 1)}, "
            "so that no effect can be detected: vary the input"
        )


def diagnosed_rig(rig: Rig, plant: Plant, auxiliary: Sequence[str]) -> Rig:
    """Return the rig with a diagnosed plant; spreads of grains that it did not have are free unless they are 0.

    Args:
        rig: The rig.
        plant: The plant with the effects (``Diagnosis.plant``).
        auxiliary: Auxiliary channels; those that one of the effects needs are added to the observed channels.
    """
    needed = [c for c in auxiliary if any(f"{c} observed" in effect.needs for effect in plant.effects)]
    is_new = plant.grains is not None and rig.plant.grains is None
    free = [name for name in SPREADS if is_new and float(parameters.get(plant, name)) > 0.0]
    fit = dataclasses.replace(rig.fit, observe=(*rig.fit.observe, *needed), free=(*rig.fit.free, *free))
    return dataclasses.replace(rig, plant=plant, fit=fit)


def _saturated_channels(observed: Sequence[str], recordings: Sequence[Recording]) -> dict[str, ChannelFault]:
    """Reasons by observed channel why it is saturated; refuses recordings of which all are."""
    faults = {c: fault for c in observed if (fault := saturation(c, recordings))}
    if len(faults) == len(observed):
        raise InputError(
            f"{next(iter(faults.values())).text}, as a saturated or clipped sensor does: remove these rows, "
            "or record with a wider range"
        )
    return faults
