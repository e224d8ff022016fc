"""Simulate a plant: one recording, inputs on a grid, or a batch of plants.

The time steps are those of ``Plant.step``: they are fixed, and one ends at every sample (``smajax.simulation.inputs``).
A simulation with half the step size shows their discretisation error.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float, Int

from smajax import parameters
from smajax.arguments import check_type
from smajax.errors import InputError, NumericsError
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.numerics.precision import require_double
from smajax.numerics.stored_programs import stored
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.recordings.recording import Recording
from smajax.simulation.argument_checks import A_RECORDING, check_plant
from smajax.simulation.compilation import flatten_state, state_unflattener
from smajax.simulation.diagnostics import describe_parameters
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.physical_limits import status_with_limits, within_limits
from smajax.simulation.sensitivities import Trajectory, outputs_along, simulate_outputs
from smajax.simulation.status import SimulationStatus
from smajax.simulation.time_stepping import integrate

# Wide vectors are faster in a batch; single simulations are slower with them.
_BATCH_OPTIONS = {"xla_cpu_prefer_vector_width": 512}


class Simulation(eqx.Module):
    """A plant's response.

    Attributes:
        time: Times of the samples, shape ``(samples,)``, s.
        channels: Channels by name, shape ``(samples,)`` each, SI and degC.
        state: States at the samples, each leaf with a leading axis of ``samples``.
        status: Status code (``SimulationStatus``).
        possible: Whether temperatures and strains are within the limits of a wire
            (``smajax.simulation.physical_limits``) at each sample.
    """

    time: Float[Array, " samples"]
    channels: dict[str, Float[Array, " samples"]]
    state: State
    status: Int[Array, ""]
    possible: Bool[Array, " samples"]


def simulate_states(plant: Plant, inputs: Inputs) -> tuple[State, Int[Array, ""]]:
    """Simulate a plant and return the states at the samples; the caller compiles and batches it.

    Differentiable once in the plant's parameters and in the inputs, in forward and in reverse mode.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.

    Returns:
        The states, each leaf with a leading axis of ``samples``, and the status code.
    """
    flat, status = simulate_outputs(plant, inputs, None, flatten_state)
    return jax.vmap(state_unflattener(plant, inputs))(flat[inputs.sample_indices]), status


def observe(
    plant: Plant, states: State, inputs: Inputs, channels: Sequence[str]
) -> dict[str, Float[Array, " samples"]]:
    """Compute channels from the states at the samples.

    Args:
        plant: The plant.
        states: States at the samples, each leaf with a leading axis of ``samples``.
        inputs: The inputs on a grid.
        channels: Names of the channels.

    Returns:
        The channels by name, SI and degC.
    """
    values = jax.vmap(plant.observe)(states, inputs.sample_signals)
    read = plant.read_sensors(values, inputs.time[inputs.sample_indices])
    return {c: read[c] for c in channels}


def trajectory(plant: Plant, inputs: Inputs, end_index: Int[Array, ""] | None = None) -> Trajectory:
    """Simulate a plant and return its trajectory. Not differentiable.

    Given the trajectory, ``simulate_channels`` does not simulate: simulation and derivatives become two programs.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        end_index: Grid point at which the simulation may end, as in ``simulate_channels``.
    """
    return Trajectory(*integrate(plant, inputs, flatten_state, end_index))


def states_along(plant: Plant, inputs: Inputs, trajectory: Trajectory) -> State:
    """Return the states of a trajectory at the samples, each leaf with a leading axis of ``samples``.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        trajectory: Its trajectory under them.
    """
    return jax.vmap(state_unflattener(plant, inputs))(trajectory.flat_states[inputs.sample_indices])


def blank_trajectory(plant: Plant, inputs: Inputs) -> Trajectory:
    """Return a trajectory of zeros with the right shapes, as an argument for compilation.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
    """
    signal = inputs.sample_signals[0]
    size = jax.eval_shape(lambda: flatten_state(plant, plant.init(signal), signal)).shape[0]
    return Trajectory(jnp.zeros((inputs.time.shape[0], size)), jnp.asarray(SimulationStatus.unsolved.value))


def simulate_channels(
    plant: Plant,
    inputs: Inputs,
    channels: Sequence[str],
    end_index: Int[Array, ""] | None = None,
    trajectory: Trajectory | None = None,
) -> tuple[dict[str, Float[Array, " samples"]], Int[Array, ""]]:
    """Simulate a plant and return channels at the samples; stores no states, for batches.

    Differentiable once in the plant's parameters and in the inputs, in forward and in reverse mode.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        channels: Names of the channels.
        end_index: Grid point at which the simulation may end, because no sample lies after it; not batched. With it
            there is no reverse mode.
        trajectory: The trajectory of this plant under these inputs, if it has been computed before.

    Returns:
        The channels by name, SI and degC, and the status code.
    """
    names = list(dict.fromkeys([*channels, *(c for effect in plant.effects for c in effect.other_channels)]))

    def outputs_of(plant: Plant, state: State, signal: jax.Array) -> jax.Array:
        values = plant.observe(state, signal)
        return jnp.stack([values[c] for c in names])

    if trajectory is None:
        values, status = simulate_outputs(plant, inputs, end_index, outputs_of)
    else:
        values, status = outputs_along(plant, inputs, end_index, outputs_of, trajectory), trajectory.status
    series = dict(zip(names, values[inputs.sample_indices].T, strict=True))
    read = plant.read_sensors(series, inputs.time[inputs.sample_indices])
    return {c: read[c] for c in channels}, status


@stored
def simulate_inputs(plant: Plant, inputs: Inputs) -> Simulation:
    """Simulate a plant under inputs on a grid; compiled once per numbers of grid points and samples.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
    """
    return _response(plant, inputs, *simulate_states(plant, inputs))


def _response(plant: Plant, inputs: Inputs, states: State, status: Int[Array, ""]) -> Simulation:
    """The response with given states at the samples, and its status with the limits of a wire."""
    channels = observe(plant, states, inputs, plant.observable)
    temperature_holds, strain_holds = within_limits(plant, states)
    status = status_with_limits(status, strain_holds)
    return Simulation(inputs.time[inputs.sample_indices], channels, states, status, temperature_holds & strain_holds)


@jit_with_kernels
def simulate_vector_field(plant: Plant, inputs: Inputs, solver: Any, adjoint: Any = None) -> Simulation:
    """Simulate a plant by a diffrax solver of its vector field.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid.
        solver: The solver, a ``diffrax.AbstractSolver``.
        adjoint: How diffrax differentiates; ``diffrax.RecursiveCheckpointAdjoint`` if not given.

    Raises:
        InputError: If the plant has no vector field.
    """
    from smajax.simulation.integration import integrate_vector_field  # diffrax, which is slow to import

    return _response(plant, inputs, *integrate_vector_field(plant, inputs, solver, adjoint))


def simulate(
    plant: Plant,
    inputs: Inputs | Recording,
    *,
    interpolation: str | None = None,
    step: float | None = None,
    solver: eqx.Module | None = None,
    adjoint: eqx.Module | None = None,
    throw: bool = True,
) -> Simulation:
    """Simulate a plant; safe under ``jax.jit``, ``jax.vmap`` and differentiation in both modes.

    Differentiable once in the plant's parameters and in the inputs, as by the factor of ``Inputs.scale``.
    ``simulate_batch`` simulates many plants faster.

    Args:
        plant: The plant; its effects of strength 0 are left out, unless the strength is traced.
        inputs: The inputs on a grid (``discretise``), or a recording that gives them. With a recording the grid is made
            here, which a plant under ``jax.jit`` or ``jax.vmap`` allows only with ``step``.
        interpolation: Electrical inputs of a recording between its samples: ``hold`` or ``linear``; by default that of
            the plant, which is that of its rig file.
        step: Longest step in s for a recording; ``default_step`` if not given.
        solver: A diffrax solver that integrates the plant's vector field (``smajax.simulation.vector_field``) with an
            adaptive step size, in place of the implicit step: a second opinion. Not every plant has one. A solver
            without an error estimate (``diffrax.Euler()``) takes the steps of the grid.
        adjoint: With ``solver``: how diffrax differentiates, ``diffrax.RecursiveCheckpointAdjoint()`` if not given.
            It has reverse mode only, and ``diffrax.ForwardMode()`` forward mode only; ``diffrax.DirectAdjoint()``,
            which is compiled more slowly, has both.
        throw: Whether to raise if the simulation fails. Under ``jax.jit`` or ``jax.vmap`` nothing is raised, so that
            programs can be cached: look at ``status``.

    Returns:
        The response at the samples.

    Raises:
        NumericsError: If the simulation fails and ``throw`` is set; the message says what to do.
        InputError: If an argument is of another type or of single precision, the recording lacks a channel, the grid
            would depend on a traced plant, an option does not apply, or the plant has no vector field for ``solver``.
        DerivativeError: When a second derivative is taken, one in reverse mode with ``diffrax.ForwardMode()``, one in
            forward mode with the default adjoint, or one with ``solver`` for a material law with driving forces or a
            mechanism with inertia.
    """
    name = inputs.name if isinstance(inputs, Recording) else "simulate"
    inputs = _on_a_grid(plant, inputs, interpolation, step)
    if adjoint is not None and solver is None:
        raise InputError("simulate: adjoint belongs to a diffrax solver: give solver, too, or leave out adjoint")
    present = dataclasses.replace(plant, effects=tuple(e for e in plant.effects if not _is_zero(e.strength)))
    if solver is None:
        result = simulate_inputs(present, inputs)
    else:
        from smajax.simulation.integration import forward_mode_refused  # diffrax, which is slow to import

        with forward_mode_refused():
            result = simulate_vector_field(present, inputs, solver, adjoint)
    if throw and not isinstance(result.status, Tracer):
        status = SimulationStatus(int(result.status))
        if status is not SimulationStatus.done:
            raise NumericsError(f"{name}: {status.name}: {status.hint}; parameters: {describe_parameters(plant)}")
    return result


def _on_a_grid(plant: Plant, inputs: Inputs | Recording, interpolation: str | None, step: float | None) -> Inputs:
    """The inputs of a simulation on a grid, after checks of types and shape."""
    name = "simulate"
    check_plant(name, plant)
    takes = f"Inputs, as discretise returns them, or {A_RECORDING}"
    check_type(name, "inputs", inputs, Inputs | Recording, takes)
    if isinstance(inputs, Recording):
        name, inputs = inputs.name, discretise(plant, inputs, interpolation=interpolation, step=step)
    elif step is not None or interpolation is not None:
        raise InputError("simulate: the inputs are on a grid already: give step and interpolation to discretise")
    require_double(inputs=inputs)
    signals = inputs.before.shape[-1] - len(inputs.surroundings)
    if signals != len(plant.signals):
        raise InputError(
            f"{name}: the inputs have {signals} signals and the plant is driven by "
            f"{', '.join(plant.signals)}: call discretise with this plant"
        )
    return inputs


def _is_zero(strength: Float[Array, "..."]) -> bool:
    """Whether an effect is absent, as far as that is known while a program is traced."""
    return not isinstance(strength, Tracer) and float(strength) == 0.0


@functools.partial(stored, compiler_options=_BATCH_OPTIONS)
def simulate_batch(
    plant: Plant, values: dict[str, jax.Array], inputs: Inputs, channels: tuple[str, ...]
) -> tuple[dict[str, Float[Array, "plants samples"]], Int[Array, " plants"]]:
    """Simulate plants that differ in named parameters under the same inputs.

    The failure of one plant does not affect the others.

    Args:
        plant: The plant.
        values: Values of the parameters by name, shape ``(plants,)`` each, internal units.
        inputs: The inputs on a grid.
        channels: Names of the channels.

    Returns:
        The channels by name, shape ``(plants, samples)`` each, and the status codes, shape ``(plants,)``.
    """

    def single(values: dict[str, Any]) -> tuple[dict[str, Any], jax.Array]:
        return simulate_channels(parameters.replace(plant, values), inputs, channels)

    return jax.vmap(single)(values)
