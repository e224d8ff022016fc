"""What every machine answers: its figures, each with a unit, from parameters that are declared as a plant's are.

A machine is an actuator, or a part of one, whose equations are not those of a wire's five stages: a section that cools, a beam that bends.
Its parameters stand in sections, one field each, and are read and set by the same names (``smajax.parameters``).
"""

from collections.abc import Mapping
from typing import ClassVar, Self

import equinox as eqx
import jax


class AbstractMachine(eqx.Module):
    """Base class of the machines. ``units`` has the figures' names in their order, and the unit of each.

    ``batch`` designs in one call of a compiled program are the fastest.
    """

    units: eqx.AbstractClassVar[Mapping[str, str]]
    batch: ClassVar[int] = 8

    def metrics(self) -> dict[str, jax.Array]:
        """The figures by name, scalars in SI units and degC; differentiable, and batched by ``jax.vmap``.

        Under ``jax.jit`` a figure that is not used costs nothing. Where dimensions do not fit together, figures are NaN.
        """
        raise NotImplementedError

    def check(self) -> None:
        """InputError, with the parameter and the cure, if dimensions do not fit together."""

    def layout(self, values: Mapping[str, float]) -> int:
        """Which program the design with these parameters needs, a whole number above 0; by default all share one."""
        return 1

    def laid_out(self, layout: int) -> Self:
        """This machine for a program: its figures are those of designs of that layout, and NaN for others."""
        return self
