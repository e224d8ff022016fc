"""The driving input of an input-output model: the input of a rig that changes, or the difference of two commands."""

from collections.abc import Sequence

import numpy as np

from smajax.channels import channel_unit, numbered
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording

# One of several inputs is constant if its range is at most the first share of its median, or at most the second share
# of the largest range of an input in the same unit. Chosen by trial; tests/unit/comparison/test_comparison.py holds
# both.
_CONSTANT_SHARE_OF_LEVEL = 0.05
_CONSTANT_SHARE_OF_OTHERS = 0.01
# Share of its largest absolute value above which an input is on.
_ON_SHARE = 0.01
# Largest share of the rows in which two alternating wires may both be on: switching takes a row or two. Chosen by
# trial.
_MAX_OVERLAP = 0.02
# Range, SI, up to which an input is constant but for rounding.
_ROUNDING = 1e-9
# Least maximum of an input, so that an input that is 0 throughout is never on.
_TINY = 1e-300


def driving_inputs(rig: Rig, model: str, recordings: Sequence[Recording]) -> list[str]:
    """Find the input that drives a rig, or those of two wires that pull by turns.

    Args:
        rig: The rig.
        model: Name of the model that takes one input, for messages.
        recordings: The training recording, and the others.

    Returns:
        One channel, or two; the input of the model is then the first minus the second.

    Raises:
        InputError: If no input changes, or if several change that cannot be combined into one.
    """
    control, inputs = rig.plant.drive.control, changing_inputs(rig.plant.signals, recordings)
    if not inputs:  # a single input that is on all the time is a step from the initial state
        inputs = [
            c for c in rig.plant.signals if control and c.startswith(control) and np.any(recordings[0].channels[c])
        ]
    if len(inputs) == 1:
        return inputs
    changing = " and ".join(inputs) if inputs else "no input"
    problem = f"takes one input that changes, and here {changing} change{'' if inputs else 's'}"
    if len(inputs) == 2 and rig.plant.mechanism.wires == 2 and control and inputs == list(numbered(control, 2)):
        overlaps = [_overlap(r, inputs) for r in recordings]
        if max(overlaps) <= _MAX_OVERLAP:
            return inputs
        worst = recordings[int(np.argmax(overlaps))]
        raise _refusal(
            model,
            f"{problem}: both are on at {100 * max(overlaps):.0f} % of the rows of {worst.name}: let the wires pull "
            "by turns, so that the difference of their commands is one input, or compare the material laws, which take "
            "both",
        )
    hint = "hold the others constant, or compare the material laws, which take all of them" if inputs else "vary one"
    raise _refusal(model, f"{problem}: {hint}")


def _refusal(model: str, reason: str) -> InputError:
    """The error of a model with a reason that holds for other models, too."""
    return InputError(f"{model} {reason}", code="driving-input", shared_reason=reason)


def changing_inputs(signals: Sequence[str], recordings: Sequence[Recording]) -> list[str]:
    """List the inputs that change; of several, those that vary by more than noise about a level.

    Args:
        signals: Names of the driving channels.
        recordings: The recordings.
    """
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
