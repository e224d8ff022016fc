"""Effects of a soft arm that the catalogue does not have: grains, slow heat, a contact, and a place to begin at."""

from __future__ import annotations

from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from smajax.parameters import parameter
from smajax.plant.effects.base import (
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    SensorEffect,
    Shapes,
    StageContext,
    ThermalNode,
    WireState,
)
from smajax.plant.effects.memory import first_order_lag
from smajax.plant.materials.base import Fractions
from smajax.plant.sensor import lag_series

# Eight grains at the middles of equal shares, as in the effect gradual-transformation of the catalogue.
_QUANTILES = (np.arange(8) + 0.5) / 8
# Their places on a logistic distribution of width 1: the inverse of its cumulative distribution.
_OFFSETS = np.log(_QUANTILES / (1.0 - _QUANTILES))[:, None]


class GrainMemory(NamedTuple):
    """Memory of the grains.

    Attributes:
        fractions: Their fractions, shape ``(8, wires)``.
        rate: Rate of their mean martensite fraction, 1/s, shape ``(wires,)``.
        delayed: Their mean martensite fraction behind a first-order lag, shape ``(wires,)``.
    """

    fractions: Fractions
    rate: jax.Array
    delayed: jax.Array


class Grains(HeatEffect, MaterialEffect):
    """Wire of grains whose transformation temperatures scatter, with their latent heat and creep.

    The transformation strain is that of the mean over the grains, in place of that of the law for a share s of the
    wire. With xi the mean martensite fraction and xi_f the same behind a first-order lag:

        C dT/dt = ... + s H dxi/dt        strain = ... - s c (xi - xi_f)

    The catalogue's latent heat and creep follow the law's own fraction, which ends abruptly. It acts on two stages, so
    it cannot be registered.
    """

    strength: jax.Array = parameter("1", "share of the wire that consists of such grains", 0.0, 1.0, 0.0)
    width: jax.Array = parameter("K", "width of the logistic distribution of their temperatures", 0.5, 40.0, 8.0)
    latent_heat: jax.Array = parameter("J/m^3", "latent heat per volume of wire", 0.0, 4e8, 1.2e8)
    creep: jax.Array = parameter("1", "strain that relaxes after a transformation", -0.02, 0.02, 0.003)
    creep_time: jax.Array = parameter("s", "time in which it relaxes", 0.5, 500.0, 10.0)
    key = "grains"
    typical: ClassVar[float] = 1.0
    source = "public recordings bu-softlimb: bend and temperature change without corners"
    confused_with: ClassVar[tuple[str, ...]] = ("gradual-transformation", "latent-heat", "creep")

    def initial_memory(self, state: WireState, context: StageContext) -> GrainMemory:
        """Return grains in the state of the law, at rest."""
        fractions = jax.tree.map(lambda f: jnp.broadcast_to(f[None], (len(_OFFSETS), *f.shape)), state.fractions)
        return GrainMemory(fractions, jnp.zeros_like(state.temperature), state.fractions.martensite)

    def update_memory(
        self,
        memory: GrainMemory,
        before: WireState,
        after: WireState,
        step: jax.Array,
        context: StageContext,
    ) -> GrainMemory:
        """Return the memory at the end of the step."""
        temperatures = tuple(at.temperature[None] + self.width * _OFFSETS for at in (before, after))
        stresses = tuple(
            jnp.broadcast_to(at.stress[None], t.shape) for at, t in zip((before, after), temperatures, strict=True)
        )
        fractions = context.material.evolve(memory.fractions, temperatures, stresses)
        first, last = (jnp.mean(f.martensite, axis=0) for f in (memory.fractions, fractions))
        rate = jnp.where(step > 0.0, (last - first) / jnp.where(step > 0.0, step, 1.0), 0.0)
        delayed = first_order_lag(memory.delayed, first, last, step, self.creep_time)
        return GrainMemory(fractions, rate, delayed)

    def power(self, state: WireState, memory: GrainMemory, context: StageContext) -> jax.Array:
        """Compute the latent heat that is set free, W/m^3."""
        return self.strength * self.latent_heat * memory.rate

    def strain(self, state: WireState, memory: GrainMemory, context: StageContext) -> jax.Array:
        """Compute the strain of the grains less that of the law, and their creep."""
        material = context.material
        gradual = jnp.mean(material.transformation_strain(memory.fractions), axis=0)
        creep = -self.creep * (jnp.mean(memory.fractions.martensite, axis=0) - memory.delayed)
        return self.strength * (gradual - material.transformation_strain(state.fractions) + creep)


