"""Model of an FMU: its variables with units, and its equations as NumPy text."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from smajax.channels import CHANNELS, Channel, channel_of
from smajax.control.export.fmu.numpy_source import HEADER, numpy_source


class Variable(NamedTuple):
    """Variable of an FMU, as in the FMI standard.

    Attributes:
        name: Name of the variable.
        causality: Whether it is an input, an output or a parameter.
        variability: When its value may change.
        unit: Unit; ``"1"`` for none.
        meaning: Description.
        start: Start value; ``None`` for outputs.
        lower: Smallest value.
        upper: Largest value.
        direct: Whether an output depends on the inputs at the same instant.
    """

    name: str
    causality: Literal["input", "output", "parameter"]
    variability: Literal["continuous", "discrete", "tunable", "fixed"]
    unit: str
    meaning: str
    start: float | None = None
    lower: float = -math.inf
    upper: float = math.inf
    direct: bool = False


class Model(NamedTuple):
    """Content of an FMU.

    Attributes:
        name: Name of the model.
        kind: Whether it is a plant or a controller.
        meaning: Description.
        variables: Variables; the position of a variable is its value reference.
        equations: NumPy text of the functions ``start``, ``advance`` and ``outputs``.
        timing: ``{"longest": ...}``, the longest step of a plant in s, or ``{"period": ...}``, the period of a
            controller in s.
    """

    name: str
    kind: Literal["plant", "controller"]
    meaning: str
    variables: tuple[Variable, ...]
    equations: str
    timing: Mapping[str, float]


def equations_text(
    start: Callable[..., Any],
    advance: Callable[..., Any],
    outputs: Callable[..., Any],
    parameter_count: int,
    input_count: int,
) -> str:
    """Return the NumPy text of a model's equations.

    Args:
        start: Function of parameters and inputs that returns the state.
        advance: Function of parameters, state, inputs and duration in s that returns the state after a step, and
            whether the step failed.
        outputs: Function of parameters, state and inputs that returns the outputs.
        parameter_count: Number of parameters.
        input_count: Number of inputs.

    Raises:
        InputError: for an operation that has no NumPy text.
    """
    number = jax.ShapeDtypeStruct((), jnp.float64)
    parameters: dict[str, Any] = {"parameters": [number] * parameter_count}
    inputs: dict[str, Any] = {"inputs": [number] * input_count}
    state = {"state": jax.eval_shape(start, parameters["parameters"], inputs["inputs"])}
    parts = (
        numpy_source("start", start, parameters | inputs),
        numpy_source("advance", advance, parameters | state | inputs | {"step": number}),
        numpy_source("outputs", outputs, parameters | state | inputs),
    )
    return "\n\n".join((HEADER, *parts))


def channel_kind(name: str) -> str:
    """Return the kind of a channel: its name without the number of the wire."""
    return channel_of(name) or name


def channel_definition(name: str) -> Channel:
    """Return unit and description of a channel."""
    return CHANNELS[channel_kind(name)]
