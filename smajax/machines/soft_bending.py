"""The soft bending actuator of an ankle orthosis: wires with a curved memory shape in a straight silicone bar (knee-ankle paper, 3.3).

Heated, the wires pull towards their memory curvature k_m, and the bar and they share a curvature. Seen as a cantilever of the rigidity
n E_A I + E I of the bar, what the wires do is a moment at its free end,

    M = n E_A I k_m,

against which a cable pulls. The bend is that of the elastica, and its rigid rod is read off the tip (eqs. 21 and 22). What the paper leaves
open are the wires' memory shape and the cable.

Of a cycle the paper has no equations. Here the bar's cross-section cools by heat conduction, as the flexural actuator's does
(``smajax.machines.cross_section``): wires in the middles of equal shares of the width, in silicone throughout. The heat that the wires take
is that which warms and transforms them; the silicone's share of it is left out.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.errors import InputError
from smajax.kinks import larger
from smajax.machines import pseudo_rigid
from smajax.machines.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.machines.elastica import Bent, bend
from smajax.machines.machine import AbstractMachine
from smajax.machines.section_grid import EvenWires
from smajax.parameters import parameter

_LONGEST = 600.0  # s


class SoftBar(eqx.Module):
    """The silicone bar, clamped at one end."""

    length: jax.Array = parameter("m", "length of the bar", 1e-3, 10.0)
    width: jax.Array = parameter("m", "width of the bar", 1e-4, 1.0)
    thickness: jax.Array = parameter("m", "thickness of the bar, across which it bends", 1e-4, 1.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the silicone", 1e3, 1e10)
    density: jax.Array = parameter("kg/m^3", "density of the silicone", 1.0, 3e4, 970.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the silicone", 10.0, 1e4, 1460.0)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the silicone", 1e-3, 1e3, 0.15)


class MemoryWires(eqx.Module):
    """The wires in the bar's middle plane, all alike."""

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)
    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    modulus_austenite: jax.Array = parameter("Pa", "Young's modulus of the wires when hot", 1e9, 2e11)
    modulus_martensite: jax.Array = parameter("Pa", "Young's modulus of the wires when cold", 1e9, 2e11)
    memory_curvature: jax.Array = parameter("1/m", "curvature of the memory shape", -1e4, 1e4)
    density: jax.Array = parameter("kg/m^3", "density of the wires", 1.0, 3e4, 6450.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the wires", 10.0, 1e4, 837.4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the wires", 1e-3, 1e3, 18.0)


class Cable(eqx.Module):
    """What the tip pulls on."""

    force: jax.Array = parameter("N", "force of the cable against the bend, across the undeformed bar", -1e4, 1e4, 0.0)


class SoftHeating(eqx.Module):
    """What heats the wires, one after the other in one circuit, and when they count as cooled."""

    current: jax.Array = parameter("A", "current through the wires while they are heated", 1e-3, 100.0, 10.0)
    resistivity: jax.Array = parameter("ohm m", "resistivity of the wires", 1e-8, 1e-5, 0.9e-6)
    latent_heat: jax.Array = parameter("J/kg", "latent heat of the whole transformation", 0.0, 1e5, 24.2e3)
    cooled: jax.Array = parameter("degC", "temperature of the wires at which they have cooled", -100.0, 500.0, 36.0)


class SoftCooling(eqx.Module):
    """The air around the bar, and the temperatures from which it cools."""

    convection: jax.Array = parameter("W/m^2/K", "convection coefficient at the surface", 0.0, 1e5, 10.0)
    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 22.0)
    wire_start: jax.Array = parameter("degC", "temperature of the wires as cooling begins", -100.0, 800.0, 46.0)
    silicone_start: jax.Array = parameter("degC", "temperature of the silicone as cooling begins", -100.0, 800.0, 22.0)


