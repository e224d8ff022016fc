"""Soft bending actuator of an ankle orthosis: wires with a curved memory shape in a straight silicone bar.

When heated, n wires bend towards their memory curvature k_m, and the bar bends with them. The bar with its wires is a
cantilever of the bending rigidity n E_A I_wire + E_bar I_bar, and the wires act on it as a moment at the free end,

    M = n E_A I_wire k_m,

against which a cable pulls. The shape is that of the elastica (``smajax.actuators.elastica``), and the position of the
tip gives the rigid rod (``smajax.actuators.pseudo_rigid_body``). The memory shape of the wires and the cable are not
specified in the paper.

The paper has no equations for a cycle. Here the cross-section of the bar cools by heat conduction, as that of the
flexural actuator (``smajax.actuators.cross_section``), with the wires in the middle of equal shares of the width and
silicone around them. The heat warms and transforms the wires; the heat of the silicone is left out.

Source: hybrid_knee_ankle_orthosis, section 3.3, equations 21 and 22.
"""

from collections.abc import Mapping
from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.actuators import pseudo_rigid_body
from smajax.actuators.base import AbstractActuator
from smajax.actuators.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.actuators.elastica import BentShape, solve_elastica
from smajax.actuators.section_grid import EvenWires
from smajax.errors import InputError
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import CheckedModule, parameter

# Duration of the simulated cooling in s; a longer ``time_to_cool`` counts as infinite. Far above the minute in which
# such bars cool; chosen by trial.
_COOLING_DURATION = 600.0


class SoftBar(CheckedModule):
    """Silicone bar, clamped at one end."""

    length: jax.Array = parameter("m", "length of the bar", 1e-3, 10.0)
    width: jax.Array = parameter("m", "width of the bar", 1e-4, 1.0)
    thickness: jax.Array = parameter("m", "thickness of the bar, across which it bends", 1e-4, 1.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the silicone", 1e3, 1e10)
    density: jax.Array = parameter("kg/m^3", "density of the silicone", 1.0, 3e4, 970.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the silicone", 10.0, 1e4, 1460.0)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the silicone", 1e-3, 1e3, 0.15)


class MemoryWires(CheckedModule):
    """Wires in the middle plane of the bar, all of one diameter and material."""

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)
    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    modulus_austenite: jax.Array = parameter("Pa", "Young's modulus of the wires when hot", 1e9, 2e11)
    modulus_martensite: jax.Array = parameter("Pa", "Young's modulus of the wires when cold", 1e9, 2e11)
    memory_curvature: jax.Array = parameter("1/m", "curvature of the memory shape", -1e4, 1e4)
    density: jax.Array = parameter("kg/m^3", "density of the wires", 1.0, 3e4, 6450.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the wires", 10.0, 1e4, 837.4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the wires", 1e-3, 1e3, 18.0)


class Cable(CheckedModule):
    """Cable at the tip."""

    force: jax.Array = parameter("N", "force of the cable against the bend, across the undeformed bar", -1e4, 1e4, 0.0)


class SoftHeating(CheckedModule):
    """Heating of the wires, which are in series, and the temperature at which they count as cooled."""

    current: jax.Array = parameter("A", "current through the wires while they are heated", 1e-3, 100.0, 10.0)
    resistivity: jax.Array = parameter("ohm m", "resistivity of the wires", 1e-8, 1e-5, 0.9e-6)
    latent_heat: jax.Array = parameter("J/kg", "latent heat of the whole transformation", 0.0, 1e5, 24.2e3)
    cooled: jax.Array = parameter("degC", "temperature of the wires at which they have cooled", -100.0, 500.0, 36.0)


class SoftCooling(CheckedModule):
    """Air around the bar, and the temperatures at which cooling begins."""

    convection: jax.Array = parameter("W/m^2/K", "convection coefficient at the surface", 0.0, 1e5, 10.0)
    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 22.0)
    wire_start: jax.Array = parameter("degC", "temperature of the wires as cooling begins", -100.0, 800.0, 46.0)
    silicone_start: jax.Array = parameter("degC", "temperature of the silicone as cooling begins", -100.0, 800.0, 22.0)


