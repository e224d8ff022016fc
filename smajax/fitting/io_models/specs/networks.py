"""The specs of the NARX network, and of a network for heating with exponentials for cooling, for fits."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.ranges import as_arrays, duration_of, ranges_of, step_of
from smajax.laws.narx import Narx
from smajax.laws.switched import Switched

# Largest absolute value of a weight: far above the weights under any ridge.
_MAX_WEIGHT = 5.0
# The input heats above this share of its range; chosen by trial on the recordings of
# tests/unit/laws/test_input_output_models.py.
_HEATING_SHARE = 0.05


def narx_spec(series: Sequence[Series], hidden: int = 10, order: int = 2) -> ModelSpec:
    """Return the spec of a NARX network, which is fitted in open and then in closed loop, under a ridge.

    Args:
        series: Training recordings.
        hidden: Number of hidden neurons.
        order: Number of past outputs, and of past inputs.

    Returns:
        The spec, with a linear model as the first guess.
    """
    lower, upper, start = map(as_arrays, _network_sides(series, hidden, order))
    return ModelSpec("narx", _make_narx, lower, upper, start, needs_even_rows=True, weight_mask=_weight_mask(start))


def heating_cooling_spec(series: Sequence[Series], hidden: int = 10, order: int = 2) -> ModelSpec:
    """Return the spec of a network for heating and two exponentials for cooling.

    The input heats while it is above a twentieth of its range. The slow time constant exceeds the fast one by the share
    ``beyond`` of the distance to the longest one, the duration of the longest recording.

    Args:
        series: Training recordings.
        hidden: Number of hidden neurons.
        order: Number of past outputs, and of past inputs.

    Returns:
        The spec, with a linear model as the first guess of the network.
    """
    low, span, bottom, swing = ranges_of(series)
    step, duration = step_of(series), duration_of(series)
    network = _network_sides(series, hidden, order)
    constants = {"off": low + _HEATING_SHARE * span, "longest": duration}
    cooling = (
        {"share": 0.0, "fast": step, "beyond": 0.0, "rest": bottom - 0.3 * swing},
        {"share": 1.0, "fast": 0.2 * duration, "beyond": 1.0, "rest": bottom + 0.3 * swing},
        {"share": 0.6, "fast": duration / 100, "beyond": 0.04, "rest": bottom},
    )
    lower, upper, start = (
        as_arrays({"heating": side} | exponentials | constants)
        for side, exponentials in zip(network, cooling, strict=True)
    )
    mask = jax.tree.map(jnp.zeros_like, start) | {"heating": _weight_mask(start["heating"])}
    return ModelSpec("heating-cooling", _make_switched, lower, upper, start, needs_even_rows=True, weight_mask=mask)


def _network_sides(
    series: Sequence[Series], hidden: int, order: int
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Bounds and first guess of a network: a linear model that returns slowly to the resting output."""
    low, span, bottom, swing = ranges_of(series)
    rest = float(np.mean([s.output[np.isfinite(s.output)][0] for s in series]))
    scale = np.array([low + 0.5 * span, 0.5 * span, bottom + 0.5 * swing, 0.5 * swing])
    shapes = {
        "hidden": (hidden, 2 * order),
        "shift": (hidden,),
        "outer": (hidden,),
        "straight": (order,),
        "constant": (),
    }
    constants = {"rest": rest, "scale": scale}
    lower, upper = (
        {k: np.full(shape, end) for k, shape in shapes.items()} | constants for end in (-_MAX_WEIGHT, _MAX_WEIGHT)
    )
    start = {k: np.zeros(shape) for k, shape in shapes.items()} | constants
    # With a first guess that keeps an output for ever, networks diverge under a ridge that pulls their weights to it.
    slow = math.exp(-step_of(series) * 50 / duration_of(series))
    start["straight"] = np.r_[slow + 0.8, -0.8 * slow, np.zeros(order - 2)] if order > 1 else np.array([slow])
    start["constant"] = (1.0 - np.sum(start["straight"])) * (rest - scale[2]) / scale[3]
    return lower, upper, start


def _weight_mask(network: dict[str, Any]) -> dict[str, Any]:
    """1 for a network's weights, 0 for its other parameters."""
    return {k: jnp.full_like(v, k not in ("rest", "scale")) for k, v in network.items()}


def _make_narx(parameters: dict[str, Any]) -> Narx:
    return Narx(**parameters)


def _make_switched(parameters: dict[str, Any]) -> Switched:
    slow = parameters["fast"] + parameters["beyond"] * (parameters["longest"] - parameters["fast"])
    return Switched(
        Narx(**parameters["heating"]), slow=slow, **{k: parameters[k] for k in ("share", "fast", "rest", "off")}
    )
