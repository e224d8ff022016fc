"""The plant as a differential equation: rates of temperatures, martensite fractions and memories, for diffrax.

    C dT/dt = q(t, T, xi, sigma) - d(stored)/dt       d(xi)/dt = K(xi, T, sigma; dT/dt, d(sigma)/dt)
    0 = B(z, T, xi, m, t)      sigma = sigma(z, t)    dm/dt = m'(m, z)

q is the net heat, ``stored`` the latent heat, B the balance of the mechanism in its unknowns z at a given motion m, and
K the material law. The motion has rates where the mechanism has an inertia: m' holds the equation of motion.
A law is written in increments that do not depend on the rate; its rates K are the one-sided derivative of an increment
in the direction of dT/dt and d(sigma)/dt. That direction decides which transformation proceeds, and the transformation
decides the direction: the rates are the root of a piecewise linear equation in dT/dt and dz/dt. All terms are those of
``smajax.plant.step_equations``, so no equation is written twice.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.errors import InputError
from smajax.numerics import newton
from smajax.numerics.implicit_differentiation import implicit_root
from smajax.numerics.nonsmooth import minimum
from smajax.plant.effects.base import MechanismEffect, WireState
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.materials.base import Fractions
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.inputs import Inputs

# s. Duration of the increment whose derivative is a rate: so long that rounding does not decide which transformation
# proceeds (a band of 20 K at 1e-3 K/s advances by 5e-11, ``NO_PROGRESS`` is 1e-12), so short that the rate at its end
# is that at its start (relative difference 1e-6 with a time constant of 1 s).
_INCREMENT = 1e-6
# Newton steps for the unknowns of the mechanism at given fractions. Their equation is piecewise linear, nearly, and the
# first guess is the integrated unknown.
_BALANCE_STEPS = 3
# Newton steps after the search for the rates. Both numbers were chosen by trial: with a step less of each, temperatures
# of a testing machine change by more than the tolerances of ``smajax.simulation.integration``.
_RATE_STEPS = 2
# Distance in martensite fraction over which rates of a law with driving forces rise (``_at_the_surface``): its error.
# Chosen by trial: implicit solvers need too many steps with 1e-5, and fail without it.
_RAMP = 1e-4


class Differential(NamedTuple):
    """The variables of the differential equation.

    Attributes:
        temperature: Temperatures of the wires, shape ``(wires,)``, degC.
        fractions: Martensite fractions, shape ``(wires,)`` each.
        unknown: Unknowns of the mechanism as shares of Young's modulus of austenite: first guesses of the solution of
            its balance, which alone counts.
        motion: State of the mechanism.
        memory: States of the effects (``State.memory``).
    """

    temperature: Float[Array, "*cells wires"]
    fractions: Fractions
    unknown: Float[Array, " unknowns"]
    motion: Any
    memory: dict[str, Any]


class FieldArguments(NamedTuple):
    """What the vector field needs in addition to time and variables: ``args`` of diffrax.

    Attributes:
        plant: The plant.
        inputs: Its inputs on a grid.
    """

    plant: Plant
    inputs: Inputs


def check_vector_field(plant: Plant) -> None:
    """Check that a plant has a vector field.

    Args:
        plant: The plant.

    Raises:
        InputError: If it has none; the message names the part and the reason.
    """
    parts = [("the material law", plant.material), ("the mechanism", plant.mechanism)]
    parts += [(f"the effect '{effect.key}'", effect) for effect in plant.all_effects]
    for name, part in parts:
        reason = part.obstacle_to_rates
        if not reason and getattr(part, "has_drag", False):
            reason = "a drag, which depends on the last step"
        if reason:
            raise InputError(
                f"simulate: {name} has {reason}, so that the plant has no vector field for a diffrax solver: leave out "
                "solver= to take implicit steps"
            )


def initial_variables(plant: Plant, signal: Float[Array, " signals"]) -> Differential:
    """Compute the variables at the first sample.

    Args:
        plant: The plant.
        signal: Signals at the first sample.
    """
    state = plant.init(signal)
    unknown = state.unknown / plant._mechanism_context().modulus
    return Differential(state.temperature, state.fractions, unknown, state.motion, state.memory)


def state_of(variables: Differential, signal: Float[Array, " signals"], plant: Plant) -> State:
    """Compute the state of the plant: the balance of the mechanism gives the stress.

    Args:
        variables: The variables of the differential equation.
        signal: Signals at the same instant.
        plant: The plant.
    """
    fixed = (plant, variables, signal)
    unknown = variables.unknown * plant._mechanism_context().modulus
    if plant.mechanism.unknowns:
        unknown = implicit_root(_balance_residual, _solve_balance, fixed, "simulate")
    state = _state_with(unknown, *fixed)
    strain = plant._strain(plant._wire_state(state), state.memory)
    motion = plant.mechanism.complete_motion(unknown, strain, state.motion, plant._mechanism_context())
    state = state._replace(motion=motion)
    if not plant.all_effects:
        return state
    return state._replace(memory=state.memory | {"contraction": plant.mechanism.contraction(strain)})


def _state_with(
    unknown: Float[Array, " unknowns"],
    plant: Plant,
    variables: Differential,
    signal: Float[Array, " signals"],
) -> State:
    """The state of the plant with given unknowns of the mechanism in Pa."""
    prescribed, temperature = plant._prescribed_channels(signal), variables.temperature
    if isinstance(plant.heat, PrescribedTemperature):
        temperature = jnp.broadcast_to(prescribed["temperature"], temperature.shape)
    stress = plant.mechanism.stress(unknown, prescribed, plant._mechanism_context())
    return State(temperature, variables.fractions, stress, unknown, variables.motion, variables.memory)


def _balance_residual(
    unknown: Float[Array, " unknowns"],
    plant: Plant,
    variables: Differential,
    signal: Float[Array, " signals"],
) -> Float[Array, " unknowns"]:
    """Residual of the mechanism's balance in Pa."""
    state = _state_with(unknown, plant, variables, signal)
    strain = plant._strain(plant._wire_state(state), state.memory)
    prescribed, context = plant._prescribed_channels(signal), plant._mechanism_context()
    return plant.mechanism.balance_at_motion(unknown, strain, variables.motion, prescribed, context)


