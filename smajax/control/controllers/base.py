"""Interface of the controllers of one channel.

A controller is sampled: once a period it takes the reference and the measured value, both in the channel's internal
unit, and returns a command in the unit of the drive (A, V, W or a duty cycle). ``reset`` and ``step`` are pure
functions of the state. Gains are the fields that are declared as parameters; in their units ``u`` stands for the unit
of the command and ``y`` for that of the channel. The loop needs nothing else of a controller than its period and the
limits of its command.
"""

import abc
import dataclasses
import inspect
from typing import TYPE_CHECKING, Any, Literal, TypeVar, get_args, get_origin

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.arguments import check_duration
from smajax.errors import InputError, missing_members, shortened, suggestion
from smajax.parameters import CheckedModule, declarations
from smajax.parameters.checks import is_concrete

_Controller = TypeVar("_Controller", bound="AbstractController")
# Fields that are given by rig and sampling, and are neither gains nor options.
_LIMITS = ("lower", "upper")


class AbstractController(CheckedModule):
    """Base class of the controllers of one channel.

    A subclass has the fields ``lower``, ``upper`` and ``period`` (or properties of these names), ``reset`` and
    ``step``. Its state is a pytree of numbers, integers or flags; the names of a ``NamedTuple``'s fields become those
    of the state in the C header.

    Attributes:
        lower: Smallest command, in the unit of the drive.
        upper: Largest command, in the unit of the drive.
        period: Period of the samples, s.
    """

    if TYPE_CHECKING:  # type checkers take abstract variables for constructor arguments

        @property
        def lower(self) -> jax.Array: ...
        @property
        def upper(self) -> jax.Array: ...
        @property
        def period(self) -> float: ...
    else:
        lower: eqx.AbstractVar[jax.Array]
        upper: eqx.AbstractVar[jax.Array]
        period: eqx.AbstractVar[float]

    def __check_init__(self) -> None:
        """Check the limits, the period, and the options whose type is a ``Literal``.

        Raises:
            InputError: If one of them is not possible.
        """
        name = type(self).__name__
        if is_concrete(self.lower) and is_concrete(self.upper) and np.any(self.lower > self.upper):
            raise InputError(f"{name}: lower = {self.lower:g} is above upper = {self.upper:g}: exchange the two")
        check_duration(name, "period", self.period)
        for field in dataclasses.fields(self):
            value, choices = getattr(self, field.name), get_args(field.type)
            if get_origin(field.type) is Literal and value not in choices:
                hint = suggestion(str(value), map(str, choices))
                raise InputError(
                    f"{name}: {field.name} = {value!r} is not known{hint}: give one of {', '.join(map(repr, choices))}"
                )

    @classmethod
    def with_default_gains(
        cls: type[_Controller], limits: tuple[Any, Any], period: float, **options: Any
    ) -> _Controller:
        """Build the controller with the default values of its gains, or 0 where they have none.

        Args:
            limits: Smallest and largest command, in the unit of the drive.
            period: Period of the samples, s.
            options: Values of the fields that are neither gains nor limits, by name.
        """
        lower, upper = (jnp.asarray(end, jnp.float64) for end in limits)
        fields: dict[str, Any] = {**zero_gains(cls), "lower": lower, "upper": upper, "period": period, **options}
        return cls(**fields)

    @classmethod
    def options(cls) -> tuple[str, ...]:
        """Return the names of the static fields other than the period, such as ``derivative_on`` of a PID."""
        names = [f.name for f in dataclasses.fields(cls) if f.metadata.get("static") and f.name != "period"]
        return tuple(names)

    def constants(self) -> dict[str, Any]:
        """Return the fixed constants and options by their names in documents: by default the static fields."""
        return {name: getattr(self, name) for name in self.options()}

    @property
    def limits(self) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Smallest and largest command, in the unit of the drive."""
        return self.lower, self.upper

    def with_limits(self: _Controller, lower: Float[Array, ""], upper: Float[Array, ""]) -> _Controller:
        """Return the controller with other limits of its output.

        Args:
            lower: Smallest command, in the unit of the drive.
            upper: Largest command, in the unit of the drive.
        """
        return eqx.tree_at(lambda c: (c.lower, c.upper), self, (lower, upper))

    def check_gains(self) -> None:
        """Raise an ``InputError`` for gains with which the controller cannot do what it is for; by default none."""

    @abc.abstractmethod
    def reset(self, reference: Float[Array, ""], value: Float[Array, ""]) -> Any:
        """Return the state of a controller whose reference and measured value have been constant.

        Args:
            reference: Reference so far, in the channel's unit.
            value: Measured value so far, in the channel's unit.
        """

    @abc.abstractmethod
    def step(self, state: Any, reference: Float[Array, ""], value: Float[Array, ""]) -> tuple[Any, Float[Array, ""]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, in the channel's unit.
            value: Measured value at this sample, in the channel's unit.

        Returns:
            The state after this sample, and the command until the next one, in the unit of the drive.
        """


def zero_gains(cls: type[AbstractController]) -> dict[str, jax.Array]:
    """Return the start values of the gains that a class declares: their defaults, or the smallest ones from 0 on.

    Args:
        cls: The class.
    """
    return {
        name: jnp.asarray(max(0.0, d.lower) if d.default is None else d.default, jnp.float64)
        for name, d in declarations(cls).items()
        if name not in _LIMITS
    }


def check_controller_class(cls: Any) -> None:
    """Check that a class is a complete controller.

    Args:
        cls: The class.

    Raises:
        InputError: if it is no class derived from ``AbstractController``, or lacks methods or fields.
    """
    if not (inspect.isclass(cls) and issubclass(cls, AbstractController)):
        shown = shortened(repr(cls)) if inspect.isclass(cls) else f"an object of type {type(cls).__name__}"
        raise InputError(f"{shown} is not a controller: give a class derived from AbstractController")
    if missing := missing_members(cls):
        raise InputError(f"{cls.__name__} is not a complete controller: {missing}")


def require_controller(controller: object) -> None:
    """Check that an object is a controller, and not its class or something else.

    Args:
        controller: The object.

    Raises:
        InputError: if it is not.
    """
    if not isinstance(controller, AbstractController):
        is_class = isinstance(controller, type)
        shown = f"the class {controller.__name__}" if is_class else f"an object of type {type(controller).__name__}"
        raise InputError(
            f"{shown} is no controller: give an instance of a class derived from AbstractController, such as "
            "smajax.controllers.PID(kp=1.0, period=0.01), or a ClosedLoop"
        )
