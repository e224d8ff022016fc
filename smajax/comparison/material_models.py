"""Fits of material laws in a rig, in place of the rig's own law."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from smajax.comparison.model_result import ModelResult
from smajax.errors import NumericsError
from smajax.files.documents import finite_or_none, is_undetermined
from smajax.files.rig_file import Rig
from smajax.fitting.fit import fit
from smajax.fitting.io_models.problem import check_rows
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.material_laws import with_law
from smajax.fitting.result import Estimate
from smajax.recordings.recording import Recording
from smajax.simulation.status import SimulationStatus
from smajax.units import as_text


def fit_material_model(rig: Rig, name: str, recordings: Sequence[Recording], channel: str, seed: int) -> ModelResult:
    """Fit a material law to the first recording, with the rig's fit settings, and predict the others.

    Args:
        rig: The rig.
        name: The law, as in ``MATERIALS``.
        recordings: The training recording, and the holdout.
        channel: The compared channel.
        seed: Seed of the starts.

    Raises:
        InputError: If the training recording has too few rows.
        NumericsError: If a simulation with the fitted parameters fails.
        KeyboardInterrupt: If the fit was interrupted.
    """
    rig_with_law = with_material_law(rig, name)
    # Models without physics take the recorded input, and so do all.
    settings = cast(Any, dataclasses.replace(rig_with_law.fit, seed=seed, input_noise=0.0))
    rows = sum(int(np.sum(np.isfinite(recordings[0].channels[c]))) for c in settings.observe)
    check_rows(recordings[0].name, rows, len(settings.names), name)
    result = fit(rig_with_law.plant, recordings[:1], settings, holdout=recordings[1:], interpolation=rig.interpolation)
    if result.status is SolverStatus.interrupted:
        raise KeyboardInterrupt  # ends the comparison with the models before this one
    failed = [r for r in result.responses if r.status is not SimulationStatus.done]
    if failed:
        values = ", ".join(f"{e.name} = {as_text(e.estimate, e.unit)}" for e in result.estimates)
        raise NumericsError(
            f"{failed[0].recording.name}: {failed[0].status.name} with the fitted {values}: bound these "
            "(fit.bounds), free fewer, or give a training recording that goes as far"
        )
    at_bound = [e for e in result.estimates if e.at_bound]
    return ModelResult(
        name,
        "law",
        len(result.problem.unknowns),
        tuple(response.model[channel] for response in result.responses),
        at_bound=tuple(f"{e.name} ({as_text(float(f'{e.estimate:.5g}'), e.unit)})" for e in at_bound),
        undetermined=tuple(e.name for e in result.estimates if _is_undetermined(e)),
        fitted={e.name: _fitted_entry(e) for e in result.estimates},
    )


def with_material_law(rig: Rig, name: str) -> Rig:
    """Replace the material law of a rig.

    Parameters that both laws have keep their values and stay free if they were; those that only the new law has get
    start values.

    Args:
        rig: The rig.
        name: The new law, as in ``MATERIALS``.

    Raises:
        InputError: If the new law has a parameter without a default that the old one does not have.
    """
    plant, settings = with_law(rig.plant, rig.fit, name)
    if plant is rig.plant:
        return rig
    return dataclasses.replace(rig, plant=plant, fit=dataclasses.replace(settings, model=name))


def _fitted_entry(estimate: Estimate) -> Mapping[str, Any]:
    """An estimate as an entry of compare.json."""
    return {
        "value": finite_or_none(estimate.estimate),
        "lower95": finite_or_none(estimate.lower95),
        "upper95": finite_or_none(estimate.upper95),
        "free": True,
        "unit": estimate.unit,
    }


def _is_undetermined(estimate: Estimate) -> bool:
    bounds = [finite_or_none(end) for end in estimate.bounds]
    return is_undetermined({**_fitted_entry(estimate), "at_bound": estimate.at_bound, "bounds": bounds})
