"""The sweep problem of an actuator whose equations are not a wire's five stages; it computes its own metrics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.actuators.base import AbstractActuator
from smajax.recordings.recording import Floats
from smajax.simulation.status import SimulationStatus
from smajax.sweeps.problem import AbstractSweepProblem


class ActuatorSweepProblem(AbstractSweepProblem):
    """An actuator with declared parameters that computes its own metrics.

    Args:
        actuator: The actuator.
        metrics: Metrics to evaluate.
    """

    actuator: AbstractActuator
    metrics: tuple[str, ...] = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """Internal units by metric."""
        return {n: self.actuator.units[n] for n in self.metrics}

    @property
    def batch(self) -> int:
        """Designs in one call of the compiled program on a processor: the actuator's own number."""
        return self.actuator.batch_size

    def steps(self, designs: Floats) -> np.ndarray:
        """Return the layout of each design, which stands for its steps: an actuator resolves itself."""
        return np.array(
            [self.actuator.program_index(dict(zip(self.names, map(float, design), strict=True))) for design in designs],
            int,
        )

    def grouped_steps(self, designs: Floats) -> np.ndarray:
        """Return the layout of each design: none stands for another."""
        return self.steps(designs)

    def shared_steps(self, design: Floats) -> int:
        """Return the layout of a design."""
        return int(self.steps(np.asarray(design)[None])[0])

    def evaluate(
        self, design: jax.Array, steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Compute the metrics of one design; the code is ``diverged`` where one of them is NaN.

        An infinite metric is a value: a wire that never warms has an infinite heating time.
        """
        values = {n: design[k] for k, n in enumerate(self.names)}
        metrics = parameters.replace(self.actuator, values).for_program(steps).metrics()
        failed = jnp.any(jnp.stack([jnp.isnan(metrics[n]) for n in self.metrics]))
        code = jnp.where(failed, SimulationStatus.diverged, SimulationStatus.done)
        return {n: metrics[n] for n in self.metrics}, code
