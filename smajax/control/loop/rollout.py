"""Rollouts of a closed loop: a plant and a sampled controller in one scan, differentiable in both.

At each sample the loop measures the channels and sets the commands, which are held for a period, during which the plant
takes its own steps.

What makes the derivatives fast:

- An implicit plant is differentiated after the rollout, with all states and step solutions known (custom JVP): no
  equation is solved again, neither in forward nor in reverse mode.
- The derivative of each sample is recomputed where it is used (``jax.checkpoint``), which is faster than storing it.
- Without an implicit solve, only every ``Scenario.block``-th state is checkpointed; the states in between are
  recomputed in the backward pass.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int

from smajax.arguments import check_duration, check_type
from smajax.channels import channel_of
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.sampled_plant import AbstractSampledSystem, SampledPlant
from smajax.control.sampling_period import check_same_period
from smajax.errors import InputError, NumericsError
from smajax.numerics.derivative_order import first_order_only, nondifferentiable
from smajax.numerics.implicit_differentiation import jvp
from smajax.numerics.precision import require_double
from smajax.numerics.stored_programs import stored
from smajax.plant.plant import Plant
from smajax.simulation.argument_checks import A_PLANT, as_array, check_plant
from smajax.simulation.status import MELTING_TEMPERATURE, SimulationStatus

# Channels that follow the command without delay; the others change in the course of the period.
_ELECTRICAL = ("current", "voltage", "power")


class Scenario(eqx.Module):
    """Inputs of a rollout of n samples.

    Attributes:
        reference: Reference at the samples, shape ``(n,)``, in the channel's unit.
        initial_reference: Reference before the first sample, a scalar.
        draws: Standard normal numbers of the sensors' noise, shape ``(n,)``.
        changes: Parameters that change with time by name, shape ``(n,)`` each, internal units.
        block: Number of samples between two checkpoints of an explicit plant.
    """

    reference: jax.Array
    initial_reference: jax.Array
    draws: jax.Array
    changes: dict[str, jax.Array]
    block: int = eqx.field(static=True, default=64)

    @property
    def rows(self) -> tuple[Any, ...]:
        """Reference, draws and changes, the arrays with an axis of samples."""
        return self.reference, self.draws, self.changes

    def without_noise(self) -> "Scenario":
        """Return the scenario without noise, which shows whether the loop oscillates by itself."""
        return dataclasses.replace(self, draws=jnp.zeros_like(self.draws))

    @classmethod
    def noiseless(
        cls, reference: Any, initial_reference: Any = 0.0, changes: dict[str, Any] | None = None
    ) -> "Scenario":
        """Build a scenario without noise.

        Args:
            reference: Reference at the samples, shape ``(n,)``, in the channel's unit.
            initial_reference: Reference before the first sample.
            changes: Parameters that change with time by name, shape ``(n,)`` each, internal units.

        Raises:
            InputError: if the reference is not a series of values, or something is of single precision.
        """
        require_double(reference=reference, initial_reference=initial_reference, changes=changes)
        reference = as_array("rollout", "reference", reference, "one value for each sample, or a Scenario")
        if reference.ndim != 1 or not reference.shape[0]:
            raise InputError(f"the reference has the shape {reference.shape}: give one value for each sample")
        initial = as_array("rollout", "initial_reference", initial_reference, "a number")
        arrays = {name: jnp.asarray(values, jnp.float64) for name, values in (changes or {}).items()}
        return cls(reference, initial, jnp.zeros_like(reference), arrays)


class Rollout(eqx.Module):
    """Result of a rollout of n samples; a batch of rollouts has leading axes.

    Attributes:
        channels: Exact channels (not as measured) at the samples by name, shape ``(n,)`` each, internal units.
        command: Commands held from each sample on, shape ``(n, wires)``, in the unit of the drive.
        unsolved: Number of the plant's steps that could not be solved, a scalar; ``None`` in a tangent.
        final_states: States of plant and loop after the last period, and the last commands.
    """

    channels: dict[str, jax.Array]
    command: jax.Array
    unsolved: jax.Array | None
    final_states: Any

    @property
    def status(self) -> Int[Array, "*batch"]:
        """How the rollout ended: a code of ``SimulationStatus`` for each rollout of a batch."""
        finite = jnp.all(jnp.isfinite(self.command), axis=(-2, -1))
        melted = jnp.zeros_like(finite)
        for name, values in self.channels.items():
            finite &= jnp.all(jnp.isfinite(values), axis=-1)
            if channel_of(name) == "temperature":
                melted |= jnp.any(values > MELTING_TEMPERATURE, axis=-1)
        unsolved = jnp.asarray(self.unsolved) > 0
        code = jnp.where(unsolved, SimulationStatus.unsolved, SimulationStatus.done)
        return jnp.where(finite, jnp.where(melted, SimulationStatus.overheated, code), SimulationStatus.diverged)


def rollout(
    system: Plant | AbstractSampledSystem,
    loop: ClosedLoop,
    reference: Any,
    *,
    initial_reference: Any = None,
    period: float | None = None,
    step: float | None = None,
    throw: bool = True,
) -> Rollout:
    """Simulate a closed loop over a reference.

    Works under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; differentiable once, in forward and in reverse mode, in the
    plant's parameters, the gains, the reference and the changes.

    Args:
        system: A plant, or a sampled one. A plant whose parameters are traced needs ``step``.
        loop: The closed loop.
        reference: Reference at the samples, shape ``(n,)``, in the channel's unit; or a ``Scenario``, which also has
            noise and changes.
        initial_reference: Reference before the first sample; by default the channel's value at rest. That of a scenario
            is used in any case.
        period: Period of the samples, s, to check that it is the loop's.
        step: Longest step of a plant that is not sampled yet, s; by default ``default_step`` of the plant.
        throw: Whether to raise if the simulation fails. In a traced function nothing is raised: check ``status``.

    Returns:
        Channels and commands at the samples, the final states, and the status.

    Raises:
        InputError: if an argument is of another type or of single precision, periods differ, the numbers of wires
            differ, the plant has no channel of the loop's name, the limits of two wires never heat one of them, or the
            step of a traced plant is not given.
        NumericsError: if the simulation fails and ``throw`` is set; the message says what to do.
    """
    check_type("rollout", "system", system, Plant | AbstractSampledSystem, f"{A_PLANT}, or a SampledPlant")
    check_type("rollout", "loop", loop, ClosedLoop, "a ClosedLoop, such as ClosedLoop(controller, channel=...)")
    if isinstance(system, Plant):
        check_plant("rollout", system)
    require_double(system=system, loop=loop, reference=reference, initial_reference=initial_reference)
    if period is not None:
        check_same_period("rollout", period, "controller", loop.period)
    if step is not None:
        check_duration("rollout", "step", step)
    sampled = _sampled(system, loop.period, step)
    loop = loop.for_wires(sampled.wires)
    result = _compiled_simulation(sampled, loop, _scenario(sampled, loop, reference, initial_reference))
    if throw and not isinstance(result.status, Tracer):
        raise_for_status(result)
    return result


def raise_for_status(result: Rollout) -> None:
    """Raise an error for the first failed rollout of a batch.

    Args:
        result: A rollout or a batch of rollouts.

    Raises:
        NumericsError: if one failed; the message says what to do.
    """
    codes = np.atleast_1d(np.asarray(result.status)).ravel()
    failed = np.flatnonzero(codes != SimulationStatus.done)
    if len(failed):
        status = SimulationStatus(int(codes[failed[0]]))
        which = f"rollout {failed[0]}" if len(codes) > 1 else "rollout"
        raise NumericsError(f"{which}: {status.name}: {status.hint}")


def _sampled(system: Plant | AbstractSampledSystem, period: float, step: float | None) -> AbstractSampledSystem:
    """The sampled plant."""
    if isinstance(system, AbstractSampledSystem):
        return system
    if step is None and any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(system)):
        raise InputError(
            "the number of steps in a period cannot depend on a traced plant: give step, or SampledPlant.of outside of "
            "the traced function"
        )
    return SampledPlant.of(system, period, step=step)


def _scenario(system: AbstractSampledSystem, loop: ClosedLoop, reference: Any, initial: Any) -> Scenario:
    """The scenario of a reference."""
    if isinstance(reference, Scenario):
        return reference
    if initial is None:
        initial = loop.controlled_value(system.observe(system.start(), jnp.zeros(system.wires)))
    return Scenario.noiseless(reference, initial)


def simulate_loop(system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario) -> Rollout:
    """Simulate a closed loop over a scenario; compilation and batching are up to the caller.

    Differentiable once, in forward and in reverse mode, in the plant's parameters, the gains, the reference and the
    changes.

    Args:
        system: The sampled plant.
        loop: The closed loop, for its number of wires.
        scenario: Reference, noise and changes.

    Returns:
        Channels and commands at the samples, and the final states.

    Raises:
        InputError: if plant and loop have different periods, or the plant has no channel of the loop's name.
    """
    check_same_period("plant", system.period, "controller", loop.period)
    if system.is_implicit:
        return _implicit_rollout(system, loop, scenario)
    return rollout_with_solutions(system, loop, scenario)[0]


def rollout_with_solutions(
    system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario, first: Any = None
) -> tuple[Rollout, Any]:
    """Simulate a closed loop, and store the states and step solutions that its derivative needs.

    Args:
        system: The sampled plant.
        loop: The closed loop, of the same period.
        scenario: Reference, noise and changes.
        first: States and commands before the first sample, such as the final states of another rollout; by default
            those of ``states_at_rest``.

    Returns:
        The rollout; and for an implicit plant the flat states before each sample and the step solutions after it, with
        a leading axis of samples (else ``()``).
    """

    def sample(carry: Any, row: tuple[Any, ...]) -> tuple[Any, Any]:
        def step(system: AbstractSampledSystem, state: Any, command: Float[Array, " wires"]) -> tuple[Any, Any]:
            state, step_solutions, unsolved = system.step(state, command)
            return state, (step_solutions, unsolved)

        later, (channels, command, (step_solutions, unsolved)) = _sample(system, loop, carry, row, step)
        solutions = (ravel_pytree(carry)[0], step_solutions) if system.is_implicit else ()
        return later, (channels, command, unsolved, solutions)

    end, (channels, command, unsolved, solutions) = _checkpointed_scan(
        sample, states_at_rest(system, loop, scenario) if first is None else first, scenario.rows, scenario.block
    )
    if system.is_implicit:
        # As one array, like the tangents: under ``vmap`` a value and its tangent are then batched together, or neither
        # is, which JAX needs for the derivative of a function that it has traced before.
        flat, unflatten = ravel_pytree(end)
        end = unflatten(flat)
    return Rollout(channels, command, jnp.sum(unsolved), end), solutions


def states_at_rest(system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario) -> Any:
    """Return the states of plant and loop at rest, and commands of 0.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: The scenario, of which the initial reference is used.
    """
    start, no_command = system.start(), jnp.zeros(system.wires)
    return start, loop.reset(scenario.initial_reference, system.observe(start, no_command)), no_command


def _sample(
    system: AbstractSampledSystem, loop: ClosedLoop, carry: Any, row: tuple[Any, ...], step: Callable[..., Any]
) -> tuple[Any, Any]:
    """One sample and its period: the carry at the end; channels, command and the second result of ``step``."""
    state, loop_state, command = carry
    reference, draw, changes = row
    changed = system.with_parameters(changes) if changes else system
    before = changed.observe(state, command)
    loop_state, command = loop.step(loop_state, reference, before, draw)
    # Only the electrical channels are taken under the new command, so that the others are not differentiated twice.
    after = changed.observe(state, command)
    channels = {name: after[name] if name.partition("_")[0] in _ELECTRICAL else value for name, value in before.items()}
    state, extra = step(changed, state, command)
    return (state, loop_state, command), (channels, command, extra)


_compiled_simulation = stored(simulate_loop)


@eqx.filter_custom_jvp
def _implicit_rollout(system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario) -> Rollout:
    """The rollout of an implicit plant, whose derivative uses the stored states and step solutions."""
    return rollout_with_solutions(system, loop, scenario)[0]


@_implicit_rollout.def_jvp
def _implicit_rollout_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    """Propagate the tangent from sample to sample; linear in the tangent, so that JAX transposes it."""
    primals = nondifferentiable(primals, first_order_only("the rollout of an implicit plant"))
    (system, loop, scenario), (system_tangent, loop_tangent, scenario_tangent) = primals, tangents
    result, (carries, solutions) = rollout_with_solutions(system, loop, scenario)
    unflatten = ravel_pytree(states_at_rest(system, loop, scenario))[1]

    def propagate(tangent: Any, sample: tuple[Any, ...]) -> tuple[Any, Any]:
        carry, step_solutions, row, row_tangent = sample

        def period(
            system: AbstractSampledSystem, loop: ClosedLoop, carry: jax.Array, row: tuple[Any, ...]
        ) -> tuple[jax.Array, Any]:
            later, (channels, command, _) = _sample(
                system,
                loop,
                unflatten(carry),
                row,
                lambda changed, state, command: (changed.differentiable_step(state, command, step_solutions), ()),
            )
            return ravel_pytree(later)[0], (channels, command)

        return jvp(period, (system, loop, carry, row), (system_tangent, loop_tangent, tangent, row_tangent))

    first = jvp(lambda *all_: ravel_pytree(states_at_rest(*all_))[0], primals, tangents)
    row_tangents = jax.tree.map(
        lambda row, tangent: jnp.zeros_like(row) if tangent is None else tangent,
        scenario.rows,
        scenario_tangent.rows,
        is_leaf=_is_none,
    )
    end, (channels, command) = jax.lax.scan(
        jax.checkpoint(propagate, prevent_cse=False), first, (carries, solutions, scenario.rows, row_tangents)
    )
    # Counts and flags in the states of some controllers have no tangent.
    final_tangents = jax.tree.map(
        lambda value, tangent: tangent if eqx.is_inexact_array(value) else None, result.final_states, unflatten(end)
    )
    return result, Rollout(channels, command, None, final_tangents)


def _is_none(leaf: Any) -> bool:
    return leaf is None


def _checkpointed_scan(function: Any, first: Any, rows: Any, block: int) -> tuple[Any, Any]:
    """Scan that stores only the carry at the beginning of each block for reverse mode."""
    count = jax.tree.leaves(rows)[0].shape[0]
    blocks = count // block
    head = jax.tree.map(lambda leaf: leaf[: blocks * block].reshape(blocks, block, *leaf.shape[1:]), rows)
    carry, block_results = jax.lax.scan(
        jax.checkpoint(lambda c, r: jax.lax.scan(function, c, r), prevent_cse=False), first, head
    )
    carry, last_results = jax.lax.scan(function, carry, jax.tree.map(lambda leaf: leaf[blocks * block :], rows))
    results = jax.tree.map(
        lambda a, b: jnp.concatenate([a.reshape(blocks * block, *a.shape[2:]), b]), block_results, last_results
    )
    return carry, results
