"""Parts of the knee of a knee-ankle orthosis: joint, geared motor, magnetic particle clutch, command.

Source: hybrid_knee_ankle_orthosis, section 3.2.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip
from smajax.parameters import CheckedModule, parameter


class Joint(CheckedModule):
    """Knee joint and the mass that hangs on it."""

    radius: jax.Array = parameter("m", "radius of the pulley on which the springs pull", 1e-4, 1.0)
    inertia: jax.Array = parameter("kg m^2", "moment of inertia of the limb about the joint", 1e-6, 100.0)
    damping: jax.Array = parameter("N m s/rad", "viscous friction of the joint", 0.0, 1e3, 0.0)
    friction: jax.Array = parameter("N m", "dry friction of the joint", 0.0, 1e3, 0.0)
    mass: jax.Array = parameter("kg", "mass that hangs on the joint", 0.0, 1e3, 0.0)
    lever: jax.Array = parameter("m", "distance of that mass from the joint", 0.0, 10.0, 0.0)
    slow: jax.Array = parameter(
        "rad/s", "rate above which dry friction is nearly complete, of joint and motor", 1e-6, 1.0, 0.01
    )


class Motor(CheckedModule):
    """Geared motor; its constants are those of the output shaft."""

    resistance: jax.Array = parameter("ohm", "resistance of the windings", 1e-4, 1e4)
    inductance: jax.Array = parameter("H", "inductance of the windings", 1e-7, 10.0)
    torque_constant: jax.Array = parameter("N m/A", "torque at the output over current", 0.0, 1e3)
    back_voltage: jax.Array = parameter("V s/rad", "voltage over the output's speed", 1e-6, 1e3)
    reduction: jax.Array = parameter("1", "turns of the rotor for one of the output", 1.0, 1e4)
    rotor_inertia: jax.Array = parameter("kg m^2", "moment of inertia of the rotor", 1e-9, 10.0)
    current: jax.Array = parameter("A", "current for which it is rated", 1e-3, 1e3)
    damping: jax.Array = parameter("N m s/rad", "viscous friction at the output", 0.0, 1e3, 0.0)
    friction: jax.Array = parameter("N m", "dry friction at the output", 0.0, 1e3, 0.0)


class Clutch(CheckedModule):
    """Magnetic particle clutch on the motor's output, and the belt behind it."""

    torque: jax.Array = parameter("N m", "torque at the rated current", 0.0, 1e4)
    current: jax.Array = parameter("A", "rated current", 1e-4, 100.0)
    belt: jax.Array = parameter("1", "turns of the clutch for one of the joint", 1e-2, 100.0)
    slip: jax.Array = parameter("rad/s", "slip above which the torque is nearly complete", 1e-5, 10.0, 0.05)
    damping: jax.Array = parameter("N m s/rad", "torque that grows with the slip", 0.0, 1e3, 0.0)

    def torque_share(self, current: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the share of the rated torque, min(i_c / i_rated, 1), at a current in A."""
        return clip(current / self.current, 0.0, 1.0)

    def transmitted_torque(self, slip: Float[Array, "..."], current: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the torque from the motor to the belt, elementwise.

        T_c = T_rated min(i_c / i_rated, 1) tanh(w / w_slip) + c w, with c w only while the clutch is energised.

        Args:
            slip: Slip w, rad/s.
            current: Current i_c of the clutch, A.

        Returns:
            Torque T_c at the clutch in N m.

        Source: hybrid_knee_ankle_orthosis, equation 16, with the sign of the slip w.
        """
        share = self.torque_share(current)
        return self.torque * share * jnp.tanh(slip / self.slip) + jnp.where(share > 0, self.damping, 0.0) * slip


class KneeCommand(CheckedModule):
    """Voltages and current that are switched on, from rest, for ``duration``: the working state of the knee."""

    duration: jax.Array = parameter("s", "time for which they are switched on", 1e-3, 1e5)
    first: jax.Array = parameter("V", "voltage on spring 1, which draws the angle back", 0.0, 1e3, 0.0)
    second: jax.Array = parameter("V", "voltage on spring 2, which turns the angle forward", 0.0, 1e3, 0.0)
    motor: jax.Array = parameter("V", "voltage on the motor", -1e3, 1e3, 0.0)
    clutch: jax.Array = parameter("A", "current of the clutch", 0.0, 100.0, 0.0)
