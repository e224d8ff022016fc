"""Exact simulators of the rigs: dead weight, bias spring, testing machine, light rotary, rotary with inertia, and paths without a clock.

Conventions (those of the shipped recordings): row 0 is the start state, the input of row k acts from row k on, held until the next row or
linear towards it; results are given at the rows. Temperatures in degC, else SI; contraction and the pull of wire 1 are positive.

Accuracy: the heat content of each wire runs by the classical Runge-Kutta rule with ``substeps`` steps a sample, every stage
with the balance of forces solved to rounding. The material's update is exact between two turning points of its driving variables. Inputs
jump only at rows, and a step is cut where a wire's net heat changes sign, where a wire crosses M_s, and where wires come taut or go slack.
What remains (a driving variable that turns because the other wire's does) is of second order in the step, and shown to be small by halving it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference.brinson import Material, advance, strain_of, stress_of
from tests.reference.wire import (
    CONTROLS,
    CURRENT,
    POWER,
    Heat,
    Rig,
    State,
    Wire,
    area,
    at_stress,
    balance,
    floats,
    heating,
    resistance,
    strain,
)

Floats = NDArray[np.float64]
GRAVITY = 9.81


@dataclass(frozen=True)
class Run:
    """Results at the rows: all (n, wires), and ``position`` (n,): displacement in m, angle in rad, or strain of the machine or path.

    ``strain`` is that of a taut wire; of a slack one its free strain.
    """

    position: Floats
    temperature: Floats
    stress: Floats
    strain: Floats
    detwinned: Floats
    twinned: Floats
    current: Floats
    voltage: Floats
    resistance: Floats


@njit(cache=True)
def _settle(rig, first, second, added1, added2, right):
    """Return both wires in force balance after they absorbed heat, and the tension, which is negative for slack wires."""
    tension = balance(rig, first, second, added1, added2, right)
    stress = max(tension, 0.0)
    wire_1 = at_stress(rig.material, rig.heat, first, added1, stress)
    wire_2 = at_stress(rig.material, rig.heat, second, added2, stress) if rig.c_2 != 0.0 else second
    return wire_1, wire_2, tension


@njit(cache=True)
def _heating(rig, signal, first, second):
    return heating(rig, signal[0], first), heating(rig, signal[1], second) if rig.c_2 != 0.0 else 0.0


@njit(cache=True)
def _between(u0, u1, part):
    return u0[0] + part * (u1[0] - u0[0]), u0[1] + part * (u1[1] - u0[1])


@njit(cache=True)
def _step(rig, first, second, step, u0, u1, r0, r1):
    """One Runge-Kutta step of ``step`` s; u0, u1 are the inputs (wire 1, wire 2) at its ends, r0, r1 the right-hand sides."""
    middle, half, right = _between(u0, u1, 0.5), 0.5 * step, 0.5 * (r0 + r1)
    a1, a2 = _heating(rig, u0, first, second)
    x, y, _ = _settle(rig, first, second, half * a1, half * a2, right)
    b1, b2 = _heating(rig, middle, x, y)
    x, y, _ = _settle(rig, first, second, half * b1, half * b2, right)
    c1, c2 = _heating(rig, middle, x, y)
    x, y, _ = _settle(rig, first, second, step * c1, step * c2, r1)
    d1, d2 = _heating(rig, u1, x, y)
    added1, added2 = step / 6.0 * (a1 + 2.0 * (b1 + c1) + d1), step / 6.0 * (a2 + 2.0 * (b2 + c2) + d2)
    return _settle(rig, first, second, added1, added2, r1)


@njit(cache=True)
def _events(rig, step, signal, first, second, tension):
    """Return the event functions: net heat of each wire, distance of each wire to M_s, and tension."""
    q1, q2 = _heating(rig, signal, first, second)
    # The net heat of a wire at its steady temperature changes sign by rounding: not an event.
    still = 1e-10 * rig.heat.capacity_austenite / step
    start = rig.material.martensite_start
    return (
        q1 if abs(q1) > still else 0.0,
        q2 if abs(q2) > still else 0.0,
        first.temperature - start,
        second.temperature - start,
        tension,
    )


@njit(cache=True)
def _crossed(before, after):
    for i in range(5):
        if before[i] * after[i] < 0.0:
            return True
    return False


@njit(cache=True)
def _step_with_events(rig, first, second, tension, step, u0, u1, r0, r1):
    """Return the end of a step that is divided where an event function changes sign."""
    for _ in range(12):
        before = _events(rig, step, u0, first, second, tension)
        x, y, z = _step(rig, first, second, step, u0, u1, r0, r1)
        if not _crossed(before, _events(rig, step, u1, x, y, z)):
            return x, y, z
        low, high = 0.0, 1.0
        while high - low > 1e-9:
            part = 0.5 * (low + high)
            inputs, right = _between(u0, u1, part), r0 + part * (r1 - r0)
            a, b, c = _step(rig, first, second, part * step, u0, inputs, r0, right)
            if _crossed(before, _events(rig, step, inputs, a, b, c)):
                high, x, y, z = part, a, b, c
            else:
                low = part
        first, second, tension = x, y, z
        if high == 1.0:
            return first, second, tension
        u0, r0, step = _between(u0, u1, high), r0 + high * (r1 - r0), step * (1.0 - high)
    return _step(rig, first, second, step, u0, u1, r0, r1)


@njit(cache=True)
def _note(out, row, wire, state):
    for i in range(4):
        out[row, wire, i] = state[i]


@njit(cache=True)
def _quasi_static(rig, linear, time, signal, right, first, second, tension, lean, substeps):
    rows = time.size
    out, leans = np.empty((rows, 2, 4)), np.empty(rows)
    for k in range(rows):
        _note(out, k, 0, first)
        _note(out, k, 1, second)
        leans[k] = lean
        if k == rows - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        start = (signal[k, 0], signal[k, 1])
        stop = (signal[k + 1, 0], signal[k + 1, 1]) if linear else start
        for j in range(substeps):
            u0, u1 = _between(start, stop, j / substeps), _between(start, stop, (j + 1) / substeps)
            r0 = right[k] + j / substeps * (right[k + 1] - right[k])
            r1 = right[k] + (j + 1) / substeps * (right[k + 1] - right[k])
            first, second, tension = _step_with_events(rig, first, second, tension, step, u0, u1, r0, r1)
            lean = _lean(lean, 0.5 * r1, strain(rig.material, rig.wire, first), strain(rig.material, rig.wire, second))
    return out, leans


@njit(cache=True)
def _lean(lean, middle, strain1, strain2):
    """Return the shortening of wire 1 from the middle: between the values at which wire 1 and wire 2 become taut."""
    return min(max(lean, middle - strain1), strain2 - middle)


def _signals(signal: Floats, wires: int) -> Floats:
    """(n, 2) contiguous: wire 2 gets zeros where there is none."""
    signal = np.asarray(signal, float).reshape(len(signal), -1)
    if signal.shape[1] != wires:
        raise ValueError(f"{signal.shape[1]} input columns for {wires} wires")
    return np.ascontiguousarray(np.hstack([signal, np.zeros((len(signal), 2 - wires))]))


def _run(material: Material, wire: Wire, out: Floats, position: Floats, signal: Floats, control: str) -> Run:
    temperature, stress, detwinned, twinned = np.moveaxis(out, 2, 0)
    free = strain_array(material, temperature, stress, detwinned, twinned, wire.ambient)
    ohm = resistance(material, wire, detwinned + twinned)
    columns = signal[:, : out.shape[1]]
    code = CONTROLS[control]
    current = (
        columns if code == CURRENT else np.sqrt(np.maximum(columns, 0.0) / ohm) if code == POWER else columns / ohm
    )
    return Run(position, temperature, stress, free, detwinned, twinned, current, current * ohm, ohm)


def strain_array(
    material: Material, temperature: Floats, stress: Floats, detwinned: Floats, twinned: Floats, reference: float
) -> Floats:
    """``strain_of`` on arrays."""
    shape = np.shape(temperature)
    flat = zip(*(np.ravel(a) for a in (temperature, stress, detwinned, twinned)), strict=True)
    return np.array([strain_of(material, *row, reference) for row in flat]).reshape(shape)


def _one_wire(
    material, heat, wire, time, signal, right, c_s, c_1, start, control, interpolation, substeps
) -> tuple[Floats, Floats]:
    signal = _signals(signal, 1)
    material, heat, wire, start = floats(material, heat, wire, start)
    linear = {"hold": False, "linear": True}[interpolation]
    time, right = np.ascontiguousarray(time, float), np.ascontiguousarray(right, float)
    rig = Rig(material, heat, wire, CONTROLS[control], float(c_s), float(c_1), 0.0)
    return _quasi_static(rig, linear, time, signal, right, start, start, start.stress, 0.0, substeps)[0][:, :1], signal


def dead_weight(
    material: Material, heat: Heat, wire: Wire, mass: float, time: Floats, signal: Floats, *,
    control: str = "current", interpolation: str = "linear", substeps: int = 20, start: State | None = None,
) -> Run:  # fmt: skip
    """A wire lifting a mass; it starts all detwinned at ambient, position is the contraction from there in m."""
    load = mass * GRAVITY / area(wire)
    start = start or State(wire.ambient, load, 1.0, 0.0)
    right = np.full(len(time), load)
    out, signal = _one_wire(
        material, heat, wire, time, signal, right, 1.0, 0.0, start, control, interpolation, substeps
    )
    run = _run(material, wire, out, np.empty(0), signal, control)
    return _placed(run, wire.length * (run.strain[0, 0] - run.strain[:, 0]))


def bias_spring(
    material: Material, heat: Heat, wire: Wire, stiffness: float, preload: float, time: Floats, signal: Floats, *,
    control: str = "current", interpolation: str = "linear", substeps: int = 20, start: State | None = None,
) -> Run:  # fmt: skip
    """A wire stretching a spring, F = preload + stiffness x; starts all detwinned at ambient under the preload. Position x in m."""
    start = start or State(wire.ambient, preload / area(wire), 1.0, 0.0)
    per_strain = stiffness * wire.length / area(wire)
    right = np.full(len(time), start.stress + per_strain * strain(material, wire, start))
    out, signal = _one_wire(
        material, heat, wire, time, signal, right, 1.0, per_strain, start, control, interpolation, substeps
    )
    run = _run(material, wire, out, np.empty(0), signal, control)
    return _placed(run, wire.length * (run.strain[0, 0] - run.strain[:, 0]))


def testing_machine(
    material: Material, heat: Heat, wire: Wire, time: Floats, prescribed: Floats, signal: Floats, *,
    control: str = "power", interpolation: str = "hold", substeps: int = 20, start: State | None = None,
) -> Run:  # fmt: skip
    """A wire between grips: strain (n,), counted from the wire's prestrain and linear between rows, gives its stress.

    Starts at ambient, stress-free, drawn out cold to its first strain: detwinned = strain / max_transformation_strain, the rest twinned.
    """
    total = wire.prestrain + np.asarray(prescribed, float)
    start = start or drawn_out(material, wire, float(total[0]))
    out, signal = _one_wire(
        material, heat, wire, time, signal, total, 0.0, 1.0, start, control, interpolation, substeps
    )
    return _run(material, wire, out, np.asarray(prescribed, float), signal, control)


def drawn_out(material: Material, wire: Wire, strain_there: float) -> State:
    """Return the stress-free state at ambient with all strain from detwinned martensite and the rest twinned."""
    detwinned = min(max(strain_there / material.max_transformation_strain, 0.0), 1.0)
    return State(wire.ambient, 0.0, detwinned, 1.0 - detwinned)


def rotary(
    material: Material, heat: Heat, wire: Wire, radius: float, time: Floats, signal: Floats, *,
    control: str = "current", interpolation: str = "hold", substeps: int = 100, start: tuple[State, State] | None = None,
    angle: float = 0.0,
) -> Run:  # fmt: skip
    """Two wires on a light pulley: they carry one stress and their strains add up to twice the prestrain. Position: angle in rad.

    Starts stress-free at ambient and angle 0, or goes on from two states and the angle that belongs to them. Between two slack wires the
    pulley stays where it is.
    """
    signal = _signals(signal, 2)
    material, heat, wire = floats(material, heat, wire)
    first, second = floats(*(start or (drawn_out(material, wire, wire.prestrain),) * 2))
    linear = {"hold": False, "linear": True}[interpolation]
    right = np.full(len(time), 2.0 * wire.prestrain)
    time = np.ascontiguousarray(time, float)
    rig = Rig(material, heat, wire, CONTROLS[control], 0.0, 1.0, 1.0)
    per_lean = wire.length / radius
    # Wires that start slack: detect when they become taut.
    tension = balance(rig, first, second, 0.0, 0.0, right[0]) if start else 0.0
    out, lean = _quasi_static(
        rig, linear, time, signal, right, first, second, tension, float(angle) / per_lean, substeps
    )
    return _placed(_run(material, wire, out, np.empty(0), signal, control), per_lean * lean)


def rotary_inertia(
    material: Material, heat: Heat, wire: Wire, radius: float, inertia: float, damping: float, time: Floats, signal: Floats, *,
    control: str = "current", interpolation: str = "hold", substeps: int = 400,
) -> Run:  # fmt: skip
    """As ``rotary``, with inertia theta'' + damping theta' = radius area (stress_1 - stress_2); kg m^2, N m s/rad."""
    signal = _signals(signal, 2)
    material, heat, wire = floats(material, heat, wire)
    start = drawn_out(material, wire, wire.prestrain)
    linear = {"hold": False, "linear": True}[interpolation]
    time = np.ascontiguousarray(time, float)
    rig = Rig(material, heat, wire, CONTROLS[control], 0.0, 1.0, 0.0)
    out, angle = _turning(rig, linear, time, signal, float(radius), float(inertia), float(damping), start, substeps)
    return _placed(_run(material, wire, out, np.empty(0), signal, control), angle)


