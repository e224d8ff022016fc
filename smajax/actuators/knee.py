"""Knee of a knee-ankle orthosis: two antagonistic SMA springs, and a geared motor behind a clutch.

The springs pull on both sides of a pulley on the joint. At angle 0 both have the same stretch d_0; theta > 0 lengthens
spring 1 (equation 12):

    J theta'' + tau_l = r_p (F_2 - F_1) + N_b T_c        stretches d_1 = d_0 + r_p theta, d_2 = d_0 - r_p theta
    tau_l = f theta' + f_c tanh(theta' / w_0) + m g a sin(theta)

Equation 12 as printed has only the elastic restoring moment, r_p^2 (k_1 + k_2) theta, in place of the difference of the
forces, and equation 17 has |k_1 - k_2|, which is 0 at angle 0. The forces are those of a coil (``smajax.plant.coil``)
with Lagoudas' law; a slack spring has no force. Each spring has its own voltage and temperature.

The constants of the motor are those of its geared output, as in the paper's table (0.3 N m/A and 24.48 rpm/V). They
include the ratio N_m of the reducer; the inertia J_m of the rotor appears at the output as J_m N_m^2. With phi the
angle of the output (equations 13 and 14, with the sign of the friction corrected):

    L i' = u - R i - K_b phi'        J_m N_m^2 phi'' = K_m i - f_m phi' - f_cm tanh(phi' / w_0) - T_c

A magnetic particle clutch connects the output to the belt, which moves at N_b theta' (equation 16, with the sign of the
slip w = phi' - N_b theta'):

    T_c = T_rated min(i_c / i_rated, 1) tanh(w / w_slip) + c w        c w only while it is energised

The clutch sticks, with a slip far below w_slip, if the load requires less than its torque; otherwise it slips. One set
of equations serves three commands: springs alone (clutch off), motor alone (springs cold; equation 15, with the
friction at the output and the rotor's inertia included), and both together (equation 17).

The phase fractions xi follow Lagoudas' law with a short time constant t_xi; for t_xi -> 0 this is the law itself:

    xi' = (xi_law(T, sigma) - xi) / t_xi

Source: hybrid_knee_ankle_orthosis, section 3.2.
"""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.actuators.base import AbstractActuator
from smajax.actuators.knee_parts import Clutch, Joint, KneeCommand, Motor
from smajax.numerics.nonsmooth import largest, maximum, peak_to_peak
from smajax.plant.coil import Coil
from smajax.plant.convection import PolynomialConvection
from smajax.plant.drive import VoltageDrive
from smajax.plant.materials.base import Fractions
from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.wire import Environment

# Share of its excess over the surroundings that a spring has lost when it counts as cooled, as for a rig's wires.
COOLED_SHARE = 0.9
# Time constant t_xi in s with which the fractions follow the law: short compared with heating and cooling, chosen by
# trial; tests/unit/actuators/test_knee.py compares it with a quarter of it.
_FRACTION_TIME_CONSTANT = 0.02
# Longest step of a simulation, as a share of the command's duration; chosen by trial.
_LONGEST_STEP = 0.02
# Largest number of steps of a simulation; chosen by trial.
_MAX_STEPS = 20_000
# Rows of the trajectory from which the metrics are computed; chosen by trial, tests/unit/actuators/test_knee.py holds
# it.
_ROWS = 201
# Gauss-Legendre points for the cooling time, far more than its smooth integrand needs.
_QUADRATURE_POINTS = 12


class KneeState(NamedTuple):
    """State of the knee at one instant.

    Attributes:
        temperature: Temperatures of the springs, shape ``(2,)``, degC.
        fractions: Martensite fractions of the springs, shape ``(2,)`` each.
        angle: Angle of the joint, rad.
        rate: Rate of the joint, rad/s.
        shaft: Angle of the motor's output shaft, rad.
        shaft_rate: Rate of the output shaft, rad/s.
        current: Current of the motor, A.
    """

    temperature: jax.Array
    fractions: Fractions
    angle: jax.Array
    rate: jax.Array
    shaft: jax.Array
    shaft_rate: jax.Array
    current: jax.Array


