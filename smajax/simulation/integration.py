"""Integration of a plant's vector field by diffrax, with an adaptive step size.

It shares the equations with the implicit step (``Plant.step``) and nothing of its integration in time, so it is a
second opinion on the latter. It is slower: rates cost several evaluations of the equations, and they jump where a
transformation starts or ends.
"""

from typing import Any, cast

import diffrax as dfx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Int

from smajax.errors import InputError
from smajax.numerics.derivative_order import forward_mode_only, nondifferentiable
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.inputs import Inputs
from smajax.simulation.status import SimulationStatus
from smajax.simulation.time_stepping import simulation_status
from smajax.simulation.vector_field import FieldArguments, check_vector_field, initial_variables, rates, state_of

# Relative tolerance of the step size control, and the absolute ones of temperature (K), fraction, and unknown (Pa);
# tests/unit/simulation/test_vector_field.py holds the resulting difference to the implicit step.
_RELATIVE_TOLERANCE = 1e-7
_ABSOLUTE_TOLERANCE = 1e-7
# Largest mean number of diffrax steps per sample. Chosen by trial, far above what the tests need.
_STEPS_PER_SAMPLE = 256

_FORWARD_MODE = (
    "simulate: adjoint ForwardMode has no derivatives in reverse mode: use jax.jvp or jax.jacfwd, or give "
    "diffrax.RecursiveCheckpointAdjoint()"
)

# Derivatives through an adaptive solver differ from finite differences of its own values for these plants.
_INACCURATE = (
    "simulate: a diffrax solver has no derivatives for a material law with driving forces or a mechanism with inertia: "
    "leave out solver= to differentiate the implicit step"
)


def check_adjoint(adjoint: dfx.AbstractAdjoint | None) -> None:
    """Check that an adjoint of diffrax can differentiate states at many samples of an input that jumps.

    Args:
        adjoint: The adjoint; ``None`` for the default one.

    Raises:
        InputError: If it cannot.
    """
    if isinstance(adjoint, dfx.ImplicitAdjoint | dfx.BacksolveAdjoint):
        raise InputError(
            f"simulate: adjoint {type(adjoint).__name__} needs a steady state or an input without jumps: give "
            "diffrax.RecursiveCheckpointAdjoint() for reverse mode, or diffrax.ForwardMode() for forward mode"
        )


def integrate_vector_field(
    plant: Plant,
    inputs: Inputs,
    solver: dfx.AbstractSolver[Any],
    adjoint: dfx.AbstractAdjoint | None = None,
) -> tuple[State, Int[Array, ""]]:
    """Integrate the plant's vector field with an adaptive step size; compilation is up to the caller.

    Args:
        plant: The plant.
        inputs: Its inputs on a grid. The solver steps to each sample, since a held input jumps there, and no step is
            longer than the longest of the grid.
        solver: The diffrax solver, such as ``diffrax.Tsit5()`` or ``diffrax.Kvaerno5()``.
        adjoint: How diffrax differentiates: ``diffrax.RecursiveCheckpointAdjoint()`` (the default, in reverse mode),
            ``diffrax.ForwardMode()``, or ``diffrax.DirectAdjoint()`` (in both modes; it is compiled more slowly).

    Returns:
        States at the samples, each leaf with a leading axis of ``samples``, and the status code.

    Raises:
        InputError: If the plant has no vector field, or the adjoint does not apply.
        DerivativeError: When a second derivative is taken, one in reverse mode with ``ForwardMode``, or one of a law
            with driving forces or a mechanism with inertia.
    """
    check_vector_field(plant)
    check_adjoint(adjoint)
    if plant.material.follows_surface or plant.mechanism.inertial:
        plant, inputs = nondifferentiable((plant, inputs), _INACCURATE)
    samples = inputs.time[inputs.sample_indices]
    controller = dfx.PIDController(
        rtol=_RELATIVE_TOLERANCE,
        atol=_ABSOLUTE_TOLERANCE,
        norm=optx.max_norm,  # a mean would depend on how many variables are constant
        dtmax=jnp.max(jnp.diff(inputs.time)),  # a longer step may pass a transformation between its stages
    )
    variables = initial_variables(plant, inputs.sample_signals[0])
    first, structure = jax.tree.flatten(variables)  # diffrax takes no empty nodes

    def flat_rates(t: Any, y: list[Any], arguments: FieldArguments) -> list[Any]:
        return jax.tree.leaves(rates(t, jax.tree.unflatten(structure, y), arguments))

    solution = dfx.diffeqsolve(
        dfx.ODETerm(flat_rates),
        solver,
        samples[0],
        samples[-1],
        None,
        first,
        args=FieldArguments(plant, inputs),
        stepsize_controller=dfx.ClipStepSizeController(controller, jump_ts=samples[1:-1]),
        saveat=dfx.SaveAt(ts=samples),
        max_steps=_STEPS_PER_SAMPLE * len(samples) + len(inputs.time),
        adjoint=dfx.RecursiveCheckpointAdjoint() if adjoint is None else adjoint,
        throw=False,
    )
    later = jax.tree.unflatten(structure, cast(list, solution.ys))
    if isinstance(adjoint, dfx.ForwardMode):
        later = forward_mode_only(later, _FORWARD_MODE)
    states = jax.vmap(lambda y, signal: state_of(y, signal, plant))(later, inputs.sample_signals)
    return states, _status(states, dfx.is_okay(solution.result))


def _status(states: State, succeeded: Bool[Array, ""]) -> Int[Array, ""]:
    """Status code: not finite, too hot, or ended before the last sample."""
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    status = simulation_status(last, ~succeeded, jnp.max(states.temperature))
    # After the solver has given up, diffrax fills the rows with infinity, which says nothing about the plant.
    return jnp.where(succeeded, status, SimulationStatus.unsolved)
