"""Interface of the actuators: metrics with units, computed from declared parameters.

An actuator here is a device, or a part of one, whose equations are not the five stages of a wire: a section that cools,
a beam that bends. Its parameters are grouped in sections, one field each. ``smajax.parameters`` reads and sets them by
name, as it does those of a plant.
"""

import abc
import dataclasses
from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, module_types


class AbstractActuator(CheckedModule):
    """Base class of the actuators.

    Attributes:
        units: Unit of each metric by the metric's name, in the order of the metrics.
        batch_size: Number of designs that one call of a compiled program evaluates fastest.
    """

    units: eqx.AbstractClassVar[Mapping[str, str]]
    # Chosen by trial: larger batches are no faster on a CPU.
    batch_size: ClassVar[int] = 8

    @classmethod
    def rig_sections(cls) -> dict[str, type[eqx.Module]]:
        """Return the classes of the sections of an actuator file, by section: the fields that are modules."""
        return {field.name: part for field in dataclasses.fields(cls) for part in module_types(cls, field)}

    @abc.abstractmethod
    def metrics(self) -> dict[str, Float[Array, ""]]:
        """Compute the metrics of the design.

        Differentiable, and batched by ``jax.vmap``; under ``jax.jit`` an unused metric costs nothing.

        Returns:
            Scalars by name, in SI units and degC; NaN if the dimensions do not fit together.
        """

    def check(self) -> None:
        """Check that the dimensions fit together.

        Raises:
            InputError: If they do not; it names the parameter and the cure.
        """

    def program_index(self, values: Mapping[str, float]) -> int:
        """Return the number, from 1, of the compiled program for a design; by default all designs share one.

        Args:
            values: Parameters of the design by name, in internal units; the others are those of this actuator.
        """
        return 1

    def for_program(self, index: int) -> "AbstractActuator":
        """Return this actuator for one compiled program: its metrics are NaN for designs of other programs.

        Args:
            index: Number of the program, as ``program_index`` gives it.
        """
        return self
