"""Interface of the actuators: metrics with units, from parameters that are declared as a plant's are.

An actuator here is a device, or a part of one, whose equations are not the five stages of a wire: a section that cools,
a beam that bends. Its parameters stand in sections, one field each, and are read and set by the same names as a plant's
(``smajax.parameters``).
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax


class AbstractActuator(eqx.Module):
    """Base class of the actuators.

    ``units`` holds the names of the metrics in their order, and the unit of each. ``batch_size`` is the number of
    designs that one call of a compiled program evaluates fastest.
    """

    units: eqx.AbstractClassVar[Mapping[str, str]]
    # Chosen by trial: more designs a call gain no more on a CPU.
    batch_size: ClassVar[int] = 8

    def metrics(self) -> dict[str, jax.Array]:
        """Return the metrics by name: scalars in SI units and degC.

        Differentiable, and batched by ``jax.vmap``; under ``jax.jit`` an unused metric costs nothing. Metrics are NaN
        if dimensions do not fit together.
        """
        raise NotImplementedError

    def check(self) -> None:
        """Check that the dimensions fit together.

        Raises:
            InputError: If they do not; it names the parameter and the cure.
        """

    def program_index(self, values: Mapping[str, float]) -> int:
        """Return the number, from 1, of the compiled program for these parameters; by default all share one."""
        return 1

    def for_program(self, index: int) -> "AbstractActuator":
        """Return this actuator for one program: its metrics are NaN for designs of another program."""
        return self
