"""Effects that isobaric cycles have: a hysteresis that widens with the stress, a thermometer that lags the specimen."""

import dataclasses
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.effects.base import WireState
from smajax.plant.materials.base import Fractions
from smajax.plant.materials.brinson import Brinson
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.materials.liang_rogers import LiangRogers
from smajax.plant.materials.tanaka import Tanaka
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate, simulate_channels
from tests.support import plants


def _isobaric_strain(effects=(), stress=200e6, temperature=None):
    """Strain of a wire that is heated and cooled once under a stress."""
    if temperature is None:
        temperature = 85.0 - 75.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 241))
    plant = dataclasses.replace(plants.stress_path(), effects=tuple(effects))
    inputs = {"temperature": temperature, "stress": np.full(len(temperature), stress), "strain": 0.0 * temperature}
    return np.asarray(simulate(plant, plants.recording(inputs)).channels["strain"])


def _crossings(strain, temperature):
    """Temperatures at which the strain is half-way on heating and on cooling, degC."""
    hottest = int(np.argmax(temperature))
    middle = 0.5 * (np.max(strain) + np.min(strain))
    heating = np.interp(-middle, -strain[: hottest + 1], temperature[: hottest + 1])
    return heating, np.interp(middle, strain[hottest:], temperature[hottest:])


@pytest.mark.slow
@pytest.mark.parametrize(("stress", "power", "widening"), [(200e6, 2.0, 8.0), (200e6, 1.0, 4.0), (50e6, 2.0, 0.5)])
def test_hysteresis_widens_with_the_power_of_the_stress(stress, power, widening):
    """Heating is shifted by s (sigma / 100 MPa)^n, cooling is not."""
    temperature = 85.0 - 75.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 2401))
    effect = catalogue()["hysteresis-widening"](strength=2.0, power=power)
    without, wide = (
        _crossings(_isobaric_strain(effects, stress, temperature), temperature) for effects in ((), (effect,))
    )
    assert wide[0] - without[0] == pytest.approx(widening, abs=0.05)
    assert wide[1] == pytest.approx(without[1], abs=0.05)


@pytest.mark.slow
def test_a_linear_widening_is_another_slope():
    """With n = 1 it is C_A with sigma / C_A + s sigma / 100 MPa, to rounding; a slack wire has none, and no NaN."""
    effect = catalogue()["hysteresis-widening"](strength=3.0, power=1.0)
    plant = plants.stress_path()
    slope = float(plant.material.clausius_clapeyron_austenite)
    other = parameters.replace(plant, {"material.clausius_clapeyron_austenite": 1.0 / (1.0 / slope + 3.0 / 100e6)})
    temperature = 85.0 - 75.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 241))
    inputs = plants.recording({"temperature": temperature, "stress": np.full(241, 2e8), "strain": 0.0 * temperature})
    expected = np.asarray(simulate(other, inputs).channels["strain"])
    assert _isobaric_strain([effect]) == pytest.approx(expected, abs=1e-12)
    assert np.array_equal(_isobaric_strain([effect], stress=0.0), _isobaric_strain(stress=0.0))


@pytest.mark.slow
def test_a_lagging_thermometer_is_a_shift_on_each_branch():
    """Far from the reversals the strain is that at a temperature above the reading on heating and below on cooling."""
    temperature = 85.0 - 75.0 * np.cos(np.linspace(0.0, 2.0 * np.pi, 2401))
    lagging = _isobaric_strain([catalogue()["specimen-lag"](strength=3.0, width=1.0)], temperature=temperature)
    heating, cooling = _crossings(lagging, temperature)
    without = _crossings(_isobaric_strain(temperature=temperature), temperature)
    assert heating - without[0] == pytest.approx(-3.0, abs=0.05)
    assert cooling - without[1] == pytest.approx(3.0, abs=0.05)


def test_the_lag_reverses_over_its_width():
    """The sign of the direction approaches that of the motion by a factor e over a path of the width."""
    effect = catalogue()["specimen-lag"](strength=1.0, width=4.0)
    none, context = jnp.zeros(1), plants.stress_path()._stage_context()
    state = WireState(none, none, Fractions(none, none), none, none, none)
    colder, memory = state._replace(temperature=jnp.array([-1.0])), jnp.ones(1)
    for _ in range(4):
        memory = effect.update_memory(memory, state, colder, jnp.ones(()), context)
    assert np.asarray(memory) == pytest.approx(-1.0 + 2.0 * math.exp(-1.0), rel=1e-12)
    assert effect.specimen_offset(memory) == memory


@pytest.mark.slow
@pytest.mark.parametrize("law", [Brinson, LiangRogers, Tanaka, Lagoudas])
@pytest.mark.parametrize(
    ("key", "name"),
    [
        ("hysteresis-widening", "strength"),
        ("hysteresis-widening", "power"),
        ("specimen-lag", "strength"),
        ("specimen-lag", "width"),
    ],
)
def test_gradients_of_isobaric_effects_agree_with_finite_differences(law, key, name):
    material = {name: value for name, value in plants.MATERIAL.items() if name in declarations(law)}
    effect = catalogue()[key](strength=1.5)
    plant = dataclasses.replace(plants.stress_path(), material=law(**material), effects=(effect,))
    temperature = 85.0 - 75.0 * np.cos(np.linspace(0.1, 6.1, 121))
    inputs = discretise(
        plant, plants.recording({"temperature": temperature, "stress": np.full(121, 1.5e8), "strain": 0 * temperature})
    )
    path = f"effects.{key}.{name}"
    value = float(parameters.get(plant, path))

    @jax.jit
    def strain(x):
        return simulate_channels(parameters.replace(plant, {path: x}), inputs, ("strain",))[0]["strain"]

    slope = np.asarray(jax.jacfwd(strain)(jnp.asarray(value)))
    difference = np.asarray(strain(jnp.asarray(value + 1e-5)) - strain(jnp.asarray(value - 1e-5))) / 2e-5
    assert np.linalg.norm(slope) > 0.0
    assert np.linalg.norm(slope - difference) < 2e-3 * np.linalg.norm(slope)
