"""Functions for loops of one's own: the plant's initial state, one time step, and its channels.

All of them are safe under ``jax.jit``, ``jax.vmap`` and differentiation in both modes, in the plant's parameters, the
state, the signals and the duration. A second derivative of a step does not exist and raises.

    plant = rig.plant
    state = init(plant, signal)
    state, info = step(plant, state, signal, dt)
    channels = observe(plant, state, signal)

A signal has one entry for each of ``plant.signals``. It may have more: the ambient temperature in degC, in place of
``environment.ambient`` in the heat balance, and then the duty of a fan.
"""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int

from smajax.arguments import check_type
from smajax.errors import InputError
from smajax.numerics.precision import require_double
from smajax.parameters.checks import is_concrete
from smajax.plant.plant import Plant
from smajax.plant.stages import SURROUNDINGS
from smajax.plant.state import State
from smajax.simulation.argument_checks import A_STATE, as_array, check_plant
from smajax.simulation.time_stepping import simulation_status


class StepInfo(eqx.Module):
    """How a step ended.

    Attributes:
        status: Status code (``SimulationStatus``): 0 if the step was solved and its end is usable.
    """

    status: Int[Array, ""]


def init(plant: Plant, signal: ArrayLike) -> State:
    """Compute the state at the first sample: as installed, at rest, in equilibrium.

    Args:
        plant: The plant.
        signal: Signals at the first sample in the order of ``plant.signals``, shape ``(signals,)``, SI and degC.

    Returns:
        The state, a pytree.

    Raises:
        InputError: If an argument is of another type, the shape is wrong, or something is of single precision.
        DerivativeError: When a second derivative is taken under a prescribed strain.
    """
    signals = _signal(plant, signal, "init")  # first, since it checks the plant
    return plant.init(signals)


def step(
    plant: Plant, state: State, signal: ArrayLike, dt: ArrayLike, *, before: ArrayLike | None = None
) -> tuple[State, StepInfo]:
    """Advance the state by one time step.

    The step is implicit, of second order or better in ``dt``; ``smajax.simulation.step_size.default_step`` gives a
    duration that resolves heating and cooling.

    Args:
        plant: The plant.
        state: The state at the start, from ``init`` or an earlier step.
        signal: Signals in the order of ``plant.signals``, shape ``(signals,)``, SI and degC; held over the step.
        dt: Duration, s.
        before: Signals at the start, if they are linear over the step and ``signal`` are those at its end.

    Returns:
        The state at the end, and how the step ended.

    Raises:
        InputError: If an argument is of another type, a shape is wrong, or something is of single precision.
        DerivativeError: When a second derivative is taken.
    """
    after = _signal(plant, signal, "step")
    start = after if before is None else _signal(plant, before, "step")
    check_type("step", "state", state, State, A_STATE)
    require_double(state=state, dt=dt)
    duration = _duration(dt)
    end, unsolved = plant.step(state, start, after, duration)
    return end, StepInfo(simulation_status(end, unsolved, jnp.max(end.temperature)))


def observe(plant: Plant, state: State, signal: ArrayLike) -> dict[str, Float[Array, ""]]:
    """Compute the channels at one instant, as their sensors read them.

    Effects that act on a whole series, such as the lag or the quantisation of a sensor, are those of ``simulate``.

    Args:
        plant: The plant.
        state: The state.
        signal: Signals at the same instant in the order of ``plant.signals``, shape ``(signals,)``, SI and degC.

    Returns:
        Scalars by channel (``plant.observable``), SI and degC.

    Raises:
        InputError: If an argument is of another type, the shape is wrong, or something is of single precision.
    """
    signals = _signal(plant, signal, "observe")
    check_type("observe", "state", state, State, A_STATE)
    require_double(state=state)
    return plant.observe(state, signals)


def _duration(dt: ArrayLike) -> Float[Array, ""]:
    """The duration of a step; one that JAX does not trace is at least 0."""
    duration = as_array("step", "dt", dt, "the duration of the step in s")
    if duration.shape:
        raise InputError(f"step: dt has shape {duration.shape}: give one duration, and map over several by jax.vmap")
    if is_concrete(duration) and not 0.0 <= float(duration) < math.inf:
        raise InputError(f"step: dt = {float(duration):g} s is not possible: give a duration of at least 0 s")
    return duration


def _signal(plant: Plant, signal: ArrayLike, function: str) -> Float[Array, " signals"]:
    """The signals as an array of double precision, after checks of plant and shape."""
    check_plant(function, plant)
    require_double(signal=signal)
    sizes = range(len(plant.signals), len(plant.signals) + len(SURROUNDINGS) + 1)
    if np.shape(signal) not in [(size,) for size in sizes]:
        raise InputError(
            f"{function}: signal has shape {np.shape(signal)}: give one value for each of {', '.join(plant.signals)}, "
            f"shape ({len(plant.signals)},)"
        )
    return jnp.asarray(signal, float)
