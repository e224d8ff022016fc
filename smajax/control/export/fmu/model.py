"""Model of an FMU: its variables with units, and its equations as NumPy text."""

import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp

from smajax.channels import CHANNELS, Channel, channel_of
from smajax.control.export.fmu.numpy_source import HEADER, numpy_source


class Variable(NamedTuple):
    """Variable of an FMU; ``direct`` outputs depend on the inputs at the same instant."""

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

    ``equations`` is the text of the functions ``start``, ``advance`` and ``outputs``. ``timing`` is ``{"longest": s}``
    for a plant, whose steps are at most so long, and ``{"period": s}`` for a controller.
    """

    name: str
    kind: Literal["plant", "controller"]
    meaning: str
    variables: tuple[Variable, ...]
    equations: str
    timing: Mapping[str, float]


def equations_text(
    start: Callable, advance: Callable, outputs: Callable, parameter_count: int, input_count: int
) -> str:
    """Return the NumPy text of a model's equations.

    Args:
        start: State from parameters and inputs.
        advance: State after a step, and whether the step failed, from parameters, state, inputs and duration.
        outputs: Outputs from parameters, state and inputs.
        parameter_count: Number of parameters.
        input_count: Number of inputs.
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
