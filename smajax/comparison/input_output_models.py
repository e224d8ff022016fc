"""Fits of input-output models to the driving input of a rig and one observed channel.

Models in discrete time need equally spaced rows. For them both recordings are resampled at the median step of the
training recording; they are scored at the recorded rows.
"""

from collections.abc import Sequence

import numpy as np

from smajax.comparison.driving_input import driving_inputs
from smajax.comparison.model_result import ModelResult
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.fitting.io_models.fit import IOModelFit, fit_io_model
from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs import MODEL_SPECS
from smajax.laws.row_spacing import is_evenly_spaced
from smajax.recordings.recording import Recording

# Number of starts for models with few parameters, and for networks, whose fits take longer. Chosen by trial.
_STARTS = 16
_STARTS_OF_NETWORKS = 4
# Share of the training input's range by which the input of the holdout may exceed it without a note. Chosen by trial.
_MAX_EXTRAPOLATION = 0.05


def fit_input_output_model(
    rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int
) -> ModelResult:
    """Fit an input-output model to the first recording, and predict the others.

    Args:
        rig: The rig, whose inputs are candidates for the model's input.
        name: The model, as in ``MODEL_SPECS``.
        recordings: The training recording, and the holdout.
        channel: The channel to fit and compare.
        seed: Seed of the starts.

    Raises:
        InputError: If the recordings have no single driving input, or too few rows.
        NumericsError: If the fit fails.
        KeyboardInterrupt: If the fit was interrupted.
    """
    inputs = driving_inputs(rig, name, recordings)
    if not any(np.any(recordings[0].channels[c]) for c in inputs):
        raise InputError(
            f"{inputs[0]} is 0 in all rows of {recordings[0].name}, which does not show its effect: give one that is "
            "driven"
        )
    if name == "heating-cooling" and len(inputs) > 1:
        raise InputError(
            f"{name} takes one wire, which heats or cools, and here {' and '.join(inputs)} take turns: compare the "
            "other models"
        )
    spec = MODEL_SPECS[name]([_to_series(r, inputs, channel) for r in recordings[:1]])
    resampled, note = _resample(spec, recordings, inputs if rig.interpolation == "hold" else ())
    series = [_to_series(r, inputs, channel) for r in resampled]
    starts = _STARTS if spec.weight_mask is None else _STARTS_OF_NETWORKS
    result = fit_io_model(spec, series[:1], starts=starts, seed=seed)
    if result.interrupted:
        raise KeyboardInterrupt  # ends the comparison with the models before this one
    responses = [result.respond(s) for s in series]
    predictions = (
        y if even is r else np.interp(r.time, even.time, y)
        for r, even, y in zip(recordings, resampled, responses, strict=True)
    )
    notes = [note, f"its input is {' less '.join(inputs)}" if len(inputs) > 1 else "", _extrapolation_note(series)]
    notes += _network_notes(result, recordings[0].name)
    return ModelResult(
        name,
        "input-output",
        result.spec.size,
        tuple(predictions),
        note="; ".join(text for text in notes if text),
        at_bound=result.at_bound,
        undetermined=result.undetermined,
        fitted=result.values,
    )


def _to_series(recording: Recording, inputs: Sequence[str], channel: str) -> Series:
    """Input and output of a model; the input is the difference of the commands if there are two."""
    first, *second = (recording.channels[c] for c in inputs)
    return Series(recording.name, recording.time, first - sum(second), recording.channels[channel])


def _resample(spec: ModelSpec, recordings: Sequence[Recording], held: Sequence[str]) -> tuple[list[Recording], str]:
    """The recordings, on equally spaced rows if a model needs them, and a note; ``held`` inputs are steps."""
    step = float(np.median(np.diff(recordings[0].time)))
    if not spec.needs_even_rows or all(is_evenly_spaced(r.time, step) for r in recordings):
        return list(recordings), ""
    resampled = [r if is_evenly_spaced(r.time, step) else r.resample(step, held) for r in recordings]
    names = " and ".join(r.name for r, even in zip(recordings, resampled, strict=True) if even is not r)
    return resampled, f"it needs rows every {step:.4g} s: {names} resampled for it, and scored at the rows recorded"


def _extrapolation_note(series: Sequence[Series]) -> str:
    """A note if the input of the holdout exceeds the range of the training input; empty if it does not."""
    low, high = float(np.min(series[0].input)), float(np.max(series[0].input))
    margin = _MAX_EXTRAPOLATION * (high - low)
    lowest, highest = float(np.min(series[1].input)), float(np.max(series[1].input))
    if low - margin <= lowest and highest <= high + margin:
        return ""
    return (
        f"the input of {series[1].name} goes from {lowest:.3g} to {highest:.3g}, beyond the range {low:.3g} to "
        f"{high:.3g} of the training input (SI units), where no row supports its prediction"
    )


def _network_notes(result: IOModelFit, train: str) -> list[str]:
    """Notes on the ridge penalty of a network, and on inputs with which it diverges."""
    notes = []
    if result.ridge:
        notes.append(
            f"its weights have a ridge penalty of {result.ridge:g}, chosen by cross-validation on quarters of {train}"
        )
    if result.divergence_rate:
        notes.append(
            f"it diverges on {100 * result.divergence_rate:.0f} % of inputs made of the pieces of its input in other "
            "orders: do not rely on it for another input before it is fitted to more recordings"
        )
    return notes
