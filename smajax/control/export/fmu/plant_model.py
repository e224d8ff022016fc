"""A plant as the model of an FMU.

Its inputs are the command of each wire and prescribed signals, held over a communication step, which the FMU divides
into shorter steps; its outputs are the channels; its parameters are those of the rig, except those of the sensors.
Units are SI and degC.
"""

import math
from typing import Any

import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.channels import numbered
from smajax.control.export.fmu.model import Model, Variable, channel_definition, channel_kind, equations_text
from smajax.plant.plant import Plant
from smajax.simulation.step_size import default_step

_ELECTRICAL = ("current", "voltage", "power")
# s. Longest step of a plant without a time constant, whose temperature is prescribed: any finite one is exact there.
_LONGEST_STEP = 1.0


def plant_model(plant: Plant, name: str, step: float | None = None) -> Model:
    """Return the model of a plant.

    Args:
        plant: The plant.
        name: Name of the model.
        step: Longest step in s; default: ``smajax.simulation.step_size.default_step``.

    Raises:
        InputError: if an effect of the plant cannot be written with NumPy.
    """
    declared = parameters.all_declarations(plant)
    values = {
        n: float(parameters.get(plant, n)) for n in declared if n not in parameters.TIES and not n.startswith("sensor.")
    }
    values = {n: v for n, v in values.items() if not math.isnan(v)}

    def with_values(numbers: Any) -> Plant:
        return parameters.replace(plant, dict(zip(values, numbers, strict=True)))

    def start(parameters: Any, inputs: Any) -> Any:
        return with_values(parameters).init(_signal(inputs))

    def advance(parameters: Any, state: Any, inputs: Any, step: jax.Array) -> Any:
        return with_values(parameters).solve_step(state, _signal(inputs), _signal(inputs), step)

    def outputs(parameters: Any, state: Any, inputs: Any) -> Any:
        channels = with_values(parameters).observe(state, _signal(inputs))
        return [channels[n] for n in plant.observable]

    equations = equations_text(start, advance, outputs, len(values), len(plant.signals))
    timing = {"longest": step or min(default_step(plant), _LONGEST_STEP)}
    return Model(name, "plant", f"the plant {name}", tuple(_variables(plant, values)), equations, timing)


def _variables(plant: Plant, values: dict[str, float]) -> list[Variable]:
    """Inputs, outputs and parameters, in this order."""
    variables = [_input(plant, i) for i in range(len(plant.signals))]
    for name in plant.observable:
        channel = channel_definition(name)
        direct = _is_direct(plant, name)
        variables.append(Variable(name, "output", "continuous", channel.unit, channel.description, direct=direct))
    for name, declared in parameters.all_declarations(plant).items():
        if name in values:
            variability = "fixed" if name.startswith("initial.") else "tunable"
            ends = declared.lower, declared.upper
            variables.append(
                Variable(name, "parameter", variability, declared.unit, declared.meaning, values[name], *ends)
            )
    return variables


def _input(plant: Plant, index: int) -> Variable:
    """The input of a signal: a command, or a prescribed channel."""
    name, wires = plant.signals[index], plant.mechanism.wires
    channel = channel_definition(name)
    if plant.drive.control and index < wires:
        command = numbered("command", wires)[index]
        return Variable(command, "input", "continuous", channel.unit, f"commanded {channel.description}", 0.0)
    rest = float(plant.environment.ambient) if channel_kind(name) == "temperature" else 0.0
    return Variable(f"prescribed.{name}", "input", "continuous", channel.unit, channel.description, rest)


def _is_direct(plant: Plant, name: str) -> bool:
    """Whether an output depends on the inputs at the same instant."""
    return channel_kind(name) in _ELECTRICAL or bool(plant.mechanism.prescribed) or not plant.drive.control


def _signal(inputs: Any) -> jax.Array:
    return jnp.stack(inputs) if inputs else jnp.zeros(0)
