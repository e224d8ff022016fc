"""A closed loop's controller, allocation and temperature limiter as the model of an FMU.

Its inputs are the reference and the measurement, its outputs the command of each wire, its parameters the gains. Units
are SI and degC. A co-simulation that steps the controller before the plant gives the same results as a rollout.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp

from smajax.channels import numbered
from smajax.control.controllers.base import require_controller
from smajax.control.export.fmu.model import Model, Variable, channel_definition, channel_kind, equations_text
from smajax.control.export.json_document import estimator_document
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.dropouts import ReferenceHold
from smajax.control.loop.gains import gain, gains, with_gains
from smajax.control.sensors.sensor_model import ideal_sensor
from smajax.errors import InputError

# Start value of a temperature input, degC, until the importing tool sets it: room temperature.
_ROOM_TEMPERATURE = 20.0


def controller_model(loop: ClosedLoop, units: tuple[str, str], gain_units: Mapping[str, str], name: str) -> Model:
    """Return the model of a controller with its allocation and its temperature limiter.

    The loop's sensor and instruments belong to the rig and are left out. With a temperature limiter, the model has the
    input ``temperature`` for each wire in addition, and with a thermal observer the input ``power``. A reference that
    is not finite is replaced by the last finite one, and the loop starts when reference and measurement have been
    finite once; dropouts of a channel, a temperature or a power are treated as in ``ClosedLoop``,
    ``TemperatureLimiter`` and ``ThermalObserver``.

    Args:
        loop: The closed loop.
        units: Units of command and channel.
        gain_units: Unit of each gain by name.
        name: Name of the model.

    Raises:
        InputError: for what is no closed loop, for an estimator other than a thermal observer, or an operation that has
            no NumPy text.
    """
    if not isinstance(loop, ClosedLoop):
        require_controller(loop)
        raise InputError("the model of a controller needs its channel: give a ClosedLoop(controller, channel=...)")
    if loop.estimator is not None:
        estimator_document(loop.estimator)
    loop = dataclasses.replace(loop, sensor=ideal_sensor(), instruments=None, allow_dropouts=True)
    extra = _extra_inputs(loop)
    values = {n: float(gain(loop, n)) for n in gains(loop)}

    def with_values(parameters: Any) -> ClosedLoop:
        return with_gains(loop, dict(zip(values, parameters, strict=True)))

    def channels(inputs: Any, held: ReferenceHold) -> dict[str, jax.Array]:
        """Return the channels; the controlled one is NaN until there has been a reference."""
        return {loop.channel: held.measurement(inputs[1])} | dict(zip(extra, inputs[2:], strict=True))

    def start(parameters: Any, inputs: Any) -> Any:
        held = ReferenceHold.init(inputs[0])
        loop_state = with_values(parameters).reset(held.reference, channels(inputs, held))
        return (loop_state, jnp.zeros(loop.wires)), held

    def advance(parameters: Any, state: Any, inputs: Any, step: jax.Array) -> Any:
        (loop_state, _), held = state
        held = held.update(inputs[0])
        loop_state, commands = with_values(parameters).step(
            loop_state, held.reference, channels(inputs, held), jnp.zeros(())
        )
        return ((loop_state, commands), held), jnp.asarray(False)

    def outputs(parameters: Any, state: Any, inputs: Any) -> Any:
        return [state[0][1][i] for i in range(loop.wires)]

    variables = _variables(loop, units, gain_units, extra)
    equations = equations_text(start, advance, outputs, len(values), 2 + len(extra))
    timing = {"period": loop.period}
    return Model(name, "controller", f"a controller of {loop.channel}", tuple(variables), equations, timing)


def _extra_inputs(loop: ClosedLoop) -> list[str]:
    """Names of the channels that temperature limiter and thermal observer measure, without the controlled one."""
    if loop.temperature_limiter is None:
        return []
    kinds = ("temperature",) if loop.estimator is None else ("temperature", "power")
    return [name for kind in kinds for name in numbered(kind, loop.wires) if name != loop.channel]


def _variables(
    loop: ClosedLoop, units: tuple[str, str], gain_units: Mapping[str, str], extra: list[str]
) -> list[Variable]:
    """Inputs, outputs and parameters, in this order."""
    (command_unit, channel_unit), description = units, channel_definition(loop.channel).description
    variables = [
        Variable("reference", "input", "discrete", channel_unit, f"reference of: {description}", 0.0),
        Variable("measurement", "input", "discrete", channel_unit, f"measurement of: {description}", 0.0),
    ]
    for name in extra:
        channel, start = channel_definition(name), _ROOM_TEMPERATURE * (channel_kind(name) == "temperature")
        variables.append(Variable(name, "input", "discrete", channel.unit, channel.description, start))
    for name in numbered("command", loop.wires):
        variables.append(Variable(name, "output", "discrete", command_unit, "command of the wire"))
    for name, declared in gains(loop).items():
        value, ends = float(gain(loop, name)), (declared.lower, declared.upper)
        variables.append(Variable(name, "parameter", "tunable", gain_units[name], declared.meaning, value, *ends))
    return variables
