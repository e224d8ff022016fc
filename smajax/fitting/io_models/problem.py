"""The fit problem of an input-output model: series, a kind of model with its bounds, and the residual.

A ``ModelSpec`` has the function that makes a model of its parameters, and their bounds; parameters and bounds are
pytrees of one structure. A search runs in the unit box between the bounds. Series of different length are filled up
with rows of weight 0 and run as one batch.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from smajax.errors import InputError
from smajax.fitting.abstract_problem import AbstractFitProblem
from smajax.laws.base import AbstractInputOutputModel
from smajax.laws.response import compute_response
from smajax.laws.row_spacing import is_evenly_spaced


class Series(NamedTuple):
    """Times, input and output of one recording.

    Attributes:
        name: Name for messages.
        time: Times (n,), s.
        input: Input (n,).
        output: Output (n,); NaN where not measured.
    """

    name: str
    time: np.ndarray
    input: np.ndarray
    output: np.ndarray


@dataclasses.dataclass(frozen=True)
class ModelSpec:
    """A kind of input-output model that can be fitted.

    Attributes:
        name: Name of the model.
        make: Function that makes the model of its parameters, a pytree of arrays.
        lower: Lower bounds of the parameters, a pytree of the same structure.
        upper: Upper bounds; parameters whose bounds are equal are fixed.
        start: A first guess.
        needs_even_rows: Whether the model needs evenly sampled rows.
        nonsmooth: Whether the cost has kinks, as where plays begin to move, with shallow minima near them. The search
            then continues from random points near its best end for as long as that lowers the cost.
        prefers_simpler: Whether the fit of the last of ``nested`` is returned instead where its Schwarz criterion (BIC,
            schwarz1978) is lower.
        weight_mask: 1 for the weights of a network and 0 for its other parameters; ``None`` for models without weights.
            Networks are fitted by ``smajax.fitting.io_models.networks``.
        extra_starts: Further first guesses.
        nested: Simpler specs, each with the function that converts its parameters to parameters of this model with the
            same output. A search also starts at their fits.
    """

    name: str
    make: Callable[[Any], AbstractInputOutputModel]
    lower: Any
    upper: Any
    start: Any
    needs_even_rows: bool = False
    nonsmooth: bool = False
    prefers_simpler: bool = False
    weight_mask: Any = None
    extra_starts: tuple[Any, ...] = ()
    nested: tuple[tuple["ModelSpec", Callable[[Any], Any]], ...] = ()

    @property
    def size(self) -> int:
        """Number of free parameters."""
        lower, upper = (ravel_pytree(side)[0] for side in (self.lower, self.upper))
        return int(np.sum(np.asarray(lower < upper)))


class SeriesData(eqx.Module):
    """Times (s), inputs, measured outputs and weights of ``r`` series, each of shape ``(r, n)``."""

    time: jax.Array
    input: jax.Array
    measured: jax.Array
    weight: jax.Array


class IOModelProblem(AbstractFitProblem):
    """The weighted residual of an input-output model as a function of a vector in the unit box.

    Attributes:
        data: The series.
        lower: Lower bounds of the flat parameters (p,).
        width: Distances of the bounds (p,).
        first_guess: First guess in the unit box (p,).
        reset_interval: Number of rows after which the past outputs are reset, where ``resets_outputs`` is set.
        make: Function that makes the model of the flat parameters.
        resets_outputs: Whether the model's past outputs are set to the measured ones every ``reset_interval`` rows: 1
            is open loop, the number of rows closed loop.
    """

    data: SeriesData
    lower: jax.Array
    width: jax.Array
    first_guess: jax.Array
    reset_interval: jax.Array
    make: Callable[[jax.Array], AbstractInputOutputModel] = eqx.field(static=True)
    resets_outputs: bool = eqx.field(static=True, default=False)

    @property
    def nominal(self) -> np.ndarray:
        """The first guess, shape ``(p,)``."""
        return np.asarray(self.first_guess)

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector, each of shape ``(p,)``; equal for fixed parameters."""
        return np.zeros(len(self.lower)), np.where(np.asarray(self.width) > 0, 1.0, 0.0)

    def model(self, vector: Float[Array, " p"]) -> AbstractInputOutputModel:
        """Return the model at a vector."""
        return self.make(self.lower + vector * self.width)

    def scaled_vector(self, parameters: Any) -> np.ndarray:
        """Return the position (p,) of parameters, a pytree, in the unit box."""
        return np.asarray(_scale(ravel_pytree(parameters)[0], self.lower, self.width))

    def predict(self, vector: Float[Array, " p"]) -> Float[Array, "r n"]:
        """Compute the outputs (r, n) of all series at a vector."""
        model: Any = self.model(vector)
        # Rows are checked where the problem is built.
        if self.resets_outputs:
            return jax.vmap(lambda t, u, y: model.predict_ahead(t, u, y, self.reset_interval, evenly_spaced=True))(
                self.data.time, self.data.input, self.data.measured
            )
        return jax.vmap(lambda t, u: compute_response(model, t, u, evenly_spaced=True))(self.data.time, self.data.input)

    def residual(self, vector: Float[Array, " p"]) -> Float[Array, " size"]:
        """Return measurement minus model, weighted, shape ``(r * n,)``."""
        weighted = (self.data.measured - self.predict(vector)) * self.data.weight
        return jnp.where(self.data.weight > 0, weighted, 0.0).ravel()


