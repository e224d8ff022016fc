"""Observers: what a rig does not measure, or measures badly, from what it does.

    thermal    T_e' = a_1 P + a_2 |T_e|^n sgn(T_e) + L (T_measured - T_e)            (hip paper's estimator; L = 0 without a thermocouple)
    angle      theta' = rate - bias, bias' = 0, corrected by a tilt                   (Kalman's filter on two states)

Both are sampled; ``reset`` and ``step`` are pure functions. In a rollout they hear what the loop's ``meters`` tell. Filters of the whole
plant are in ``extended`` (the extended Kalman filter) and ``ensemble``.
"""

import math
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.sensing import quantised
from smajax.plant.plant import Plant
from smajax.units import numbered


class AbstractThermometer(eqx.Module):
    """Base class of what tells a guard the wires' temperatures. ``heard`` are the plant's channels at a sample, scalars by name."""

    def begin(self, heard: dict[str, jax.Array]) -> Any:
        """The state at rest."""
        raise NotImplementedError

    def watch(self, state: Any, heard: dict[str, jax.Array]) -> tuple[Any, jax.Array]:
        """The state a period later, and the temperatures that it tells, degC, shape ``(wires,)``."""
        raise NotImplementedError

    def under(self, state: Any, command: jax.Array) -> Any:
        """The state once the wires' commands, shape ``(wires,)``, are known, which act until the next sample."""
        raise NotImplementedError


class AbstractFilter(AbstractThermometer):
    """Base class of filters of the whole plant, by which a controller may go, too."""

    def believed(self, state: Any, channel: str) -> jax.Array:
        """What is believed of a channel at a sample, a scalar."""
        raise NotImplementedError


class Estimate(NamedTuple):
    """What a filter of the whole plant knows, and how well: means and standard deviations of the channels by name, scalars, and of the
    ``martensite`` fraction of each wire, shape ``(wires,)``.
    """

    mean: dict[str, jax.Array]
    spread: dict[str, jax.Array]
    martensite: jax.Array
    martensite_spread: jax.Array


def each(heard: dict[str, jax.Array], name: str) -> jax.Array:
    """A channel of every wire, shape ``(wires,)``."""
    return jnp.stack([heard[n] for n in numbered(name, 1 if name in heard else 2)])


class ThermalState(NamedTuple):
    """Estimates, what the thermocouples read then (the estimate where they told nothing), degC, and the last powers, W; ``(wires,)``."""

    estimate: jax.Array
    reading: jax.Array
    power: jax.Array


class ThermalObserver(AbstractThermometer):
    """The temperature of a wire from its electrical power: ``a1`` in K/J, ``a2`` in K^(1 - n)/s and below 0, ``exponent`` n.

    ``gain`` in 1/s trusts a thermocouple, where there is one; a reading that is NaN is none. Of a power that is NaN the last one that was
    is kept, and no temperature is told meanwhile.
    """

    a1: jax.Array
    a2: jax.Array
    exponent: jax.Array
    ambient: jax.Array
    gain: jax.Array
    period: float = eqx.field(static=True)

    @classmethod
    def of(cls, plant: Plant, temperature: float, period: float, gain: float = 0.0) -> "ThermalObserver":
        """What a plant's heat stage says near a temperature in degC, n = 1, with phases half and half and without its effects."""
        at, wire = jnp.asarray(temperature, jnp.float64), plant.wire
        capacity = plant.heat.capacity(jnp.asarray(0.5))
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
        """The estimate at the start, degC."""
        return jnp.asarray(temperature)

    def step(self, estimate: jax.Array, power: jax.Array, measured: jax.Array | None = None) -> jax.Array:
        """The estimate a period on, under a power in W held meanwhile; ``measured`` is the thermocouple's reading at its start, degC."""
        excess = estimate - self.ambient
        away = jnp.abs(excess)
        some = jnp.where(away > 0.0, away, 1.0)
        lost = jnp.sign(excess) * jnp.where(away > 0.0, some**self.exponent, 0.0)
        change = self.a1 * power + self.a2 * lost
        if measured is not None:
            change = change + self.gain * jnp.where(jnp.isnan(measured), 0.0, measured - estimate)
        return estimate + self.period * change

    def begin(self, heard: dict[str, jax.Array]) -> ThermalState:
        """See ``AbstractThermometer``; a wire of which no temperature is known is as warm as the surroundings."""
        temperature = each(heard, "temperature")
        estimate = jnp.where(jnp.isfinite(temperature), temperature, self.ambient)
        return ThermalState(estimate, estimate, jnp.zeros_like(estimate))

    def watch(self, state: ThermalState, heard: dict[str, jax.Array]) -> tuple[ThermalState, jax.Array]:
        """See ``AbstractThermometer``: what the last period's power, and the reading at its start, have made of the last estimate."""
        told, reading = each(heard, "power"), each(heard, "temperature")
        known = jnp.isfinite(told)
        power = jnp.where(known, told, state.power)
        estimate = self.step(state.estimate, power, state.reading)
        reading = jnp.where(jnp.isfinite(reading), reading, estimate)
        return ThermalState(estimate, reading, power), jnp.where(known, estimate, jnp.nan)

    def under(self, state: ThermalState, command: jax.Array) -> ThermalState:
        """See ``AbstractThermometer``: the power tells it."""
        return state


