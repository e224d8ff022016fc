"""Grains: their spread about the transformation temperatures of the whole wire, and partial loops."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import integrate, stats

from smajax.plant.grains import SHAPES, Grains
from smajax.plant.materials.base import COSINE_DEVIATION, COSINE_TANGENT_FACTOR, AbstractMaterial
from smajax.plant.materials.lagoudas import LINEAR_DEVIATION, LINEAR_TANGENT_FACTOR
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate
from tests.support import plants

STRESS = 150e6
# Rates over the progress of a transformation from 0 to 1.
RATES = {
    "cosine": (lambda p: 0.5 * np.pi * np.sin(np.pi * p), COSINE_DEVIATION, COSINE_TANGENT_FACTOR, 3e-4),
    "linear": (lambda p: 1.0, LINEAR_DEVIATION, LINEAR_TANGENT_FACTOR, 3e-3),
}


def cycle(temperatures: np.ndarray, grains: Grains | None, law: str = "brinson") -> np.ndarray:
    """Transformation strain along a path of temperatures under a constant stress."""
    values: dict[str, Any] = {
        n: v for n, v in plants.MATERIAL.items() if law == "brinson" or not n.startswith("detwinning")
    }
    values |= {"modulus_martensite": 31.5e9, "thermal_expansion_austenite": 0.0, "thermal_expansion_martensite": 0.0}
    return strain_along(temperatures, MATERIALS[law](**values), grains)


def strain_along(temperatures: np.ndarray, material: AbstractMaterial, grains: Grains | None) -> np.ndarray:
    plant = dataclasses.replace(plants.stress_path(), material=material, grains=grains)
    assert isinstance(plant.mechanism, StressPath)
    recording = plants.recording({"temperature": temperatures, "stress": np.full(len(temperatures), STRESS)})
    return np.asarray(simulate(plant, discretise(plant, recording)).channels["strain"])


def tangents(temperature: np.ndarray, strain: np.ndarray) -> tuple[float, float]:
    """Temperatures at which the steepest tangent of a branch meets its lowest and its highest strain."""
    slope = np.gradient(strain, temperature)
    k = int(np.argmax(np.abs(slope)))
    meets = [temperature[k] + (level - strain[k]) / slope[k] for level in (strain.max(), strain.min())]
    return min(meets), max(meets)


@pytest.mark.parametrize("form", RATES)
def test_the_factor_keeps_the_steepest_tangent(form):
    rate, deviation, coefficients, error = RATES[form]
    assert deviation == pytest.approx(np.sqrt(integrate.quad(lambda p: rate(p) * (p - 0.5) ** 2, 0.0, 1.0)[0]))
    for spread in (0.1, 0.3, 0.5, 0.7, 0.9, 0.95):
        width = np.sqrt(1.0 - spread**2)

        def density(z: float, width: float = width, spread: float = spread) -> float:
            progress = 0.5 + spread * deviation * z / width
            return stats.norm.pdf(z) * rate(progress) / width

        reach = min(0.5 * width / (spread * deviation), 12.0)
        exact = integrate.quad(density, -reach, reach)[0] / rate(0.5)
        fitted = 1.0 + sum(c * spread ** (2 * i) for i, c in enumerate(coefficients, 1))
        assert fitted == pytest.approx(exact, abs=error)


@pytest.mark.slow
@pytest.mark.parametrize("law", ["brinson", "lagoudas", "liang-rogers"])
def test_tangents_of_a_simulated_cycle_do_not_depend_on_the_spread(law):
    up = np.linspace(40.0, 140.0, 1001)
    path = np.concatenate([up, up[::-1]])
    for spreads in ((0.5, 0.5), (0.8, 0.4)):
        one, many = (cycle(path, g, law) for g in (None, Grains(*map(jnp.asarray, spreads), count=24)))
        assert np.ptp(many) == pytest.approx(np.ptp(one), rel=1e-6)
        for half in (slice(0, 1001), slice(1001, None)):
            branches = [tangents(path[half], strain[half]) for strain in (one, many)]
            band = branches[0][1] - branches[0][0]
            np.testing.assert_allclose(branches[1], branches[0], atol=0.04 * band)


@pytest.mark.slow
def test_grains_converge_and_change_nothing_without_a_spread():
    path = np.concatenate([np.linspace(40.0, 140.0, 501), np.linspace(140.0, 40.0, 501)])
    none = Grains(jnp.asarray(0.0), jnp.asarray(0.0), count=6)
    np.testing.assert_allclose(cycle(path, none), cycle(path, None), atol=1e-12)
    curves = [cycle(path, Grains(count=count)) for count in (3, 6, 12, 48)]
    errors = [float(np.sqrt(np.mean((curve - curves[-1]) ** 2))) for curve in curves[:-1]]
    assert errors[1] < 0.6 * errors[0] and errors[2] < 0.6 * errors[1]
    assert errors[1] < 0.005 * np.ptp(curves[-1])


@pytest.mark.slow
@pytest.mark.parametrize("law", ["brinson", "lagoudas", "tanaka"])
def test_factors_on_the_widths_are_wider_temperatures(law):
    path = np.concatenate([np.linspace(20.0, 160.0, 301), np.linspace(160.0, 40.0, 301), np.linspace(40.0, 95.0, 101)])
    values = {n: v for n, v in plants.MATERIAL.items() if law == "brinson" or not n.startswith("detwinning")}
    material = MATERIALS[law](**values)
    grains = Grains(*map(jnp.asarray, (0.6, 0.5, 1.5, 0.8)), count=6)
    whole, wider = grains.with_whole_width(material)
    assert float(whole.austenite_width) == float(whole.martensite_width) == 1.0
    band, wide = (float(m.austenite_finish - m.austenite_start) for m in (material, wider))
    assert wide == pytest.approx(1.5 * band)
    strains = [strain_along(path, m, g) for m, g in ((material, grains), (wider, whole), (material, whole))]
    np.testing.assert_allclose(strains[1], strains[0], atol=1e-9)
    assert np.max(np.abs(strains[2] - strains[0])) > 1e-3


def test_minor_loops_close_better_with_a_larger_spread():
    """The law of one grain transforms further at each equal excursion of the temperature; a narrow grain does not."""
    inside, outside = 94.0, 60.0
    loop = np.concatenate([np.linspace(inside, outside, 60), np.linspace(outside, inside, 60)])
    path = np.concatenate([np.linspace(40.0, inside, 200), loop, loop])
    gaps = []
    for grains in (None, *(Grains(jnp.asarray(s), jnp.asarray(s), count=24) for s in (0.7, 0.95))):
        strain = cycle(path, grains)
        first, second = strain[200:320], strain[320:440]
        assert np.ptp(first) > 2e-3
        gaps.append(float(np.max(np.abs(second - first)) / np.ptp(first)))
    assert gaps[2] < 0.7 * gaps[1] < 0.7 * gaps[0] and gaps[2] < 0.1, gaps


def test_each_grain_has_a_memory_of_its_own():
    """After partial heating, grains that transformed and grains that did not are side by side."""
    plant = dataclasses.replace(plants.stress_path(), grains=Grains(count=8))
    path = np.linspace(40.0, 94.0, 200)
    recording = plants.recording({"temperature": path, "stress": np.full(200, STRESS)})
    detwinned = np.asarray(simulate(plant, discretise(plant, recording)).state.fractions.detwinned)[-1, :, 0]
    assert np.all(np.diff(detwinned) >= -1e-12) and detwinned[0] < 0.1 and detwinned[-1] > 0.9


@pytest.mark.parametrize("count", [2, 3, 5, 6, 12])
def test_quantiles_are_independent_of_those_in_another_order(count):
    first, other = Grains(count=count).quantiles.T
    assert np.mean(first) == pytest.approx(0.0, abs=1e-12) and np.mean(first**2) == pytest.approx(1.0)
    assert np.mean(other) == pytest.approx(0.0, abs=1e-12) and np.mean(first * other) == pytest.approx(0.0, abs=1e-12)
    assert np.mean(other**2) == pytest.approx(0.0 if count == 2 else 1.0, abs=1e-12)


@pytest.mark.parametrize("count", [2, 3, 5, 6, 12])
def test_shapes_keep_the_mean_and_the_variance_of_the_shifts(count):
    grains = Grains(correlation_angle=jnp.asarray(1.2), count=count)
    drawn = np.random.default_rng(count).normal(size=len(SHAPES))
    shaped = dataclasses.replace(grains, **dict(zip(SHAPES, map(jnp.asarray, drawn), strict=True)))
    first, other = grains.quantiles.T
    np.testing.assert_array_equal(grains.shifts[:, 0], first)
    np.testing.assert_allclose(grains.shifts[:, 1], np.cos(1.2) * first + np.sin(1.2) * other, atol=1e-15)
    np.testing.assert_allclose(np.mean(np.asarray(shaped.shifts), axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.mean(np.asarray(shaped.shifts) ** 2, axis=0)[0], 1.0, atol=1e-12)
    is_shaped = not np.allclose(shaped.shifts, grains.shifts)
    assert is_shaped == (count > 2)


def test_shapes_give_six_grains_any_shifts():
    """Together with mean, spread and angle they have as many directions as there are grains, in both transformations."""
    grains = Grains(correlation_angle=jnp.asarray(1.2), count=6)
    names = ("correlation_angle", *SHAPES)

    def shifts(values):
        own = dataclasses.replace(grains, **dict(zip(names, values, strict=True)))
        return own.shifts.T

    derivative = np.asarray(jax.jacfwd(shifts)(jnp.array([1.2, *[0.1] * len(SHAPES)])))
    value = np.asarray(shifts(jnp.array([1.2, *[0.1] * len(SHAPES)])))
    for k in range(2):
        directions = np.column_stack([np.ones(6), value[k], derivative[k]])
        assert np.linalg.matrix_rank(directions, tol=1e-9) == 6


@pytest.mark.parametrize("name", ["austenite_cubic", "martensite_quadratic"])
def test_derivatives_by_shapes_are_those_of_finite_differences(name):
    path = np.concatenate([np.linspace(40.0, 94.0, 60), np.linspace(94.0, 40.0, 60)])
    plant = dataclasses.replace(plants.stress_path(), grains=Grains(count=6))
    inputs = discretise(plant, plants.recording({"temperature": path, "stress": np.full(len(path), STRESS)}))

    def strain(value):
        grains = dataclasses.replace(Grains(count=6), **{name: value})
        return simulate(dataclasses.replace(plant, grains=grains), inputs).channels["strain"]

    _, derivative = jax.jvp(strain, (jnp.asarray(0.3),), (jnp.asarray(1.0),))
    differences = np.asarray(strain(jnp.asarray(0.3 + 1e-5)) - strain(jnp.asarray(0.3 - 1e-5))) / 2e-5
    assert np.max(np.abs(differences)) > 1e-4
    np.testing.assert_allclose(derivative, differences, atol=1e-3 * np.max(np.abs(differences)))


def test_the_cosine_of_the_angle_is_the_correlation_of_both_shifts():
    law = MATERIALS["brinson"](**plants.MATERIAL)
    shifts = {}
    for angle in (0.0, 0.5 * np.pi, 2.0):
        grains = Grains(correlation_angle=jnp.asarray(angle), count=6)
        laws = [grains.material_of(law, tuple(shift)) for shift in grains.shifts]
        reverse, forward = (
            np.array([float(getattr(m, f"{p}_start")) for m in laws]) for p in ("austenite", "martensite")
        )
        assert np.corrcoef(reverse, forward)[0, 1] == pytest.approx(np.cos(angle), abs=1e-9)
        shifts[angle] = np.std(reverse), np.std(forward)
    assert shifts[2.0] == pytest.approx(shifts[0.0])