@njit(cache=True)
def _stretched(rig, state, added, strain_there):
    stress = max(0.0, balance(rig, state, state, added, 0.0, strain_there))
    return at_stress(rig.material, rig.heat, state, added, stress)


@njit(cache=True)
def _turning(rig, linear, time, signal, radius, inertia, damping, start, substeps):
    wire = rig.wire
    rows, per_angle = time.size, radius / wire.length
    lever = radius * area(wire)
    out, angles = np.empty((rows, 2, 4)), np.empty(rows)
    first, second, angle, speed = start, start, 0.0, 0.0
    nodes, weights = (0.0, 0.5, 0.5, 1.0), (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)
    for k in range(rows):
        _note(out, k, 0, first)
        _note(out, k, 1, second)
        angles[k] = angle
        if k == rows - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        begin = (signal[k, 0], signal[k, 1])
        end = (signal[k + 1, 0], signal[k + 1, 1]) if linear else begin
        for j in range(substeps):
            # Rates of (heat 1, heat 2, angle, speed) at the four stages, each from the start of the step.
            r1, r2, r3, r4 = 0.0, 0.0, 0.0, 0.0
            s1, s2, s3, s4 = 0.0, 0.0, 0.0, 0.0
            for stage in range(4):
                h = nodes[stage] * step
                u = _between(begin, end, (j + nodes[stage]) / substeps)
                end_angle = angle + h * r3
                x = _stretched(rig, first, h * r1, wire.prestrain - per_angle * end_angle) if stage else first
                y = _stretched(rig, second, h * r2, wire.prestrain + per_angle * end_angle) if stage else second
                turning = speed + h * r4
                r1, r2 = heating(rig, u[0], x), heating(rig, u[1], y)
                r3, r4 = turning, (lever * (x.stress - y.stress) - damping * turning) / inertia
                s1 += weights[stage] * r1
                s2 += weights[stage] * r2
                s3 += weights[stage] * r3
                s4 += weights[stage] * r4
            angle += step * s3
            speed += step * s4
            first = _stretched(rig, first, step * s1, wire.prestrain - per_angle * angle)
            second = _stretched(rig, second, step * s2, wire.prestrain + per_angle * angle)
    return out, angles


