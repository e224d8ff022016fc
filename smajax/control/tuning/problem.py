"""The tuning problem: a loop around one plant or several as a function of a point in the unit box.

A point is the logarithm of each gain between its bounds, scaled to 0..1.
"""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Array, Float

from smajax.control.analysis.members import rollout_members
from smajax.control.analysis.step_response import Jumps, find_jumps
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gain, with_gains
from smajax.control.loop.rollout import Rollout, Scenario
from smajax.control.sampled_plant import AbstractSampledSystem
from smajax.control.sampling_period import check_same_period
from smajax.control.tuning.objective import Objective, ObjectiveTerms, ReferenceSignal, evaluate_objective
from smajax.errors import InputError
from smajax.numerics.stored_programs import stored

# Number of noise draws that gains are tuned for, so that they do not overfit a single one. Chosen by
# experiments/papers/rotary/rotary_tracking.py.
NOISE_DRAWS = 8
# The same within limits: with 8 members the gains keep a limit for these and miss it for other cases more often. Chosen
# by experiments/control/random_tuning_tasks.py.
LIMITED_NOISE_DRAWS = 24
# Relative spread of the gains that several members evaluate, so that the gains do not overfit the instants at which a
# single reference jumps. Chosen by experiments/control/wire_position.py.
GAIN_SPREAD = 0.1
# Number in the seed of the noise that separates its random numbers from others of the same seed.
_NOISE_STREAM = 11


class TuningProblem(eqx.Module):
    """Tuning problem: one loop and scenario, simulated for several members (plants, draws of the sensor's noise).

    Each member evaluates the gains with its own small offsets. A wire's loop may oscillate, and the phase of the
    oscillation at a jump of the reference changes the cost; the offsets average over it.

    Attributes:
        system: The sampled plant.
        loop: The closed loop, with the start gains.
        scenario: The scenario; its noise is replaced by ``draws``.
        reference: The reference and its jumps.
        members: Parameters in which the members differ, by name, internal units, shape ``(m,)`` each.
        draws: Standard normal numbers of the noise, shape ``(m, n)``.
        offsets: Offsets of each member in the unit box, shape ``(m, p)``.
        lower: Lower bounds of the gains, internal units, shape ``(p,)``.
        upper: Upper bounds of the gains, internal units, shape ``(p,)``.
        names: Names of the ``p`` free gains.
    """

    system: AbstractSampledSystem
    loop: ClosedLoop
    scenario: Scenario
    reference: ReferenceSignal
    members: dict[str, jax.Array]
    draws: jax.Array
    offsets: jax.Array
    lower: jax.Array
    upper: jax.Array
    names: tuple[str, ...] = eqx.field(static=True)

    @classmethod
    def of(
        cls,
        system: AbstractSampledSystem,
        loop: ClosedLoop,
        scenario: Scenario,
        bounds: Mapping[str, tuple[float, float]],
        members: Mapping[str, Any] | None = None,
        draws: Any | None = None,
        spread: float = 0.0,
    ) -> "TuningProblem":
        """Build a tuning problem.

        Args:
            system: The sampled plant.
            loop: The closed loop, with the start gains.
            scenario: The scenario.
            bounds: Positive lower and upper bound of each free gain by name, internal units.
            members: Parameters in which the members differ, by name, internal units, shape ``(m,)`` each.
            draws: Noise of the members, shape ``(m, n)`` or ``(1, n)`` for the same noise in all; default: the
                scenario's noise in all.
            spread: Relative spread of the gains that several members evaluate.

        Raises:
            InputError: if periods or numbers of wires differ, if the controller has no such gain, or if its start value
                does not lie between positive bounds.
        """
        check_same_period("plant", system.period, "controller", loop.period)
        loop = loop.for_wires(system.wires)
        for name, (low, high) in bounds.items():
            value = float(gain(loop, name))
            if not 0.0 < low <= value <= high:
                raise InputError(
                    f"{name} starts at {value:.6g} and is to be tuned between {low:.6g} and {high:.6g}: the bounds "
                    "have to be positive and contain the start value"
                )
        lower, upper = (jnp.asarray([b[k] for b in bounds.values()], jnp.float64) for k in (0, 1))
        values = {k: jnp.asarray(v) for k, v in (members or {}).items()}
        noise = scenario.draws[None] if draws is None else jnp.asarray(draws)
        count = next((len(v) for v in values.values()), len(noise))
        noise = jnp.broadcast_to(noise, (count, scenario.reference.shape[0]))
        width = np.log(np.where(upper > lower, upper / lower, math.inf))
        even = np.full((1, len(bounds)), 0.5)
        if len(noise) > 1:
            even = scipy.stats.qmc.Halton(len(bounds), rng=0).random(len(noise))
        offsets = jnp.asarray(math.log1p(spread) / width * (2.0 * even - 1.0))
        reference = _reference_signal(system, loop, scenario)
        return cls(system, loop, scenario, reference, values, noise, offsets, lower, upper, names=tuple(bounds))

    @property
    def count(self) -> int:
        """Number of members, which is the number of rollouts of one evaluation."""
        return self.draws.shape[0]

    def single_member(self, member: int = 0) -> "TuningProblem":
        """Return the problem of one member without offsets."""
        single = self._select(slice(member, member + 1))
        return dataclasses.replace(single, offsets=0.0 * single.offsets)

    def first_members(self, count: int) -> "TuningProblem":
        """Return the problem with the first ``count`` members."""
        return self._select(slice(count))

    def _select(self, rows: slice) -> "TuningProblem":
        members = {name: values[rows] for name, values in self.members.items()}
        return dataclasses.replace(self, members=members, draws=self.draws[rows], offsets=self.offsets[rows])

    @property
    def jumps(self) -> Jumps:
        """Jumps of the reference."""
        initial = float(self.scenario.initial_reference)
        return find_jumps(np.asarray(self.scenario.reference), initial, self.reference.period)

    @property
    def start(self) -> Float[np.ndarray, " gains"]:
        """The loop's own gains as a point of the unit box, shape ``(p,)``."""
        values = np.array([float(gain(self.loop, name)) for name in self.names])
        low, high = np.asarray(self.lower), np.asarray(self.upper)
        return np.log(values / low) / np.where(high > low, np.log(high / low), 1.0)

    def gains(self, point: Any) -> dict[str, jax.Array]:
        """Return the gains at a point of the unit box.

        Args:
            point: A point, shape ``(p,)``, or several, shape ``(p, k)``; a NumPy or JAX array.

        Returns:
            Gains by name, internal units, scalars or of shape ``(k,)``.
        """
        values = jnp.asarray(point)
        return {name: self.lower[i] * (self.upper[i] / self.lower[i]) ** values[i] for i, name in enumerate(self.names)}

    def loop_with(self, gains: Mapping[str, Any]) -> ClosedLoop:
        """Return the loop with other gains, by name in internal units."""
        return with_gains(self.loop, gains)

    def simulate(self, gains: Mapping[str, Any]) -> Rollout:
        """Simulate all members with other gains, without offsets.

        Args:
            gains: Gains by name, internal units, scalars.

        Returns:
            Rollouts whose leaves have a leading axis of ``m``.
        """
        return self._simulate({name: jnp.broadcast_to(value, self.count) for name, value in gains.items()})

    def _simulate(self, gains: dict[str, jax.Array]) -> Rollout:
        """The rollouts of all members, each with its own gains, shape ``(m,)`` each."""
        return rollout_members(self.system, self.loop, self.scenario, self.members, self.draws, gains)

    def objective_terms(self, point: Float[Array, " gains"], objective: Objective) -> ObjectiveTerms:
        """Compute terms and violations of all members, each with its offsets.

        Args:
            point: A point of the unit box, shape ``(p,)``.
            objective: Weights and limits.

        Returns:
            Terms, shape ``(m, 5, n)``, and violations, shape ``(m, 5, n)``.
        """
        rollouts = self._simulate(self.gains((point[None] + self.offsets).T))
        rollouts = dataclasses.replace(rollouts, final_states=None)
        return jax.vmap(lambda rollout: evaluate_objective(rollout, self.reference, objective))(rollouts)


