"""The input-output laws that can be fitted, with bounds that follow from the recordings: see ``smajax.fit.operator_problem``.

The bounds of the hysteresis operators are those under which the flexible-actuator paper's models can be searched at all: sizes relative to
the ranges of input and output.
"""

import functools
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from smajax.blackbox.hammerstein_wiener import HammersteinWiener
from smajax.blackbox.narx import Narx
from smajax.blackbox.switched import Switched
from smajax.blackbox.transfer_function import STRUCTURES, Structure, TransferFunction
from smajax.errors import InputError
from smajax.fit.operator_problem import Family, Series
from smajax.hysteresis.bouc_wen import BoucWen
from smajax.hysteresis.prandtl_ishlinskii import Envelope, PrandtlIshlinskii


def _ranges(series: Sequence[Series]) -> tuple[float, float, float, float]:
    """Lowest input, its range, lowest output, its range."""
    inputs, outputs = np.concatenate([s.input for s in series]), np.concatenate([s.output for s in series])
    return (
        float(inputs.min()),
        float(np.ptp(inputs)) or 1.0,
        float(np.nanmin(outputs)),
        float(np.nanmax(outputs) - np.nanmin(outputs)) or 1.0,
    )


def _way(series: Sequence[Series]) -> float:
    """1 where the output rises with the input, -1 where it falls."""
    values, outputs = np.concatenate([s.input for s in series]), np.concatenate([s.output for s in series])
    seen = np.isfinite(outputs)
    return -1.0 if float(np.cov(values[seen], outputs[seen])[0, 1]) < 0.0 else 1.0


def _step(series: Sequence[Series]) -> float:
    return float(np.median(np.diff(series[0].time)))


def _duration(series: Sequence[Series]) -> float:
    return max(float(s.time[-1] - s.time[0]) for s in series)


def _arrays(tree: Any) -> Any:
    return jax.tree.map(lambda v: jnp.asarray(v, jnp.float64), tree)


def _bouc_wen(parameters: dict) -> BoucWen:
    return BoucWen(**parameters)


def _at_no_input(low: float, span: float, bottom: float, swing: float, way: float) -> tuple[float, float, float]:
    """Bounds and first guess of the output at input 0, where the output goes the ``way`` of the input, which need not come near 0."""
    guess, reach = (bottom if way > 0.0 else bottom + swing) - way * swing * low / span, 5.0 * swing * (1.0 + abs(low) / span)
    return bottom - reach, bottom + reach, guess


def bouc_wen(series: Sequence[Series], *, rest: bool = False) -> Family:
    """The five parameters; with ``rest``, a constant beside them, for sensors that do not read 0 where the input begins."""
    low, span, bottom, swing = _ranges(series)
    way = _way(series)
    lower = {"kx": -10 * swing / span, "kw": -10 * swing, "rho": 0.1 / span, "sigma": 0.5, "n": 1.0}
    upper = {"kx": 10 * swing / span, "kw": 10 * swing, "rho": 100.0 / span, "sigma": 5.0, "n": 6.0}
    start = {"kx": way * 0.5 * swing / span, "kw": way * 0.5 * swing, "rho": 2.0 / span, "sigma": 1.0, "n": 1.5}
    if rest:
        ends = _at_no_input(low, span, bottom, swing, way)
        lower, upper, start = (side | {"rest": end} for side, end in zip((lower, upper, start), ends, strict=True))
    return Family("bouc-wen", _bouc_wen, _arrays(lower), _arrays(upper), _arrays(start))


def _spread(parameters: dict) -> PrandtlIshlinskii:
    densities = parameters["densities"]
    count = densities.shape[0]
    thresholds = jnp.cumsum(parameters["gaps"]) if "gaps" in parameters else parameters["reach"] * jnp.arange(1, count + 1) / count
    unloading = parameters.get("unloading")
    return PrandtlIshlinskii(
        parameters["direct"], thresholds, densities, _envelope(parameters["loading"]), _envelope(unloading) if unloading else None
    )