def _solve_balance(
    plant: Plant, variables: Differential, signal: Float[Array, " signals"]
) -> Float[Array, " unknowns"]:
    """Unknowns of the mechanism at given fractions, Pa."""
    guess = variables.unknown * plant._mechanism_context().modulus
    return newton.polish(lambda z: _balance_residual(z, plant, variables, signal), guess, _BALANCE_STEPS)


def rates(t: Any, y: Differential, args: FieldArguments) -> Differential:
    """Compute the time derivatives of the variables; the signature is that of a diffrax vector field.

    Args:
        t: Time, s.
        y: The variables.
        args: Plant and inputs.

    Returns:
        The derivatives, in units of the variables per second.
    """
    plant, inputs = args
    signal, slope = _signal_at(inputs, t)
    state = plant._begin_step(state_of(y, signal, plant), jnp.asarray(_INCREMENT))
    state, share = _at_the_surface(plant, state)
    net_heat = plant._net_heat(plant._wire_state(state), state.memory, signal)
    problem = (plant, state, net_heat, signal, slope, share)
    rate = implicit_root(_rate_balance, _solve_rates, problem, "simulate")
    end = _rate_residual(rate, *problem)[1]
    heats, modulus = plant.temperatures, plant._mechanism_context().modulus
    temperature_rate = rate[:heats].reshape(plant.temperature_shape)
    return Differential(temperature_rate, end.fractions, rate[heats:] / modulus, end.motion, end.memory)


def _at_the_surface(plant: Plant, state: State) -> tuple[State, Float[Array, "*grains wires"] | None]:
    """The state whose fractions satisfy the law, and the share of the rates of its fractions that counts.

    A law with driving forces (``AbstractMaterial.follows_surface``) has fractions on a surface while they change, which
    integrated fractions leave by rounding and by the solver's error. Beyond the surface the law returns to it at once;
    rates are those on the surface. Short of it there are none. This jump of the rates is within the solver's error,
    and implicit solvers do not resolve it: the share makes the rates rise over a distance of ``_RAMP``.
    """
    if not plant.material.follows_surface:
        return state, None
    at_once = plant._evolve_fractions(plant._wire_state(state), state.fractions, state.temperature, state.stress)
    beyond = minimum(jnp.abs(at_once.martensite - state.fractions.martensite) * (1.0 / _RAMP), 1.0)
    return state._replace(fractions=at_once), beyond**2 * (3.0 - 2.0 * beyond)