def build_io_problem(spec: ModelSpec, series: Sequence[Series], weight: float | None = None) -> IOModelProblem:
    """Build the fit problem of an input-output model.

    Args:
        spec: The kind of model.
        series: The recordings.
        weight: One over the noise; by default one over the standard deviation of the output.

    Returns:
        The problem, with weight 0 where the output was not measured.

    Raises:
        InputError: The model needs evenly sampled rows, and those of a series are not.
    """
    steps = [float(np.median(np.diff(s.time))) for s in series]
    for s in series:
        check_sampling(spec, s, steps[0])
    spread = float(np.nanstd(np.concatenate([s.output for s in series])))
    lower, unravel = ravel_pytree(spec.lower)
    width = ravel_pytree(spec.upper)[0] - lower
    first_guess = _scale(ravel_pytree(spec.start)[0], lower, width)
    count = max(len(s.time) for s in series)
    data = _series_data(series, steps, count, weight or 1.0 / (spread or 1.0))
    return IOModelProblem(data, lower, width, first_guess, jnp.asarray(count), _Maker(spec.make, unravel))


def _series_data(series: Sequence[Series], steps: Sequence[float], count: int, weight: float) -> SeriesData:
    """The series filled up to ``count`` rows; gaps in the output are interpolated, with weight 0."""

    def fill_up(values: np.ndarray, last: float = math.nan) -> np.ndarray:
        end = values[-1] if math.isnan(last) else last
        return np.append(values, np.full(count - len(values), end))

    outputs = [np.interp(s.time, s.time[np.isfinite(s.output)], s.output[np.isfinite(s.output)]) for s in series]
    further = [s.time[-1] + step * np.arange(1, count - len(s.time) + 1) for s, step in zip(series, steps, strict=True)]
    return SeriesData(
        *(
            jnp.asarray(np.stack(rows))
            for rows in (
                [np.append(s.time, more) for s, more in zip(series, further, strict=True)],
                [fill_up(s.input) for s in series],
                [fill_up(o) for o in outputs],
                [fill_up(np.where(np.isfinite(s.output), weight, 0.0), 0.0) for s in series],
            )
        )
    )


def check_sampling(spec: ModelSpec, series: Series, step: float) -> None:
    """Check that a series is evenly sampled where the model needs that.

    Args:
        spec: The kind of model.
        series: The series.
        step: Time between two rows, s.

    Raises:
        InputError: It is not.
    """
    if spec.needs_even_rows and not is_evenly_spaced(series.time, step):
        gaps = np.diff(series.time)
        raise InputError(
            f"{series.name}: its rows are {gaps.min():.4g} to {gaps.max():.4g} s apart, and {spec.name} needs rows "
            f"every {step:.4g} s, the step that it was fitted with: resample it (Recording.resample)"
        )


def _scale(flat: jax.Array, lower: jax.Array, width: jax.Array) -> jax.Array:
    """Position of flat parameters in the unit box; 0 for fixed parameters."""
    return jnp.where(width > 0, (flat - lower) / jnp.where(width > 0, width, 1.0), 0.0)


class _Maker(NamedTuple):
    """Function that makes a model of a flat vector."""

    make: Callable[[Any], AbstractInputOutputModel]
    unravel: Callable[[jax.Array], Any]

    def __call__(self, flat: jax.Array) -> AbstractInputOutputModel:
        return self.make(self.unravel(flat))


def check_rows(names: str, rows: int, count: int, model: str) -> None:
    """Check that a model has fewer parameters than there are measured rows; otherwise it may fit all of them exactly.

    Args:
        names: Names of the series, for the message.
        rows: Number of measured rows.
        count: Number of parameters.
        model: Name of the model, for the message.

    Raises:
        InputError: It has not.
    """
    if rows <= count:
        raise InputError(
            f"{names}: {rows} measured rows do not determine the {count} parameters of {model}: record more rows"
        )