class AngleState(NamedTuple):
    """``mean`` of angle and bias, shape ``(2,)``, and their ``covariance``."""

    mean: jax.Array
    covariance: jax.Array


class AngleFilter(eqx.Module):
    """Kalman's filter for an angle from a rate gyroscope with a drifting bias, and a tilt from an accelerometer.

    ``rate_noise`` is the gyroscope's (rad/s), ``bias_walk`` how its bias wanders (rad/s per root second), ``tilt_noise`` the tilt's (rad).
    With the rate alone the angle cannot be observed: it drifts with the bias. A tilt that is NaN was not measured.
    """

    rate_noise: jax.Array
    bias_walk: jax.Array
    tilt_noise: jax.Array
    period: float = eqx.field(static=True)

    def reset(self, angle: jax.Array, *, angle_spread: float = 0.1, bias_spread: float = 0.02) -> AngleState:
        """The state at the start: an angle, no bias, and what is thought of both."""
        return AngleState(
            jnp.stack([jnp.asarray(angle, jnp.float64), jnp.zeros(())]), jnp.diag(jnp.asarray([angle_spread, bias_spread]) ** 2)
        )

    def step(self, state: AngleState, rate: jax.Array, tilt: jax.Array | float = math.nan) -> AngleState:
        """The state after a sample of both sensors, or of the gyroscope alone."""
        dt = self.period
        moves = jnp.asarray([[1.0, -dt], [0.0, 1.0]])
        mean = moves @ state.mean + jnp.stack([dt * rate, jnp.zeros(())])
        wander = jnp.diag(jnp.stack([(dt * self.rate_noise) ** 2, dt * self.bias_walk**2]))
        covariance = moves @ state.covariance @ moves.T + wander
        blind = jnp.isnan(tilt)
        gain = jnp.where(blind, 0.0, covariance[:, 0] / (covariance[0, 0] + self.tilt_noise**2))
        mean = mean + gain * jnp.where(blind, 0.0, tilt - mean[0])
        return AngleState(mean, covariance - jnp.outer(gain, covariance[0]))


class Inertial(eqx.Module):
    """An ``AngleFilter`` in the place of an encoder: a loop's ``sensing`` by a gyroscope and a tilt on the moving link.

    The true sensors have noise of standard deviation ``rate_noise`` (rad/s) and ``tilt_noise`` (rad), steps of ``rate_quantum`` and
    ``tilt_quantum`` (0: none), and the gyroscope a ``bias`` (rad/s). A sample's draw is the tilt's noise, and the gyroscope's one sample
    later. What the filter tells arrives ``delay`` samples later. But for that its response to the angle is 1, as ``margins`` have it.
    """

    filter: AngleFilter
    rate_noise: jax.Array
    tilt_noise: jax.Array
    bias: jax.Array
    rate_quantum: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    tilt_quantum: jax.Array = eqx.field(default=0.0, converter=jnp.asarray)
    delay: int = eqx.field(static=True, default=0)

    @property
    def noise(self) -> jax.Array:
        """What a draw of one makes of the tilt, rad."""
        return self.tilt_noise

    def reset(self, value: jax.Array) -> tuple[AngleState, jax.Array, jax.Array, jax.Array]:
        """The filter at an angle at which the link is at rest, that angle, no draw yet, and the angles on their way, oldest first."""
        return self.filter.reset(value), jnp.asarray(value, jnp.float64), jnp.zeros(()), jnp.full(self.delay, value, jnp.float64)

    def step(self, state: tuple[AngleState, jax.Array, jax.Array, jax.Array], value: jax.Array, draw: jax.Array) -> tuple[Any, jax.Array]:
        """The state after a sample at a true angle, and the angle as the filter has it."""
        known, before, last, waiting = state
        rate = quantised((value - before) / self.filter.period + self.bias + self.rate_noise * last, self.rate_quantum)
        known = self.filter.step(known, rate, quantised(value + self.tilt_noise * draw, self.tilt_quantum))
        told = jnp.append(waiting, known.mean[0])
        return (known, value, jnp.asarray(draw, jnp.float64), told[1:]), told[0]
