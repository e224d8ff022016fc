"""Base class of sweep problems: the map from a design to its metrics, with its time steps and its memory."""

import abc

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.simulation.status import SimulationStatus
from smajax.sweeps.step_levels import group_steps, next_power_of_two

# Names of the result codes by number.
CODES = tuple(code.name for code in SimulationStatus)


class AbstractSweepProblem(eqx.Module):
    """Base class of sweep problems: maps a design to its metrics.

    Attributes:
        names: Names of the axes, in the order of a design's values.
    """

    names: tuple[str, ...] = eqx.field(static=True)

    @property
    @abc.abstractmethod
    def units(self) -> dict[str, str]:
        """Internal units by metric."""

    @property
    def batch(self) -> int:
        """Number of designs in one call of the compiled program on a CPU."""
        # The states of so many fit into the caches of a core; chosen by trial, experiments/speed/sweep_throughput.py
        # measures the throughput.
        return 64

    def numbers(self, steps: int) -> int:
        """Return about how many numbers the simulation of one design with ``steps`` stores at once."""
        return 1

    def size_message(self, steps: int) -> str:
        """Return the beginning of the error message about a design whose ``steps`` need too much memory."""
        return f"a design takes {steps:,} steps"

    @property
    def size_hint(self) -> str:
        """Hint what to change if a design needs too much memory."""
        return "narrow the parameters"

    @abc.abstractmethod
    def steps(self, designs: Float[np.ndarray, "designs axes"]) -> Int[np.ndarray, " designs"]:
        """Return the number of time steps that resolves each design, shape ``(designs,)``."""

    def grouped_steps(self, designs: Float[np.ndarray, "designs axes"]) -> Int[np.ndarray, " designs"]:
        """Return the number of steps with which each design is simulated; see ``step_levels.group_steps``."""
        return group_steps(self.steps(designs))

    def shared_steps(self, design: Float[np.ndarray, " axes"]) -> int:
        """Return a number of steps that resolves a design and those near it, so that they share a compiled program."""
        return next_power_of_two(int(self.steps(np.asarray(design)[None])[0]))

    def batch_order(self, designs: Float[np.ndarray, "designs axes"]) -> Float[np.ndarray, " designs"]:
        """Return a sort key for each design; neighbours in the sorted order share a batch.

        The implicit steps of a batch take as many iterations as its slowest design, so a batch of similar designs is
        the fastest.
        """
        return np.zeros(len(designs))

    @abc.abstractmethod
    def evaluate(
        self, design: Float[Array, " axes"], steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], Int[Array, ""]]:
        """Simulate one design.

        Args:
            design: Values of the axes in internal units, shape ``(axes,)``.
            steps: Number of steps, see ``steps``.
            differentiable: Whether the metrics must have derivatives with respect to the design.

        Returns:
            Metrics by name, scalars in the units of ``units`` (NaN where the simulation failed), and the number of the
            ``SimulationStatus``.
        """