def _solve_rates(plant: Plant, state: State, *terms: Any) -> Float[Array, " unknowns"]:
    """Rates of temperatures and unknowns, in K/s and Pa/s; NaN if the search failed."""
    guess = jnp.zeros_like(state.step_unknowns)

    def residual(rate: jax.Array) -> jax.Array:
        return _rate_balance(rate, plant, state, *terms)

    rate, failed = newton.solve(residual, guess, plant.temperatures)
    return newton.polish(residual, jnp.where(failed, jnp.nan, rate), _RATE_STEPS)


def _rate_balance(
    rate: Float[Array, " unknowns"], plant: Plant, state: State, *terms: Any
) -> Float[Array, " unknowns"]:
    """The residual of ``_rate_residual`` alone."""
    return _rate_residual(rate, plant, state, *terms)[0]


def _rate_residual(
    rate: Float[Array, " unknowns"],
    plant: Plant,
    state: State,
    net_heat: Float[Array, "*cells wires"],
    signal: Float[Array, " signals"],
    slope: Float[Array, " signals"],
    share: Float[Array, "*grains wires"] | None,
) -> tuple[Float[Array, " unknowns"], State]:
    """Residual of the heat balance in K/s and of the mechanism's in Pa/s, and the rates of the state.

    Args:
        rate: Trial rates: dT/dt in K/s, then dz/dt in Pa/s.
        plant: The plant.
        state: The state.
        net_heat: Net heat of the wires, W/m^3.
        signal: Signals.
        slope: Their derivatives, per second.
        share: Shares of the rates of the fractions (``_at_the_surface``).
    """
    first, heats = plant._wire_state(state), plant.temperatures
    first = plant._in_surroundings(first, plant._prescribed_channels(signal))
    start = state.step_unknowns
    (balance, stored, end) = jax.jvp(
        lambda h: _increment(plant, state, first, (signal + h * slope, start + h * rate), h, share),
        (jnp.asarray(_INCREMENT),),
        (jnp.ones(()),),
    )[1]
    if isinstance(plant.heat, PrescribedTemperature):
        heat = rate[:heats] - plant._prescribed_channels(slope)["temperature"]
    else:
        warming = (net_heat - stored) / plant._heat_capacity(first.fractions.martensite)
        heat = rate[:heats] - warming.ravel()
    return jnp.concatenate([heat, balance]), end


def _increment(
    plant: Plant,
    state: State,
    first: WireState,
    ends: tuple[Any, ...],
    step: Float[Array, ""],
    share: Float[Array, "*grains wires"] | None,
) -> tuple[Float[Array, " balances"], Float[Array, "*cells wires"], State]:
    """Balance, stored heat and state after an increment to signals and unknowns; the terms of ``_residual``."""
    signal, end = ends
    mechanism, context = plant.mechanism, plant._mechanism_context()
    prescribed, unknown = plant._prescribed_channels(signal), end[plant.temperatures :]
    last, fractions, memory = plant._end_of_step(state, first, unknown, prescribed, step, end, share)
    strain = plant._strain(last, memory)
    if plant.all_effects:
        last = last._replace(contraction=mechanism.contraction(strain))
        memory = memory | plant._updated_memory((MechanismEffect,), memory, first, last, step)
        memory = memory | plant._shared_memory(last)
    motion = jax.tree.map(lambda m, rate: m + step * rate, state.motion, mechanism.motion_rates(state.motion))
    balance = mechanism.balance_at_motion(unknown, strain, motion, prescribed, context)
    stored = jnp.zeros_like(last.temperature) + plant._stored_heat(first, last)
    return balance, stored, State(last.temperature, fractions, last.stress, unknown, motion, memory)


def _signal_at(inputs: Inputs, t: Any) -> tuple[Float[Array, " signals"], Float[Array, " signals"]]:
    """The signals at a time and their slopes, from the step of the grid that holds it."""
    index = jnp.clip(jnp.searchsorted(inputs.time, t, side="right") - 1, 0, inputs.before.shape[0] - 1)
    before, after = inputs.before[index], inputs.after[index]
    duration = inputs.time[index + 1] - inputs.time[index]
    duration = jnp.where(duration > 0.0, duration, 1.0)
    slope = (after - before) / duration
    return before + (t - inputs.time[index]) * slope, slope
