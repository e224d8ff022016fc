"""Time constants of a plant, and the step size that resolves them."""

import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Float

from smajax.numerics.stored_programs import stored
from smajax.plant.effects.base import ThermalNode
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant

# degC. Temperature at which the time constant is taken: a usual one of a wire that cools through its transformations.
_COOLING_TEMPERATURE = 80.0
# W/m^2/K. Lower limit of h(T) here, so that no h(T) makes the time constant infinite.
_MIN_CONVECTION = 1.0
# s. Longest step, also of slower plants, so that inputs are resolved that change faster than the wire cools.
# Chosen by trial; the tests of convergence to the exact simulators in tests/unit/simulation hold it.
_MAX_STEP = 0.05
# Steps per time constant of cooling; chosen by trial, held by the same tests.
_STEPS_PER_TIME_CONSTANT = 30.0


def time_constant(plant: Plant) -> Float[Array, ""]:
    """Compute the time constant of the wire's cooling at 80 degC.

    Args:
        plant: The plant.

    Returns:
        Time constant in s: C d / (4 h), with the heat capacity C per volume, the diameter d and the convection h.
    """
    capacity = plant.heat.capacity(jnp.asarray(0.5))
    convection = plant.heat.convection(jnp.asarray(_COOLING_TEMPERATURE))
    return capacity * plant.wire.diameter / (4.0 * jnp.maximum(convection, _MIN_CONVECTION))


def time_constant_bounds(plant: Plant) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Bound the fastest and the slowest time constant of a wire that cools.

    With a second thermal node of strength s and time constant tau (``ThermalNode``) the wire is 1 + s times as fast
    while the node is cold. The time constants of the two modes add up to at most that of the wire plus (1 + s) tau.

    Args:
        plant: The plant.

    Returns:
        Lower bound of the fastest and upper bound of the slowest time constant, in s.
    """
    wire = time_constant(plant)
    nodes = [term for term in plant.all_effects if isinstance(term, ThermalNode)]
    strength = sum((node.strength for node in nodes), jnp.zeros(()))
    node_time = sum((node.time_constant for node in nodes), jnp.zeros(()))
    return wire / (1.0 + strength), wire + (1.0 + strength) * node_time


def resolving_step(plant: Plant) -> Float[Array, ""]:
    """Compute a step that resolves heating, cooling and the oscillations of the mechanism.

    Args:
        plant: The plant.

    Returns:
        Step in s: a thirtieth of the time constant, at most 50 ms and at most the plant's ``longest_step``. A wire
        whose temperature is prescribed has no time constant: only ``longest_step`` limits the step, which is infinite
        for a path, so that each row is one step.
    """
    if isinstance(plant.heat, PrescribedTemperature):
        return jnp.asarray(plant.longest_step)
    return jnp.minimum(jnp.minimum(_MAX_STEP, time_constant(plant) / _STEPS_PER_TIME_CONSTANT), plant.longest_step)


def default_step(plant: Plant) -> float:
    """Return ``resolving_step`` as a Python float, in s; infinite where each row is one step."""
    # The step may be known although other parameters of the plant are traced; a program's result would be traced, too.
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(plant))
    return float(resolving_step(plant) if traced else _resolving_step(plant))


def wire_time_constant(plant: Plant) -> float:
    """Return ``time_constant`` as a Python float, in s."""
    return float(_time_constant(plant))


# One program each instead of one for each operation.
_resolving_step, _time_constant = stored(resolving_step), stored(time_constant)
