"""Metrics and derivatives of single designs for a search; each design is simulated once."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from smajax.numerics.jax_setup import on_cpu
from smajax.recordings.recording import Floats
from smajax.sweeps.compilation import differentiate_batch
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis


class DesignEvaluator:
    """Evaluates designs by their shares of the free axes, 0 to 1 each, and remembers them.

    Axes of listed values keep the value of the start. Metrics and derivatives come from one simulation with its
    tangents, which counts as 1 + axes simulations.
    """

    def __init__(self, problem: AbstractSweepProblem, axes: Sequence[Axis], start: Floats, steps: int):
        """Prepare the evaluation.

        Args:
            problem: Maps a design to its metrics.
            axes: Axes of the space.
            start: Design whose values the axes of listed values keep, shape ``(axes,)``.
            steps: Steps with which each design is simulated.
        """
        self.problem, self.axes, self.steps = problem, axes, steps
        self.start = np.array(start, dtype=np.float64)
        self.free = [k for k, axis in enumerate(axes) if not axis.values]
        self.evaluated: dict[bytes, tuple[dict[str, float], dict[str, Floats]]] = {}

    @property
    def simulations(self) -> int:
        """Number of simulations so far."""
        return len(self.evaluated) * (1 + len(self.axes))

    def design(self, shares: Floats) -> Floats:
        """Return the design, shape ``(axes,)``, at shares of the free axes, shape ``(free,)``, clipped to 0..1."""
        design = self.start.copy()
        for k, share in zip(self.free, np.clip(shares, 0.0, 1.0), strict=True):
            design[k] = self.axes[k].at(np.asarray([share]))[0]
        return design

    def shares(self, design: Floats) -> Floats:
        """Return the shares of a design on the free axes, shape ``(free,)``."""
        return np.array([float(np.clip(self.axes[k].share(design[k]), 0.0, 1.0)) for k in self.free])

    def evaluate(self, shares: Floats) -> tuple[dict[str, float], dict[str, Floats]]:
        """Return metrics at shares of the free axes, and their derivatives in these, shape ``(free,)`` each."""
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
    """Derivative of an axis' value with respect to its share."""
    return value * float(np.log(axis.upper / axis.lower)) if axis.log else axis.upper - axis.lower