def _reference_signal(system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario) -> ReferenceSignal:
    period = loop.period
    reference, initial = np.asarray(scenario.reference), float(scenario.initial_reference)
    jumps = find_jumps(reference, initial, period)
    values = np.append(reference, initial)
    span = float(np.max(values) - np.min(values)) or abs(initial) or 1.0
    return ReferenceSignal(
        *map(jnp.asarray, (reference, jumps.since_jump, jumps.jump_size, span)),
        channel=loop.channel,
        period=period,
        wires=system.wires,
    )


def noise_draws(
    loop: ClosedLoop, scenario: Scenario, count: int = NOISE_DRAWS, seed: int = 0
) -> Float[Array, "draws samples"]:
    """Return draws of the sensors' noise; the first is the scenario's own.

    Args:
        loop: The closed loop, which says whether any of its sensors has noise.
        scenario: The scenario.
        count: Number of draws.
        seed: Seed of the other draws.

    Returns:
        Standard normal numbers, shape ``(count, n)``, or ``(1, n)`` if no sensor has noise.
    """
    count = count if has_noise(loop) else 1
    others = np.random.default_rng([seed, _NOISE_STREAM]).standard_normal((count - 1, scenario.draws.shape[0]))
    return jnp.concatenate([scenario.draws[None], jnp.asarray(others)])


def has_noise(loop: ClosedLoop) -> bool:
    """Return whether any sensor of a loop has noise."""
    used = loop.temperature_limiter is not None or loop.estimator is not None
    sensors = loop.instruments.sensors.values() if loop.instruments is not None and used else ()
    return any(float(sensor.noise) > 0.0 for sensor in (loop.sensor, *sensors))


@stored
def evaluate_points(
    problem: TuningProblem, points: Float[Array, "points gains"], objective: Objective
) -> tuple[Float[Array, "points terms"], Float[Array, "points limits"]]:
    """Evaluate terms and limits at several points.

    Args:
        problem: The tuning problem.
        points: Points of the unit box, shape ``(k, p)``.
        objective: Weights and limits.

    Returns:
        Terms (sums of squares over the samples, mean over the members), shape ``(k, 5)``, and the largest violation of
        each limit over samples and members, shape ``(k, 5)``.
    """

    def evaluate(point: jax.Array) -> tuple[jax.Array, jax.Array]:
        evaluated = problem.objective_terms(point, objective)
        terms = jnp.mean(jnp.sum(evaluated.terms**2, axis=2), axis=0)
        return terms, jnp.max(evaluated.violations, axis=(0, 2))

    return jax.vmap(evaluate)(points)


def simulate_gains(problem: TuningProblem, gains: Mapping[str, Any]) -> Rollout:
    """Simulate all members with other gains; compiled once for all gains.

    Args:
        problem: The tuning problem.
        gains: Gains by name, internal units, scalars.

    Returns:
        Rollouts whose leaves have a leading axis of ``m``.
    """
    return _simulate_gains(problem, {name: jnp.asarray(value, jnp.float64) for name, value in gains.items()})


@stored
def _simulate_gains(problem: TuningProblem, gains: dict[str, jax.Array]) -> Rollout:
    return problem.simulate(gains)
