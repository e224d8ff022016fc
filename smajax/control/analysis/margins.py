"""Stability margins of a loop: gain and phase margin and largest sensitivity of its linearisation along a rollout.

The loop is cut at the controller's output. At a sample of a rollout, plant and controller are linearised about their
states, and their frequency responses are multiplied: L = -K P. The largest sensitivity is the maximum of |1 / (1 + L)|.

The dynamics of a shape-memory wire differ between heating and cooling, so margins are computed at many samples, and
their medians are reported. Where the wire does not transform, its thermal expansion moves the channel in the opposite
direction; such samples have no margin and are left out, since the loop does not stay there. Frequencies far below the
crossover are left out as well: the states change within such a period. An estimate that the controller uses is assumed
to be exact; the effect of its filter on the loop appears in rollouts only.
"""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Float

from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.rollout import Scenario, rollout_with_solutions
from smajax.control.sampled_plant import AbstractSampledSystem
from smajax.numerics.jax_setup import EMITTER_OPTIONS
from smajax.numerics.stored_programs import stored

# Number of frequencies, evenly spaced on a logarithmic axis from a tenth of a cycle over the whole rollout to the
# Nyquist frequency, and the lowest one times the rollout's duration over pi. Chosen by trial;
# tests/unit/control/test_control.py compares margins with exact ones.
_FREQUENCIES = 400
_LOWEST_FREQUENCY = 0.2
# Number of samples of the rig's own rollout, and of the rollout of one draw, at which the loop is linearised: medians
# change little with more.
_SAMPLES = 300
_SAMPLES_OF_DRAW = 60
# Point of the z plane at which a response consists of its first sample only: z^-1 is negligible there.
_FAR = 1e6
# Frequencies below the crossover frequency by more than this factor are left out; chosen by trial.
_BELOW_CROSSOVER = 5.0


class Margins(NamedTuple):
    """Stability margins of a loop; for a nonlinear plant, medians over the samples of a rollout.

    Attributes:
        gain: Gain margin, a factor; infinite without a phase crossover.
        phase: Phase margin in degrees; infinite without a gain crossover.
        sensitivity: Largest sensitivity, dimensionless.
    """

    gain: float
    phase: float
    sensitivity: float

    @property
    def unstable(self) -> bool:
        """Whether the linearised loop is unstable; the limits of the command may bound its oscillation."""
        return self.gain < 1.0 or self.phase < 0.0


class MarginSpread(NamedTuple):
    """Margins over the operating points of a rollout.

    Attributes:
        median: Medians.
        low: The 5 % quantile of gain and phase margin, and the 95 % quantile of the largest sensitivity.
    """

    median: Margins
    low: Margins


# Margins of a loop whose command never changes.
_OPEN_LOOP = Margins(math.inf, math.inf, 0.0)
# Usual margins of a loop: astrom1995 gives the ranges 2 to 5 for the gain margin, 30 to 60 degrees for the phase margin
# and 1.2 to 2 for the largest sensitivity.
USUAL_MARGINS = Margins(2.0, 45.0, 1.8)
# Quantile of the operating points that counts as low.
_LOW = 0.05


def has_usual_margins(margins: Margins) -> bool:
    """Return whether margins are at least as good as ``USUAL_MARGINS``."""
    usual = USUAL_MARGINS
    return margins.gain >= usual.gain and margins.phase >= usual.phase and margins.sensitivity <= usual.sensitivity


@stored
def _carries(system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario) -> tuple[jax.Array, jax.Array]:
    """States before each sample of a rollout, flattened, and commands."""
    result, (carries, _) = rollout_with_solutions(system, loop, scenario)
    return carries, result.command


@stored
def _loop_gain(
    system: AbstractSampledSystem, loop: ClosedLoop, carry: Any, reference: jax.Array, draw: jax.Array, z: jax.Array
) -> jax.Array:
    """L(z) at a sample, linearised; complex, of the shape of ``z``."""
    state, loop_state, last_commands = carry
    channels = system.observe(state, last_commands)
    controller_state, measurement_states, limiters, _ = loop_state
    value, temperatures, _ = loop.measure(measurement_states, channels, draw)
    controller, _, _ = loop.apply_temperature_limits(limiters, temperatures)
    flat, unflatten = ravel_pytree(controller_state)

    def step(flat: jax.Array, value: jax.Array) -> tuple[jax.Array, jax.Array]:
        later, command = controller.step(unflatten(flat), reference, value)
        return ravel_pytree(later)[0].astype(flat.dtype), command

    (a, c), (b, d) = (jax.jacfwd(step, argnums=i)(flat, value) for i in (0, 1))
    command = controller.step(controller_state, reference, value)[1]
    commands, direction = loop.allocate(command), jax.jacfwd(loop.allocate)(command)
    plant = system.frequency_response(state, commands, direction, loop.channel, z)

    def controller_response(z: jax.Array) -> jax.Array:
        return c @ jnp.linalg.solve(z * jnp.eye(len(flat)) - a, b.astype(z.dtype)) + d

    delay = 0 if loop.use_estimate else -loop.sensor.delay
    return -jax.vmap(controller_response)(z) * plant * z**delay


def stability_margins(
    system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario, *, samples: int = _SAMPLES
) -> Margins:
    """Compute the stability margins of a loop; for a nonlinear plant, medians.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: Scenario of the rollout along which a nonlinear plant is linearised.
        samples: Number of samples of the rollout, evenly spread over those at which the command changes.
    """
    return margin_spread(system, loop, scenario, samples=samples).median


