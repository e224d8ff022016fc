"""Fits that begin where nothing transforms: the notice, and starts at which something does."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.app.commands.check import describe
from smajax.errors import InputError
from smajax.fitting.fit import fit
from smajax.fitting.fit_warnings import transformation_notices
from smajax.fitting.profile import profile_likelihood
from smajax.fitting.transformation_check import needs_transformation, transformation_gap
from smajax.recordings.datasets import data_path
from smajax.report import summary
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate
from tests.support import plants
from tests.unit.fitting.test_bounds_and_noise import Settings

SHIFTS = ("material.austenite_shift", "material.martensite_shift")
ENDS = tuple(f"material.{phase}_{end}" for phase in ("austenite", "martensite") for end in ("start", "finish"))


def cycle(middle: float, stress: float = 100e6, rows: int = 120):
    """Return a thermal cycle about a temperature under a constant stress."""
    temperature = middle + 70.0 * np.sin(np.linspace(-np.pi / 2, 3.5 * np.pi, rows))
    return plants.recording({"temperature": temperature, "stress": np.full(rows, stress)})


def loops(temperature: float = 22.0):
    """Return strain loops at one temperature, as of a superelastic wire."""
    strain = 0.06 * (1.0 - np.abs(np.linspace(-1.0, 1.0, 81)))
    return plants.recording({"temperature": np.full(81, temperature), "strain": strain})


def measured(plant, blank, channel: str, noise: float):
    """Return a recording with a channel of a plant, with noise."""
    values = np.asarray(simulate(plant, discretise(plant, blank)).channels[channel])
    noisy = values + noise * np.random.default_rng(0).standard_normal(len(values))
    return dataclasses.replace(blank, channels={**blank.channels, channel: noisy})


def changed(plant, **values):
    return parameters.replace(plant, {f"material.{k}": jnp.asarray(v) for k, v in values.items()})


@pytest.mark.slow
@pytest.mark.parametrize("displaced", [-140.0, 150.0], ids=["austenite", "martensite"])
def test_a_wire_that_stays_in_one_phase_is_noticed_and_found_where_it_transforms(displaced):
    """The start values are far from the wire's: its temperatures lie outside of the recorded ones."""
    truth = plants.stress_path()
    recording = measured(truth, cycle(60.0), "strain", 1e-5)
    start = changed(truth, **{f"{phase}_{end}": float(getattr(truth.material, f"{phase}_{end}")) + displaced
                              for phase in ("austenite", "martensite") for end in ("start", "finish")})  # fmt: skip
    result = fit(start, [recording], Settings(free=SHIFTS, observe=("strain",)))
    assert result.start_gap is not None and result.start_gap.is_martensite == (displaced > 0) and result.end_gap is None
    assert result.rmse("strain") < 2e-5
    for estimate in result.estimates:
        assert estimate.estimate == pytest.approx(-displaced, abs=1.0) and estimate.lower95 is not None
    first, second = transformation_notices(result)
    words = ("A_s", "above", "hottest", "lower") if displaced > 0 else ("M_s", "below", "coldest", "higher")
    assert all(word in first for word in words) and "does not transform on made.csv" in first
    assert "transforms at the estimates" in second


def test_the_distance_is_from_the_row_that_is_nearest_to_the_transformation():
    plant, recording = plants.stress_path(), cycle(-40.0, stress=50e6)
    gap = transformation_gap([plant], [recording])
    law = plant.material
    start = float(law.austenite_start)
    hottest = float(np.max(recording.channels["temperature"]))
    assert gap is not None and gap.is_martensite and gap.start == start
    assert gap.kelvin == pytest.approx(start + 50e6 / float(law.clausius_clapeyron_austenite) - hottest)
    low, high = gap.displacements
    assert low < -gap.kelvin < high
    assert transformation_gap([plant], [cycle(60.0)]) is None
    assert transformation_gap([plant] * 2, [recording, cycle(60.0)]) is None


