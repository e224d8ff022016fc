"""The knee of a knee-ankle orthosis: two antagonistic SMA springs, and a geared motor behind a clutch (knee-ankle paper, section 3.2).

The springs lie on both sides of a pulley on the joint, stretched alike at angle 0; theta > 0 lengthens spring 1 (eq. 12):

    J theta'' + tau_l = r_p (F_2 - F_1) + N_b T_c        stretches d_1 = d_0 + r_p theta, d_2 = d_0 - r_p theta
    tau_l = f theta' + f_c tanh(theta' / w_0) + m g a sin(theta)

Eq. 12 as printed holds the elastic restoring moment only, r_p^2 (k_1 + k_2) theta, and eq. 17 has |k_1 - k_2| in its place, which is nought
at angle 0: what moves the joint is the difference of the forces. The forces are those of a coil (``smajax.plant.wire``) that follows
Lagoudas' law; a slack one pulls nothing. Each spring has its own voltage and temperature.

The motor's constants are those of its geared output, as its table gives them (0.3 N m/A and 24.48 rpm/V), so the reducer's ratio is in them
already; its rotor's inertia J_m comes to the output as J_m N_m^2. With phi the output's angle (eq. 13, 14, the friction's sign put right):

    L i' = u - R i - K_b phi'        J_m N_m^2 phi'' = K_m i - f_m phi' - f_cm tanh(phi' / w_0) - T_c

A magnetic particle clutch joins it to the belt, N_b theta' (eq. 16, its sign that of the slip w = phi' - N_b theta'):

    T_c = T_rated min(i_c / i_rated, 1) tanh(w / w_slip) + c w        c w only while it is energised

It sticks where less than its torque is asked for, which leaves a slip far below w_slip, and slips where more is. The springs alone (clutch
off), the motor alone (springs cold, eq. 15 with the friction geared and the rotor's inertia kept) and both together (eq. 17) are one set of
equations under three commands.

The phases' fractions follow Lagoudas' law, xi' = (law's fraction at T, sigma - xi) / t_xi: with t_xi -> 0 the law itself.
"""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.kinks import larger, largest, swing, within
from smajax.machines.machine import AbstractMachine
from smajax.parameters import parameter
from smajax.plant.drive import VoltageDrive
from smajax.plant.heat import PolynomialHeat
from smajax.plant.material.base import Fractions
from smajax.plant.material.lagoudas import Lagoudas
from smajax.plant.wire import Coil, Environment

# The share of its excess over the surroundings that a spring has lost when it counts as cooled, as a rig's wires do.
COOLED = 0.9
_FOLLOWS = 0.02  # s, in which the fractions come to what the law says


class Joint(eqx.Module):
    """The knee and what hangs on it."""

    radius: jax.Array = parameter("m", "radius of the pulley on which the springs pull", 1e-4, 1.0)
    inertia: jax.Array = parameter("kg m^2", "moment of inertia of the limb about the joint", 1e-6, 100.0)
    damping: jax.Array = parameter("N m s/rad", "viscous friction of the joint", 0.0, 1e3, 0.0)
    friction: jax.Array = parameter("N m", "dry friction of the joint", 0.0, 1e3, 0.0)
    mass: jax.Array = parameter("kg", "mass that hangs on the joint", 0.0, 1e3, 0.0)
    lever: jax.Array = parameter("m", "distance of that mass from the joint", 0.0, 10.0, 0.0)
    slow: jax.Array = parameter("rad/s", "rate above which dry friction is nearly whole, of joint and motor", 1e-6, 1.0, 0.01)


class Motor(eqx.Module):
    """A geared motor; constants are those of its output shaft."""

    resistance: jax.Array = parameter("ohm", "resistance of the windings", 1e-4, 1e4)
    inductance: jax.Array = parameter("H", "inductance of the windings", 1e-7, 10.0)
    torque_constant: jax.Array = parameter("N m/A", "torque at the output over current", 0.0, 1e3)
    back_voltage: jax.Array = parameter("V s/rad", "voltage over the output's speed", 1e-6, 1e3)
    reduction: jax.Array = parameter("1", "turns of the rotor for one of the output", 1.0, 1e4)
    rotor_inertia: jax.Array = parameter("kg m^2", "moment of inertia of the rotor", 1e-9, 10.0)
    current: jax.Array = parameter("A", "current for which it is rated", 1e-3, 1e3)
    damping: jax.Array = parameter("N m s/rad", "viscous friction at the output", 0.0, 1e3, 0.0)
    friction: jax.Array = parameter("N m", "dry friction at the output", 0.0, 1e3, 0.0)


