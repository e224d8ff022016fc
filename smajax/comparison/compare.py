"""Fits of several models to one recording, and their predictions of another."""

import dataclasses
import threading
import time
from collections.abc import Callable, Sequence

import numpy as np

from smajax.comparison.input_output_models import fit_input_output_model
from smajax.comparison.material_models import fit_material_model
from smajax.comparison.model_result import ModelResult
from smajax.errors import Cancelled, InputError, NumericsError
from smajax.files.rig_file import Rig
from smajax.numerics.ensemble import share_among_cores
from smajax.plant.materials.registry import MATERIALS
from smajax.progress import CallbackStop, stoppable
from smajax.recordings.recording import Recording

# Absolute value from which a prediction counts as not finite: its square would overflow in the scores.
_OVERFLOW = 1e100


def compare_models(
    rig: Rig,
    models: Sequence[str],
    recordings: Sequence[Recording],
    *,
    seed: int,
    progress: Callable[[str], object] = lambda model: None,
) -> list[ModelResult]:
    """Fit each model to the training recording and predict the first observed channel of the holdout, one per core.

    Args:
        rig: The rig, with the fit settings of the material laws.
        models: Names of the models, as in ``model_names()``.
        recordings: The training recording and the holdout.
        seed: Seed of the starts.
        progress: Called with the name of each model before it is fitted; ends the comparison if it raises
            ``StopIteration``, as Ctrl-C does.

    Returns:
        A result for each model, in the given order; one that cannot be fitted has a reason instead of predictions. A
        comparison that is stopped has the models that were fitted before. The wall time of a model is longer where
        others were fitted at the same time.

    Raises:
        InputError: If no model can be fitted, for each of them because of the input.
        NumericsError: If no model can be fitted, for at least one of them because of the numerics.
        Cancelled: If the comparison is stopped before a model was fitted.
    """
    report, lock, waiting = stoppable(progress), threading.Lock(), list(models)
    finished: dict[str, ModelResult] = {}

    def fit_next(_: int) -> None:
        try:
            with lock:
                if not waiting:
                    return
                name = waiting.pop(0)
                if name != models[0]:
                    report(name)
            finished[name] = _fit_model(rig, name, recordings, rig.fit.observe[0], seed)
        except (CallbackStop, Cancelled):
            waiting.clear()

    try:
        report(models[0])  # in this thread, which alone may set the handling of Ctrl-C
        share_among_cores(fit_next, range(len(models)))
    except (CallbackStop, KeyboardInterrupt):
        waiting.clear()
    results = [finished[name] for name in models if name in finished]
    if len(results) < len(models) and all(result.reason for result in results):
        raise Cancelled("the comparison was cancelled before a model was fitted")
    if all(result.reason for result in results):
        error = InputError if all(result.input_insufficient for result in results) else NumericsError
        raise error("no model could be fitted: " + _merge_reasons(results))
    return results


def _fit_model(rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int) -> ModelResult:
    """Fit one model; if that fails, return a result with the reason, so that the others are still compared."""
    start, is_law = time.perf_counter(), name in MATERIALS
    fit_model = fit_material_model if is_law else fit_input_output_model
    try:
        result = fit_model(rig, name, recordings, channel, seed)
        for recording, values in zip(recordings, result.predictions, strict=True):
            _check_finite(recording, channel, values)
    except (InputError, NumericsError) as error:
        kind = "law" if is_law else "input-output"
        is_input = isinstance(error, InputError)
        shared = error.fields.get("shared_reason", "") if is_input else ""
        return ModelResult(name, kind, reason=str(error), shared_reason=shared, input_insufficient=is_input)
    return dataclasses.replace(result, wall_time=time.perf_counter() - start)


def _check_finite(recording: Recording, channel: str, values: np.ndarray) -> None:
    """Raise ``NumericsError`` if a prediction is not finite at a measured row, since it could not be ranked."""
    not_finite = np.isfinite(recording.channels[channel]) & ~(np.abs(values) < _OVERFLOW)
    if np.any(not_finite):
        row = int(np.argmax(not_finite))
        raise NumericsError(
            f"{recording.name}: its prediction of {channel} is not finite at {np.sum(not_finite)} of {len(values)} "
            f"rows, first at row {row + 1}, {recording.time[row]:.6g} s"
        )


def _merge_reasons(results: Sequence[ModelResult]) -> str:
    """The reasons why no model could be fitted, each one once with the models that share it."""
    names_by_reason: dict[str, list[str]] = {}
    for result in results:
        names_by_reason.setdefault(result.shared_reason or result.reason, []).append(result.name)
    return "; ".join(f"{', '.join(names)}: {reason}" for reason, names in names_by_reason.items())
