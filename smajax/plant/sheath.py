"""A sheath around a wire: a Bowden cable with a liner of PTFE, in which the wire rubs and which it has to warm (flexible-actuator paper).

Where the sheath is bent through the angle phi in all, the capstan equation gives the tension at the far end of the wire over that at the
joint: exp(mu phi) while the wire contracts, exp(-mu phi) while it is drawn out. At a reversal it passes from one to the other over a small
motion, as all dry friction here does.

Heat goes wire -> liner -> air. With conductances g_w and g_a from wire to liner and from liner to air, and the liner's capacity C_p,

    C dT/dt = joule - g_w (T - T_p)        C_p dT_p/dt = g_w (T - T_p) - g_a (T_p - T_ambient)

In terms of the steady conductance G = g_w g_a / (g_w + g_a), which h(T) of the heat stage stands for, this is

    C dT/dt = joule - G (T - T_ambient) - s G (T - T_ambient - u)        tau du/dt = T - T_ambient - u

with s = g_w / g_a, tau = C_p / (g_w + g_a) and u = (T_p - T_ambient) (g_w + g_a) / g_w: a second node, which is nowhere at s = 0.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import SecondNode


class Sheath(eqx.Module):
    """Friction and heat of a sheath; without friction and conduction the wire hangs free in air."""

    friction: jax.Array = parameter("1", "coefficient of friction between wire and sheath", 0.0, 2.0, 0.0)
    bend: jax.Array = parameter("rad", "angle through which the sheath is bent, all bends together", 0.0, 100.0, 0.0)
    conduction: jax.Array = parameter("1", "conductance from wire to sheath over that from sheath to air", 0.0, 1e3, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the sheath follows a steady wire", 1e-3, 1e4, 5.0)

    def passed(self, z: jax.Array) -> jax.Array:
        """Tension at the joint over the wire's at its far end, friction being engaged by ``z`` in -1..1."""
        return jnp.exp(-self.friction * self.bend * z)


class Liner(SecondNode):
    """The PTFE tube as a second thermal node."""

    strength: jax.Array = parameter("1", "conductance from wire to liner over that from liner to air", 0.0, 1e3, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the liner follows a steady wire", 1e-3, 1e4, 5.0)
    key = "sheath-liner"
    typical = 1.0
    source = "flexible-actuator paper: a PTFE tube between wire and Bowden cable"
