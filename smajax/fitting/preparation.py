"""Compilation of a fit's search in the background, while recordings are checked and starts are chosen.

Compilation, and loading from the cache, release Python's global interpreter lock, so that they run on another core.
``experiments/speed/start_up.py`` prints the times of a fit.
"""

import contextlib
import importlib
import threading
from collections.abc import Sequence

from smajax.errors import InputError, NumericsError
from smajax.fitting.abstract_problem import residual
from smajax.fitting.memory import fit_memory, search_in_parts
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import build_problem
from smajax.fitting.searches import search_options
from smajax.fitting.unknowns import Settings
from smajax.numerics.process import COMPILATION
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording


def compile_in_background(
    plant: Plant, recordings: Sequence[Recording], settings: Settings, interpolation: str
) -> None:
    """Start a thread that compiles the program of the default search; it ends when the program has run once.

    A search that begins meanwhile waits for the program instead of compiling it, too. Errors are left to the search,
    which meets them again.

    Args:
        plant: The plant of a fit.
        recordings: Its training recordings.
        settings: Its settings.
        interpolation: Electrical inputs between samples.
    """
    arguments = plant, recordings, settings, interpolation
    threading.Thread(target=_take_a_step, args=arguments, name=COMPILATION).start()


def _take_a_step(plant: Plant, recordings: Sequence[Recording], settings: Settings, interpolation: str) -> None:
    with contextlib.suppress(InputError, NumericsError):
        is_limited, _ = search_in_parts(
            fit_memory(plant, recordings, settings, interpolation=interpolation), recordings[0].name
        )
        if not is_limited:
            problem = build_problem(plant, recordings, settings, interpolation=interpolation)
            options = search_options(problem, len(recordings))
            MultiStartSolver(residual, problem, problem.nominal[None], *problem.bounds, **options).advance(1)
    importlib.import_module("scipy.special")  # for the intervals, and slow to import
