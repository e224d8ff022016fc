"""The one input of an input-output model: the input of a rig that changes, or the difference of two commands."""

from collections.abc import Sequence

import numpy as np

from smajax.channels import channel_unit, numbered
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording

# Of several inputs, one whose range is below this share of its level is held constant; so is one whose range is below
# this share of that of another input of its kind. Chosen by trial; tests/unit/comparison/test_comparison.py holds both.
_CONSTANT_SHARE_OF_LEVEL = 0.05
_CONSTANT_SHARE_OF_OTHERS = 0.01
# Share of its largest value above which an input is on.
_ON_SHARE = 0.01
# Share of the rows in which two alternating wires may both be on: switching takes a row or two. Chosen by trial.
_MAX_OVERLAP = 0.02
# Range below which an input is constant but for rounding.
_ROUNDING = 1e-9
# Keeps a share of a maximum of 0 positive.
_TINY = 1e-300


def driving_inputs(rig: Rig, model: str, recordings: Sequence[Recording]) -> list[str]:
    """Find the input that drives a rig, or those of two wires that pull by turns.

    Args:
        rig: The rig.
        model: The model that takes one input, for messages.
        recordings: The training recording first.

    Returns:
        One input, or two, of which the first less the second is the input of the model.

    Raises:
        InputError: If no input changes, or if several do that cannot be one.
    """
    control, inputs = rig.plant.drive.control, changing_inputs(rig.plant.signals, recordings)
    if not inputs:  # a single input that is on all the time is a step from the initial state
        inputs = [
            c for c in rig.plant.signals if control and c.startswith(control) and np.any(recordings[0].channels[c])
        ]
    if len(inputs) == 1:
        return inputs
    listed = " and ".join(inputs) if inputs else "no input"
    said = f"{model} takes one input that changes, and here {listed} change{'' if inputs else 's'}"
    if len(inputs) == 2 and rig.plant.mechanism.wires == 2 and control and inputs == list(numbered(control, 2)):
        overlaps = [_overlap(r, inputs) for r in recordings]
        if max(overlaps) <= _MAX_OVERLAP:
            return inputs
        worst = recordings[int(np.argmax(overlaps))]
        raise InputError(
            f"{said}: both are on at {100 * max(overlaps):.0f} % of the rows of {worst.name}: let the wires pull by "
            "turns, "
            "so that the difference of their commands is one input, or compare the material laws, which take both"
        )
    hint = "hold the others constant, or compare the material laws, which take all of them" if inputs else "vary one"
    raise InputError(f"{said}: {hint}")


def changing_inputs(signals: Sequence[str], recordings: Sequence[Recording]) -> list[str]:
    """List the inputs that change; of several, those that do more than scatter about a level."""
    spans = {c: max(float(np.ptp(r.channels[c])) for r in recordings) for c in signals}
    varying = [c for c in signals if spans[c] > _ROUNDING]
    levels = {c: abs(float(np.median(np.concatenate([r.channels[c] for r in recordings])))) for c in varying}
    largest = {c: max(spans[other] for other in varying if channel_unit(other) == channel_unit(c)) for c in varying}
    changing = [
        c
        for c in varying
        if spans[c] > _CONSTANT_SHARE_OF_LEVEL * levels[c] and spans[c] > _CONSTANT_SHARE_OF_OTHERS * largest[c]
    ]
    return changing if len(varying) > 1 and changing else varying


def _overlap(recording: Recording, inputs: Sequence[str]) -> float:
    """Share of the rows in which all these inputs are on."""
    on = [
        np.abs(recording.channels[c]) > _ON_SHARE * max(float(np.max(np.abs(recording.channels[c]))), _TINY)
        for c in inputs
    ]
    return float(np.mean(np.all(on, axis=0)))