class HeatSoak(ThermalNode):
    """Body around the wire that warms slowly, and at the first row is as warm as the wire."""

    strength: jax.Array = parameter("1", "conduction into the body over convection", 0.0, 6.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the body follows the wire", 60.0, 3000.0, 300.0)
    key = "heat-soak"
    typical: ClassVar[float] = 0.1
    source = "estimate: minutes, a tenth of the convection"
    confused_with: ClassVar[tuple[str, ...]] = ("coating", "ambient-drift")
    shapes: ClassVar[Shapes] = (("time_constant", (150.0, 600.0)),)

    def initial_memory(self, state: WireState, context: StageContext) -> jax.Array:
        """Return the body's excess over ambient: that of the wire at the first row."""
        return state.temperature - context.environment.ambient


class BodyHeat(ThermalNode):
    """Body of the arm, which warms within minutes, and at the first row is at ambient temperature."""

    strength: jax.Array = parameter("1", "conduction into the body over convection", 0.0, 6.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the body follows the wire", 20.0, 3000.0, 100.0)
    key = "body-heat"
    typical: ClassVar[float] = 0.1
    source = "public recordings bu-softlimb: wires are 0.9 to 1.4 K above their start after 180 s of cooling"
    confused_with: ClassVar[tuple[str, ...]] = ("coating", "ambient-drift")
    shapes: ClassVar[Shapes] = (("time_constant", (50.0, 200.0)),)


class ThermocoupleContact(SensorEffect):
    """Thermocouple that touches both the wire and the silicone around it, and follows them with two equal lags.

    The silicone follows the wire with a first-order lag. With T_s its temperature, q its share and s the time constant
    of each lag, the reading is (1 - q) T + q T_s behind both.
    """

    strength: jax.Array = parameter("s", "time constant of each of the two lags", 0.0, 10.0, 0.0)
    silicone_share: jax.Array = parameter("1", "share of the silicone in the reading", 0.0, 1.0, 0.0)
    silicone_time: jax.Array = parameter("s", "time in which the silicone follows the wire", 0.5, 60.0, 4.0)
    key = "thermocouple-contact"
    typical: ClassVar[float] = 1.0
    source = "public recordings bu-softlimb: one of four thermocouples reaches 72 degC, the others 101 to 111 degC"
    confused_with: ClassVar[tuple[str, ...]] = ("thermocouple-embedding", "thermocouple-attachment", "coating")
    channel = "temperature"

    def reading(self, series: jax.Array, channels: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """Compute the change of the reading."""
        silicone = lag_series(series, time, self.silicone_time)
        touched = series + self.silicone_share * (silicone - series)
        return lag_series(lag_series(touched, time, self.strength), time, self.strength) - series


class RestOffset(MechanismEffect):
    """Distance s of the arm from its rest at the first row, which the first motion removes.

    An arm that begins ahead of its rest (s > 0) stays there until the wire, which is slack, has shortened by s. One
    that begins behind it (s < 0) has a wire that was stretched further, which it recovers as it transforms: in
    proportion to its way.
    """

    strength: jax.Array = parameter("m", "distance from rest at the first row", -1e-3, 1e-3, 0.0)
    key = "rest-offset"
    typical: ClassVar[float] = 1e-4
    source = "public recordings bu-softlimb: the arm begins 1 to 3 of 15 deg from where it later rests"
    confused_with: ClassVar[tuple[str, ...]] = ("initial-set",)

    def displacement(self, motion: jax.Array, channels: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """Compute the remaining distance, m at the wire."""
        way = jax.lax.cummax(motion - motion[0])
        whole = jnp.maximum(way[-1], 1e-9)  # of a wire that is never heated, nothing is removed
        ahead, behind = jnp.maximum(self.strength - way, 0.0), self.strength * (1.0 - way / whole)
        return jnp.where(self.strength > 0.0, ahead, behind)


ARM_EFFECTS = {effect.key: effect for effect in (Grains, HeatSoak, BodyHeat, ThermocoupleContact, RestOffset)}