class Knee(AbstractActuator):
    """Springs, motor and clutch on a knee."""

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
    heat: PolynomialConvection
    environment: Environment
    joint: Joint
    motor: Motor
    clutch: Clutch
    command: KneeCommand

    def stiffness(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the stiffness of one spring.

        Args:
            martensite: Martensite fraction xi.

        Returns:
            Stiffness in N/m.

        Source: hybrid_knee_ankle_orthosis, equation 7.
        """
        modulus = self._effective_material.modulus(Fractions(martensite, jnp.zeros_like(martensite)))
        return modulus * self.wire.force_per_stress / self.wire.motion_per_strain

    def stretch(self, angle: Float[Array, ""]) -> Float[Array, "2"]:
        """Compute the stretch of both springs: d_0 + r_p theta, d_0 - r_p theta.

        Args:
            angle: Angle theta of the joint, rad.

        Returns:
            Stretches in m.
        """
        return self.wire.prestretch + self.joint.radius * angle * jnp.array([1.0, -1.0])

    def stress(
        self, fractions: Fractions, temperature: Float[Array, "..."], stretch: Float[Array, "..."]
    ) -> Float[Array, "..."]:
        """Compute the stress of the material law in a spring, elementwise.

        Args:
            fractions: Martensite fractions.
            temperature: Temperature, degC.
            stretch: Stretch of the spring, m.

        Returns:
            Equivalent tension (``smajax.plant.coil``) in Pa; 0 in a slack spring.
        """
        material = self._effective_material
        free_strain = material.strain(fractions, temperature, jnp.zeros_like(stretch), self.environment.ambient)
        return maximum(material.modulus(fractions) * (stretch / self.wire.motion_per_strain - free_strain), 0.0)

    def forces(self, state: KneeState) -> Float[Array, "2"]:
        """Compute the forces of both springs in N."""
        return self.wire.force_per_stress * self.stress(state.fractions, state.temperature, self.stretch(state.angle))

    def power(self, state: KneeState) -> Float[Array, ""]:
        """Compute the electrical power into springs and motor in W; the clutch's is left out (unknown resistance)."""
        joule = self._joule(state, self.command)
        return jnp.sum(joule) * self.wire.area * self.wire.length + self.command.motor * state.current

    def init(self) -> KneeState:
        """Return the state at rest: at angle 0 and ambient temperature, with cold, stretched springs."""
        zero = jnp.zeros(())
        fractions = self._effective_material.installed_fractions(jnp.broadcast_to(self.wire.prestrain, (2,)))
        return KneeState(jnp.broadcast_to(self.environment.ambient, (2,)), fractions, zero, zero, zero, zero, zero)

    def slip(self, state: KneeState) -> Float[Array, "..."]:
        """Compute the slip of the clutch, w = phi' - N_b theta', in rad/s; elementwise for a trajectory."""
        return state.shaft_rate - self.clutch.belt * state.rate

    def rates(self, state: KneeState, command: KneeCommand) -> KneeState:
        """Compute the rate of change of the state by the equations of the module.

        Args:
            state: The state.
            command: The command at that instant.

        Returns:
            The rate of each part of the state, per second.
        """
        joule = self._joule(state, command)
        heating = self.heat.net_heat(joule, state.temperature, self.wire, self.environment) / self.heat.capacity(
            state.fractions.martensite
        )
        stress = self.stress(state.fractions, state.temperature, self.stretch(state.angle))
        increment = self._effective_material.equilibrium_increment(state.fractions, state.temperature, stress)
        clutch_torque = self.clutch.transmitted_torque(self.slip(state), command.clutch)
        voltage_drop = (
            command.motor - self.motor.resistance * state.current - self.motor.back_voltage * state.shaft_rate
        )
        return KneeState(
            heating,
            Fractions(*(change / _FRACTION_TIME_CONSTANT for change in increment)),
            state.rate,
            self._joint_acceleration(state, self.wire.force_per_stress * stress, clutch_torque),
            state.shaft_rate,
            self._shaft_acceleration(state, clutch_torque),
            voltage_drop / self.motor.inductance,
        )

    def _joule(self, state: KneeState, command: KneeCommand) -> jax.Array:
        """Joule heat of the springs per volume, shape ``(2,)``, W/m^3."""
        voltage = jnp.stack([command.first, command.second])
        return self.drive.joule(voltage, self._effective_material.resistivity(state.fractions), self.wire)

    def _joint_acceleration(self, state: KneeState, forces: jax.Array, clutch_torque: jax.Array) -> jax.Array:
        joint = self.joint
        weight = joint.mass * self.environment.gravity * joint.lever * jnp.sin(state.angle)
        load = joint.damping * state.rate + joint.friction * jnp.tanh(state.rate / joint.slow) + weight
        torque = joint.radius * (forces[1] - forces[0]) + self.clutch.belt * clutch_torque - load
        return torque / joint.inertia

    def _shaft_acceleration(self, state: KneeState, clutch_torque: jax.Array) -> jax.Array:
        motor = self.motor
        friction = motor.damping * state.shaft_rate + motor.friction * jnp.tanh(state.shaft_rate / self.joint.slow)
        torque = motor.torque_constant * state.current - friction - clutch_torque
        return torque / (motor.rotor_inertia * motor.reduction**2)

    def trajectory(
        self,
        share: Float[Array, " rows"],
        command: KneeCommand | None = None,
        *,
        rtol: float = 1e-6,
        atol: float = 1e-8,
    ) -> KneeState:
        """Simulate the command from rest; differentiable in forward mode.

        Args:
            share: Shares 0..1 of the command's duration, rising, shape ``(n,)``.
            command: The command; by default the knee's own.
            rtol: Relative tolerance of the steps.
            atol: Absolute tolerance of the steps.

        Returns:
            The states at these shares, each part with a leading axis of ``n``; NaN if the number of steps was not
            sufficient.
        """
        command = command or self.command
        # The unit of time is the duration, so that the derivative with respect to the duration exists.
        solution = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, args: _rates_per_duration(self, y, command)),
            dfx.Kvaerno3(),
            0.0,
            1.0,
            None,
            self.init(),
            stepsize_controller=dfx.PIDController(rtol=rtol, atol=atol, dtmax=_LONGEST_STEP),
            saveat=dfx.SaveAt(ts=share),
            max_steps=_MAX_STEPS,
            adjoint=dfx.ForwardMode(),
            throw=False,
        )
        succeeded = solution.result == dfx.RESULTS.successful
        return jax.tree.map(lambda leaf: jnp.where(succeeded, leaf, jnp.nan), solution.ys)

    def metrics(self) -> dict[str, Float[Array, ""]]:
        """Compute the metrics named in ``units``: those of the parts, and those of the command.

        ``stroke`` is the largest less the smallest angle, ``force`` the largest force of a spring. A cycle consists of
        the command and the cooling after it. ``energy_per_cycle`` is the energy of springs and motor during the
        command; the cooling requires none. ``work_per_cycle`` is the work of the springs while they shorten plus that
        of the clutch while it drives the joint. ``efficiency`` is their ratio (0 without energy), and ``bandwidth`` the
        rate of such cycles.
        """
        values = self._part_metrics() | self._command_metrics()
        return {name: jnp.where(self.wire.fits, values[name], jnp.nan) for name in self.units}

    def _part_metrics(self) -> dict[str, jax.Array]:
        """Metrics of springs, motor and clutch alone."""
        zero, one = jnp.zeros(()), jnp.ones(())
        hot_force = self.stiffness(zero) * self.wire.prestretch
        motor_torque = self.motor.torque_constant * self.motor.current
        return {
            "austenite_stiffness": self.stiffness(zero),
            "martensite_stiffness": self.stiffness(one),
            "spring_resistance": self.material.resistivity_martensite * self.wire.length / self.wire.area,
            "heating_time": self.heating_time(maximum(self.command.first, self.command.second)),
            "spring_torque": self.joint.radius * hot_force,
            "motor_speed": self.motor_speed(self.command.motor),
            "motor_torque": motor_torque,
            "motor_torque_at_knee": self.clutch.belt * self.motor.torque_constant * self.motor.current,
            "clutch_torque_at_knee": self.clutch.belt * self.clutch.torque,
        }

    def _command_metrics(self) -> dict[str, jax.Array]:
        """Metrics of a cycle of the command."""
        share = jnp.linspace(0.0, 1.0, _ROWS)
        states = self.trajectory(share)
        end = jax.tree.map(lambda leaf: leaf[-1], states)
        torque = jnp.abs(self.clutch.transmitted_torque(self.slip(end), self.command.clutch))
        available_torque = self.clutch.torque * self.clutch.torque_share(self.command.clutch)
        energy = self.command.duration * jnp.trapezoid(jax.vmap(self.power)(states), share)
        work, cooling = self.work(states), self.time_to_cool(end)
        sticks = (available_torque > 0) & (torque < available_torque * jnp.tanh(1.0))
        return {
            "angle": end.angle,
            "stroke": peak_to_peak(states.angle),
            "force": largest(jax.vmap(self.forces)(states)),
            "peak_temperature": largest(states.temperature),
            "energy_per_cycle": energy,
            "work_per_cycle": work,
            "efficiency": jnp.where(energy > 0.0, work / jnp.where(energy > 0.0, energy, 1.0), 0.0),
            "time_to_cool": cooling,
            "bandwidth": 1.0 / (self.command.duration + cooling),
            "slip": self.slip(end),
            "clutch_sticks": jnp.where(sticks, 1.0, 0.0),
        }

    def work(self, states: KneeState) -> Float[Array, ""]:
        """Compute the work of springs and clutch along a trajectory, by the trapezoidal rule.

        The springs do work while they shorten, the clutch while it drives the joint: intervals with negative work do
        not count.

        Args:
            states: States of the trajectory, each part with a leading axis.

        Returns:
            Work in J.
        """
        forces, rotation = jax.vmap(self.forces)(states), jnp.diff(states.angle)
        shortening = self.joint.radius * jnp.stack([-rotation, rotation], axis=1)
        torque = self.clutch.belt * self.clutch.transmitted_torque(self.slip(states), self.command.clutch)
        springs = jnp.sum(maximum(0.5 * (forces[1:] + forces[:-1]) * shortening, 0.0))
        return springs + jnp.sum(maximum(0.5 * (torque[1:] + torque[:-1]) * rotation, 0.0))

    def time_to_cool(self, state: KneeState) -> Float[Array, ""]:
        """Compute the time in which the hottest spring loses 90 % of its excess temperature over ambient.

        The heat balance without current is C dT/dt = -g(T) (T - T_ambient), with the mean capacity C of both phases.
        The time is the integral of C / g over the logarithm of the excess.

        Args:
            state: State at the end of the command.

        Returns:
            Time in s; 0 if the command heats no spring.
        """
        heated = jnp.stack([self.command.first, self.command.second]) > 0.0
        excess = largest(state.temperature) - self.environment.ambient
        points, weights = np.polynomial.legendre.leggauss(_QUADRATURE_POINTS)
        log_ratio = jnp.log(1.0 / (1.0 - COOLED_SHARE))
        temperature = self.environment.ambient + excess * jnp.exp(-0.5 * log_ratio * (1.0 + points))
        time_constant = self.heat.capacity(jnp.asarray(0.5)) / self.heat.conductance(temperature, self.wire)
        return jnp.where(jnp.any(heated), 0.5 * log_ratio * jnp.sum(weights * time_constant), 0.0)

    def heating_time(self, voltage: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the time in which a spring without load reaches its austenite finish temperature.

        Resistivity and heat capacity are the means of both phases; h is that of the mean temperature.

        Args:
            voltage: Voltage on the spring, V.

        Returns:
            Time in s; infinite if the spring does not reach the temperature.
        """
        resistivity = 0.5 * (self.material.resistivity_austenite + self.material.resistivity_martensite)
        target = self.material.austenite_finish - self.environment.ambient
        conductance = self.heat.conductance(self.environment.ambient + 0.5 * target, self.wire)
        joule = self.drive.joule(voltage, resistivity, self.wire)
        share = conductance * target / jnp.where(joule > 0, joule, 1.0)
        reaches = (joule > 0) & (share < 1.0)
        capacity = self.heat.capacity(jnp.asarray(0.5))
        return jnp.where(reaches, -capacity / conductance * jnp.log1p(-jnp.where(reaches, share, 0.0)), jnp.inf)

    def motor_speed(self, voltage: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the speed of the motor's output without load and friction, in rad/s, at a voltage in V."""
        return voltage / self.motor.back_voltage

    @property
    def _effective_material(self) -> Lagoudas:
        return self.material.with_scaled_moduli(self.wire.modulus_factor)  # pyright: ignore[reportReturnType]


@eqx.filter_jit  # traced once for all stages of a step, their Jacobians and tangents
def _rates_per_duration(knee: Knee, state: KneeState, command: KneeCommand) -> KneeState:
    """Rate of change of the state per share of the command's duration."""
    return jax.tree.map(lambda rate: command.duration * rate, knee.rates(state, command))