def _placed(run: Run, position: Floats) -> Run:
    return Run(position, *(getattr(run, name) for name in list(Run.__dataclass_fields__)[1:]))


# Paths without a clock, linear between rows: the heat is a change of temperature.
UNIT_WIRE = Wire(math.sqrt(4.0 / math.pi), 1.0, 0.0, 20.0)
UNIT_CAPACITY = Heat(0.0, 0.0, 0.0, 2.0, 1.0, 1.0, 0.0)


@njit(cache=True)
def _stress_path(m, temperature, stress, detwinned, twinned):
    out = np.empty((temperature.size, 1, 4))
    for k in range(temperature.size):
        if k:
            detwinned, twinned = advance(
                m, detwinned, twinned, temperature[k - 1], stress[k - 1], temperature[k], stress[k]
            )
        _note(out, k, 0, State(temperature[k], stress[k], detwinned, twinned))
    return out


def cooled_from_austenite(material: Material, temperature: float, stress: float) -> State:
    """Return the fractions of a wire after cooling from far above A_f to a temperature under a stress."""
    return State(temperature, stress, *advance(material, 0.0, 0.0, 1e4, stress, temperature, stress))


def path(
    material: Material, temperature: Floats, *, stress: Floats | None = None, strain: Floats | None = None,
    reference: float = 20.0, start: State | None = None, substeps: int = 40,
) -> Run:  # fmt: skip
    """A material point led through (temperature, stress) or (temperature, strain), all (n,). Position: the strain.

    Starts as if cooled from austenite under its first stress (zero where the strain is prescribed: then the stress that fits at once).
    Thermal strain counts from ``reference``. A prescribed stress is exact at any spacing; a prescribed strain takes ``substeps`` a row.
    """
    temperature = np.ascontiguousarray(temperature, float)
    (material,), unit = floats(material), UNIT_WIRE._replace(ambient=float(reference))
    if stress is not None:
        stress = np.ascontiguousarray(stress, float)
        start = start or cooled_from_austenite(material, temperature[0], stress[0])
        out = _stress_path(material, temperature, stress, start.detwinned, start.twinned)
    elif strain is not None:
        strain = np.ascontiguousarray(strain, float)
        start = start or cooled_from_austenite(material, temperature[0], 0.0)
        fitting = stress_of(material, temperature[0], strain[0], start.detwinned, start.twinned, reference)
        start = State(temperature[0], fitting, start.detwinned, start.twinned)
        # With this constant "power" between rows, the temperature is linear between rows.
        rate = np.column_stack([np.append(np.diff(temperature), 0.0), np.zeros(len(temperature))])
        rig = Rig(material, UNIT_CAPACITY, unit, POWER, 0.0, 1.0, 0.0)
        rows = np.arange(len(temperature), dtype=float)
        out = _quasi_static(rig, False, rows, rate, strain, start, start, start.stress, 0.0, substeps)[0]
    else:
        raise ValueError("a path needs a stress or a strain")
    run = _run(material, unit, out[:, :1], np.empty(0), np.zeros((len(temperature), 1)), "current")
    return _placed(run, run.strain[:, 0] if strain is None else strain)
