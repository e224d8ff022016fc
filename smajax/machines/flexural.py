"""The flexural actuator: wires bent with the elastomer sheets around them, which straighten as they are heated (flexural paper).

What a design is judged by, from its dimensions and materials: the moment of the bent wires and the force that it makes at the tip, the work
that can come of it against the heat that it takes, and how long the wires take to cool.

The paper measures blocking forces and efficiencies, and gives no model of them. Here the straightening moment acts at a lever,

    F_blocked = n M / lever

as the whole bending moment, or as the part of it that yielding carries (the paper's hypothesis is that only what has yielded recovers: a
wire below the yield diameter does not actuate). Pushing against a cantilever of stiffness k_b, the actuator gives way by its own stiffness
k_a = 3 (n E I + elastomers' rigidity) / lever^3, so that P = F_blocked k_b / (k_a + k_b), and the work done is P^2 / (2 k_b). The heat is
that which warms the wires from the ambient to the temperature where cooling begins and transforms them; the sheets' share is left out, as
in the paper's limiting efficiency.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.errors import InputError
from smajax.kinks import larger
from smajax.machines.bending_moment import BilinearLaw
from smajax.machines.cantilever import Cantilever
from smajax.machines.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.machines.machine import AbstractMachine
from smajax.machines.section_grid import EvenWires, SpacedWires
from smajax.parameters import parameter


class FlexuralBody(eqx.Module):
    """The strip as a whole: so many wires lie side by side, one wire led to and fro."""

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)
    width: jax.Array = parameter("m", "width of the strip", 1e-4, 1.0)
    length: jax.Array = parameter("m", "length of the strip, and of each of the wires in it", 1e-3, 10.0)
    curvature: jax.Array = parameter("1/m", "curvature at rest, to which the wires are bent", 1e-3, 1e4)
    lever: jax.Array = parameter("m", "distance from the clamp at which the blocked tip pushes", 1e-3, 10.0)
    crossing: jax.Array = parameter("m", "length of wire that joins the wires at the ends, all of it", 0.0, 10.0, 0.0)
    rigidity: jax.Array = parameter("N m^2", "bending rigidity of the elastomers together", 0.0, 10.0, 0.0)
    spacing: jax.Array | None = parameter("m", "distance from wire to wire, in the middle of the strip; else even", 1e-6, 1.0, math.nan)


class FlexuralHeating(eqx.Module):
    """What heats the wires."""

    current: jax.Array = parameter("A", "current through the wire while it is heated", 1e-3, 100.0)
    resistivity: jax.Array = parameter("ohm m", "resistivity of the wire", 1e-8, 1e-5, 0.9e-6)
    latent_heat: jax.Array = parameter("J/kg", "latent heat of the whole transformation", 0.0, 1e5, 0.0)


class FlexuralTest(eqx.Module):
    """What a cooling is judged by."""

    target: jax.Array = parameter("degC", "temperature of the hottest wire at which the cycle is complete", -100.0, 500.0, 55.0)
    pause: jax.Array = parameter("s", "time after which the hottest wire's temperature is told", 1e-3, 1e4, 2.0)


class FlexuralActuator(AbstractMachine):
    """A strip of two elastomer sheets with wires between them, bent at rest."""

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
    batch: ClassVar[int] = 1  # the factors of one section's equations fill the caches

    body: FlexuralBody
    wire: SectionWire
    tape: Layer
    silicone: Layer
    bending: BilinearLaw
    cooling: Cooling
    heating: FlexuralHeating
    test: FlexuralTest
    bench: Cantilever
    cells: int = eqx.field(static=True, default=10)
    wires: int = eqx.field(static=True, default=0)

    def __post_init__(self) -> None:
        # The grid of wires at a spacing has so many columns for each of them.
        self.wires = self.wires or round(float(self.body.count))

    def layout(self, values: Mapping[str, float]) -> int:
        """See ``AbstractMachine``: of wires at a spacing their number."""
        return 1 if self.body.spacing is None else round(values.get("body.count", float(self.wires)))

    def laid_out(self, layout: int) -> Self:
        """See ``AbstractMachine``."""
        return self if self.body.spacing is None else replace(self, wires=layout)

    def check(self) -> None:
        """See ``AbstractMachine``."""
        wire, room = self.wire, float(self.silicone.thickness)
        if float(wire.diameter) + 2 * abs(float(wire.offset)) >= room:
            raise InputError(
                f"wire.diameter leaves no silicone above or below the wire: keep it below {1e3 * room:.6g} mm less twice the offset"
            )
        if float(wire.diameter * self.body.count) >= float(self.body.width):
            raise InputError("body.count wires do not fit side by side into body.width: take fewer or thinner wires, or a wider strip")
        if not self.bench.reaches:
            raise InputError("bench.position is beyond bench.length, where there is no cantilever to push: correct one of the two")
        if not self.bending.softens:
            raise InputError("bending.tangent_modulus is above bending.modulus, so that yielding stiffens the wire: correct one of the two")
        if self.body.spacing is None:
            return
        if float(self.body.spacing) <= float(wire.diameter):
            raise InputError("body.spacing is not above wire.diameter, so that the wires overlap: give a larger one")
        if float((self.body.count - 1.0) * self.body.spacing + wire.diameter) >= float(self.body.width):
            raise InputError("body.spacing sets the outer wires outside body.width: give a smaller one, or a wider strip")

    @property
    def section(self) -> CrossSection:
        """The cross-section that cools; of wires at a spacing only with the count that the machine is laid out for, else NaN.

        These cannot be differentiated in their number: such a derivative is NaN.
        """
        body, placement = self.body, EvenWires(self.body.count)
        if body.spacing is not None:
            placement = SpacedWires(self.wires, jnp.where(body.count == self.wires, body.spacing, jnp.nan) + _without_slope(body.count))
        return CrossSection(self.tape, self.silicone, self.wire, placement, self.cooling, body.width, self.cells)

    @property
    def wire_length(self) -> jax.Array:
        """All of the wire, m."""
        return self.body.count * self.body.length + self.body.crossing

    def metrics(self) -> dict[str, jax.Array]:
        """The figures named in ``units``.

        ``moment`` is one wire's, forces and works are the actuator's. ``force`` is ``blocking_force`` by the name that rigs have;
        ``stroke`` and ``work_per_cycle`` are against the bench's cantilever. ``heating_time`` is without losses to the sheets, and ends at
        ``peak_temperature``, where cooling begins. ``time_to_cool``, down to the test's target, is infinite where it exceeds both 10 s and
        ten pauses. ``bandwidth`` is the rate of heating and cooling in turns.
        """
        body, wire, heating = self.body, self.wire, self.heating
        diameter, area = wire.diameter, 0.25 * jnp.pi * wire.diameter**2
        moment = self.bending.moment(diameter, body.curvature)
        plastic = self.bending.plastic_moment(diameter, body.curvature)
        force = body.count * moment / body.lever
        rigidity = body.count * self.bending.modulus * jnp.pi / 64.0 * diameter**4 + body.rigidity
        bench = self.bench.stiffness
        push = force * bench / (3.0 * rigidity / body.lever**3 + bench)
        bench_work = 0.5 * push**2 / bench
        stored = self.wire_length * self.bending.plastic_work(diameter, body.curvature)
        warmed = wire.heat_capacity * (self.cooling.wire_start - self.cooling.ambient) + heating.latent_heat
        heat = wire.density * area * self.wire_length * warmed
        resistance = heating.resistivity * self.wire_length / area
        heating_time = heat / (heating.current**2 * resistance)
        course = self.section.cool(larger(10.0, 10.0 * self.test.pause))
        time_to_cool = course.cooled(self.test.target)
        return {
            "moment": moment,
            "plastic_share": plastic / moment,
            "yield_diameter": self.bending.yield_diameter(body.curvature),
            "blocking_force": force,
            "blocking_force_of_yielding": body.count * plastic / body.lever,
            "plastic_work": stored,
            "stroke": push / bench,
            "force": force,
            "peak_temperature": larger(self.cooling.wire_start, self.cooling.elastomer_start),
            "work_per_cycle": bench_work,
            "energy_per_cycle": heat,
            "efficiency": bench_work / heat,
            "limit_efficiency": stored / heat,
            "resistance": resistance,
            "heating_time": heating_time,
            "time_to_cool": time_to_cool,
            "temperature_after": course.at(self.test.pause),
            "bandwidth": 1.0 / (heating_time + time_to_cool),
        }


@jax.custom_jvp
def _without_slope(count: jax.Array) -> jax.Array:
    """0, whose derivative is NaN: of what there is in whole numbers alone."""
    return jnp.zeros_like(count)


@_without_slope.defjvp
def _(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    return jnp.zeros_like(primals[0]), jnp.where(tangents[0] == 0.0, 0.0, jnp.nan)