class SoftBending(AbstractMachine):
    """A bar that bends when the wires in it are heated."""

    units: ClassVar[Mapping[str, str]] = {
        "moment": "N m",
        "rigidity": "N m^2",
        "cold_rigidity": "N m^2",
        "tip_slope": "rad",
        "tip_deflection": "m",
        "tip_shortening": "m",
        "rod_angle": "rad",
        "rod_share": "1",
        "rod_stiffness": "N m/rad",
        "blocking_force": "N",
        "cold_strain": "1",
        "stroke": "m",
        "force": "N",
        "peak_temperature": "degC",
        "work_per_cycle": "J",
        "energy_per_cycle": "J",
        "efficiency": "1",
        "heating_time": "s",
        "time_to_cool": "s",
        "bandwidth": "Hz",
    }
    batch: ClassVar[int] = 1  # as the flexural actuator's

    bar: SoftBar
    wires: MemoryWires
    cable: Cable
    heating: SoftHeating
    cooling: SoftCooling

    def check(self) -> None:
        """See ``AbstractMachine``."""
        if float(self.wires.diameter) >= float(self.bar.thickness):
            raise InputError("wires.diameter is not below bar.thickness: take thinner wires, or a thicker bar")
        if float(self.wires.count * self.wires.diameter) >= float(self.bar.width):
            raise InputError("wires.count wires do not fit side by side into bar.width: take fewer or thinner wires, or a wider bar")

    def rigidity(self, modulus: jax.Array) -> jax.Array:
        """Bending rigidity, N m^2, with wires of a modulus."""
        bar = self.bar
        return self._wires(modulus) + bar.modulus * bar.width * bar.thickness**3 / 12.0

    def _wires(self, modulus: jax.Array) -> jax.Array:
        return self.wires.count * modulus * jnp.pi / 64.0 * self.wires.diameter**4

    @property
    def section(self) -> CrossSection:
        """The bar's cross-section: silicone in its outer layers, too, each a quarter of what the wires leave of the thickness."""
        bar, wires, cooling = self.bar, self.wires, self.cooling
        outer = 0.25 * (bar.thickness - wires.diameter)

        def layer(thickness: jax.Array) -> Layer:
            return Layer(thickness, bar.density, bar.heat_capacity, bar.conductivity)

        return CrossSection(
            tape=layer(outer),
            silicone=layer(bar.thickness - 2.0 * outer),
            wire=SectionWire(wires.diameter, wires.density, wires.heat_capacity, wires.conductivity),
            placement=EvenWires(wires.count),
            cooling=Cooling(cooling.convection, cooling.ambient, cooling.wire_start, cooling.silicone_start),
            width=bar.width,
        )

    def cycle(self, hot: Bent) -> dict[str, jax.Array]:
        """The figures of a cycle in which the tip goes from where the cable holds the cold bar to ``hot``, and back.

        The heat is that which warms the wires from the surroundings to ``peak_temperature``, where cooling begins, and transforms them;
        ``heating_time`` is that without losses. ``stroke`` is the tip's way across, and the work that of the cable's force along it, 0
        where the cable gives work back. ``time_to_cool`` is infinite where it exceeds ``_LONGEST``.
        """
        bar, wires, heating, cooling = self.bar, self.wires, self.heating, self.cooling
        cold = bend(self.cable.force, jnp.zeros(()), bar.length, self.rigidity(wires.modulus_martensite))
        stroke = hot.y - cold.y
        area, length = 0.25 * jnp.pi * wires.diameter**2, wires.count * bar.length
        warmed = wires.heat_capacity * (cooling.wire_start - cooling.ambient) + heating.latent_heat
        heat = wires.density * area * length * warmed
        work = larger(self.cable.force * stroke, 0.0)
        heating_time = heat / (heating.current**2 * heating.resistivity * length / area)
        time_to_cool = self.section.cool(_LONGEST).cooled(heating.cooled)
        return {
            "stroke": jnp.abs(stroke),
            "peak_temperature": larger(cooling.wire_start, cooling.silicone_start),
            "work_per_cycle": work,
            "energy_per_cycle": heat,
            "efficiency": work / heat,
            "heating_time": heating_time,
            "time_to_cool": time_to_cool,
            "bandwidth": 1.0 / (heating_time + time_to_cool),
        }

    def metrics(self) -> dict[str, jax.Array]:
        """The figures named in ``units``.

        ``rod_angle`` (2 alpha) and ``rod_share`` (lambda) are the pseudo-rigid body's, ``rod_stiffness`` that of its hinge's spring: what
        wires and cable turn it with over its angle (eq. 25 holds for M = F L / 3 alone). ``blocking_force`` is the cable's that holds the
        tip where it was, at small slopes, and ``force`` its size, by the name that rigs have; ``cold_strain`` is that at the surface of a
        wire that lies straight. Of a bar that nothing bends, the rod is that of the smallest moment; figures of a bend that there is not
        (``bend``) are NaN, and so are all of wires that do not fit into the bar.
        """
        length, hot = self.bar.length, self.rigidity(self.wires.modulus_austenite)
        moment = self._wires(self.wires.modulus_austenite) * self.wires.memory_curvature
        bent = bend(self.cable.force, moment, length, hot)
        straight = (moment == 0.0) & (self.cable.force == 0.0)
        angle, share = pseudo_rigid.rod_of_shortening(bent.shortening, jnp.where(straight, length, bent.y), length)
        held = (moment - self.cable.force * share * length * jnp.cos(angle)) / jnp.where(straight, 1.0, angle)
        least_share, least_stiffness = pseudo_rigid.SMALL_MOMENT
        figures = {
            "moment": moment,
            "rigidity": hot,
            "cold_rigidity": self.rigidity(self.wires.modulus_martensite),
            "tip_slope": bent.slope,
            "tip_deflection": bent.y,
            "tip_shortening": bent.shortening,
            "rod_angle": jnp.where(straight, bent.y / (least_share * length), angle),
            "rod_share": jnp.where(straight, least_share, share),
            "rod_stiffness": jnp.where(straight, least_stiffness * hot / length, held),
            "blocking_force": 1.5 * moment / length,
            "cold_strain": 0.5 * self.wires.diameter * jnp.abs(self.wires.memory_curvature),
            "force": 1.5 * jnp.abs(moment) / length,
        } | self.cycle(bent)
        fits = (self.wires.diameter < self.bar.thickness) & (self.wires.count * self.wires.diameter < self.bar.width)
        return {name: jnp.where(fits, value, jnp.nan) for name, value in figures.items()}
