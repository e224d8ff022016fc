"""Flexural actuator: wires bent with the elastomer sheets around them, which straighten as they are heated.

Metrics of a design, from its dimensions and materials: the moment of the bent wires and the force that it makes at the
tip, the work that it can do against the heat that it takes, and how long the wires take to cool. Source: dauksher2021.

The paper measures blocking forces and efficiencies, and gives no model of them. Here the straightening moment acts at a
lever,

    F_blocked = n M / lever

as the whole bending moment, or as the part of it that yielding carries (the paper's hypothesis is that only what has
yielded recovers: a wire below the yield diameter does not actuate). Pushing against a cantilever of stiffness k_b, the
actuator yields by its own stiffness k_a = 3 (n E I + elastomers' rigidity) / lever^3, so that P = F_blocked k_b / (k_a
+ k_b), and the work done is P^2 / (2 k_b). The heat warms the wires from the ambient temperature to the one where
cooling begins, and transforms them; the sheets' share is left out, as in the paper's limiting efficiency.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.actuators.base import AbstractActuator
from smajax.actuators.bending_moment import BilinearStressStrain
from smajax.actuators.cantilever import Cantilever
from smajax.actuators.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.actuators.section_grid import EvenWires, SpacedWires
from smajax.errors import InputError
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter

# Duration of the simulated cooling in s, and in pauses of the test: the longer one counts. Later times to cool are
# infinite.
_SHORTEST_COOLING = 10.0
_PAUSES = 10.0


class FlexuralBody(eqx.Module):
    """Strip as a whole: its wires lie side by side, one wire led back and forth."""

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)
    width: jax.Array = parameter("m", "width of the strip", 1e-4, 1.0)
    length: jax.Array = parameter("m", "length of the strip, and of each of the wires in it", 1e-3, 10.0)
    curvature: jax.Array = parameter("1/m", "curvature at rest, to which the wires are bent", 1e-3, 1e4)
    lever: jax.Array = parameter("m", "distance from the clamp at which the blocked tip pushes", 1e-3, 10.0)
    crossing: jax.Array = parameter("m", "length of wire that joins the wires at the ends, all of it", 0.0, 10.0, 0.0)
    rigidity: jax.Array = parameter("N m^2", "bending rigidity of the elastomers together", 0.0, 10.0, 0.0)
    spacing: jax.Array | None = parameter(
        "m", "distance from wire to wire, in the middle of the strip; else even", 1e-6, 1.0, math.nan
    )


class FlexuralHeating(eqx.Module):
    """Heating of the wires."""

    current: jax.Array = parameter("A", "current through the wire while it is heated", 1e-3, 100.0)
    resistivity: jax.Array = parameter("ohm m", "resistivity of the wire", 1e-8, 1e-5, 0.9e-6)
    latent_heat: jax.Array = parameter("J/kg", "latent heat of the whole transformation", 0.0, 1e5, 0.0)


class FlexuralTest(eqx.Module):
    """Test that a cooling is measured by."""

    target: jax.Array = parameter(
        "degC", "temperature of the hottest wire at which the cycle is complete", -100.0, 500.0, 55.0
    )
    pause: jax.Array = parameter("s", "time after which the hottest wire's temperature is given", 1e-3, 1e4, 2.0)


class FlexuralActuator(AbstractActuator):
    """Strip of two elastomer sheets with wires between them, bent at rest."""

    units: ClassVar[Mapping[str, str]] = {
        "moment": "N m",
        "plastic_share": "1",
        "yield_diameter": "m",
        "blocking_force": "N",
        "blocking_force_of_yielding": "N",
        "plastic_work": "J",
        "stroke": "m",
        "force": "N",
        "peak_temperature": "degC",
        "work_per_cycle": "J",
        "energy_per_cycle": "J",
        "efficiency": "1",
        "limit_efficiency": "1",
        "resistance": "ohm",
        "heating_time": "s",
        "time_to_cool": "s",
        "temperature_after": "degC",
        "bandwidth": "Hz",
    }
    # The factors of one section's equations fill the caches.
    batch_size: ClassVar[int] = 1

    body: FlexuralBody
    wire: SectionWire
    tape: Layer
    silicone: Layer
    bending: BilinearStressStrain
    cooling: Cooling
    heating: FlexuralHeating
    test: FlexuralTest
    bench: Cantilever
    cells: int = eqx.field(static=True, default=10)
    wires: int = eqx.field(static=True, default=0)

    def __post_init__(self) -> None:
        # The grid of wires at a spacing has a fixed number of columns for each of them.
        self.wires = self.wires or round(float(self.body.count))

    def program_index(self, values: Mapping[str, float]) -> int:
        """Return the number of wires if they have a spacing, else 1."""
        return 1 if self.body.spacing is None else round(values.get("body.count", float(self.wires)))

    def for_program(self, index: int) -> "FlexuralActuator":
        """Return this actuator with a grid for so many wires, if they have a spacing."""
        return self if self.body.spacing is None else replace(self, wires=index)

    def check(self) -> None:
        """Check that wires, strip, bench and bending curve fit together.

        Raises:
            InputError: If they do not; it names the parameter and the cure.
        """
        wire, silicone = self.wire, float(self.silicone.thickness)
        if float(wire.diameter) + 2 * abs(float(wire.offset)) >= silicone:
            raise InputError(
                "wire.diameter leaves no silicone above or below the wire: "
                f"keep it below {1e3 * silicone:.6g} mm less twice the offset"
            )
        if float(wire.diameter * self.body.count) >= float(self.body.width):
            raise InputError(
                "body.count wires do not fit side by side into body.width: "
                "take fewer or thinner wires, or a wider strip"
            )
        if not self.bench.contains_position:
            raise InputError(
                "bench.position is beyond bench.length, where there is no cantilever to push: correct one of the two"
            )
        if not self.bending.softens:
            raise InputError(
                "bending.tangent_modulus is above bending.modulus, so that yielding stiffens the wire: "
                "correct one of the two"
            )
        if self.body.spacing is not None:
            self._check_spacing(float(self.body.spacing))

    def _check_spacing(self, spacing: float) -> None:
        if spacing <= float(self.wire.diameter):
            raise InputError("body.spacing is not above wire.diameter, so that the wires overlap: give a larger one")
        if float((self.body.count - 1.0) * spacing + self.wire.diameter) >= float(self.body.width):
            raise InputError(
                "body.spacing sets the outer wires outside body.width: give a smaller one, or a wider strip"
            )

    @property
    def section(self) -> CrossSection:
        """Cross-section that cools.

        If the wires have a spacing, it is NaN unless their count is the one of this program (``for_program``), and the
        derivative by the count is NaN.
        """
        body, placement = self.body, EvenWires(self.body.count)
        if body.spacing is not None:
            placement = SpacedWires(
                self.wires,
                jnp.where(body.count == self.wires, body.spacing, jnp.nan) + _zero_with_nan_slope(body.count),
            )
        return CrossSection(self.tape, self.silicone, self.wire, placement, self.cooling, body.width, self.cells)

    @property
    def wire_length(self) -> jax.Array:
        """Length of all the wire, m."""
        return self.body.count * self.body.length + self.body.crossing

    def metrics(self) -> dict[str, jax.Array]:
        """Return the metrics named in ``units``.

        ``moment`` is one wire's, forces and works are the actuator's. ``force`` is ``blocking_force`` under the name
        that rigs have; ``stroke`` and ``work_per_cycle`` are against the bench's cantilever. ``heating_time`` is
        without losses to the sheets, and ends at ``peak_temperature``, where cooling begins. ``time_to_cool``, down to
        the test's target, is infinite if it exceeds both 10 s and ten pauses. ``bandwidth`` is the rate of alternate
        heating and cooling.
        """
        body = self.body
        plastic = self.bending.plastic_moment(self.wire.diameter, body.curvature)
        mechanical, thermal = self._mechanical_metrics(plastic), self._heating_metrics()
        curve = self.section.cool(maximum(_SHORTEST_COOLING, _PAUSES * self.test.pause))
        time_to_cool = curve.time_to_reach(self.test.target)
        heat = thermal["energy_per_cycle"]
        values = (
            mechanical
            | thermal
            | {
                "peak_temperature": maximum(self.cooling.wire_start, self.cooling.elastomer_start),
                "efficiency": mechanical["work_per_cycle"] / heat,
                "limit_efficiency": mechanical["plastic_work"] / heat,
                "time_to_cool": time_to_cool,
                "temperature_after": curve.temperature_at(self.test.pause),
                "bandwidth": 1.0 / (thermal["heating_time"] + time_to_cool),
            }
        )
        return {name: values[name] for name in self.units}

    def _mechanical_metrics(self, plastic: jax.Array) -> dict[str, jax.Array]:
        """Moment, forces, work and stroke; ``plastic`` is the plastic part of one wire's moment."""
        body, diameter, bending = self.body, self.wire.diameter, self.bending
        moment = bending.moment(diameter, body.curvature)
        force = body.count * moment / body.lever
        rigidity = body.count * bending.modulus * jnp.pi / 64.0 * diameter**4 + body.rigidity
        bench = self.bench.stiffness
        push = force * bench / (3.0 * rigidity / body.lever**3 + bench)
        return {
            "moment": moment,
            "plastic_share": plastic / moment,
            "yield_diameter": bending.yield_diameter(body.curvature),
            "blocking_force": force,
            "blocking_force_of_yielding": body.count * plastic / body.lever,
            "plastic_work": self.wire_length * bending.plastic_work(diameter, body.curvature),
            "stroke": push / bench,
            "force": force,
            "work_per_cycle": 0.5 * push**2 / bench,
        }

    def _heating_metrics(self) -> dict[str, jax.Array]:
        """Heat of a cycle, resistance, and heating time without losses."""
        wire, heating = self.wire, self.heating
        area = 0.25 * jnp.pi * wire.diameter**2
        heat_per_mass = wire.heat_capacity * (self.cooling.wire_start - self.cooling.ambient) + heating.latent_heat
        heat = wire.density * area * self.wire_length * heat_per_mass
        resistance = heating.resistivity * self.wire_length / area
        return {
            "energy_per_cycle": heat,
            "resistance": resistance,
            "heating_time": heat / (heating.current**2 * resistance),
        }


@jax.custom_jvp
def _zero_with_nan_slope(count: jax.Array) -> jax.Array:
    """0 with a NaN derivative, for a number that is whole by its nature."""
    return jnp.zeros_like(count)


@_zero_with_nan_slope.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    return jnp.zeros_like(primals[0]), jnp.where(tangents[0] == 0.0, 0.0, jnp.nan)
