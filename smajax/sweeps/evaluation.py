"""Metrics and derivatives of single designs for an optimiser; each design is simulated once."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from smajax.numerics.jax_setup import on_cpu
from smajax.sweeps.compilation import differentiate_batch
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis

# Shares this close to an end are at the end: SLSQP stops short of a bound by its rounding.
_ROUNDING = 1e-9


class DesignEvaluator:
    """Evaluator of designs at shares of the free axes, 0 to 1 each; results are cached.

    Axes of listed values keep the value of the start. Metrics and derivatives come from one simulation with its
    tangents, which counts as 1 + axes simulations.
    """

    def __init__(
        self, problem: AbstractSweepProblem, axes: Sequence[Axis], start: Float[np.ndarray, " axes"], steps: int
    ):
        """Prepare the evaluation.

        Args:
            problem: Maps a design to its metrics.
            axes: Axes of the space.
            start: Design that gives the values of axes of listed values, in internal units, shape ``(axes,)``.
            steps: Number of steps with which each design is simulated.
        """
        self.problem = problem
        self.axes = axes
        self.steps = steps
        self.start: np.ndarray = np.array(start, dtype=np.float64)
        self.free: list[int] = [k for k, axis in enumerate(axes) if not axis.values]
        self.evaluated: dict[bytes, tuple[dict[str, float], dict[str, Float[np.ndarray, " free"]]]] = {}

    @property
    def simulations(self) -> int:
        """Number of simulations so far."""
        return len(self.evaluated) * (1 + len(self.axes))

    def design(self, shares: Float[np.ndarray, " free"]) -> Float[np.ndarray, " axes"]:
        """Return the design, shape ``(axes,)``, at shares of the free axes, shape ``(free,)``, clipped to [0, 1]."""
        design = self.start.copy()
        inside = np.where(shares < _ROUNDING, 0.0, np.where(shares > 1.0 - _ROUNDING, 1.0, shares))
        for k, share in zip(self.free, inside, strict=True):
            design[k] = self.axes[k].at(np.asarray([share]))[0]
        return design

    def shares(self, design: Float[np.ndarray, " axes"]) -> Float[np.ndarray, " free"]:
        """Return the shares of a design on the free axes, shape ``(free,)``."""
        return np.array([float(np.clip(self.axes[k].share(design[k]), 0.0, 1.0)) for k in self.free])

    def evaluate(
        self, shares: Float[np.ndarray, " free"]
    ) -> tuple[dict[str, float], dict[str, Float[np.ndarray, " free"]]]:
        """Evaluate metrics and their derivatives.

        Args:
            shares: Shares of the free axes, shape ``(free,)``.

        Returns:
            Metrics by name in internal units, and their derivatives with respect to the shares, shape ``(free,)`` each.
        """
        key = np.asarray(shares, dtype=np.float64).tobytes()
        if key not in self.evaluated:
            design = self.design(shares)
            with on_cpu():
                values, derivatives, _ = differentiate_batch(self.problem, jnp.asarray(design)[None], self.steps)
            per_share = np.array([_value_per_share(self.axes[k], design[k]) for k in self.free])
            self.evaluated[key] = (
                {n: float(values[n][0]) for n in self.problem.units},
                {n: np.asarray(derivatives[n][0])[self.free] * per_share for n in self.problem.units},
            )
        return self.evaluated[key]


def _value_per_share(axis: Axis, value: float) -> float:
    """Derivative of a value of an axis with respect to its share."""
    return value * float(np.log(axis.upper / axis.lower)) if axis.log else axis.upper - axis.lower