class Clutch(eqx.Module):
    """A magnetic particle clutch on the motor's output, and the belt behind it."""

    torque: jax.Array = parameter("N m", "torque at the rated current", 0.0, 1e4)
    current: jax.Array = parameter("A", "rated current", 1e-4, 100.0)
    belt: jax.Array = parameter("1", "turns of the clutch for one of the joint", 1e-2, 100.0)
    slip: jax.Array = parameter("rad/s", "slip above which the torque is nearly whole", 1e-5, 10.0, 0.05)
    damping: jax.Array = parameter("N m s/rad", "torque that grows with the slip", 0.0, 1e3, 0.0)

    def share(self, current: jax.Array) -> jax.Array:
        """The share of the rated torque at a current in A."""
        return within(current / self.current, 0.0, 1.0)

    def transmitted(self, slip: jax.Array, current: jax.Array) -> jax.Array:
        """Torque in N m from the motor to the belt, at the clutch."""
        on = self.share(current)
        return self.torque * on * jnp.tanh(slip / self.slip) + jnp.where(on > 0, self.damping, 0.0) * slip


class KneeCommand(eqx.Module):
    """What is switched on, from rest, for ``duration``: the state in which the knee works."""

    duration: jax.Array = parameter("s", "time for which it is so", 1e-3, 1e5)
    first: jax.Array = parameter("V", "voltage on spring 1, which draws the angle back", 0.0, 1e3, 0.0)
    second: jax.Array = parameter("V", "voltage on spring 2, which turns the angle forward", 0.0, 1e3, 0.0)
    motor: jax.Array = parameter("V", "voltage on the motor", -1e3, 1e3, 0.0)
    clutch: jax.Array = parameter("A", "current of the clutch", 0.0, 100.0, 0.0)


class KneeState(NamedTuple):
    """The knee at one instant: temperatures and fractions of the springs, shape ``(2,)``, the rest scalars; angles of joint and motor."""

    temperature: jax.Array
    fractions: Fractions
    angle: jax.Array
    rate: jax.Array
    shaft: jax.Array
    shaft_rate: jax.Array
    current: jax.Array


