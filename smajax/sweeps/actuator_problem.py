"""Sweep problem of an actuator whose equations are not a wire's five stages; it computes its own metrics."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax import parameters
from smajax.actuators.base import AbstractActuator
from smajax.simulation.status import SimulationStatus
from smajax.sweeps.problem import AbstractSweepProblem


class ActuatorSweepProblem(AbstractSweepProblem):
    """Sweep problem of an actuator with declared parameters that computes its own metrics.

    Attributes:
        actuator: The actuator.
        metrics: Names of the metrics to evaluate.
    """

    actuator: AbstractActuator
    metrics: tuple[str, ...] = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """Internal units by metric."""
        return {n: self.actuator.units[n] for n in self.metrics}

    @property
    def batch(self) -> int:
        """Number of designs in one call of the compiled program on a CPU, as the actuator declares it."""
        return self.actuator.batch_size

    def steps(self, designs: Float[np.ndarray, "designs axes"]) -> Int[np.ndarray, " designs"]:
        """Return the program index of each design, which replaces a number of steps: an actuator chooses its own."""
        return np.array(
            [self.actuator.program_index(dict(zip(self.names, map(float, design), strict=True))) for design in designs],
            int,
        )

    def grouped_steps(self, designs: Float[np.ndarray, "designs axes"]) -> Int[np.ndarray, " designs"]:
        """Return the program index of each design; no program can replace another."""
        return self.steps(designs)

    def shared_steps(self, design: Float[np.ndarray, " axes"]) -> int:
        """Return the program index of a design."""
        return int(self.steps(np.asarray(design)[None])[0])

    def evaluate(
        self, design: Float[Array, " axes"], steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], Int[Array, ""]]:
        """Compute the metrics of one design; the code is ``diverged`` if one of them is NaN.

        An infinite metric is valid: a wire that never warms has an infinite heating time.
        """
        values = {n: design[k] for k, n in enumerate(self.names)}
        metrics = parameters.replace(self.actuator, values).for_program(steps).metrics()
        failed = jnp.any(jnp.stack([jnp.isnan(metrics[n]) for n in self.metrics]))
        code = jnp.where(failed, SimulationStatus.diverged, SimulationStatus.done)
        return {n: metrics[n] for n in self.metrics}, code
