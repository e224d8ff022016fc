"""Interface of the sensors of the controlled channel."""

import abc
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule


class AbstractSensor(CheckedModule):
    """Base class of the sensors of one channel.

    Apart from its delay, the response of a sensor to the channel is 1, which ``smajax.control.analysis.margins`` uses.

    Attributes:
        noise: Standard deviation of its white noise, a scalar in the channel's unit; 0: none.
        delay: Delay of the measurement, samples.
    """

    if TYPE_CHECKING:  # type checkers take abstract variables for constructor arguments

        @property
        def noise(self) -> jax.Array: ...
        @property
        def delay(self) -> int: ...
    else:
        noise: eqx.AbstractVar[jax.Array]
        delay: eqx.AbstractVar[int]

    @property
    def sampling_period(self) -> float | None:
        """Period for which the sensor is built, s; ``None`` if it serves any."""
        return None

    @abc.abstractmethod
    def reset(self, value: Float[Array, ""]) -> Any:
        """Return the state of a sensor whose channel has had the constant value ``value``."""

    @abc.abstractmethod
    def step(self, state: Any, value: Float[Array, ""], draw: Float[Array, ""]) -> tuple[Any, Float[Array, ""]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            value: Exact value, in the channel's unit.
            draw: Standard normal number of this sample.

        Returns:
            The state after this sample, and the measured value.
        """
