"""Integration of a plant's vector field by diffrax, with an adaptive step size.

It shares the equations with the implicit step (``Plant.step``) and nothing of its integration in time, so it is a
second opinion on the latter. It is slower: rates cost several evaluations of the equations, and they jump where a
transformation starts or ends.
"""

import contextlib
from collections.abc import Iterator
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

from smajax.errors import DerivativeError, InputError
from smajax.numerics.derivative_order import forward_mode_only, nondifferentiable
from smajax.plant.plant import Plant
from smajax.plant.state import State
from smajax.simulation.inputs import Inputs
from smajax.simulation.status import SimulationStatus
from smajax.simulation.time_stepping import simulation_status
from smajax.simulation.vector_field import (
    Differential,
    FieldArguments,
    check_vector_field,
    initial_variables,
    rates,
    state_of,
)

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

_REVERSE_MODE = (
    "simulate: adjoint RecursiveCheckpointAdjoint has no derivatives in forward mode: use jax.grad or jax.vjp, or give "
    "adjoint=diffrax.ForwardMode()"
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
    if adjoint is not None and not isinstance(adjoint, dfx.AbstractAdjoint):
        shown = adjoint.__name__ if isinstance(adjoint, type) else repr(adjoint)
        raise InputError(
            f"simulate: adjoint = {shown} is not an adjoint of diffrax: give one, such as diffrax.ForwardMode()"
        )
    if isinstance(adjoint, dfx.ImplicitAdjoint | dfx.BacksolveAdjoint):
        raise InputError(
            f"simulate: adjoint {type(adjoint).__name__} needs a steady state or an input without jumps: give "
            "diffrax.RecursiveCheckpointAdjoint() for reverse mode, or diffrax.ForwardMode() for forward mode"
        )


def check_solver(solver: Any) -> None:
    """Check that something is a diffrax solver of one vector field.

    Args:
        solver: What was given as the solver.

    Raises:
        InputError: If it is not.
    """
    if not isinstance(solver, dfx.AbstractSolver):
        shown = solver.__name__ if isinstance(solver, type) else repr(solver)
        raise InputError(f"simulate: solver = {shown} is not a solver of diffrax: give one, such as diffrax.Tsit5()")
    if solver.term_structure is not dfx.AbstractTerm:
        raise InputError(
            f"simulate: solver {type(solver).__name__} is for several terms or for noise, and a plant has one vector "
            "field: give a solver of one, such as diffrax.Tsit5() or diffrax.Kvaerno5()"
        )


@contextlib.contextmanager
def forward_mode_refused() -> Iterator[None]:
    """Raise a ``DerivativeError`` where JAX says that the default adjoint has no forward mode."""
    try:
        yield
    except TypeError as error:
        if "custom_vjp" in str(error):
            raise DerivativeError(_REVERSE_MODE) from None
        raise


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
        solver: The diffrax solver, such as ``diffrax.Tsit5()`` or ``diffrax.Kvaerno5()``. One without an error
            estimate, such as ``diffrax.Euler()``, takes the steps of the grid.
        adjoint: How diffrax differentiates: ``diffrax.RecursiveCheckpointAdjoint()`` (the default, in reverse mode),
            ``diffrax.ForwardMode()``, or ``diffrax.DirectAdjoint()`` (in both modes; it is compiled more slowly).

    Returns:
        States at the samples, each leaf with a leading axis of ``samples``, and the status code.

    Raises:
        InputError: If the plant has no vector field, or solver or adjoint do not apply.
        DerivativeError: When a second derivative is taken, one in reverse mode with ``ForwardMode``, or one of a law
            with driving forces or a mechanism with inertia.
    """
    check_vector_field(plant)
    check_solver(solver)
    check_adjoint(adjoint)
    if plant.material.follows_surface or plant.mechanism.inertial:
        plant, inputs = nondifferentiable((plant, inputs), _INACCURATE)
    samples = inputs.time[inputs.sample_indices]
    variables = initial_variables(plant, inputs.sample_signals[0])
    first, structure = jax.tree.flatten(variables)  # diffrax takes no empty nodes

    def flat_rates(t: Any, y: list[Any], arguments: FieldArguments) -> list[Any]:
        return jax.tree.leaves(_guarded_rates(t, jax.tree.unflatten(structure, y), variables, arguments))

    solution = dfx.diffeqsolve(
        dfx.ODETerm(flat_rates),
        solver,
        samples[0],
        samples[-1],
        None,
        first,
        args=FieldArguments(plant, inputs),
        stepsize_controller=_step_size_controller(solver, inputs, samples),
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


def _step_size_controller(
    solver: dfx.AbstractSolver[Any], inputs: Inputs, samples: Float[Array, " samples"]
) -> dfx.AbstractStepSizeController[Any, Any]:
    """Steps by the error estimate of the solver, to each sample; those of the grid for a solver without an estimate."""
    if not isinstance(solver, dfx.AbstractAdaptiveSolver):
        return dfx.StepTo(ts=inputs.time)
    controller = dfx.PIDController(
        rtol=_RELATIVE_TOLERANCE,
        atol=_ABSOLUTE_TOLERANCE,
        norm=optx.max_norm,  # a mean would depend on how many variables are constant
        dtmax=jnp.max(jnp.diff(inputs.time)),  # a longer step may pass a transformation between its stages
    )
    return dfx.ClipStepSizeController(controller, jump_ts=samples[1:-1])


@eqx.filter_custom_jvp
def _guarded_rates(t: Any, y: Differential, first: Differential, arguments: FieldArguments) -> Differential:
    """The vector field, with derivatives of 0 where it is NaN; ``first`` are variables at which it is not.

    A step that leaves the range of the equations is rejected and taken again. In reverse mode its cotangents are 0, and
    their product with its own derivatives would be NaN.
    """
    return rates(t, y, arguments)


@_guarded_rates.def_jvp
def _guarded_tangents(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Differential, Differential]:
    (t, y, first, arguments), (t_dot, y_dot, _, arguments_dot) = primals, tangents
    value = rates(t, y, arguments)
    defined = jnp.all(jnp.stack([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(value)]))
    inside = jax.tree.map(lambda a, b: jnp.where(defined, a, b), y, first)
    _, tangent = eqx.filter_jvp(rates, (t, inside, arguments), (t_dot, y_dot, arguments_dot))
    return value, jax.tree.map(lambda leaf: jnp.where(defined, leaf, jnp.zeros_like(leaf)), tangent)


def _status(states: State, succeeded: Bool[Array, ""]) -> Int[Array, ""]:
    """Status code: not finite, too hot, or ended before the last sample."""
    last = jax.tree.map(lambda leaf: leaf[-1], states)
    status = simulation_status(last, ~succeeded, jnp.max(states.temperature))
    # After the solver has given up, diffrax fills the rows with infinity, which says nothing about the plant.
    return jnp.where(succeeded, status, SimulationStatus.unsolved)