def test_check_says_that_nothing_transforms_and_what_a_fit_takes(tmp_path):
    path = data_path("recordings", "isobaric", "rig.toml")
    for middle in (-40.0, 60.0):
        recording = cycle(middle)
        strain = {"strain": 1e-3 * np.random.default_rng(0).standard_normal(len(recording))}
        dataclasses.replace(recording, channels={**recording.channels, **strain}).write(tmp_path / f"{middle:.0f}.csv")
    cold, warm = (describe(path, [tmp_path / f"{middle}.csv"]) for middle in (-40, 60))
    assert "Note: At the values of this rig this wire does not transform on -40.csv and stays martensite" in cold
    assert "does not transform" not in warm
    for text in (cold, warm):
        assert "A simulation of these recordings takes 119 steps, and a fit about 0.6 GB of memory." in text


@pytest.mark.slow
def test_loops_of_a_superelastic_wire_are_fitted_from_values_of_an_actuator():
    truth = changed(plants.strain_path(), austenite_shift=-75.0, martensite_shift=-80.0)
    truth = changed(truth, modulus_austenite=40e9)
    recording = measured(truth, loops(), "stress", 1e6)
    result = fit(
        plants.strain_path(), [recording], Settings(free=(*SHIFTS, "material.modulus_austenite"), observe=("stress",))
    )
    assert result.start_gap is not None and result.end_gap is None
    assert result.rmse("stress") < 3e6


@pytest.mark.slow
def test_a_heated_wire_that_never_gets_hot_enough_is_noticed():
    """Its temperatures are computed; no parameter that could mend it is free, so no further starts are made."""
    plant = plants.dead_weight()
    time = np.arange(60) * 0.1
    blank = plants.recording({"current": np.full(60, 0.05)}, time)
    recording = measured(plant, blank, "displacement", 1e-6)
    free = ("material.max_transformation_strain",)
    result = fit(plant, [recording], Settings(free=free, observe=("displacement",)))
    assert result.start_gap is not None and result.end_gap is not None and result.starts == 1
    assert "not determined by this fit" in transformation_notices(result)[-1]


def test_fits_without_parameters_of_a_transformation_are_not_checked():
    assert not needs_transformation(("heat.h0", "drive.gain", "material.modulus_austenite"))
    assert all(needs_transformation((name,)) for name in (*SHIFTS, *ENDS, "material.max_transformation_strain"))


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        (None, "--profile x shows whether other values fit as well"),
        ({"rise": [1.0, 0.0, 2.0]}, "as its profile shows, these recordings fit about as well with any value"),
        ({"rise": [9.0, 0.0, 2.0]}, "small changes of it do not change the model."),
        ({"rise": [None, 0.0, 2.0]}, "small changes of it do not change the model."),
    ],
)
def test_only_a_search_says_that_any_value_fits(profile, words):
    entry = {"estimate": 1.0, "lower95": None, "upper95": None, "unit": "K", "free": True, "at_bound": False}
    document = {
        "parameters": {"x": entry | {"bounds": [-200.0, 200.0]}},
        "profiles": {} if profile is None else {"x": profile},
        "solver": {"code": "converged"},
    }
    (sentence,) = summary._undetermined_sentences(document)
    assert words in sentence and ("any value" in sentence) == ("profile shows," in words)


@pytest.mark.slow
def test_a_parameter_that_is_not_determined_has_a_profile_over_its_bounds(monkeypatch):
    """One cycle under 100 MPa: a slope C moves A_s by 100 MPa / C, up to 50 MPa/K, so that a shift can be replaced."""
    plant = plants.stress_path()
    slope = "material.clausius_clapeyron_austenite"
    recording = measured(plant, cycle(60.0), "strain", 1e-5)
    settings = Settings(free=(*SHIFTS, slope), observe=("strain",), starts=1)
    result = fit(plant, [recording], settings)
    assert result.estimates[0].lower95 is None
    profile = profile_likelihood(result, SHIFTS[0])
    assert profile["values"][0] == -200.0
    assert np.all(profile["rise"][:-1] < 3.84) and profile["rise"][-1] > 3.84
    exact = 100e6 / float(plant.material.clausius_clapeyron_austenite) - 100e6 / 50e6
    assert profile["lower95"] is None and profile["upper95"] == pytest.approx(exact, abs=0.4)
    assert profile_likelihood(result, slope)["upper95"] is None
    monkeypatch.setattr(
        type(result.problem), "bounds", property(lambda self: (np.full(3, -np.inf), np.full(3, np.inf)))
    )
    with pytest.raises(InputError, match="has no bounds: give it bounds under"):
        profile_likelihood(result, SHIFTS[0])
