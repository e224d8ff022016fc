"""Base class of the controllers that are built around a PID, whose limits and period are theirs."""

from typing import TYPE_CHECKING, Any, TypeVar

import equinox as eqx
import jax
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController, zero_gains
from smajax.control.controllers.pid import PID

_Controller = TypeVar("_Controller", bound="AbstractControllerAroundPID")


class AbstractControllerAroundPID(AbstractController):
    """Base class of the controllers around a PID.

    Attributes:
        pid: The PID.
    """

    if TYPE_CHECKING:  # type checkers take abstract variables for constructor arguments

        @property
        def pid(self) -> PID: ...
    else:
        pid: eqx.AbstractVar[PID]

    @classmethod
    def with_default_gains(
        cls: type[_Controller], limits: tuple[Any, Any], period: float, **options: Any
    ) -> _Controller:
        """Build the controller with the default values of its gains and of those of the PID.

        Args:
            limits: Smallest and largest command, in the unit of the drive.
            period: Period of the samples, s.
            options: Values of the fields of controller and PID that are neither gains nor limits, by name.
        """
        pid = PID.with_default_gains(limits, period, **{n: options.pop(n) for n in PID.options() if n in options})
        fields: dict[str, Any] = {"pid": pid, **zero_gains(cls), **options}
        return cls(**fields)

    @classmethod
    def options(cls) -> tuple[str, ...]:
        """Return the names of the static fields of controller and PID other than the period."""
        return (*super().options(), *PID.options())

    def constants(self) -> dict[str, Any]:
        """Return the fixed constants and options of controller and PID by their names in documents."""
        names = [name for name in self.options() if name not in PID.options()]
        return {name: getattr(self, name) for name in names} | self.pid.constants()

    @property
    def lower(self) -> jax.Array:
        """Smallest command: that of the PID."""
        return self.pid.lower

    @property
    def upper(self) -> jax.Array:
        """Largest command: that of the PID."""
        return self.pid.upper

    @property
    def period(self) -> Any:
        """Period of the samples, s: that of the PID, a number that the export to C traces."""
        return self.pid.period

    def with_limits(self: _Controller, lower: Float[Array, ""], upper: Float[Array, ""]) -> _Controller:
        """Return the controller with other limits of its output, which are those of the PID.

        Args:
            lower: Smallest command, in the unit of the drive.
            upper: Largest command, in the unit of the drive.
        """
        return eqx.tree_at(lambda c: c.pid, self, self.pid.with_limits(lower, upper))
