"""The tuning problem of a controller file, whose members differ in parameters, noise and ambient temperature."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from smajax import parameters
from smajax.control.analysis.cases import DRAWN_CASES, QUIET_MEMBERS, ambient_members
from smajax.control.controller_file.read import ControllerFile
from smajax.control.tuning.plant_draws import draw_from_fit, draw_from_ranges
from smajax.control.tuning.problem import (
    GAIN_SPREAD,
    LIMITED_NOISE_DRAWS,
    NOISE_DRAWS,
    TuningProblem,
    noise_draws,
)
from smajax.errors import InputError
from smajax.files.result_folder import read_json
from smajax.files.rig_file import Rig

# Key of the random stream of the draws, which makes it independent of other streams with the same seed.
_DRAWS_STREAM = 7


# Name of the fitted rig in the folder of a fit.
_FITTED_RIG = "rig-fitted.toml"


def with_fit_of_rig(rig: Rig, settings: ControllerFile) -> ControllerFile:
    """Let cases vary what the fit of a fitted rig leaves open, where the controller file has no section [robust].

    Args:
        rig: The rig; it belongs to a fit if its file is rig-fitted.toml in the folder of one.
        settings: The content of a controller file.

    Returns:
        The settings with the folder of the fit and a note that says so, or why the fit cannot be used.
    """
    is_fitted = rig.path is not None and rig.path.name == _FITTED_RIG and (rig.path.parent / "fit.json").is_file()
    if settings.robust is not None or settings.check == 1 or rig.path is None or not is_fitted:
        return settings
    folder = rig.path.parent
    try:
        _draw_from_fit(rig, folder, 1, np.random.default_rng(0))
    except InputError as error:
        note = f"Cases do not vary the parameters of the fit in {folder}: {error}"
        return replace(settings, notes=(*settings.notes, note))
    note = f"Cases vary the parameters within the intervals of the fit in {folder}, to which the rig belongs"
    return replace(settings, case_fit=folder, notes=(*settings.notes, note))


def _draw_from_fit(rig: Rig, folder: Path, count: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draw parameters from the intervals of the fit in a folder."""
    return draw_from_fit(read_json(folder, "fit.json"), list(parameters.all_declarations(rig.plant)), count, rng)


def draw_parameters(
    rig: Rig, settings: ControllerFile, seed: int, repeat: int | None = None
) -> dict[str, Float[np.ndarray, " draws"]]:
    """Draw the uncertain parameters; the number is the larger of ``robust.draws`` and ``robust.check``.

    Args:
        rig: The rig.
        settings: The content of a controller file.
        seed: Seed of the random numbers.
        repeat: Number of a check on cases, each of which has its own draws; ``None`` for those of the search.

    Returns:
        Samples by name, internal units, shape ``(count,)`` each; empty without [robust] and without a fit of the rig.

    Raises:
        InputError: if the folder of the fit has no fit, or one without intervals.
    """
    robust = settings.robust
    rng = np.random.default_rng([seed, _DRAWS_STREAM, *(() if repeat is None else (1 + repeat,))])
    if robust is None:
        if settings.case_fit is None or repeat is None:
            return {}
        return _draw_from_fit(rig, settings.case_fit, DRAWN_CASES, rng)
    count = max(robust.draws, robust.check) if repeat is None else DRAWN_CASES
    draws: dict[str, np.ndarray] = {}
    if robust.fit is not None:
        try:
            draws = _draw_from_fit(rig, robust.fit, count, rng)
        except InputError as error:
            raise InputError(f"{settings.place}: robust.fit: {error}") from None
    return draws | draw_from_ranges(robust.vary, count, rng)


def tuning_problem(settings: ControllerFile, draws: Mapping[str, np.ndarray], seed: int) -> TuningProblem:
    """Return the tuning problem: the first draws, or draws of the noise, some of them none, and ambient temperatures.

    Args:
        settings: The content of a controller file.
        draws: Drawn parameters by name, internal units, shape ``(count,)`` each; empty without [robust].
        seed: Seed of the noise.
    """
    robust = settings.robust
    members = {n: v[: robust.draws] for n, v in draws.items()} if robust else {}
    count = LIMITED_NOISE_DRAWS if settings.check > 1 and settings.limits else NOISE_DRAWS
    noise = noise_draws(settings.loop, settings.scenario, robust.draws if robust else count, seed)
    if settings.check > 1 and len(noise) > 1:
        if settings.limits:
            members |= ambient_members(settings, len(noise), draws)
        quiet = QUIET_MEMBERS if settings.limits and len(noise) >= 2 * QUIET_MEMBERS else 1
        noise = noise.at[-quiet:].set(0.0)
    # Gains that are limited, or tuned for several plants, are evaluated as they are.
    spread = 0.0 if settings.limits or settings.settle or robust else GAIN_SPREAD
    return TuningProblem.of(settings.system, settings.loop, settings.scenario, settings.bounds, members, noise, spread)
