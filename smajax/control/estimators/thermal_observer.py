"""Thermal observer: the temperature of a wire from its electrical power, corrected by a thermocouple.

    T_e' = a_1 P + a_2 |T_e|^n sgn(T_e) + L (T_measured - T_e)

with temperatures above ambient; L = 0 without a thermocouple. In a rollout the power and the thermocouple are those of
the loop's instruments. Filters of the whole plant are ``ExtendedKalmanFilter`` and ``EnsembleKalmanFilter``.

Source: ali2026 (estimator, L = 0); luenberger1964 (correction by a measurement).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.estimators.base import AbstractTemperatureEstimator, per_wire
from smajax.plant.plant import Plant

# Martensite fraction for which ``ThermalObserver.of`` evaluates the heat capacity: phases half and half.
_HALF_TRANSFORMED = 0.5


class ThermalState(NamedTuple):
    """State of the observer, each of shape ``(wires,)``.

    ``estimate`` in degC; ``reading`` of the thermocouples at that sample in degC (the estimate where there was none);
    last ``power`` in W.
    """

    estimate: jax.Array
    reading: jax.Array
    power: jax.Array


class ThermalObserver(AbstractTemperatureEstimator):
    """Observer of wire temperatures: ``a1`` in K/J, ``a2`` < 0 in K^(1 - n)/s, ``exponent`` n, ``ambient`` in degC.

    ``gain`` in 1/s is the correction by a thermocouple; a reading that is NaN is left out. A power that is NaN is
    replaced by the last one, and the estimate is NaN meanwhile.
    """

    a1: jax.Array
    a2: jax.Array
    exponent: jax.Array
    ambient: jax.Array
    gain: jax.Array
    period: float = eqx.field(static=True)

    @classmethod
    def of(cls, plant: Plant, temperature: float, period: float, gain: float = 0.0) -> "ThermalObserver":
        """Linearise a plant's heat balance without its effects: n = 1, phases half and half.

        Args:
            plant: The plant.
            temperature: Temperature about which the heat loss is linearised, degC.
            period: Period of the samples, s.
            gain: Correction by a thermocouple, 1/s.
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

    def reset(self, temperature: jax.Array) -> jax.Array:
        """Return the estimate at the start, degC."""
        return jnp.asarray(temperature)

    def step(self, estimate: jax.Array, power: jax.Array, measured: jax.Array | None = None) -> jax.Array:
        """Return the estimate a period later, by an explicit Euler step.

        Args:
            estimate: Estimate at the beginning, degC.
            power: Electrical power during the period, W, of the same shape.
            measured: Reading of the thermocouple at the beginning, degC; NaN or ``None``: none.
        """
        excess = estimate - self.ambient
        distance = jnp.abs(excess)
        safe = jnp.where(distance > 0.0, distance, 1.0)
        loss = jnp.sign(excess) * jnp.where(distance > 0.0, safe**self.exponent, 0.0)
        rate = self.a1 * power + self.a2 * loss
        if measured is not None:
            rate = rate + self.gain * jnp.where(jnp.isnan(measured), 0.0, measured - estimate)
        return estimate + self.period * rate

    def init(self, measured: dict[str, jax.Array]) -> ThermalState:
        """Return the state at rest; a wire whose temperature is not measured is at ambient."""
        temperature = per_wire(measured, "temperature")
        estimate = jnp.where(jnp.isfinite(temperature), temperature, self.ambient)
        return ThermalState(estimate, estimate, jnp.zeros_like(estimate))

    def update(self, state: ThermalState, measured: dict[str, jax.Array]) -> tuple[ThermalState, jax.Array]:
        """Take one sample: the power is the mean of the last period, the reading corrects the next step."""
        measured_power, reading = per_wire(measured, "power"), per_wire(measured, "temperature")
        finite = jnp.isfinite(measured_power)
        power = jnp.where(finite, measured_power, state.power)
        estimate = self.step(state.estimate, power, state.reading)
        reading = jnp.where(jnp.isfinite(reading), reading, estimate)
        return ThermalState(estimate, reading, power), jnp.where(finite, estimate, jnp.nan)

    def apply_command(self, state: ThermalState, command: jax.Array) -> ThermalState:
        """Return the state unchanged: the measured power has the effect of the command."""
        return state
