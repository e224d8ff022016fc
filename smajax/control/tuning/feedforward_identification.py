"""Identification of a feedforward: a Prandtl-Ishlinskii operator is fitted to one slow cycle and inverted.

The command rises and falls so slowly that the wire is close to its thermal equilibrium; the operator is fitted to the
second such cycle. The cycle covers the range of commands in which it has hysteresis, below the limit on temperature.
The misfit is the RMSE of the operator; it is large for the steep cycle of a dead weight.

Source: krejci2001, for the operator and its inverse.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from smajax.channels import CHANNELS, numbered
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.controllers.ppid import PPID
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.sampled_plant import SampledPlant
from smajax.errors import InputError
from smajax.fitting.io_models.fit import fit_io_model
from smajax.fitting.io_models.problem import Series
from smajax.fitting.io_models.specs import prandtl_ishlinskii_spec
from smajax.laws.prandtl_ishlinskii import PrandtlIshlinskii
from smajax.laws.prandtl_ishlinskii_inverse import InversePrandtlIshlinskii, inverse_operator
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.simulation.step_size import wire_time_constant

# Number of samples of a cycle, one per time constant of the wire: 200 time constants for each branch. Chosen by
# experiments/control/feedforward.py.
_SAMPLES = 400
# Distance between the branches of a cycle, as a share of the stroke, above which it counts as hysteresis. Chosen by
# experiments/control/feedforward.py.
_MIN_DISTANCE = 0.02
# Smallest number of samples with hysteresis, and of samples below the limit on temperature.
_MIN_ROWS = 3
# Correlation of command and channel above which the channel rises with the command; chosen by trial.
_MIN_CORRELATION = 0.1
# Temperature in K by which a simulated cycle may exceed the limit: its command range comes from a coarser cycle.
_TEMPERATURE_TOLERANCE = 1.0
# Number of starts of the fit of the operator.
_FIT_STARTS = 4


class Feedforward(NamedTuple):
    """Settings of a feedforward.

    Attributes:
        operators: Number of play operators.
        command_range: Smallest and largest command of the simulated cycle, internal unit; ``None`` for the range in
            which it has hysteresis.
        measured: A measured cycle that is used instead of a simulated one.
        notes: Sentences on its recording.
    """

    operators: int
    command_range: tuple[float, float] | None = None
    measured: Series | None = None
    notes: tuple[str, ...] = ()


class IdentifiedFeedforward(NamedTuple):
    """Inverse operator, and the quality of the operator's fit to its cycle.

    Attributes:
        inverse: The inverse operator.
        misfit: RMSE of the operator, internal unit of the channel.
        stroke: Largest minus smallest value of the channel in the cycle, internal unit.
        command_range: Smallest and largest command of the cycle, internal unit.
        seconds: Duration of the cycle, s.
    """

    inverse: InversePrandtlIshlinskii
    misfit: float
    stroke: float
    command_range: tuple[float, float]
    seconds: float


def identify_feedforward(
    system: SampledPlant, loop: ClosedLoop, settings: Feedforward, max_temperature: float = math.inf
) -> IdentifiedFeedforward:
    """Fit a Prandtl-Ishlinskii operator to a slow cycle and invert it.

    Args:
        system: The sampled plant.
        loop: The closed loop, for its channel and the limits of its command.
        settings: Number of play operators, and the cycle.
        max_temperature: Limit of the wires' temperature in a simulated cycle, degC.

    Raises:
        InputError: if the channel does not rise with the command, or the wires overheat.
    """
    series = settings.measured or _simulated_cycle(system, loop, settings.command_range, max_temperature)
    stroke = float(np.ptp(series.output))
    correlation = np.corrcoef(series.input, series.output)[0, 1] if stroke > 0.0 else 0.0
    if not correlation > _MIN_CORRELATION:
        raise InputError(
            f"feedforward: the {loop.channel} does not rise with the command in a slow loop: leave [feedforward] out"
        )
    fitted = fit_io_model(
        prandtl_ishlinskii_spec([series], settings.operators, envelopes=1), [series], starts=_FIT_STARTS
    )
    assert isinstance(fitted.model, PrandtlIshlinskii)
    inverse = inverse_operator(fitted.model)
    assert isinstance(inverse, InversePrandtlIshlinskii)  # since the operator has one envelope
    command_range = (float(series.input.min()), float(series.input.max()))
    return IdentifiedFeedforward(inverse, fitted.rmse, stroke, command_range, float(np.ptp(series.time)))


def with_inverse(controller: AbstractController, inverse: InversePrandtlIshlinskii) -> AbstractController:
    """Return the controller with a feedforward.

    Args:
        controller: A PID or PPID.
        inverse: The inverse operator, from the channel to the command.

    Raises:
        InputError: for another kind of controller.
    """
    if isinstance(controller, PPID):
        return PPID(controller.pid, controller.kp_rest, controller.band, controller.exit_factor, inverse)
    if isinstance(controller, PID):
        return FeedforwardPID(controller, inverse)
    raise InputError(f"feedforward: a {type(controller).__name__} cannot have one: make the kind pid or ppid")


def _simulated_cycle(
    system: SampledPlant, loop: ClosedLoop, command_range: tuple[float, float] | None, max_temperature: float
) -> Series:
    """The second of two slow cycles of the command, simulated."""
    slow = SampledPlant.of(system.plant, wire_time_constant(system.plant))
    limits = loop.controller.limits
    if command_range is None:
        command, value, temperature = _second_cycle(slow, loop, (float(limits[0]), float(limits[1])))
        command_range = _hysteretic_range(command, value, temperature, max_temperature)
    command, value, temperature = _second_cycle(slow, loop, command_range)
    if not np.all(np.isfinite(value)) or temperature.max() > max_temperature + _TEMPERATURE_TOLERANCE:
        unit = CHANNELS[system.plant.drive.control].unit
        raise InputError(
            f"feedforward: in a slow loop up to {command_range[1]:.4g} {unit} the wire reaches "
            f"{temperature.max():.4g} degC: give a smaller range of commands"
        )
    return Series("slow loop", slow.period * np.arange(len(command)), command, value)


def _second_cycle(
    slow: SampledPlant, loop: ClosedLoop, command_range: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Command, channel and highest temperature along the second of two cycles, shape ``(_SAMPLES + 1,)`` each."""
    share = 1.0 - np.abs(2.0 * ((np.arange(2 * _SAMPLES + 1) / _SAMPLES) % 1.0) - 1.0)
    command = command_range[0] + (command_range[1] - command_range[0]) * share
    value, temperature = _simulate(slow, loop, jnp.asarray(command))
    return command[_SAMPLES:], np.asarray(value)[_SAMPLES:], np.asarray(temperature)[_SAMPLES:]


