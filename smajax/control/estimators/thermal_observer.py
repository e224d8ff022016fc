"""Thermal observer: the temperature of a wire from its electrical power, corrected by a thermocouple.

    T_e' = a_1 P + a_2 |T_e|^n sgn(T_e) + L (T_m - T_e)

with the estimate T_e and the reading T_m as temperatures above ambient; L = 0 without a thermocouple. In a rollout, the
loop's instruments measure power and temperature.

Source: ali2026 (estimator, L = 0); luenberger1964 (correction by a measurement).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from smajax.control.estimators.base import AbstractTemperatureEstimator, per_wire
from smajax.errors import InputError
from smajax.numerics.nonsmooth import maximum
from smajax.parameters.checks import is_concrete
from smajax.plant.plant import Plant

# Martensite fraction at which ``ThermalObserver.of`` evaluates the heat capacity: the middle of a transformation.
_HALF_TRANSFORMED = 0.5


class ThermalState(NamedTuple):
    """State of the observer, arrays of shape ``(wires,)``.

    Attributes:
        estimate: Estimated temperatures at the last sample, degC.
        reading: Readings of the thermocouples at that sample, degC; the estimates where there was none.
        power: Last finite power, W.
    """

    estimate: jax.Array
    reading: jax.Array
    power: jax.Array


class UnstableObserverError(InputError):
    """An observer whose explicit step is too long for its rates.

    Attributes:
        longest_period: Longest period with which the observer is stable, s.
        gain_is_faster: Whether the correction is faster than the heat loss.
    """

    def __init__(self, period: float, longest_period: float, gain_is_faster: bool):
        """Make the error.

        Args:
            period: Period of the observer, s.
            longest_period: Longest period with which the observer is stable, s.
            gain_is_faster: Whether the correction is faster than the heat loss.
        """
        cause = "gain" if gain_is_faster else "a2"
        super().__init__(
            f"the thermal observer's {cause} acts faster than its period of {period:g} s: give a smaller one, or a "
            f"period of at most {longest_period:.4g} s"
        )
        self.longest_period: float = longest_period
        self.gain_is_faster: bool = gain_is_faster


class ThermalObserver(AbstractTemperatureEstimator):
    """Luenberger observer of the temperatures of the wires.

    A reading that is NaN is not used. A power that is NaN is replaced by the last finite one, and the returned
    temperature is NaN meanwhile.

    Attributes:
        a1: Heating a_1 per energy, a scalar, K/J.
        a2: Heat loss a_2 <= 0, a scalar, K^(1 - n)/s.
        exponent: Exponent n of the heat loss, a scalar.
        ambient: Temperature of the surroundings, a scalar, degC.
        gain: Gain L of the correction by a thermocouple, a scalar, 1/s.
        period: Period of the samples, s.
    """

    a1: jax.Array
    a2: jax.Array
    exponent: jax.Array
    ambient: jax.Array
    gain: jax.Array
    period: float = eqx.field(static=True)

    def __check_init__(self) -> None:
        if is_concrete(self.a2) and not np.all(np.asarray(self.a2) <= 0.0):
            value = float(np.max(np.asarray(self.a2)))
            raise InputError(
                f"ThermalObserver: a2 = {value:g} would heat the wire without power: give a heat loss below 0"
            )
        linear = is_concrete(self.exponent) and np.all(np.asarray(self.exponent) == 1.0)
        # The loss of a linear observer has one rate; that of others depends on the temperature (``check_stability``).
        self._check_rates(-self.a2 if linear else jnp.zeros(()))

    def check_stability(self, temperature: ArrayLike) -> None:
        """Check that the explicit step is stable up to a temperature.

        Args:
            temperature: The temperature, a scalar, degC.

        Raises:
            UnstableObserverError: if the sum of the rates of heat loss and correction is above one per period. Between
                one and two per period the error would alternate in sign, and beyond it would grow.
        """
        if all(map(is_concrete, (temperature, self.ambient, self.a2, self.exponent))):
            excess = maximum(temperature - self.ambient, 0.0)
            self._check_rates(-self.exponent * self.a2 * excess ** (self.exponent - 1.0))

    def _check_rates(self, loss_rate: jax.Array) -> None:
        """Raise the error if loss and correction are too fast for the period; tracers are not checked."""
        if not all(map(is_concrete, (loss_rate, self.gain))):
            return
        rate = float(np.max(np.asarray(loss_rate + self.gain)))
        if self.period * rate > 1.0:
            raise UnstableObserverError(self.period, 1.0 / rate, bool(np.max(self.gain - loss_rate) > 0.0))

    @classmethod
    def of(cls, plant: Plant, temperature: float, period: float, gain: float = 0.0) -> "ThermalObserver":
        """Build the observer from a plant's heat balance, without its effects: n = 1, phases half and half.

        Args:
            plant: The plant.
            temperature: Temperature at which the conductance of the heat loss is evaluated, degC.
            period: Period of the samples, s.
            gain: Gain of the correction by a thermocouple, 1/s.
        """
        at, wire = jnp.asarray(temperature, jnp.float64), plant.wire
        capacity = plant.heat.capacity(jnp.asarray(_HALF_TRANSFORMED))
        loss = plant.heat.conductance(at, wire)
        return cls(
            1.0 / (capacity * wire.area * wire.length),
            -loss / capacity,
            jnp.asarray(1.0),
            plant.environment.ambient,
            jnp.asarray(gain),
            period,
        )

    def reset(self, temperature: ArrayLike) -> jax.Array:
        """Return the estimate at the start for a temperature in degC."""
        return jnp.asarray(temperature)

    def step(
        self,
        estimate: Float[Array, "*wires"],
        power: Float[Array, "*wires"],
        measured: Float[Array, "*wires"] | None = None,
    ) -> Float[Array, "*wires"]:
        """Return the estimate a period later, by an explicit Euler step.

        Args:
            estimate: Estimate at the beginning, degC.
            power: Electrical power during the period, W.
            measured: Reading of the thermocouple at the beginning, degC; NaN or ``None``: not measured.

        Returns:
            The estimate at the end, degC.
        """
        excess = estimate - self.ambient
        distance = jnp.abs(excess)
        safe = jnp.where(distance > 0.0, distance, 1.0)
        loss = jnp.sign(excess) * jnp.where(distance > 0.0, safe**self.exponent, 0.0)
        rate = self.a1 * power + self.a2 * loss
        if measured is not None:
            rate = rate + self.gain * jnp.where(jnp.isnan(measured), 0.0, measured - estimate)
        return estimate + self.period * rate

    def init(self, measured: dict[str, Float[Array, ""]]) -> ThermalState:
        """Return the state at rest; a wire whose temperature is not measured is at ambient temperature."""
        temperature = per_wire(measured, "temperature")
        estimate = jnp.where(jnp.isfinite(temperature), temperature, self.ambient)
        return ThermalState(estimate, estimate, jnp.zeros_like(estimate))

    def update(
        self, state: ThermalState, measured: dict[str, Float[Array, ""]]
    ) -> tuple[ThermalState, Float[Array, " wires"]]:
        """Take one sample: the power is that of the last period, and the reading corrects the next step."""
        measured_power, reading = per_wire(measured, "power"), per_wire(measured, "temperature")
        finite = jnp.isfinite(measured_power)
        power = jnp.where(finite, measured_power, state.power)
        estimate = self.step(state.estimate, power, state.reading)
        reading = jnp.where(jnp.isfinite(reading), reading, estimate)
        return ThermalState(estimate, reading, power), jnp.where(finite, estimate, jnp.nan)

    def apply_command(self, state: ThermalState, command: Float[Array, " wires"]) -> ThermalState:
        """Return the state unchanged: the observer uses the measured power, not the command."""
        return state
