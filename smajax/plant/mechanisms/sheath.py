"""Sheath around a wire: a Bowden cable with a PTFE liner, with capstan friction and heat exchange.

Capstan friction: with the total wrap angle phi of the bent sheath and the friction coefficient mu, the tension at the
joint over that at the far end of the wire is

    F_joint / F_far = exp(-mu phi z)

where z = 1 while the wire contracts and z = -1 while it is stretched. At a reversal the presliding state z changes from
one to the other over a small motion (``smajax.plant.effects.memory.presliding_state``).

Heat flows wire -> liner -> air. With conductances g_w and g_a from wire to liner and from liner to air, and the liner's
capacity C_p,

    C dT/dt = joule - g_w (T - T_p)        C_p dT_p/dt = g_w (T - T_p) - g_a (T_p - T_ambient)

In terms of the steady conductance G = g_w g_a / (g_w + g_a), which is that of h(T) in the heat stage, this is

    C dT/dt = joule - G (T - T_ambient) - s G (T - T_ambient - u)        tau du/dt = T - T_ambient - u

with s = g_w / g_a, tau = C_p / (g_w + g_a) and u = (T_p - T_ambient) (g_w + g_a) / g_w: a second thermal node, absent
at s = 0.

Source: copaci2020 for the PTFE tube in a Bowden cable.
"""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.effects.base import ThermalNode


class Sheath(CheckedModule):
    """Friction and heat of a sheath; with the default values the wire is free in air."""

    friction: jax.Array = parameter("1", "coefficient of friction between wire and sheath", 0.0, 2.0, 0.0)
    wrap_angle: jax.Array = parameter(
        "rad", "angle through which the sheath is bent, all bends together", 0.0, 100.0, 0.0
    )
    conductance_ratio: jax.Array = parameter(
        "1", "conductance from wire to sheath over that from sheath to air", 0.0, 1e3, 0.0
    )
    time_constant: jax.Array = parameter("s", "time in which the sheath follows a steady wire", 1e-3, 1e4, 5.0)

    def tension_ratio(self, z: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the tension at the joint over that at the far end by the capstan equation, exp(-mu phi z).

        Args:
            z: Presliding state of the friction, -1 (the wire is stretched) to 1 (it contracts).
        """
        return jnp.exp(-self.friction * self.wrap_angle * z)


class Liner(ThermalNode):
    """PTFE tube as a second thermal node."""

    strength: jax.Array = parameter("1", "conductance from wire to liner over that from liner to air", 0.0, 1e3, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the liner follows a steady wire", 1e-3, 1e4, 5.0)
    key = "sheath-liner"
    typical: ClassVar[float] = 1.0
    source = "copaci2020: a PTFE tube between wire and Bowden cable"
