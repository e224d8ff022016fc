"""What is fitted of an input-output law: recordings as it sees them, a kind of law with its bounds, and their residual.

A ``Family`` says how a law is made of its parameters and between which bounds these lie; both are pytrees of one structure. A search runs
in the unit box between the bounds. Recordings of different length are filled up, unobserved, and run as one batch.
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

from smajax import simulate
from smajax.errors import InputError
from smajax.fit.searchable import Searchable
from smajax.hysteresis.operator import AbstractOperator

_UNEVEN = 0.01


class Series(NamedTuple):
    """One recording as an input-output law sees it: times in s, input and output, each of shape ``(n,)``; NaN where not measured."""

    name: str
    time: np.ndarray
    input: np.ndarray
    output: np.ndarray


@dataclasses.dataclass(frozen=True)
class Family:
    """A kind of law: ``make`` gives the law of parameters that lie between ``lower`` and ``upper``, pytrees of arrays alike.

    ``start`` is a first guess, ``others`` are further ones, for a forward search. ``holds`` lists simpler families, each with what writes
    its parameters as ones of this law that do the same: a search begins at their fits, too. A ``frugal`` law is left for the last of these
    where the rest of its parameters lower the error by no more than Schwarz's criterion (BIC) asks.
    ``even`` laws need rows that are equally far apart. ``kinked`` laws leave the cost kinks, as plays do where they begin to move, and
    shallow minima beside them: their search goes on from a little beside its best end for as long as that ends lower. ``weights``, alike,
    says by 1 which parameters are weights of a network and by 0 which are not: such a law has so many that it is fitted by BFGS with
    derivatives in reverse mode, from fits of ``ahead`` over longer and longer stretches, its weights held near the first guess by a ridge
    (see ``fit_operator``).
    """

    name: str
    make: Callable[[Any], AbstractOperator]
    lower: Any
    upper: Any
    start: Any
    even: bool = False
    kinked: bool = False
    frugal: bool = False
    weights: Any = None
    others: tuple[Any, ...] = ()
    holds: tuple[tuple["Family", Callable[[Any], Any]], ...] = ()

    @property
    def size(self) -> int:
        """Number of parameters that are free."""
        lower, upper = (ravel_pytree(side)[0] for side in (self.lower, self.upper))
        return int(np.sum(np.asarray(lower < upper)))


class Measured(eqx.Module):
    """Times, inputs, outputs and weights, each of shape ``(r, n)``."""

    time: jax.Array
    input: jax.Array
    measured: jax.Array
    weight: jax.Array


class OperatorProblem(Searchable):
    """The weighted residual of a law as a function of a vector in the unit box; ``baselines`` takes it like a ``Problem``."""

    data: Measured
    lower: jax.Array
    width: jax.Array
    first: jax.Array
    every: jax.Array
    make: Callable[[jax.Array], AbstractOperator] = eqx.field(static=True)
    ahead: bool = eqx.field(static=True, default=False)

    @property
    def nominal(self) -> np.ndarray:
        """The first guess."""
        return np.asarray(self.first)

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector; parameters that are held have no room."""
        return np.zeros(len(self.lower)), np.where(np.asarray(self.width) > 0, 1.0, 0.0)

    def law(self, vector: jax.Array) -> AbstractOperator:
        """The law at a point."""
        return self.make(self.lower + vector * self.width)

    def point(self, parameters: Any) -> np.ndarray:
        """Where parameters lie in the box, shape ``(p,)``."""
        return np.asarray(_share(ravel_pytree(parameters)[0], self.lower, self.width))

    def predict(self, vector: jax.Array) -> jax.Array:
        """Outputs, shape ``(r, n)``; with ``ahead``, set to the measured ones ``every`` so many rows."""
        law: Any = self.law(vector)
        if self.ahead:
            return jax.vmap(lambda t, u, y: law.ahead(t, u, y, self.every))(self.data.time, self.data.input, self.data.measured)
        return jax.vmap(lambda t, u: simulate.respond(law, t, u))(self.data.time, self.data.input)

    def residual(self, vector: jax.Array) -> jax.Array:
        """Model minus measurement, weighted, shape ``(r * n,)``."""
        return jnp.where(self.data.weight > 0, (self.predict(vector) - self.data.measured) * self.data.weight, 0.0).ravel()


def build_operator(family: Family, series: Sequence[Series], weight: float | None = None) -> OperatorProblem:
    """Puts a fit together; ``weight`` is one over the noise (default: over the spread of the output).

    Raises ``InputError`` if the rows of a series are not as far apart as the law needs them.
    """
    steps = [float(np.median(np.diff(s.time))) for s in series]
    for s in series:
        check_steps(family, s, steps[0])
    count = max(len(s.time) for s in series)

    def filled(values: np.ndarray, last: float = math.nan) -> np.ndarray:
        end = values[-1] if math.isnan(last) else last
        return np.append(values, np.full(count - len(values), end))

    outputs = [np.interp(s.time, s.time[np.isfinite(s.output)], s.output[np.isfinite(s.output)]) for s in series]
    spread = float(np.nanstd(np.concatenate([s.output for s in series])))
    each = weight or 1.0 / (spread or 1.0)
    further = [s.time[-1] + step * np.arange(1, count - len(s.time) + 1) for s, step in zip(series, steps, strict=True)]
    data = Measured(
        *(
            jnp.asarray(np.stack(rows))
            for rows in (
                [np.append(s.time, more) for s, more in zip(series, further, strict=True)],
                [filled(s.input) for s in series],
                [filled(o) for o in outputs],
                [filled(np.where(np.isfinite(s.output), each, 0.0), 0.0) for s in series],
            )
        )
    )
    lower, unravel = ravel_pytree(family.lower)
    width = ravel_pytree(family.upper)[0] - lower
    first = _share(ravel_pytree(family.start)[0], lower, width)
    return OperatorProblem(data, lower, width, first, jnp.asarray(count), _Maker(family.make, unravel))


def evenly(time: np.ndarray, step: float) -> bool:
    """Whether rows are as far apart as ``step`` (s), all of them."""
    return bool(np.max(np.abs(np.diff(time) - step)) <= _UNEVEN * step)


def check_steps(family: Family, series: Series, step: float) -> None:
    """Raises ``InputError`` if a law that goes row by row meets rows that are not ``step`` s apart."""
    if family.even and not evenly(series.time, step):
        gaps = np.diff(series.time)
        raise InputError(
            f"{series.name}: its rows are {gaps.min():.4g} to {gaps.max():.4g} s apart, and {family.name} needs rows every {step:.4g} s as "
            "it was fitted with: resample it (Recording.resample)"
        )


def _share(flat: jax.Array, lower: jax.Array, width: jax.Array) -> jax.Array:
    return jnp.where(width > 0, (flat - lower) / jnp.where(width > 0, width, 1.0), 0.0)


class _Maker(NamedTuple):
    """Makes a law of a flat vector."""

    make: Callable[[Any], AbstractOperator]
    unravel: Callable[[jax.Array], Any]

    def __call__(self, flat: jax.Array) -> AbstractOperator:
        return self.make(self.unravel(flat))


def check_rows(names: str, rows: int, count: int, law: str) -> None:
    """Raises ``InputError`` where no more rows are measured than a law has parameters: some curve of it goes through all of them."""
    if rows <= count:
        raise InputError(f"{names}: {rows} measured rows do not tell the {count} parameters of {law}: record more rows")