def margin_spread(
    system: AbstractSampledSystem, loop: ClosedLoop, scenario: Scenario, *, samples: int = _SAMPLES
) -> MarginSpread:
    """Compute medians and low quantiles of the stability margins over the operating points of a rollout.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: Scenario of the rollout along which a nonlinear plant is linearised.
        samples: Number of samples of the rollout, evenly spread over those at which the command changes.
    """
    period = loop.period
    count = scenario.reference.shape[0]
    lowest = _LOWEST_FREQUENCY * math.pi / (count * period)
    frequencies = np.geomspace(lowest, math.pi / period, _FREQUENCIES)
    z = jnp.append(jnp.exp(1j * frequencies * period), _FAR)
    start, idle = system.start(), jnp.zeros(system.wires)
    first = (start, loop.reset(scenario.initial_reference, system.observe(start, idle)), idle)
    if not system.is_implicit:  # linear: the response is the same at every state
        gains = np.asarray(_loop_gain(system, loop, first, scenario.initial_reference, jnp.zeros(()), z))[None]
    else:
        carries, command = _carries(system, loop, scenario)
        moving = np.flatnonzero(np.any(np.abs(np.diff(np.asarray(command), axis=0)) > 0.0, axis=1)) + 1
        if not len(moving):
            return MarginSpread(_OPEN_LOOP, _OPEN_LOOP)
        rows = moving[np.linspace(0, len(moving) - 1, samples).astype(int)]
        gains = np.asarray(
            _loop_gains(system, loop, carries[rows], scenario.reference[rows], scenario.draws[rows], z, first)
        )
        # A first sample of the response that is not positive: the channel moves in the opposite direction.
        gains = gains[(np.real(gains[:, -1]) > 0.0) & np.all(np.isfinite(gains), axis=1)]
    return _spread_of_margins(gains[:, :-1], frequencies)


def margins_of_draws(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    scenario: Scenario,
    draws: Mapping[str, Float[np.ndarray, " draws"]],
) -> list[Margins]:
    """Compute the margins of a loop around each of several plants, at a part of the samples of each rollout.

    Args:
        system: The sampled plant.
        loop: The closed loop.
        scenario: Scenario of the rollouts.
        draws: Parameters in which the plants differ, by name, internal units, shape ``(count,)`` each.

    Returns:
        The margins of each draw.
    """
    count = len(next(iter(draws.values())))
    systems = (
        system.with_parameters({name: jnp.asarray(values[k], jnp.float64) for name, values in draws.items()})
        for k in range(count)
    )
    return [stability_margins(draw, loop, scenario, samples=_SAMPLES_OF_DRAW) for draw in systems]


def worst_margins(margins: Sequence[Margins]) -> Margins:
    """Return the smallest gain margin, the smallest phase margin and the largest sensitivity, each by itself."""
    gain, phase, sensitivity = zip(*margins, strict=True)
    return Margins(min(gain), min(phase), max(sensitivity))


@functools.partial(stored, compiler_options=EMITTER_OPTIONS)
def _loop_gains(
    system: AbstractSampledSystem,
    loop: ClosedLoop,
    carries: Any,
    references: Any,
    draws: Any,
    z: jax.Array,
    structure: Any,
) -> jax.Array:
    """L(z) at several samples, one row each; ``structure`` is a carry that is not flattened."""
    unflatten = ravel_pytree(structure)[1]
    return jax.lax.map(
        lambda row: _loop_gain(system, loop, unflatten(row[0]), row[1], row[2], z), (carries, references, draws)
    )


def _spread_of_margins(gains: np.ndarray, frequencies: np.ndarray) -> MarginSpread:
    """Medians and low quantiles of the margins over the rows of ``gains``, which are L at ``frequencies``."""
    rows = [_margins_of_response(gain, frequencies) for gain in gains]
    if not rows:
        return MarginSpread(_OPEN_LOOP, _OPEN_LOOP)
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    low = (np.quantile(v, q, method="inverted_cdf") for v, q in zip(columns, (_LOW, _LOW, 1.0 - _LOW), strict=True))
    return MarginSpread(Margins(*(float(np.median(v)) for v in columns)), Margins(*map(float, low)))


def _margins_of_response(gain: np.ndarray, frequencies: np.ndarray) -> Margins:
    """Margins of one response: phase at the last gain crossover, smallest gain margin of all phase crossovers."""
    size, angle = np.abs(gain), np.mod(np.angle(gain), -2.0 * math.pi)  # from -360 to 0 degrees
    crossings = np.flatnonzero((size[:-1] > 1.0) & (size[1:] <= 1.0))
    crossover = frequencies[crossings[-1]] if len(crossings) else frequencies[0]
    near = frequencies >= crossover / _BELOW_CROSSOVER
    gain_margin, phase = math.inf, math.inf
    for k in crossings[-1:]:
        phase = math.degrees(angle[k + 1] + math.pi)
    # A step of the angle by more than 180 degrees is the jump from -360 to 0 degrees, not a crossover.
    steps_down = (angle[:-1] > -math.pi) & (angle[1:] <= -math.pi) & (angle[:-1] - angle[1:] < math.pi)
    for k in np.flatnonzero(steps_down & near[1:]):
        part = (angle[k] + math.pi) / (angle[k] - angle[k + 1])
        log_gain = -math.log(size[k]) - part * (math.log(size[k + 1]) - math.log(size[k]))
        gain_margin = min(gain_margin, math.exp(log_gain))
    return Margins(gain_margin, phase, float(np.max(1.0 / np.abs(1.0 + gain[near]))))
