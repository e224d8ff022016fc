"""Margins of constraints: they hold for all values of some parameters, not only for the nominal ones.

Each design is simulated at all corners of the deviations, and at both ends of the half axes of a fit's intervals
(``control.tuning.plant_draws.confidence_axes``). With the nominal value m, the value m_i at corner i and the larger
decrease d_k at the two ends of half axis k, the lowest value of a metric is

    min(m, m_i) - sqrt(sum_k max(d_k, 0)^2)

and the highest accordingly. For a metric that is linear in the fitted parameters, the root is the half width of its
95 % interval.
"""

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import largest, maximum

# Prefixes of the metrics with margin, and the sign with which a metric and the other one are largest.
LOWEST = "lowest_"
HIGHEST = "highest_"
# Smallest sum of squares of which the root is taken: the derivative of a root is infinite at 0.
_TINY = 1e-300


@dataclass(frozen=True)
class Margins:
    """Deviations of parameters from their values in a design.

    Attributes:
        names: Names of the parameters.
        corners: Deviations of all parameters at each corner, in internal units.
        axes: Deviations of all parameters at the end of each half axis of a fit's intervals.
        metrics: Names of the metrics with margin.
        fit: Name of the fit whose intervals count; empty for none.
    """

    names: tuple[str, ...]
    corners: tuple[tuple[float, ...], ...] = ()
    axes: tuple[tuple[float, ...], ...] = ()
    metrics: tuple[str, ...] = ()
    fit: str = ""

    @property
    def deviations(self) -> Float[np.ndarray, "scenarios names"]:
        """Deviations in all simulations of a design: none, the corners, and both ends of each half axis."""
        rows = [(0.0,) * len(self.names), *self.corners]
        for axis in self.axes:
            rows += [axis, tuple(-value for value in axis)]
        return np.array(rows, dtype=np.float64).reshape(-1, len(self.names))

    def metric_of(self, name: str) -> str:
        """Return the metric without margin of a metric with margin."""
        return name.removeprefix(LOWEST).removeprefix(HIGHEST)

    def with_margins(self, values: Mapping[str, Float[Array, " scenarios"]]) -> dict[str, Float[Array, ""]]:
        """Return the metrics of a design, and those with margin.

        Args:
            values: Metrics by name in all simulations, in the order of ``deviations``.

        Returns:
            Scalars by name.
        """
        metrics = {n: v[0] for n, v in values.items()}
        for name in self.metrics:
            base = values[self.metric_of(name)]
            metrics[name] = -self._highest(-base) if name.startswith(LOWEST) else self._highest(base)
        return metrics

    def _highest(self, values: Float[Array, " scenarios"]) -> Float[Array, ""]:
        count = 1 + len(self.corners)
        at_corners, nominal = largest(values[:count]), values[0]
        if not self.axes:
            return at_corners
        ends = values[count:].reshape(len(self.axes), 2)
        rise = maximum(jnp.max(ends, axis=1) - nominal, 0.0)
        square = jnp.sum(rise**2)
        # A comparison with NaN, of a failed simulation, is false: the result is NaN.
        return at_corners + jnp.where(square <= _TINY, 0.0, jnp.sqrt(jnp.where(square <= _TINY, 1.0, square)))

    def to_document(self) -> dict[str, Any]:
        """Return the margins as a JSON document; see ``margins_from_document``."""
        document = asdict(self)
        return document | {key: [list(row) for row in document[key]] for key in ("corners", "axes")}


def margins_from_document(document: Mapping[str, Any] | None) -> Margins | None:
    """Return the margins of a document of ``Margins.to_document``."""
    if document is None:
        return None
    corners, axes = (tuple(tuple(row) for row in document[key]) for key in ("corners", "axes"))
    return Margins(tuple(document["names"]), corners, axes, tuple(document["metrics"]), document["fit"])


def evaluate_with_margins(
    margins: Margins | None, evaluate: Callable[[Mapping[str, jax.Array]], tuple[dict[str, jax.Array], jax.Array]]
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Evaluate the metrics of a design, with margins if there are any.

    Args:
        margins: The margins; ``None`` for none.
        evaluate: Maps deviations by parameter to metrics by name and the number of the status.

    Returns:
        Metrics by name, and the number of the status without deviations. A metric with margin is NaN if a simulation
        with deviations failed.
    """
    if margins is None:
        return evaluate({})
    values, codes = jax.vmap(lambda row: evaluate(dict(zip(margins.names, row, strict=True))))(
        jnp.asarray(margins.deviations)
    )
    return margins.with_margins(values), codes[0]
