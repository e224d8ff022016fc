"""Plausible ranges as priors of the selection: fits that need what no alloy has, and effects of strength 0."""

from types import SimpleNamespace

import numpy as np
import pytest

from smajax import parameters
from smajax.diagnosis.acceptance import RejectionCode
from smajax.diagnosis.candidates import CandidateFit, EffectSet, Refit
from smajax.diagnosis.plausibility import absent_effects, newly_implausible, plausible_fits, refusal
from smajax.diagnosis.result import _rejections
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.plant.effects import catalogue
from smajax.report.diagnosis_wording import rejection_text
from tests.support import plants

AUSTENITE = "material.thermal_expansion_austenite"


@pytest.fixture
def problem():
    """A problem whose base vector is the expansion of austenite in 1e-6 1/K."""
    effects = {key: catalogue()[key] for key in ("r-phase", "creep", "hard-stop")}

    def fitted_plant(refit):
        plant = parameters.replace(plants.dead_weight(), {AUSTENITE: 1e-6 * refit.base[0]})
        own = tuple(effects[key]() for key in refit.effect_set.keys)
        plant = parameters.replace(plant.__class__(**{**vars(plant), "effects": own}), refit.values)
        return plant

    return SimpleNamespace(
        problems=[SimpleNamespace(unknowns=[SimpleNamespace(name=AUSTENITE)])],
        effects=effects,
        fitted_plant=fitted_plant,
        free_effect_parameters=lambda effect_set: [name for name, _ in effect_set.values],
    )


def fit(expansion, key="", total=10.0, **values):
    names = {f"effects.{key}.{name}": value for name, value in values.items()}
    refit = Refit(
        EffectSet((key,) if key else (), tuple(names.items())),
        np.array([expansion]),
        np.zeros(1),
        np.zeros((1, 1)),
        SolverStatus.converged,
    )
    return CandidateFit(refit, 0.5 * total, 0.5 * total, 0.0)


def state_of(current):
    return SimpleNamespace(current=current, rejected=[], accepted=())


def test_an_effect_that_needs_what_no_alloy_has_is_left_out_and_named(problem):
    good, wide = fit(11.0, "creep", 4.0, strength=1e-3), fit(11.0, "r-phase", 2.0, strength=6e-3, width=40.0)
    negative = fit(-14.0, "creep", 3.0, strength=1e-3)
    state = state_of(fit(11.0))
    assert plausible_fits(problem, state, [good, wide, negative]) == [good]
    (rejected,) = state.rejected
    assert (rejected.key, rejected.code, rejected.others) == (
        "r-phase",
        RejectionCode.implausible,
        ("effects.r-phase.width",),
    )
    assert "brings effects.r-phase.width outside of the plausible range" in rejection_text(rejected)
    assert plausible_fits(problem, state, [wide]) == [] and refusal(problem, fit(11.0), wide) == rejected
    assert _rejections(state) == (rejected,)
    state.accepted = ("r-phase",)  # in another form
    assert _rejections(state) == ()


def test_a_stop_that_takes_a_third_of_the_motion_is_none(problem):
    """Such a fit only bends the end of the stroke."""
    soft, stiff = (fit(11.0, "hard-stop", 2.0, strength=strength, place=5e-3) for strength in (0.34, 0.97))
    assert refusal(problem, fit(11.0), stiff) is None
    rejected = refusal(problem, fit(11.0), soft)
    assert rejected is not None and rejected.others == ("effects.hard-stop.strength",)


def test_a_parameter_that_is_outside_without_the_effect_refuses_none(problem):
    """The base fit is biased by what is missing: the effect must only not bring it farther out."""
    base = fit(-14.0)
    assert newly_implausible(problem, fit(-15.0, "creep", strength=1e-3).refit, base.refit) == ()
    assert newly_implausible(problem, fit(-40.0, "creep", strength=1e-3).refit, base.refit) == (AUSTENITE,)
    assert refusal(problem, base, fit(11.0, "creep", strength=1e-3)) is None


def test_an_effect_of_strength_zero_is_never_accepted(problem):
    nothing = fit(11.0, "r-phase", 1.0, strength=1e-7, width=10.0)
    assert absent_effects(problem, nothing.refit) == ("r-phase",)
    rejected = refusal(problem, fit(11.0), nothing)
    assert rejected is not None and rejected.code is RejectionCode.zero
    assert rejection_text(rejected) == "has a fitted strength of 0"
