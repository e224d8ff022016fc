"""Base class of sweep problems: the map from a design to its metrics, with its steps and its memory."""

import equinox as eqx
import jax
import numpy as np

from smajax.recordings.recording import Floats
from smajax.simulation.status import SimulationStatus
from smajax.sweeps.step_levels import group_steps, next_power_of_two

# Prefix of axes that vary the input, not the rig.
INPUT = "input."
# Names of the result codes by number.
CODES = tuple(code.name for code in SimulationStatus)


class AbstractSweepProblem(eqx.Module):
    """Base class of sweep problems.

    Args:
        names: Names of the axes, in the order of a design's values.
    """

    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """Internal units by metric."""
        raise NotImplementedError

    @property
    def batch(self) -> int:
        """Designs in one call of the compiled program on a processor."""
        # As many as the caches of a core hold; chosen by trial, experiments/speed/sweep_throughput.py measures the
        # throughput.
        return 64

    def numbers(self, steps: int) -> int:
        """Return about how many numbers the simulation of one design holds at once."""
        return 1

    def size_message(self, steps: int) -> str:
        """Return what to say of a design of so many steps that needs too much memory."""
        return f"a design takes {steps:,} steps"

    @property
    def size_hint(self) -> str:
        """What to change where a design needs too much memory."""
        return "narrow the parameters"

    def steps(self, designs: Floats) -> np.ndarray:
        """Return the steps that resolve each design, whole numbers, shape ``(m,)``, for designs ``(m, axes)``."""
        raise NotImplementedError

    def grouped_steps(self, designs: Floats) -> np.ndarray:
        """Return the steps with which each design is simulated, shape ``(m,)``; see ``step_levels.group_steps``."""
        return group_steps(self.steps(designs))

    def shared_steps(self, design: Floats) -> int:
        """Return steps that resolve a design, shape ``(axes,)``, and those near it, so that these share a program."""
        return next_power_of_two(int(self.steps(np.asarray(design)[None])[0]))

    def batch_order(self, designs: Floats) -> Floats:
        """Return a number for each design, shape ``(m,)``, by which designs are sorted into batches.

        The implicit steps of a batch take as many iterations as its slowest design, so that a batch of similar designs
        is the fastest.
        """
        return np.zeros(len(designs))

    def evaluate(
        self, design: jax.Array, steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Simulate one design.

        Args:
            design: Values of the axes, shape ``(axes,)``.
            steps: Steps, see ``steps``.
            differentiable: Whether derivatives are needed; without it there are none.

        Returns:
            Metrics by name, scalars in the units of ``units`` (NaN where the simulation failed), and the
            ``SimulationStatus``.
        """
        raise NotImplementedError
