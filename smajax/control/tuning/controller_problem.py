"""The tuning problem of a controller file, whose members differ in parameters, noise and ambient temperature."""

from collections.abc import Mapping

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
        Samples by name, internal units, shape ``(count,)`` each; empty without [robust].

    Raises:
        InputError: if the folder of the fit has no fit, or one without intervals.
    """
    robust = settings.robust
    if robust is None:
        return {}
    count = max(robust.draws, robust.check) if repeat is None else DRAWN_CASES
    rng = np.random.default_rng([seed, _DRAWS_STREAM, *(() if repeat is None else (1 + repeat,))])
    draws: dict[str, np.ndarray] = {}
    if robust.fit is not None:
        names = list(parameters.all_declarations(rig.plant))
        try:
            draws = draw_from_fit(read_json(robust.fit, "fit.json"), names, count, rng)
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
