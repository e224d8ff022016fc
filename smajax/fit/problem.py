"""What is fitted to what: free parameters, recordings, weights, and the weighted residual as a function of one vector.

The vector holds the shared parameters first and then, recording by recording, those that each recording has for itself. Its entries are the
parameters over their ``scale``, so that steps and bounds are of order one. Recordings of different length are laid out on grids of one
length: the shorter ones stand still at their end, unobserved, and all are simulated as one batch. A row at which a channel is NaN
was not measured there and weighs nothing: so channels of different rates, and parts that are held back, stand in one recording.
"""

import dataclasses
import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters, simulate
from smajax.errors import InputError
from smajax.fit.searchable import Searchable
from smajax.kinks import larger, smaller
from smajax.parameters import ORDERED
from smajax.plant.plant import Plant
from smajax.recording import Recording

_FAILED = 1e3
_NARROWEST = 1e-3  # band of a transformation, relative to where its first end lies


@runtime_checkable
class Settings(Protocol):
    """What a fit needs to know; ``smajax.rig.FitSettings`` has it."""

    free: Sequence[str]
    per_recording: Sequence[str]
    initial: Sequence[str]
    bounds: Any
    observe: Sequence[str]
    noise: Any
    starts: int
    seed: int


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One entry of the vector: a parameter, of one recording or (``recording`` = ``None``) of all.

    Only its name and unit make it another one: what differs in the rest needs no compilation of its own.
    """

    name: str
    recording: str | None = dataclasses.field(compare=False)
    nominal: float = dataclasses.field(compare=False)
    lower: float = dataclasses.field(compare=False)
    upper: float = dataclasses.field(compare=False)
    scale: float = dataclasses.field(compare=False)
    unit: str

    @property
    def label(self) -> str:
        """``section.key``, with ``@recording`` behind it where each recording has its own."""
        return self.name if self.recording is None else f"{self.name}@{self.recording}"


class Data(eqx.Module):
    """Arrays of all recordings, each with a leading axis of ``r`` recordings; channels ``c``, samples ``n`` of the longest.

    ``until``, if there is one, is the grid point after which no recording has a sample.
    """

    inputs: simulate.Inputs
    measured: jax.Array
    weight: jax.Array
    until: jax.Array | None = None


class Problem(Searchable):
    """A plant, the data, and the free parameters; ``residual`` and ``predict`` are pure functions of the vector.

    ``scales``, shape ``(p,)``, are data, so that rigs of other values need no compilation of their own.
    """

    plant: Plant
    data: Data
    scales: jax.Array
    unknowns: tuple[Unknown, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    shared: tuple[str, ...] = eqx.field(static=True)
    own: tuple[str, ...] = eqx.field(static=True)

    @property
    def nominal(self) -> np.ndarray:
        """The vector of the rig's own values, shape ``(p,)``."""
        return np.array([u.nominal / u.scale for u in self.unknowns])

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector, each of shape ``(p,)``."""
        return np.array([u.lower / u.scale for u in self.unknowns]), np.array([u.upper / u.scale for u in self.unknowns])

    def search_box(self) -> tuple[np.ndarray, np.ndarray]:
        """A finite box inside the bounds from which starts are drawn and populations bred, each of shape ``(p,)``.

        Where a bound lies further than a factor 2.5 from the nominal value, or further than two scales where that is zero, the box ends
        there.
        """
        lower, upper = self.box
        middle = self.nominal
        near = np.where(np.abs(middle) > 0.5, 0.6 * np.abs(middle), 2.0)
        far = np.where(np.abs(middle) > 0.5, 1.5 * np.abs(middle), 2.0)
        below = np.where(middle > 0, near, far)
        above = np.where(middle > 0, far, near)
        return np.maximum(lower, middle - below), np.minimum(upper, middle + above)

    def values(self, vector: jax.Array) -> tuple[dict[str, jax.Array], dict[str, jax.Array]]:
        """Parameter values of the vector: shared ones (scalars), and each recording's own, shape ``(r,)``.

        The two ends of a transformation that are both free have changed places where the vector has them the wrong way round: a search
        may pass that line, and finds the same plant on its other side.
        """
        natural = vector * self.scales
        shared = {name: natural[i] for i, name in enumerate(self.shared)}
        own = natural[len(self.shared) :].reshape(-1, len(self.own)).T if self.own else []
        return _in_order(shared), _in_order({name: own[i] for i, name in enumerate(self.own)})

    def put_in_order(self, vector: np.ndarray, jacobian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The vector of the same plant with all ends of transformations the right way round, and the residual's Jacobian there."""
        vector, jacobian, scales = vector.copy(), jacobian.copy(), np.asarray(self.scales)
        places = {(u.name, u.recording): i for i, u in enumerate(self.unknowns)}
        for (name, recording), i in places.items():
            for low, high in ORDERED:
                k = places.get((high, recording))
                if name == low and k is not None and vector[i] * scales[i] > vector[k] * scales[k]:
                    ratio = scales[k] / scales[i]
                    vector[i], vector[k] = vector[k] * ratio, vector[i] / ratio
                    jacobian[:, i], jacobian[:, k] = jacobian[:, k] / ratio, jacobian[:, i] * ratio
        return vector, jacobian

    def predict(self, vector: jax.Array, known: simulate.Track | None = None) -> tuple[jax.Array, jax.Array]:
        """Model of the observed channels, shape ``(r, c, n)``, and the result code of each recording, shape ``(r,)``.

        ``known`` is what ``track`` gives at this vector, where that has been asked.
        """

        def single(member: Plant, inputs: simulate.Inputs, known: simulate.Track | None) -> tuple[jax.Array, jax.Array]:
            values, code = simulate.watch(member, inputs, self.channels, self.data.until, known)
            return jnp.stack([values[c] for c in self.channels]), code

        return self._each(single, vector, known)

    def track(self, vector: jax.Array) -> simulate.Track:
        """Where the plant goes, for ``predict`` and ``residual``; leaves with a leading axis of ``r`` recordings."""
        return self._each(lambda member, inputs, _: simulate.track(member, inputs, self.data.until), vector, None)

    def blank_track(self, vector: jax.Array) -> simulate.Track:
        """A track of the right shapes that leads nowhere."""
        return self._each(lambda member, inputs, _: simulate.blank_track(member, inputs), vector, None)

    def _each(self, single: Callable[[Plant, simulate.Inputs, Any], Any], vector: jax.Array, known: Any) -> Any:
        """A function of the plant, of a recording's inputs and of what is known of it, for each recording."""
        shared, own = self.values(vector)
        plant = parameters.replace(self.plant, shared)

        def one(own: dict[str, jax.Array], inputs: simulate.Inputs, known: Any) -> Any:
            return single(parameters.replace(plant, own), inputs, known)

        each = own, self.data.inputs, known
        if self.data.measured.shape[0] == 1:  # one recording needs no batch: its program compiles and runs faster
            return jax.tree.map(lambda leaf: leaf[None], one(*jax.tree.map(lambda leaf: leaf[0], each)))
        return jax.vmap(one)(*each)

    def residual(self, vector: jax.Array, known: simulate.Track | None = None) -> jax.Array:
        """Model minus measurement over the noise, shape ``(r * c * n,)``; zero where a recording has no sample.

        Of a simulation that fails it is ``_FAILED`` times as large: a search takes no step from a sound state into such a one.
        ``known`` as in ``predict``.
        """
        model, code = self.predict(vector, known)
        weight = self.data.weight * jnp.where(code == simulate.Code.done, 1.0, _FAILED)[:, None, None]
        return jnp.where(weight > 0, (model - self.data.measured) * weight, 0.0).ravel()


