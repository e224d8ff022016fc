"""Exact simulator of a limb with sheathed wires: heat content of the wire, temperature of the sheath, angle and angular rate.

    q = joule - g_w (T - T_p)      C_p dT_p/dt = g_w (T - T_p) - g_a (T_p - T_ambient)      I theta'' = n A sigma exp(-mu phi z) r / ratio - c theta' - M(theta)

all by the classical Runge-Kutta rule, every stage with the wire's stress that fits its strain, solved to rounding. Conductances and the
sheath's capacity are per volume of wire; g_w and g_a are given by their ratio and by the steady g_w g_a / (g_w + g_a) = 4 h(T_ambient) / d.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from tests.reference.brinson import Material, advance
from tests.reference.rigs import GRAVITY, Floats, Run, _between, _note, _placed, _run, _signals, _stretched, drawn_out
from tests.reference.wire import CONTROLS, Heat, Rig, State, Wire, area, convection, floats, heating, strain

YIELD = 5e-5


class Limb(NamedTuple):
    """In SI and rad; ``mass`` to ``preload`` are the limb's, ``radius`` to ``damping`` the pulley's, then transmission and sheath."""

    mass: float
    lever: float
    tilt: float
    stiffness: float
    preload: float
    radius: float
    inertia: float
    damping: float
    count: float
    ratio: float
    friction: float
    wrap_angle: float
    conductance_ratio: float
    time_constant: float


@njit(cache=True)
def load(limb, angle):
    """M(theta) in N m."""
    return limb.mass * GRAVITY * limb.lever * math.sin(angle + limb.tilt) + limb.stiffness * angle + limb.preload


@njit(cache=True)
def _engaged(z, strain0, strain1):
    return min(max(z - (strain1 - strain0) / YIELD, -1.0), 1.0)


@njit(cache=True)
def _swing(rig, limb, linear, time, signal, start, substeps):
    wire, material, heat = rig.wire, rig.material, rig.heat
    rows, arm = time.size, limb.radius / limb.ratio
    grip, lever = limb.friction * limb.wrap_angle, limb.count * area(wire) * arm
    steady = 4.0 / wire.diameter * convection(heat, wire.ambient)
    inner, outer, capacity = 0.0, steady, 1.0
    if limb.conductance_ratio > 0.0:
        inner, outer = (
            steady * (1.0 + limb.conductance_ratio),
            steady * (1.0 + limb.conductance_ratio) / limb.conductance_ratio,
        )
        capacity = limb.time_constant * (inner + outer)
    out, angles = np.empty((rows, 2, 4)), np.empty(rows)
    here, angle, speed, liner, z = start, 0.0, 0.0, wire.ambient, 0.0
    installed = strain(material, wire, start)
    nodes, weights = (0.0, 0.5, 0.5, 1.0), (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
    for k in range(rows):
        _note(out, k, 0, here)
        _note(out, k, 1, here)
        angles[k] = angle
        if k == rows - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        begin = (signal[k, 0], 0.0)
        end = (signal[k + 1, 0], 0.0) if linear else begin
        for j in range(substeps):
            # Rates of (heat, sheath, angle, speed) at the four stages, each from the start of the step.
            r1, r2, r3, r4 = 0.0, 0.0, 0.0, 0.0
            s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0
            before = strain(material, wire, here)
            for stage in range(4):
                h = nodes[stage] * step
                u, _ = _between(begin, end, (j + nodes[stage]) / substeps)
                x = _stretched(rig, here, h * r1, installed - arm / wire.length * (angle + h * r3)) if stage else here
                grip_strain = _engaged(z, before, strain(material, wire, x))
                warm, turning = liner + h * r2, speed + h * r4
                over = x.temperature - wire.ambient
                r1, r2 = heating(rig, u, x), 0.0
                if limb.conductance_ratio > 0.0:
                    # There is no direct heat flow to the air.
                    r1 += 4.0 / wire.diameter * convection(heat, x.temperature) * over - inner * (x.temperature - warm)
                    r2 = (inner * (x.temperature - warm) - outer * (warm - wire.ambient)) / capacity
                pull = lever * x.stress * math.exp(-grip * grip_strain)
                r3, r4 = turning, (pull - limb.damping * turning - load(limb, angle + h * r3)) / limb.inertia
                s1 += weights[stage] * r1
                s2 += weights[stage] * r2
                s3 += weights[stage] * r3
                s4 += weights[stage] * r4
            angle += step * s3
            speed += step * s4
            liner += step * s2
            here = _stretched(rig, here, step * s1, installed - arm / wire.length * angle)
            z = _engaged(z, before, strain(material, wire, here))
    return out, angles


def limb(
    material: Material, heat: Heat, wire: Wire, parts: Limb, time: Floats, signal: Floats, *,
    control: str = "current", interpolation: str = "hold", substeps: int = 100,
) -> Run:  # fmt: skip
    """Simulate wires on a limb, which starts at rest and angle 0, stretched to the prestrain and then loaded. Position: angle in rad.

    With a sheath, the wire loses heat only to it, so that h must be constant.
    """
    signal = _signals(signal, 1)
    material, heat, wire, parts = floats(material, heat, wire, parts)
    free = drawn_out(material, wire, wire.prestrain)
    stress = max(load(parts, 0.0), 0.0) * parts.ratio / (parts.radius * parts.count * area(wire))
    start = State(
        wire.ambient, stress, *advance(material, free.detwinned, free.twinned, wire.ambient, 0.0, wire.ambient, stress)
    )
    linear = {"hold": False, "linear": True}[interpolation]
    rig = Rig(material, heat, wire, CONTROLS[control], 0.0, 1.0, 0.0)
    out, angle = _swing(rig, parts, linear, np.ascontiguousarray(time, float), signal, start, substeps)
    return _placed(_run(material, wire, out[:, :1], np.empty(0), signal, control), angle)
