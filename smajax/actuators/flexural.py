"""Flexural actuator: wires that are bent together with the elastomer sheets around them, and straighten when heated.

Metrics of a design follow from its dimensions and materials: the moment of the bent wires and the force at the tip, the
work per cycle and the heat that it requires, and the time in which the wires cool.

The paper measures blocking forces and efficiencies, and gives no model of them. Here the straightening moment of n
wires acts at a lever,

    F_blocked = n M / lever

M is either the whole bending moment or its plastic part. The latter is the paper's hypothesis: only strain beyond yield
recovers, so a wire below the yield diameter does not actuate. Against a cantilever of stiffness k_b, the stiffness k_a
= 3 (n E I + rigidity of the elastomers) / lever^3 of the actuator itself reduces the force and determines the work:

    P = F_blocked k_b / (k_a + k_b)        work = P^2 / (2 k_b)

The heat warms the wires from the ambient temperature to the temperature at which cooling begins, and transforms them.
The heat of the sheets is left out, as in the paper's limiting efficiency.

Source: dauksher2021.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.actuators.base import AbstractActuator
from smajax.actuators.bending_moment import BilinearStressStrain
from smajax.actuators.cantilever import Cantilever
from smajax.actuators.cross_section import Cooling, CrossSection, Layer, SectionWire
from smajax.actuators.section_grid import EvenWires, SpacedWires
from smajax.errors import InputError
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import CheckedModule, parameter

# Duration of the simulated cooling in s, and in pauses of the test; the longer of the two counts. Chosen by trial: a
# longer ``time_to_cool`` counts as infinite.
_SHORTEST_COOLING = 10.0
_PAUSES = 10.0


class FlexuralBody(CheckedModule):
    """Strip as a whole; one wire is laid back and forth in it, so that its passes lie side by side."""

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


class FlexuralHeating(CheckedModule):
    """Heating of the wires."""

    current: jax.Array = parameter("A", "current through the wire while it is heated", 1e-3, 100.0)
    resistivity: jax.Array = parameter("ohm m", "resistivity of the wire", 1e-8, 1e-5, 0.9e-6)
    latent_heat: jax.Array = parameter("J/kg", "latent heat of the whole transformation", 0.0, 1e5, 0.0)


class FlexuralTest(CheckedModule):
    """Test by which a cooling is rated."""

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
        """Return the number of wires of the design if the wires have a spacing, else 1."""
        return 1 if self.body.spacing is None else round(values.get("body.count", float(self.wires)))

    def for_program(self, index: int) -> "FlexuralActuator":
        """Return this actuator with a grid for ``index`` wires, if the wires have a spacing."""
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

        If the wires have a spacing, the grid is that of one count of wires (``for_program``): the spacing is NaN for
        every other count, and the derivative with respect to the count is NaN.
        """
        body, placement = self.body, EvenWires(self.body.count)
        if body.spacing is not None:
            placement = SpacedWires(
                self.wires,
                jnp.where(body.count == self.wires, body.spacing, jnp.nan) + _zero_with_nan_slope(body.count),
            )
        return CrossSection(self.tape, self.silicone, self.wire, placement, self.cooling, body.width, self.cells)

    @property
    def wire_length(self) -> Float[Array, ""]:
        """Length of all the wire, m."""
        return self.body.count * self.body.length + self.body.crossing

    def metrics(self) -> dict[str, Float[Array, ""]]:
        """Compute the metrics named in ``units``.

        ``moment`` is that of one wire; forces and works are those of the actuator. ``force`` equals ``blocking_force``;
        it is the name of this metric for rigs. ``stroke`` and ``work_per_cycle`` are against the cantilever of the
        bench. ``heating_time`` is without losses to the sheets; it ends at ``peak_temperature``, where cooling begins.
        ``time_to_cool``, down to the target of the test, is infinite if it exceeds both 10 s and ten pauses.
        ``bandwidth`` is the rate of cycles of heating and cooling.
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
    """0 with a NaN derivative, for a number that takes whole values only."""
    return jnp.zeros_like(count)


@_zero_with_nan_slope.defjvp
def _zero_with_nan_slope_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    return jnp.zeros_like(primals[0]), jnp.where(tangents[0] == 0.0, 0.0, jnp.nan)