@jit_with_kernels
def _simulate(slow: SampledPlant, loop: ClosedLoop, command: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Channel and highest temperature under a command, shape ``(n,)`` each."""

    def sample(state: Any, command: jax.Array) -> tuple[Any, tuple[jax.Array, jax.Array]]:
        commands = loop.allocate(command)
        state, _, _ = slow.step(state, commands)
        channels = slow.observe(state, commands)
        temperatures = jnp.stack([channels[n] for n in numbered("temperature", slow.wires)])
        return state, (channels[loop.channel], jnp.max(temperatures))

    return jax.lax.scan(sample, slow.start(), command)[1]


def _hysteretic_range(
    command: np.ndarray, value: np.ndarray, temperature: np.ndarray, max_temperature: float
) -> tuple[float, float]:
    """Smallest and largest command at which a cycle has hysteresis and the wires are below their limit."""
    half = _SAMPLES // 2
    values, temperatures = (np.stack([v[: half + 1], v[: half - 1 : -1]]) for v in (value, temperature))
    cool = np.all((temperatures <= max_temperature) & np.isfinite(values), axis=0)
    if np.sum(cool) < _MIN_ROWS:
        raise InputError(
            "feedforward: in a slow loop the wire overheats at the smallest commands already: raise the limit on "
            "temperature"
        )
    distance = np.abs(values[0] - values[1])
    hysteretic = cool & (distance > _MIN_DISTANCE * np.ptp(values[:, cool]))
    commands = command[: half + 1][hysteretic if np.sum(hysteretic) >= _MIN_ROWS else cool]
    return float(commands[0]), float(commands[-1])