def _envelope(parameters: dict) -> Envelope:
    """By its ``centre``, which is an input, and so is within bounds that do not depend on where inputs are counted from."""
    return Envelope(parameters["height"], parameters["slope"], -parameters["slope"] * parameters["centre"], parameters["middle"])


_PLAYS = 10
# Other first guesses: slopes times the input's range, centres and distance of the envelopes over it, and a factor on the plays' reach.
_ELSEWHERE = ((2.0, 4.0, 8.0, 16.0), (0.2, 0.35, 0.5, 0.65, 0.8), (0.0, 0.1, 0.25), (0.2, 1.0))


def prandtl_ishlinskii(
    series: Sequence[Series],
    count: int = _PLAYS,
    envelopes: int = 2,
    *,
    thresholds: Sequence[float] | np.ndarray | Literal["even", "free"] = "even",
    densities: Sequence[float] | np.ndarray | Literal["free"] = "free",
) -> Family:
    """``count`` plays, and one tanh envelope or one for each direction; more than ten even ones begin at the fit of half as many, too.

    ``thresholds``, in the output's unit, are fitted as evenly spread ones up to a largest (``"even"``), each for itself (``"free"``), or
    held at rising values, shape ``(count,)``; ``densities`` are fitted or held at values of that shape. While both are fitted, the height
    of the loading envelope is held: envelopes and thresholds so many times larger, with direct part and densities so many times smaller,
    are the same law. The envelopes rise or fall as the output does with the input, by their covariance. Raises ``InputError`` for values
    that no operator has.
    """
    gaps = np.diff(np.asarray(thresholds, float), prepend=0.0) if not isinstance(thresholds, str) else None
    held = np.asarray(densities, float) if not isinstance(densities, str) else None
    if gaps is not None and (gaps.shape != (count,) or not np.all(gaps > 0.0)):
        raise InputError(f"thresholds have to be {count} rising numbers above 0: give as many as plays, or 'even' or 'free'")
    if held is not None and (held.shape != (count,) or not np.all(held >= 0.0)):
        raise InputError(f"densities have to be {count} numbers of at least 0: give as many as plays, or 'free'")
    low, span, bottom, swing = _ranges(series)
    middle, way = low + 0.5 * span, _way(series)

    envelope = {"height": way * 0.5 * swing, "slope": 3.0 / span, "centre": middle, "middle": bottom + 0.5 * swing}
    ends = {
        "height": (0.1 * swing, swing) if way > 0.0 else (-swing, -0.1 * swing),
        "slope": (0.2 / span, 40.0 / span),
        "centre": (low - 0.5 * span, low + 1.5 * span),
        "middle": (bottom - swing, bottom + 2 * swing),
    }
    lower = {"direct": 1e-3, "densities": np.zeros(count), "reach": 0.01 * swing, "loading": {k: v[0] for k, v in ends.items()}}
    upper = {"direct": 4.0, "densities": np.full(count, 2.0), "reach": swing, "loading": {k: v[1] for k, v in ends.items()}}
    start = {"direct": 0.6, "densities": np.full(count, 0.4 / count), "reach": 0.5 * swing, "loading": envelope}
    if envelopes == 2:
        lower, upper, start = (side | {"unloading": side["loading"]} for side in (lower, upper, start))
    if gaps is not None or thresholds == "free":
        least, most = (gaps, gaps) if gaps is not None else (np.full(count, 1e-4 * swing), np.full(count, swing))
        first = gaps if gaps is not None else np.full(count, 0.5 * swing / count)
        lower, upper, start = (
            {k: v for k, v in side.items() if k != "reach"} | {"gaps": g}
            for side, g in zip((lower, upper, start), (least, most, first), strict=True)
        )
    if held is not None:
        lower, upper, start = (side | {"densities": held} for side in (lower, upper, start))
    if gaps is None and held is None:
        lower, upper = (side | {"loading": side["loading"] | {"height": envelope["height"]}} for side in (lower, upper))
    others = []
    # Two envelopes can stand in for each other's plays: from those of another slope in another place a search ends there. One cannot, but
    # thresholds that are all free can stand in for its slope.
    slopes, places, apart, factors = _ELSEWHERE
    ways = (slopes, places, apart if envelopes == 2 else (0.0,), factors if "reach" in start else (1.0,))
    elsewhere = envelopes == 2 or (gaps is None and thresholds == "free")
    for slope, place, gap, factor in itertools.product(*ways) if elsewhere else ():
        other = start | ({"reach": factor * start["reach"]} if "reach" in start else {})
        for name, side in (("loading", 0.5), ("unloading", -0.5))[:envelopes]:
            other |= {name: envelope | {"slope": slope / span, "centre": low + (place + side * gap) * span}}
        others.append(_arrays(other))
    name = f"prandtl-ishlinskii-{count}" if count != _PLAYS else "prandtl-ishlinskii"
    held_plays = ()
    if "reach" in start and held is None and count > _PLAYS and count % 2 == 0:
        held_plays = ((prandtl_ishlinskii(series, count // 2, envelopes), _twice_as_many),)
    return Family(name, _spread, *map(_arrays, (lower, upper, start)), kinked=True, others=tuple(others), holds=held_plays)


def _twice_as_many(fewer: dict) -> dict:
    """The parameters of twice as many plays that do the same: those at the thresholds between have no density."""
    return fewer | {"densities": jnp.stack([jnp.zeros_like(fewer["densities"]), fewer["densities"]], axis=1).ravel()}


def transfer_function(series: Sequence[Series], structure: Structure = "underdamped-and-pole") -> Family:
    """One of the four structures, with a delay of at most half the recording; each holds those before it, and begins at their fits, too.

    ``settled`` is free only where a recording begins with the input on and changes it later: without the first it makes no difference,
    without the second it cannot be told from gain and rest.
    """
    low, span, bottom, swing = _ranges(series)
    constant = all(np.ptp(s.input) == 0.0 for s in series)
    if constant and low != 0.0:
        span = abs(low)
    step, duration = _step(series), _duration(series)
    names = ("gain", "rest", "first", "second", "damping", "delay", "settled")
    on = 1.0 if not constant and any(abs(s.input[0]) > 1e-9 * span for s in series) else 0.0
    nearest = min(float(np.min(np.abs(s.input))) for s in series)
    on *= 1.0 + (span / nearest if nearest > 0.5 * span else 0.0)  # about a bias, what came before may have been further from 0
    prompt = 1e-3 * step  # from one row to the next such a lag is none, so that a structure holds those with fewer poles
    least, most, rising = _at_no_input(0.0 if constant else low, span, bottom, swing, 1.0)
    ways = (1.0, rising), (-1.0, _at_no_input(0.0 if constant else low, span, bottom, swing, -1.0)[2])
    lower = (-20 * swing / span, least, prompt, prompt, 0.05, 0.0, 0.0)
    upper = (20 * swing / span, most, duration, duration, _DAMPED, duration / 2, on)
    start = (swing / span, rising, duration / 50, duration / 100, 0.9, step, 0.0)
    ends = [{k: v for k, v in zip(names, side, strict=True) if k not in _UNUSED[structure]} for side in (lower, upper, start)]
    others = [
        ends[2] | {"gain": sign * ends[2]["gain"], "rest": rest, "delay": delay, "first": slow} | second
        for delay in np.linspace(0.0, 0.45, 10) * duration
        for slow in (duration / 50, duration / 12)
        for second in ([{"second": slow / 2}, {"second": step}] if "second" in ends[2] else [{}])
        for sign, rest in ways
    ]
    name, before = f"transfer-function-{structure}", STRUCTURES.index(structure) - 1

    def as_one_of_these(simpler: dict) -> dict:
        return ends[2] | _richer(simpler, structure, prompt)

    held = ((transfer_function(series, STRUCTURES[before]), as_one_of_these),) if before >= 0 else ()
    return Family(name, _functions[structure], *map(_arrays, ends), even=True, others=tuple(map(_arrays, others)), holds=held)


def _richer(simpler: dict, structure: Structure, prompt: float) -> dict:
    """The parameters of a ``structure`` that does what the one before it does: two poles as a damped pair, and a prompt pole more."""
    if structure != "underdamped":
        return simpler | {"second": prompt}
    slow, fast = (float(f(simpler["first"], simpler["second"])) for f in (jnp.maximum, jnp.minimum))
    damping = min((slow + fast) / (2.0 * math.sqrt(slow * fast)), _DAMPED)
    first = slow / (damping + math.sqrt(damping**2 - 1.0))  # of poles too far apart for a pair, the slow one
    return {k: v for k, v in simpler.items() if k != "second"} | {"first": first, "damping": damping}


_DAMPED = 20.0  # a pair so much damped is one pole: the other is a thousand times as fast
_UNUSED: Mapping[Structure, tuple[str, ...]] = {
    "one-pole": ("second", "damping"), "two-poles": ("damping",), "underdamped": ("second",), "underdamped-and-pole": (),
}  # fmt: skip


def _function(parameters: dict, structure: Structure) -> TransferFunction:
    return TransferFunction(**parameters, **dict.fromkeys(_UNUSED[structure], jnp.asarray(1.0)), structure=structure)


_functions = {s: functools.partial(_function, structure=s) for s in STRUCTURES}  # one object each: it is what a program is known by


def _wiener(parameters: dict) -> HammersteinWiener:
    return HammersteinWiener(**parameters)


def hammerstein_wiener(series: Sequence[Series], knots: int = 10) -> Family:
    """Ten knots in each curve, two poles and, where it tells, a delay of at most half the recording, looked for from several.

    ``settled`` is free where a recording begins with the input on.
    """
    low, span, bottom, swing = _ranges(series)
    step, duration = _step(series), _duration(series)
    places, even = np.linspace(low, low + span, knots), np.linspace(0.0, 1.0, knots)
    edges = np.r_[0.0, np.full(knots - 2, -0.5), 1.0], np.r_[0.0, np.full(knots - 2, 1.5), 1.0]
    lower = {
        "knots": places,
        "inlet": edges[0],
        "reflections": (-1 + 1e-6, -0.999),
        "split": -3.0,
        "outlet": np.full(knots, bottom - swing),
        "delay": 0.0,
        "settled": 0.0 if any(abs(s.input[0]) > 1e-9 * span for s in series) else 1.0,
    }
    upper = {
        "knots": places,
        "inlet": edges[1],
        "reflections": (1.0, 1 - 1e-6),
        "split": 4.0,
        "outlet": np.full(knots, bottom + 2 * swing),
        "delay": duration / 2,
        "settled": 1.0,
    }
    start = {
        "knots": places,
        "inlet": even,
        "reflections": _slow_pair(step, duration / 50),
        "split": 0.5,
        "outlet": bottom + swing * even,
        "delay": 0.0,
        "settled": 1.0,
    }
    others = [
        start | {"delay": delay, "reflections": _slow_pair(step, slow)}
        for delay in np.linspace(0.0, 0.45, 19) * duration
        for slow in (duration / 50, duration / 12)
    ]
    lower, upper, start, *others = ({**side, "reflections": np.array(side["reflections"])} for side in (lower, upper, start, *others))
    ends = [_arrays(side) for side in (lower, upper, start)]
    prompt = Family("hammerstein-wiener", _wiener, *({k: v for k, v in side.items() if k != "delay"} for side in ends), even=True)
    late, held = tuple(map(_arrays, others)), ((prompt, _at_once),)
    return Family("hammerstein-wiener", _wiener, *ends, even=True, others=late, holds=held, frugal=True)


def _at_once(prompt: dict) -> dict:
    return prompt | {"delay": jnp.zeros(())}


def _slow_pair(step: float, slow: float) -> tuple[float, float]:
    """The reflection coefficients of two poles of the time constant ``slow``."""
    pole = math.exp(-step / slow)
    return -2 * pole / (1 + pole**2), pole**2


def _narx(parameters: dict) -> Narx:
    return Narx(**parameters)


def _network(series: Sequence[Series], hidden: int, order: int) -> tuple[dict, dict, dict]:
    low, span, bottom, swing = _ranges(series)
    rest = float(np.mean([s.output[np.isfinite(s.output)][0] for s in series]))
    scale = np.array([low + 0.5 * span, 0.5 * span, bottom + 0.5 * swing, 0.5 * swing])
    shapes = {"hidden": (hidden, 2 * order), "shift": (hidden,), "outer": (hidden,), "straight": (order,), "constant": ()}
    known = {"rest": rest, "scale": scale}
    lower, upper = ({k: np.full(shape, end) for k, shape in shapes.items()} | known for end in (-5.0, 5.0))
    start = {k: np.zeros(shape) for k, shape in shapes.items()} | known
    # Left alone it goes back to rest: a guess that holds an output for ever makes networks that run away of a ridge that pulls to it.
    slow = math.exp(-_step(series) * 50 / _duration(series))
    start["straight"] = np.r_[slow + 0.8, -0.8 * slow, np.zeros(order - 2)] if order > 1 else np.array([slow])
    start["constant"] = (1.0 - np.sum(start["straight"])) * (rest - scale[2]) / scale[3]
    return lower, upper, start


def narx(series: Sequence[Series], hidden: int = 10, order: int = 2) -> Family:
    """Ten neurons on the last two outputs and inputs, fitted in open and then in closed loop, under a ridge."""
    lower, upper, start = map(_arrays, _network(series, hidden, order))
    return Family("narx", _narx, lower, upper, start, even=True, weights=_weights(start))


def _weights(network: dict) -> dict:
    """Which of a network's parameters are weights."""
    return {k: jnp.full_like(v, k not in ("rest", "scale")) for k, v in network.items()}


def _switched(parameters: dict) -> Switched:
    slow = parameters["fast"] + parameters["beyond"] * (parameters["longest"] - parameters["fast"])
    return Switched(Narx(**parameters["heating"]), slow=slow, **{k: parameters[k] for k in ("share", "fast", "rest", "off")})


def heating_cooling(series: Sequence[Series], hidden: int = 10, order: int = 2) -> Family:
    """A network while the input is above a twentieth of its range, two exponentials while it is not.

    The slow time lies ``beyond`` the fast one, by a share of the way to the longest: the recording's length.
    """
    low, span, bottom, swing = _ranges(series)
    step, duration = _step(series), _duration(series)
    network = _network(series, hidden, order)
    known = {"off": low + 0.05 * span, "longest": duration}
    ends = (
        {"share": 0.0, "fast": step, "beyond": 0.0, "rest": bottom - 0.3 * swing},
        {"share": 1.0, "fast": 0.2 * duration, "beyond": 1.0, "rest": bottom + 0.3 * swing},
        {"share": 0.6, "fast": duration / 100, "beyond": 0.04, "rest": bottom},
    )
    lower, upper, start = (_arrays({"heating": side} | end | known) for side, end in zip(network, ends, strict=True))
    weights = jax.tree.map(jnp.zeros_like, start) | {"heating": _weights(start["heating"])}
    return Family("heating-cooling", _switched, lower, upper, start, even=True, weights=weights)


FAMILIES: Mapping[str, Callable[[Sequence[Series]], Family]] = {
    "bouc-wen": functools.partial(bouc_wen, rest=True),
    "prandtl-ishlinskii": prandtl_ishlinskii,
    "prandtl-ishlinskii-20": functools.partial(prandtl_ishlinskii, count=20),
    "hammerstein-wiener": hammerstein_wiener,
    "narx": narx,
    "heating-cooling": heating_cooling,
    **{f"transfer-function-{s}": functools.partial(transfer_function, structure=s) for s in STRUCTURES},
}
