"""The specs of transfer functions with delay for fits."""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.ranges import (
    Ranges,
    as_arrays,
    begins_on,
    duration_of,
    output_at_zero,
    ranges_of,
    step_of,
)
from smajax.laws.transfer_function import STRUCTURES, Structure, TransferFunction

_NAMES = ("gain", "rest", "first", "second", "damping", "delay", "settled")
_UNUSED: Mapping[Structure, tuple[str, ...]] = {
    "one-pole": ("second", "damping"),
    "two-poles": ("damping",),
    "underdamped": ("second",),
    "underdamped-and-pole": (),
}
# Largest damping: the two poles of such a pair differ by a factor of about 1600, so that only the slow one matters.
_MAX_DAMPING = 20.0
# A time constant this share of a step has no effect from row to row, so that a structure contains those with fewer
# poles.
_PROMPT_SHARE = 1e-3


def transfer_function_spec(series: Sequence[Series], structure: Structure = "underdamped-and-pole") -> ModelSpec:
    """Return the spec of one of the four structures, with a delay of at most half the recording.

    Each structure contains those before it, and a search also starts at their fits. ``settled`` is free only where a
    recording begins with the input on and changes it later: if the input begins off it has no effect, and if the input
    is constant it cannot be distinguished from gain and rest.

    Args:
        series: Training recordings.
        structure: The structure, one of ``STRUCTURES``.

    Returns:
        The spec, with the structure before this one as the nested one.
    """
    ranges, constant = _input_ranges(series)
    step, duration = step_of(series), duration_of(series)
    lower, upper, start = _sides(series, ranges, constant, structure)
    origin = ranges._replace(low=0.0) if constant else ranges
    directions = (1.0, start["rest"]), (-1.0, output_at_zero(origin, -1.0)[2])
    extra_starts = [
        start | {"gain": sign * start["gain"], "rest": rest, "delay": delay, "first": slow} | second
        for delay in np.linspace(0.0, 0.45, 10) * duration
        for slow in (duration / 50, duration / 12)
        for second in ([{"second": slow / 2}, {"second": step}] if "second" in start else [{}])
        for sign, rest in directions
    ]
    simpler = STRUCTURES.index(structure) - 1

    def embed(parameters: dict[str, Any]) -> dict[str, Any]:
        return start | _with_more_poles(parameters, structure, _PROMPT_SHARE * step)

    nested = ((transfer_function_spec(series, STRUCTURES[simpler]), embed),) if simpler >= 0 else ()
    return ModelSpec(
        f"transfer-function-{structure}",
        _makers[structure],
        *map(as_arrays, (lower, upper, start)),
        needs_even_rows=True,
        extra_starts=tuple(map(as_arrays, extra_starts)),
        nested=nested,
    )


def _input_ranges(series: Sequence[Series]) -> tuple[Ranges, bool]:
    """The ranges, and whether the input is constant: then its range is its distance from 0."""
    ranges = ranges_of(series)
    constant = all(np.ptp(s.input) == 0.0 for s in series)
    if constant and ranges.low != 0.0:
        ranges = ranges._replace(span=abs(ranges.low))
    return ranges, constant


def _sides(
    series: Sequence[Series], ranges: Ranges, constant: bool, structure: Structure
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Lower and upper bounds and the first guess."""
    _, span, _, swing = ranges
    step, duration = step_of(series), duration_of(series)
    settled = 1.0 if not constant and begins_on(series, span) else 0.0
    nearest = min(float(np.min(np.abs(s.input))) for s in series)
    # If the input varies about a bias, it may have been further from 0 before the recording.
    settled *= 1.0 + (span / nearest if nearest > 0.5 * span else 0.0)
    prompt = _PROMPT_SHARE * step
    least, most, rest = output_at_zero(ranges._replace(low=0.0) if constant else ranges, 1.0)
    lower = (-20 * swing / span, least, prompt, prompt, 0.05, 0.0, 0.0)
    upper = (20 * swing / span, most, duration, duration, _MAX_DAMPING, duration / 2, settled)
    start = (swing / span, rest, duration / 50, duration / 100, 0.9, step, 0.0)
    used = [
        {k: v for k, v in zip(_NAMES, side, strict=True) if k not in _UNUSED[structure]}
        for side in (lower, upper, start)
    ]
    return used[0], used[1], used[2]


def _with_more_poles(parameters: dict[str, Any], structure: Structure, prompt: float) -> dict[str, Any]:
    """The parameters of a ``structure`` with the output of the one before it: two poles as a pair, or one fast pole."""
    if structure != "underdamped":
        return parameters | {"second": prompt}
    slow, fast = (float(f(parameters["first"], parameters["second"])) for f in (jnp.maximum, jnp.minimum))
    damping = min((slow + fast) / (2.0 * math.sqrt(slow * fast)), _MAX_DAMPING)
    first = slow / (damping + math.sqrt(damping**2 - 1.0))  # of poles too far apart for a pair, the slow one
    return {k: v for k, v in parameters.items() if k != "second"} | {"first": first, "damping": damping}


def _make(parameters: dict[str, Any], structure: Structure) -> TransferFunction:
    return TransferFunction(**parameters, **dict.fromkeys(_UNUSED[structure], jnp.asarray(1.0)), structure=structure)


# One object for each structure, since compiled programs are cached by it.
_makers = {s: functools.partial(_make, structure=s) for s in STRUCTURES}
