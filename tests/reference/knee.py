"""The knee of springs, motor and clutch, in shear variables of the springs and integrated by SciPy: shares no code with smajax."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

Floats = NDArray[np.float64]
ROOT3 = math.sqrt(3.0)


@dataclass(frozen=True)
class Knee:
    """Parameters of a knee in SI and degC; ``v`` by the names of the actuator file (``"wire.turns"``). ``follows``: time of the kinetics, s."""

    v: dict[str, float]
    follows: float = 0.02

    def stiffness(self, xi: Floats | float) -> Floats | float:
        """k = G r^4 / (4 R^3 N), its reciprocal linear in xi."""
        v = self.v
        r, R = v["wire.diameter"] / 2, v["wire.coil_diameter"] / 2
        both = [
            v[f"material.modulus_{phase}"] / (2 * (1 + v["wire.poisson_ratio"])) * r**4 / (4 * R**3 * v["wire.turns"])
            for phase in ("austenite", "martensite")
        ]
        return 1.0 / ((1 - xi) / both[0] + xi / both[1])

    def force(self, xi: Floats, stretch: Floats) -> Floats:
        """F = k (y - y_t xi) with y_t = 2 pi R^2 N gamma_L / r, gamma_L = sqrt(3) H."""
        v = self.v
        r, R = v["wire.diameter"] / 2, v["wire.coil_diameter"] / 2
        transformed = 2 * math.pi * R**2 * v["wire.turns"] * ROOT3 * v["material.max_transformation_strain"] / r
        return np.maximum(self.stiffness(xi) * (stretch - transformed * xi), 0.0)

    def law(self, xi: Floats, temperature: Floats, force: Floats) -> Floats:
        """Return the fraction by Lagoudas' law with linear hardening: not below the forward line, not above the reverse line."""
        v = self.v
        r, R = v["wire.diameter"] / 2, v["wire.coil_diameter"] / 2
        shear = 2 * force * R / (math.pi * r**3)
        slack = (
            2
            * (1 + v["wire.poisson_ratio"])
            * (1 / v["material.modulus_martensite"] - 1 / v["material.modulus_austenite"])
        )
        # Work of the transformation shear strain, and what the change of compliance stores.
        drive = shear * ROOT3 * v["material.max_transformation_strain"] + 0.5 * slack * shear**2
        entropy = -v["material.clausius_clapeyron_austenite"] * v["material.max_transformation_strain"]
        lines = []
        for start, finish in (("martensite_start", "martensite_finish"), ("austenite_finish", "austenite_start")):
            span = entropy * (v[f"material.{finish}"] - v[f"material.{start}"])
            lines.append(np.clip((drive + entropy * (temperature - v[f"material.{start}"])) / span, 0.0, 1.0))
        return np.minimum(np.maximum(xi, lines[0]), lines[1])

    def slope(self, _: float, y: Floats, command: dict[str, float]) -> Floats:
        """Return the rates of (T_1, T_2, xi_1, xi_2, theta, theta', phi', i)."""
        v = self.v
        temperature, xi, (angle, rate, shaft, current) = y[:2], y[2:4], y[4:]
        d, length = v["wire.diameter"], math.pi * v["wire.coil_diameter"] * v["wire.turns"]
        area = math.pi / 4 * d**2
        rho = v["material.resistivity_austenite"] + xi * (
            v["material.resistivity_martensite"] - v["material.resistivity_austenite"]
        )
        power = np.array([command["first"], command["second"]]) ** 2 / (rho * length / area)
        lost = v["heat.h0"] * math.pi * d * length * (temperature - v["environment.ambient"])
        warming = (power - lost) / (v["heat.capacity_austenite"] * area * length)
        arm = v["joint.radius"]
        force = self.force(xi, v["wire.prestretch"] + arm * angle * np.array([1.0, -1.0]))
        on = min(command["clutch"] / v["clutch.current"], 1.0)
        slip = shaft - v["clutch.belt"] * rate
        passed = v["clutch.torque"] * on * math.tanh(slip / v["clutch.slip"]) + (
            v["clutch.damping"] * slip if on > 0 else 0.0
        )
        weight = v["joint.mass"] * v["environment.gravity"] * v["joint.lever"] * math.sin(angle)
        resistance = v["joint.damping"] * rate + v["joint.friction"] * math.tanh(rate / v["joint.slow"]) + weight
        turning = arm * (force[1] - force[0]) + v["clutch.belt"] * passed - resistance
        rubbed = v["motor.damping"] * shaft + v["motor.friction"] * math.tanh(shaft / v["joint.slow"])
        spin = (v["motor.torque_constant"] * current - rubbed - passed) / (
            v["motor.rotor_inertia"] * v["motor.reduction"] ** 2
        )
        rise = (command["motor"] - v["motor.resistance"] * current - v["motor.back_voltage"] * shaft) / v[
            "motor.inductance"
        ]
        return np.array(
            [
                *warming,
                *((self.law(xi, temperature, force) - xi) / self.follows),
                rate,
                turning / v["joint.inertia"],
                spin,
                rise,
            ]
        )

    def roll(self, command: dict[str, float], time: Floats) -> Floats:
        """Return the state at the times, shape ``(8, n)``."""
        y0 = np.array([self.v["environment.ambient"]] * 2 + [1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
        solution = solve_ivp(
            self.slope, (0.0, time[-1]), y0, "LSODA", t_eval=time, args=(command,), rtol=1e-9, atol=1e-11, max_step=0.05
        )
        if not solution.success:
            raise ArithmeticError(solution.message)
        return solution.y

    def locked(self, voltage: float, time: Floats) -> Floats:
        """Return the angle of the joint with a locked clutch and springs of cold stiffness: eq. 15, with geared friction and the
        rotor's inertia kept."""
        v = self.v
        belt = v["clutch.belt"]
        inertia = v["joint.inertia"] + v["motor.rotor_inertia"] * (v["motor.reduction"] * belt) ** 2

        def slope(_: float, y: Floats) -> Floats:
            angle, rate, current = y
            shaft = belt * rate
            force = self.force(np.ones(2), v["wire.prestretch"] + v["joint.radius"] * angle * np.array([1.0, -1.0]))
            rubbed = v["motor.damping"] * shaft + v["motor.friction"] * math.tanh(shaft / v["joint.slow"])
            resistance = v["joint.damping"] * rate + v["joint.friction"] * math.tanh(rate / v["joint.slow"])
            turning = (
                belt * (v["motor.torque_constant"] * current - rubbed)
                - resistance
                + v["joint.radius"] * (force[1] - force[0])
            )
            rise = (voltage - v["motor.resistance"] * current - v["motor.back_voltage"] * shaft) / v["motor.inductance"]
            return np.array([rate, turning / inertia, rise])

        return solve_ivp(slope, (0.0, time[-1]), np.zeros(3), "LSODA", t_eval=time, rtol=1e-9, atol=1e-11).y[0]