class Knee(AbstractMachine):
    """Springs, motor and clutch on a knee (see the module's text)."""

    units: ClassVar[Mapping[str, str]] = {
        "austenite_stiffness": "N/m",
        "martensite_stiffness": "N/m",
        "spring_resistance": "ohm",
        "heating_time": "s",
        "spring_torque": "N m",
        "motor_speed": "rad/s",
        "motor_torque": "N m",
        "motor_torque_at_knee": "N m",
        "clutch_torque_at_knee": "N m",
        "angle": "rad",
        "stroke": "rad",
        "force": "N",
        "peak_temperature": "degC",
        "energy_per_cycle": "J",
        "work_per_cycle": "J",
        "efficiency": "1",
        "time_to_cool": "s",
        "bandwidth": "Hz",
        "slip": "rad/s",
        "clutch_sticks": "1",
    }
    drive: VoltageDrive
    wire: Coil
    material: Lagoudas
    heat: PolynomialHeat
    environment: Environment
    joint: Joint
    motor: Motor
    clutch: Clutch
    command: KneeCommand

    def stiffness(self, martensite: jax.Array) -> jax.Array:
        """Stiffness of one spring in N/m at a martensite fraction (eq. 7)."""
        modulus = self._law.modulus(Fractions(martensite, jnp.zeros_like(martensite)))
        return modulus * self.wire.force_per_stress / self.wire.motion_per_strain

    def stretch(self, angle: jax.Array) -> jax.Array:
        """Stretch of the springs in m, shape ``(2,)``."""
        return self.wire.prestretch + self.joint.radius * angle * jnp.array([1.0, -1.0])

    def stress(self, fractions: Fractions, temperature: jax.Array, stretch: jax.Array) -> jax.Array:
        """Stress that the law sees in springs of a stretch in m; none in a slack one."""
        free = self._law.strain(fractions, temperature, jnp.zeros_like(stretch), self.environment.ambient)
        return larger(self._law.modulus(fractions) * (stretch / self.wire.motion_per_strain - free), 0.0)

    def forces(self, state: KneeState) -> jax.Array:
        """Pull of the springs in N, shape ``(2,)``."""
        return self.wire.force_per_stress * self.stress(state.fractions, state.temperature, self.stretch(state.angle))

    def power(self, state: KneeState) -> jax.Array:
        """Electrical power into springs and motor in W; the clutch's, whose resistance is not known, is left out."""
        voltage = jnp.stack([self.command.first, self.command.second])
        joule = self.drive.joule(voltage, self._law.resistivity(state.fractions), self.wire)
        return jnp.sum(joule) * self.wire.area * self.wire.length + self.command.motor * state.current

    def start(self) -> KneeState:
        """At rest at angle 0 and ambient temperature, the springs drawn out cold."""
        nothing = jnp.zeros(())
        cold = self._law.installed(jnp.broadcast_to(self.wire.prestrain, (2,)))
        return KneeState(jnp.broadcast_to(self.environment.ambient, (2,)), cold, nothing, nothing, nothing, nothing, nothing)

    def slip(self, state: KneeState) -> jax.Array:
        """Slip of the clutch in rad/s."""
        return state.shaft_rate - self.clutch.belt * state.rate

    def slope(self, state: KneeState, command: KneeCommand) -> KneeState:
        """Rate of change of every part of the state."""
        voltage = jnp.stack([command.first, command.second])
        joule = self.drive.joule(voltage, self._law.resistivity(state.fractions), self.wire)
        warming = self.heat.rate(joule, state.temperature, self.wire, self.environment) / self.heat.capacity(state.fractions.martensite)
        stress = self.stress(state.fractions, state.temperature, self.stretch(state.angle))
        due = self._law.due(state.fractions, state.temperature, stress)
        pull = self.wire.force_per_stress * stress
        passed = self.clutch.transmitted(self.slip(state), command.clutch)
        joint, motor = self.joint, self.motor
        weight = joint.mass * self.environment.gravity * joint.lever * jnp.sin(state.angle)
        held = joint.damping * state.rate + joint.friction * jnp.tanh(state.rate / joint.slow) + weight
        turning = joint.radius * (pull[1] - pull[0]) + self.clutch.belt * passed - held
        rubbed = motor.damping * state.shaft_rate + motor.friction * jnp.tanh(state.shaft_rate / joint.slow)
        driving = motor.torque_constant * state.current - rubbed - passed
        drop = command.motor - motor.resistance * state.current - motor.back_voltage * state.shaft_rate
        return KneeState(
            warming,
            Fractions(*(change / _FOLLOWS for change in due)),
            state.rate,
            turning / joint.inertia,
            state.shaft_rate,
            driving / (motor.rotor_inertia * motor.reduction**2),
            drop / motor.inductance,
        )

    def roll(self, share: jax.Array, command: KneeCommand | None = None, *, rtol: float = 1e-6, atol: float = 1e-8) -> KneeState:
        """The states at shares 0..1 of the command's duration, rising, shape ``(n,)``: each part with a leading axis of ``n``.

        Differentiable forwards. NaN from where the steps ran out.
        """
        command = command or self.command
        # Time counts in durations, so that the duration has its derivative.
        solution = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, args: _course(self, y, command)),
            dfx.Kvaerno3(),
            0.0,
            1.0,
            None,
            self.start(),
            stepsize_controller=dfx.PIDController(rtol=rtol, atol=atol, dtmax=0.02),
            saveat=dfx.SaveAt(ts=share),
            max_steps=20_000,
            adjoint=dfx.ForwardMode(),
            throw=False,
        )
        done = solution.result == dfx.RESULTS.successful
        return jax.tree.map(lambda leaf: jnp.where(done, leaf, jnp.nan), solution.ys)

    def metrics(self) -> dict[str, jax.Array]:
        """See ``AbstractMachine``: the parts' own figures, and what the command makes of them.

        ``stroke`` is the largest less the smallest angle, ``force`` the largest pull of a spring. A cycle is the command, and the cooling
        after it: ``energy_per_cycle`` is what springs and motor take while the command lasts, since going back takes none,
        ``work_per_cycle`` what springs do while they shorten and the clutch while it drives the joint, ``efficiency`` their ratio (0 where
        nothing is taken), and ``bandwidth`` the rate of such cycles.
        """
        one, none = jnp.ones(()), jnp.zeros(())
        share = jnp.linspace(0.0, 1.0, 201)
        way = self.roll(share)
        end = jax.tree.map(lambda leaf: leaf[-1], way)
        passed = jnp.abs(self.clutch.transmitted(self.slip(end), self.command.clutch))
        whole = self.clutch.torque * self.clutch.share(self.command.clutch)
        hot = self.stiffness(none) * self.wire.prestretch
        energy = self.command.duration * jnp.trapezoid(jax.vmap(self.power)(way), share)
        work, cooling = self.work(way), self.time_to_cool(end)
        found = {
            "austenite_stiffness": self.stiffness(none),
            "martensite_stiffness": self.stiffness(one),
            "spring_resistance": self.material.resistivity_martensite * self.wire.length / self.wire.area,
            "heating_time": self.heating_time(larger(self.command.first, self.command.second)),
            "spring_torque": self.joint.radius * hot,
            "motor_speed": self.motor_speed(self.command.motor),
            "motor_torque": self.motor.torque_constant * self.motor.current,
            "motor_torque_at_knee": self.clutch.belt * self.motor.torque_constant * self.motor.current,
            "clutch_torque_at_knee": self.clutch.belt * self.clutch.torque,
            "angle": end.angle,
            "stroke": swing(way.angle),
            "force": largest(jax.vmap(self.forces)(way)),
            "peak_temperature": largest(way.temperature),
            "energy_per_cycle": energy,
            "work_per_cycle": work,
            "efficiency": jnp.where(energy > 0.0, work / jnp.where(energy > 0.0, energy, 1.0), 0.0),
            "time_to_cool": cooling,
            "bandwidth": 1.0 / (self.command.duration + cooling),
            "slip": self.slip(end),
            "clutch_sticks": jnp.where((whole > 0) & (passed < whole * jnp.tanh(1.0)), 1.0, 0.0),
        }
        return {n: jnp.where(self.wire.fits, value, jnp.nan) for n, value in found.items()}

    def work(self, way: KneeState) -> jax.Array:
        """Work in J along a way of ``n`` states: of the springs while they shorten, and of the clutch while it drives the joint.

        By the trapezoidal rule, each from state to state where it is positive.
        """
        pull, turned = jax.vmap(self.forces)(way), jnp.diff(way.angle)
        shortened = self.joint.radius * jnp.stack([-turned, turned], axis=1)
        drive = self.clutch.belt * self.clutch.transmitted(self.slip(way), self.command.clutch)
        springs = jnp.sum(larger(0.5 * (pull[1:] + pull[:-1]) * shortened, 0.0))
        return springs + jnp.sum(larger(0.5 * (drive[1:] + drive[:-1]) * turned, 0.0))

    def time_to_cool(self, state: KneeState) -> jax.Array:
        """Time in s in which the hottest heated spring loses 90 % of its excess over the surroundings; 0 where none is heated.

        By the heat balance without current, C dT/dt = -g(T) (T - T_ambient), and the capacity of the mean of both phases: the integral of
        C / g over the logarithm of the excess.
        """
        heated = jnp.stack([self.command.first, self.command.second]) > 0.0
        excess = largest(state.temperature) - self.environment.ambient
        points, weights = np.polynomial.legendre.leggauss(12)
        fall = jnp.log(1.0 / (1.0 - COOLED))
        temperature = self.environment.ambient + excess * jnp.exp(-0.5 * fall * (1.0 + points))
        slowness = self.heat.capacity(jnp.asarray(0.5)) / self.heat.conductance(temperature, self.wire)
        return jnp.where(jnp.any(heated), 0.5 * fall * jnp.sum(weights * slowness), 0.0)

    def heating_time(self, voltage: jax.Array) -> jax.Array:
        """Time in s in which a spring without load warms up to its austenite finish; infinite where it never does.

        By the resistivity and capacity of the mean of both phases, and h at the mean temperature.
        """
        rho = 0.5 * (self.material.resistivity_austenite + self.material.resistivity_martensite)
        target = self.material.austenite_finish - self.environment.ambient
        loss = self.heat.conductance(self.environment.ambient + 0.5 * target, self.wire)
        joule = self.drive.joule(voltage, rho, self.wire)
        share = loss * target / jnp.where(joule > 0, joule, 1.0)
        warms = (joule > 0) & (share < 1.0)
        return jnp.where(warms, -self.heat.capacity(jnp.asarray(0.5)) / loss * jnp.log1p(-jnp.where(warms, share, 0.0)), jnp.inf)

    def motor_speed(self, voltage: jax.Array) -> jax.Array:
        """Speed of the motor's output in rad/s without load; by its constants alone, friction apart."""
        return voltage / self.motor.back_voltage

    @property
    def _law(self) -> Lagoudas:
        return self.material.stiffened(self.wire.modulus_factor)  # pyright: ignore[reportReturnType]


@eqx.filter_jit  # traced once for all stages of a step, their Jacobians and tangents
def _course(knee: Knee, state: KneeState, command: KneeCommand) -> KneeState:
    """Rate of change of the state by the share of the command's duration."""
    return jax.tree.map(lambda rate: command.duration * rate, knee.slope(state, command))
