"""The soft bending actuator of an ankle orthosis: wires with a curved memory shape in a straight silicone bar (knee-ankle paper, 3.3).

Heated, the wires pull towards their memory curvature k_m, and the bar and they share a curvature. Seen as a cantilever of the rigidity
n E_A I + E I of the bar, what the wires do is a moment at its free end,

    M = n E_A I k_m,

against which a cable pulls. The bend is that of the elastica, and its rigid rod is read off the tip (eqs. 21 and 22). What the paper leaves
open are the wires' memory shape and the cable.
"""

from collections.abc import Mapping
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.errors import InputError
from smajax.machines import pseudo_rigid
from smajax.machines.elastica import bend
from smajax.machines.machine import AbstractMachine
from smajax.parameters import parameter


class SoftBar(eqx.Module):
    """The silicone bar, clamped at one end."""

    length: jax.Array = parameter("m", "length of the bar", 1e-3, 10.0)
    width: jax.Array = parameter("m", "width of the bar", 1e-4, 1.0)
    thickness: jax.Array = parameter("m", "thickness of the bar, across which it bends", 1e-4, 1.0)
    modulus: jax.Array = parameter("Pa", "Young's modulus of the silicone", 1e3, 1e10)


class MemoryWires(eqx.Module):
    """The wires in the bar's middle plane, all alike."""

    count: jax.Array = parameter("1", "number of wires side by side", 1.0, 1000.0, whole=True)
    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    modulus_austenite: jax.Array = parameter("Pa", "Young's modulus of the wires when hot", 1e9, 2e11)
    modulus_martensite: jax.Array = parameter("Pa", "Young's modulus of the wires when cold", 1e9, 2e11)
    memory_curvature: jax.Array = parameter("1/m", "curvature of the memory shape", -1e4, 1e4)


class Cable(eqx.Module):
    """What the tip pulls on."""

    force: jax.Array = parameter("N", "force of the cable against the bend, across the undeformed bar", -1e4, 1e4, 0.0)


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
    }

    bar: SoftBar
    wires: MemoryWires
    cable: Cable

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

    def metrics(self) -> dict[str, jax.Array]:
        """The figures named in ``units``.

        ``rod_angle`` (2 alpha) and ``rod_share`` (lambda) are the pseudo-rigid body's, ``rod_stiffness`` that of its hinge's spring: what
        wires and cable turn it with over its angle (eq. 25 holds for M = F L / 3 alone). ``blocking_force`` is the cable's that holds the
        tip where it was, at small slopes; ``cold_strain`` is that at the surface of a wire that lies straight. Of a bar that nothing
        bends, the rod is that of the smallest moment; figures of a bend that there is not (``bend``) are NaN, and so are all of wires that
        do not fit into the bar.
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
        }
        fits = (self.wires.diameter < self.bar.thickness) & (self.wires.count * self.wires.diameter < self.bar.width)
        return {name: jnp.where(fits, value, jnp.nan) for name, value in figures.items()}