class SoftBending(AbstractActuator):
    """Silicone bar that bends when the wires in it are heated."""

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
    # The factors of one section's equations fill the caches.
    batch_size: ClassVar[int] = 1

    bar: SoftBar
    wires: MemoryWires
    cable: Cable
    heating: SoftHeating
    cooling: SoftCooling

    def check(self) -> None:
        """Check that the wires fit into the bar.

        Raises:
            InputError: If they do not; it names the parameter and the cure.
        """
        if float(self.wires.diameter) >= float(self.bar.thickness):
            raise InputError("wires.diameter is not below bar.thickness: take thinner wires, or a thicker bar")
        if float(self.wires.count * self.wires.diameter) >= float(self.bar.width):
            raise InputError(
                "wires.count wires do not fit side by side into bar.width: take fewer or thinner wires, or a wider bar"
            )

    def rigidity(self, modulus: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the bending rigidity of bar and wires: n E I_wire + E_bar I_bar.

        Args:
            modulus: Young's modulus E of the wires, Pa.

        Returns:
            Rigidity in N m^2.
        """
        bar = self.bar
        return self._wire_rigidity(modulus) + bar.modulus * bar.width * bar.thickness**3 / 12.0

    def _wire_rigidity(self, modulus: jax.Array) -> jax.Array:
        return self.wires.count * modulus * jnp.pi / 64.0 * self.wires.diameter**4

    @property
    def section(self) -> CrossSection:
        """Cross-section of the bar: its outer layers, a quarter of the thickness without wires each, are silicone."""
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

    def cycle(self, hot: BentShape) -> dict[str, Float[Array, ""]]:
        """Compute the metrics of a cycle in which the tip moves from the shape of the cold bar to that of the hot one.

        The heat warms the wires from ambient to ``peak_temperature``, where cooling begins, and transforms them;
        ``heating_time`` is without losses. ``stroke`` is the motion of the tip across the axis. ``work_per_cycle`` is
        that against the force of the cable along it, 0 where the cable does work on the bar. ``time_to_cool`` is
        infinite beyond 600 s.

        Args:
            hot: Shape of the hot bar.

        Returns:
            The metrics by name, scalars.
        """
        bar, wires, heating, cooling = self.bar, self.wires, self.heating, self.cooling
        cold = solve_elastica(self.cable.force, jnp.zeros(()), bar.length, self.rigidity(wires.modulus_martensite))
        stroke = hot.y - cold.y
        area, length = 0.25 * jnp.pi * wires.diameter**2, wires.count * bar.length
        heat_per_mass = wires.heat_capacity * (cooling.wire_start - cooling.ambient) + heating.latent_heat
        heat = wires.density * area * length * heat_per_mass
        work = maximum(self.cable.force * stroke, 0.0)
        heating_time = heat / (heating.current**2 * heating.resistivity * length / area)
        time_to_cool = self.section.cool(_COOLING_DURATION).time_to_reach(heating.cooled)
        return {
            "stroke": jnp.abs(stroke),
            "peak_temperature": maximum(cooling.wire_start, cooling.silicone_start),
            "work_per_cycle": work,
            "energy_per_cycle": heat,
            "efficiency": work / heat,
            "heating_time": heating_time,
            "time_to_cool": time_to_cool,
            "bandwidth": 1.0 / (heating_time + time_to_cool),
        }

    def metrics(self) -> dict[str, Float[Array, ""]]:
        """Compute the metrics named in ``units``.

        ``rod_angle`` (2 alpha), ``rod_share`` (lambda) and ``rod_stiffness`` are those of the pseudo-rigid body. The
        stiffness is the moment of wires and cable at the hinge over the angle of the rod (equation 25 holds for M = F L
        / 3 only). For a straight bar the rod is the limit of a small moment. ``blocking_force`` is the cable force that
        holds the tip in place, at small slopes; ``force`` is its magnitude, the name of this metric for rigs.
        ``cold_strain`` is the strain at the surface of a wire that is held straight. Metrics of a bend without a
        solution (``solve_elastica``) are NaN; all metrics are NaN if the wires do not fit into the bar.
        """
        length, hot = self.bar.length, self.rigidity(self.wires.modulus_austenite)
        moment = self._wire_rigidity(self.wires.modulus_austenite) * self.wires.memory_curvature
        bent = solve_elastica(self.cable.force, moment, length, hot)
        values = {
            "moment": moment,
            "rigidity": hot,
            "cold_rigidity": self.rigidity(self.wires.modulus_martensite),
            "tip_slope": bent.slope,
            "tip_deflection": bent.y,
            "tip_shortening": bent.shortening,
            **self._rod(bent, moment, hot),
            "blocking_force": 1.5 * moment / length,
            "cold_strain": 0.5 * self.wires.diameter * jnp.abs(self.wires.memory_curvature),
            "force": 1.5 * jnp.abs(moment) / length,
        } | self.cycle(bent)
        fits = (self.wires.diameter < self.bar.thickness) & (self.wires.count * self.wires.diameter < self.bar.width)
        return {name: jnp.where(fits, value, jnp.nan) for name, value in values.items()}

    def _rod(self, bent: BentShape, moment: jax.Array, rigidity: jax.Array) -> dict[str, jax.Array]:
        """Angle, share and stiffness of the pseudo-rigid body."""
        length = self.bar.length
        is_straight = (moment == 0.0) & (self.cable.force == 0.0)
        angle, factor = pseudo_rigid_body.rigid_rod_from_shortening(
            bent.shortening, jnp.where(is_straight, length, bent.y), length
        )
        hinge_moment = moment - self.cable.force * factor * length * jnp.cos(angle)
        stiffness = hinge_moment / jnp.where(is_straight, 1.0, angle)
        small_factor, small_stiffness = pseudo_rigid_body.SMALL_MOMENT
        return {
            "rod_angle": jnp.where(is_straight, bent.y / (small_factor * length), angle),
            "rod_share": jnp.where(is_straight, small_factor, factor),
            "rod_stiffness": jnp.where(is_straight, small_stiffness * rigidity / length, stiffness),
        }
