"""What a search sees of a study: metrics and their slopes at a place in the space, scaled to 0..1 an axis, each place simulated once."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from smajax.jax_options import on_processor
from smajax.recording import Floats
from smajax.sweep.space import Axis
from smajax.sweep.study import AbstractStudy, differentiate_batch


class Look:
    """The designs around ``start``, shape ``(axes,)``, on ``steps``; axes of listed values are held where it has them.

    Metrics and derivatives come from one simulation with its tangents, which counts as 1 + axes simulations.
    """

    def __init__(self, study: AbstractStudy, axes: Sequence[Axis], start: Floats, steps: int):
        self.study, self.axes, self.steps = study, axes, steps
        self.start = np.array(start, dtype=np.float64)
        self.moving = [k for k, axis in enumerate(axes) if not axis.values]
        self.known: dict[bytes, tuple[dict[str, float], dict[str, Floats]]] = {}

    @property
    def simulations(self) -> int:
        """What was simulated so far."""
        return len(self.known) * (1 + len(self.axes))

    def design(self, share: Floats) -> Floats:
        """The design at shares ``(moving,)``, those beyond 0..1 taken as the end."""
        design = self.start.copy()
        for k, s in zip(self.moving, np.clip(share, 0.0, 1.0), strict=True):
            design[k] = self.axes[k].at(np.asarray([s]))[0]
        return design

    def share(self, design: Floats) -> Floats:
        """Where a design lies, shares ``(moving,)``."""
        return np.array([float(np.clip(self.axes[k].share(design[k]), 0.0, 1.0)) for k in self.moving])

    def at(self, share: Floats) -> tuple[dict[str, float], dict[str, Floats]]:
        """Metrics at shares, and their derivatives in them, each ``(moving,)``."""
        key = np.asarray(share, dtype=np.float64).tobytes()
        if key not in self.known:
            design = self.design(share)
            with on_processor():
                found, slopes, _ = differentiate_batch(self.study, jnp.asarray(design)[None], self.steps)
            per_share = np.array([_slope(self.axes[k], design[k]) for k in self.moving])
            values = {n: float(found[n][0]) for n in self.study.units}
            self.known[key] = values, {n: np.asarray(slopes[n][0])[self.moving] * per_share for n in self.study.units}
        return self.known[key]


def _slope(axis: Axis, value: float) -> float:
    """d value / d share."""
    return value * float(np.log(axis.upper / axis.lower)) if axis.log else axis.upper - axis.lower