def _in_order(values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The values with the ends of each transformation in order, and not quite at one place."""
    for low, high in ORDERED:
        if low in values and high in values:
            first, second = smaller(values[low], values[high]), larger(values[low], values[high])
            values = values | {low: first, high: larger(second, first + _NARROWEST * jnp.abs(first))}
    return values


def build(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    interpolation: str = "hold",
    step: float | None = None,
    multiple: int = 1,
) -> Problem:
    """Puts a fit together. Raises ``InputError`` if a channel is missing or a parameter is free twice.

    Grids and samples are filled up to a ``multiple``, so that recordings of nearly one length share a compiled program.
    """
    for recording in recordings:
        missing = [c for c in (*plant.signals, *settings.observe) if c not in recording.channels]
        if missing:
            raise InputError(f"{recording.name} has no channel '{missing[0]}'; it has {', '.join(recording.channels)}")
    own = tuple(dict.fromkeys((*settings.per_recording, *(f"initial.{name}" for name in settings.initial))))
    shared = tuple(name for name in settings.free if name not in own)
    if not shared and not own:
        raise InputError("nothing is free: name the parameters to fit under [fit] free")
    bounds = {name: _bounds(plant, name, settings, (*shared, *own)) for name in (*shared, *own)}
    unknowns = [_unknown(plant, name, None, bounds[name], recordings[0]) for name in shared]
    unknowns += [_unknown(plant, name, r.name, bounds[name], r) for r in recordings for name in own]
    noise = {c: settings.noise.get(c) or max(difference_noise(r.channels[c]) for r in recordings) for c in settings.observe}
    for name in own:  # a start value left to the plant becomes a leaf
        if name.startswith("initial."):
            plant = parameters.replace(plant, {name: next(u.nominal for u in unknowns if u.name == name)})
    data = _data(plant, recordings, tuple(settings.observe), noise, interpolation, step, multiple)
    return Problem(
        plant=plant,
        data=data,
        scales=jnp.asarray([u.scale for u in unknowns]),
        unknowns=tuple(unknowns),
        channels=tuple(settings.observe),
        shared=shared,
        own=own,
    )


def difference_noise(values: np.ndarray) -> float:
    """Standard deviation of the fastest part of a column, from second differences, robustly; at least its rounding and 1e-5 of its range.

    A recording needs no rest for it. Where the noise is slower than the sampling it comes out too small. Rows without a value do not count.
    """
    values = values[np.isfinite(values)]
    second = np.diff(values, 2)
    spread = 1.4826 * float(np.median(np.abs(second))) / math.sqrt(6.0) if len(second) else 0.0
    return max(spread, rounding_noise(values), 1e-5 * float(np.ptp(values)))


def rounding_noise(values: np.ndarray) -> float:
    """Standard deviation of a column's rounding: the smallest step between two of its values over the root of 12."""
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(np.min(steps)) / math.sqrt(12.0) if len(steps) else 0.0


def _unknown(plant: Plant, name: str, recording: str | None, bounds: tuple[float, float], sample: Recording) -> Unknown:
    declared = parameters.declaration(plant, name)
    nominal = float(parameters.get(plant, name))
    if math.isnan(nominal):
        nominal = _resting(plant, name, sample)
    lower, upper = bounds
    if name.startswith("sensor.") and name.endswith("_offset"):
        channel = sample.channels.get(name.removeprefix("sensor.").removesuffix("_offset"))
        scale = float(np.nanmax(channel) - np.nanmin(channel)) if channel is not None else 1.0
    else:
        scale = abs(nominal) or _TYPICAL.get(declared.unit) or min(abs(upper), abs(lower), 1.0) or 1.0
        if declared.unit in ("degC", "K"):
            scale = _TYPICAL["K"]
    return Unknown(name, recording, nominal, lower, upper, scale, declared.unit)


def _bounds(plant: Plant, name: str, settings: Settings, free: Collection[str]) -> tuple[float, float]:
    """The bounds of a parameter; an end of a transformation that is free stays on its side of the other end where that is not."""
    declared = parameters.declaration(plant, name)
    lower, upper = settings.bounds.get(name, (declared.lower, declared.upper))
    for low, high in ORDERED:
        other = high if name == low else low
        if name not in (low, high) or other in free or other not in parameters.declared(plant):
            continue
        there = float(parameters.get(plant, other))
        least = _NARROWEST * abs(there)
        lower, upper = (lower, min(upper, there - least)) if name == low else (max(lower, there + least), upper)
    return lower, upper


# Steps of order one where a nominal value of zero gives no scale.
_TYPICAL = {"K": 10.0, "W/m^2/K": 100.0, "W/m^2/K^2": 0.5, "W/m^2/K^3": 0.005, "1/K": 1e-5, "ohm": 0.1}


def _resting(plant: Plant, name: str, sample: Recording) -> float:
    first = jnp.asarray([sample.channels[c][0] for c in plant.signals])
    state = plant.start(first)
    key = name.removeprefix("initial.")
    return float({"temperature": state.temperature, "detwinned": state.fractions.detwinned, "twinned": state.fractions.twinned}[key][0])


def _data(
    plant: Plant,
    recordings: Sequence[Recording],
    channels: tuple,
    noise: dict,
    interpolation: str,
    step: float | None,
    multiple: int,
) -> Data:
    laid = [simulate.lay_out(plant, r, interpolation=interpolation, step=step) for r in recordings]
    grid = -(-max(i.time.shape[0] for i in laid) // multiple) * multiple
    samples = -(-max(i.rows.shape[0] for i in laid) // multiple) * multiple
    inputs = jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *[i.padded(grid, samples) for i in laid])
    measured = np.zeros((len(recordings), len(channels), samples))
    weight = np.zeros_like(measured)
    for k, recording in enumerate(recordings):
        for j, channel in enumerate(channels):
            values = recording.channels[channel]
            known = np.isfinite(values)
            measured[k, j, : len(values)] = np.where(known, values, 0.0)
            weight[k, j, : len(values)] = np.where(known, 1.0 / noise[channel], 0.0)
    return Data(inputs, jax.device_put(measured), jax.device_put(weight))
