"""Strict by default: float64, warnings are errors, shapes and types checked at run time, and one compilation cache for the whole run."""

import gc
import os
import pathlib

import pytest

from smajax.numerics.process import prepare_jax

ROOT = pathlib.Path(__file__).parent.parent
SHARED = ROOT.parent / "shared"

os.environ.setdefault("JAX_COMPILATION_CACHE_DIR", str(ROOT / ".jax_cache"))
os.environ.setdefault("NUMBA_CACHE_DIR", str(ROOT / ".jax_cache" / "numba"))
# Tests replace functions while they run, which a stored program would not notice.
os.environ.setdefault("SMAJAX_STORED_PROGRAMS", "off")
prepare_jax()

import jax  # noqa: E402
from jaxtyping import install_import_hook  # noqa: E402

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
install_import_hook(
    [
        "smajax.numerics",
        "smajax.plant",
        "smajax.laws",
        "smajax.actuators",
        "smajax.simulation",
        "smajax.fitting",
        "smajax.properties",
        "smajax.diagnosis.compiled_model",
        "smajax.diagnosis.detectability",
        "smajax.diagnosis.equivalence",
        "smajax.diagnosis.localisation",
        "smajax.diagnosis.nonparametric",
        "smajax.diagnosis.problem_layout",
        "smajax.diagnosis.residual_checks",
        "smajax.diagnosis.screening",
        "smajax.diagnosis.sensitivities",
        "smajax.diagnosis.step_errors",
        "smajax.comparison.driving_input",
        "smajax.comparison.scores",
        "smajax.control.controllers",
        "smajax.control.sensors",
        "smajax.control.estimators",
        "smajax.control.loop",
        "smajax.control.sampled_plant",
        "smajax.control.pulse_width",
        "smajax.control.analysis",
        "smajax.control.tuning",
        "smajax.sweeps.actuator_problem",
        "smajax.sweeps.bandwidth",
        "smajax.sweeps.best_designs",
        "smajax.sweeps.chunks",
        "smajax.sweeps.compilation",
        "smajax.sweeps.constraints",
        "smajax.sweeps.evaluation",
        "smajax.sweeps.excitation",
        "smajax.sweeps.feasibility",
        "smajax.sweeps.metrics",
        "smajax.sweeps.pareto",
        "smajax.sweeps.problem",
        "smajax.sweeps.refinement",
        "smajax.sweeps.rig_problem",
        "smajax.sweeps.sobol",
        "smajax.sweeps.space",
        "smajax.sweeps.step_levels",
    ],
    "beartype.beartype",
)


@pytest.fixture(scope="module", autouse=True)
def forget_programs():
    """Compiled programs of one file of tests serve no other: kept, they would fill the memory of a small machine."""
    yield
    jax.clear_caches()
    gc.collect()


@pytest.fixture(scope="session")
def shared() -> pathlib.Path:
    """The folder of recordings next to the checkout; a test that needs it is skipped where it is absent."""
    if not SHARED.is_dir():
        pytest.skip("the recordings of others are not next to this checkout (../shared)")
    return SHARED


# What takes longest begins first, so that no process waits for another's last file.
LONGEST = [
    "tuning",
    "sweeps",
    "control",
    "simulation",
    "effects",
    "lagoudas",
    "measured",
    "input_output_models",
    "diagnosis",
    "fit",
    "coil",
    "comparison",
    "one_fraction",
    "cli",
    "reference",
    "knee",
    "cross_section",
    "properties",
    "baselines",
    "fmu",
    "limb",
    "hysteresis",
    "actuator_file",
    "recording",
    "ensemble_kalman_filter",
    "extended_kalman_filter",
]


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Orders the files of tests."""
    rank = {f"test_{name}": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: rank.get(item.path.stem, len(rank)))
