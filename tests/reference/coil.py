"""Exact simulators of rigs with helical SMA springs, in torsional stress and strain at the surface of the wire.

    tau = 2 F R / (pi r^3)        gamma = r y / (2 pi R^2 N)        gamma = tau / G + gamma_L xi_s        (Theta = 0)

with the wire's radius r, the coil's mean radius R, N turns, a pull F and a stretch y. The laws stand here with shear constants
(``sheared``): G = E / (2 (1 + nu)), gamma_L = sqrt(3) eps_L, and stresses and slopes C over sqrt(3), as von Mises has it. Heat is counted for the
whole spring: m c T' = heat - h(T) A (T - T_ambient) with the developed wire's surface A = pi d (2 pi R N).

Plain small steps: Heun's rule for the temperature, the laws as closed forms from the start of a step to its end, the pull by bisection of
an increasing function. Steps are not cut at events; halving the steps shows the error.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference.brinson import Material
from tests.reference.wire import Heat

Floats = NDArray[np.float64]
BRINSON, TANAKA, LIANG_ROGERS, LAGOUDAS = 0, 1, 2, 3
LAWS = {"brinson": BRINSON, "tanaka": TANAKA, "liang-rogers": LIANG_ROGERS, "lagoudas": LAGOUDAS}
DEAD_WEIGHT, BIAS_SPRING = 0, 1
GRAVITY = 9.81


class Shear(NamedTuple):
    """A law's constants in shear: degC, Pa, Pa/K."""

    law: int
    martensite_start: float
    martensite_finish: float
    austenite_start: float
    austenite_finish: float
    slope_austenite: float
    slope_martensite: float
    modulus_austenite: float
    modulus_martensite: float
    start_stress: float
    finish_stress: float
    max_transformation_strain: float


class Coil(NamedTuple):
    """Wire radius r, mean coil radius R (m), turns N, springs side by side, and the ambient temperature; the wire's resistivities (ohm m)."""

    wire_radius: float
    coil_radius: float
    turns: float
    springs: float
    ambient: float
    resistivity_austenite: float
    resistivity_martensite: float


class Spring(NamedTuple):
    """State: temperature, shear stress, and detwinned and twinned martensite."""

    temperature: float
    stress: float
    detwinned: float
    twinned: float


def sheared(material: Material, poisson_ratio: float, law: str = "brinson") -> Shear:
    """The constants in shear of a material known in tension."""
    root, per_modulus = math.sqrt(3.0), 1.0 / (2.0 * (1.0 + poisson_ratio))
    return Shear(
        LAWS[law], material.martensite_start, material.martensite_finish, material.austenite_start, material.austenite_finish,
        material.clausius_clapeyron_austenite / root, material.clausius_clapeyron_martensite / root,
        material.modulus_austenite * per_modulus, material.modulus_martensite * per_modulus,
        material.detwinning_start_stress / root, material.detwinning_finish_stress / root, material.max_transformation_strain * root,
    )  # fmt: skip


@njit(cache=True)
def developed_length(coil):
    return 2.0 * math.pi * coil.coil_radius * coil.turns


@njit(cache=True)
def _cosine(share):
    """Half a cosine, from 1 at 0 to 0 at 1."""
    return 0.5 * (1.0 + math.cos(math.pi * min(max(share, 0.0), 1.0)))


@njit(cache=True)
def _remains(law, share):
    """Return the fraction not yet transformed at a position of the driving variable in its band."""
    return 0.01 ** max(share, 0.0) if law == TANAKA else _cosine(share)


@njit(cache=True)
def _over(after, before):
    return after / before if before > 0.0 else 0.0


@njit(cache=True)
def evolve(m, spring, temperature, stress):
    """Return the fractions after a monotone path from the state to (temperature, stress)."""
    s, t = spring.detwinned, spring.twinned
    if m.law == LAGOUDAS:
        compliance = 0.5 * (1.0 / m.modulus_martensite - 1.0 / m.modulus_austenite) * stress**2
        entropy = -m.slope_austenite * m.max_transformation_strain
        work = m.max_transformation_strain * stress + compliance
        forward = (work + entropy * (temperature - m.martensite_start)) / (
            entropy * (m.martensite_finish - m.martensite_start)
        )
        if forward > s + t:
            return min(forward, 1.0) - t, t
        driving = m.max_transformation_strain * s / (s + t) * stress + compliance if s + t > 0.0 else 0.0
        reverse = 1.0 + (driving + entropy * (temperature - m.austenite_start)) / (
            entropy * (m.austenite_start - m.austenite_finish)
        )
        if s + t > 0.0 and reverse < s + t:
            factor = max(reverse, 0.0) / (s + t)
            return s * factor, t * factor
        return s, t
    before = (spring.temperature - m.austenite_start - spring.stress / m.slope_austenite) / (
        m.austenite_finish - m.austenite_start
    )
    after = (temperature - m.austenite_start - stress / m.slope_austenite) / (m.austenite_finish - m.austenite_start)
    if after > before:
        factor = _over(_remains(m.law, after), _remains(m.law, before))
        s, t = s * factor, t * factor
    if m.law == BRINSON:
        band = m.finish_stress - m.start_stress
        before = (
            spring.stress - m.slope_martensite * max(spring.temperature - m.martensite_start, 0.0) - m.start_stress
        ) / band
        after = (stress - m.slope_martensite * max(temperature - m.martensite_start, 0.0) - m.start_stress) / band
        if after > before:
            remainder = _over(_cosine(after), _cosine(before))
            s, t = 1.0 - (1.0 - s) * remainder, t * remainder
        if temperature < spring.temperature:
            before = (m.martensite_start - spring.temperature) / (m.martensite_start - m.martensite_finish)
            after = (m.martensite_start - temperature) / (m.martensite_start - m.martensite_finish)
            t = 1.0 - s - (1.0 - s - t) * _over(_cosine(after), _cosine(before))
        return s, t
    before = (m.martensite_start + spring.stress / m.slope_martensite - spring.temperature) / (
        m.martensite_start - m.martensite_finish
    )
    after = (m.martensite_start + stress / m.slope_martensite - temperature) / (
        m.martensite_start - m.martensite_finish
    )
    if after > before:
        s = 1.0 - t - (1.0 - s - t) * _over(_remains(m.law, after), _remains(m.law, before))
    return s, t


@njit(cache=True)
def shear_modulus(m, martensite):
    if m.law == LAGOUDAS:
        return 1.0 / (1.0 / m.modulus_austenite + martensite * (1.0 / m.modulus_martensite - 1.0 / m.modulus_austenite))
    return m.modulus_austenite + martensite * (m.modulus_martensite - m.modulus_austenite)


@njit(cache=True)
def stretch(m, coil, stress, detwinned, twinned):
    """y in m."""
    strain = stress / shear_modulus(m, detwinned + twinned) + m.max_transformation_strain * detwinned
    return 2.0 * math.pi * coil.coil_radius**2 * coil.turns / coil.wire_radius * strain


@njit(cache=True)
def pull(coil, stress):
    """F in N of all springs of the bundle."""
    return coil.springs * math.pi * coil.wire_radius**3 * stress / (2.0 * coil.coil_radius)


@njit(cache=True)
def _brought(m, spring, temperature, stress):
    s, t = evolve(m, spring, temperature, stress)
    return Spring(temperature, stress, s, t)


@njit(cache=True)
def _heat_rate(heat, coil, power, temperature, martensite):
    """T' of one spring that takes ``power`` W."""
    length, r = developed_length(coil), coil.wire_radius
    capacity = heat.capacity_austenite + martensite * (heat.capacity_martensite - heat.capacity_austenite)
    h = heat.h0 + heat.h1 * temperature
    if heat.h2 != 0.0:
        h += heat.h2 * max(temperature, 0.0) ** heat.exponent
    return (power - h * 2.0 * math.pi * r * length * (temperature - coil.ambient)) / (
        capacity * math.pi * r**2 * length
    )


@njit(cache=True)
def ohms(coil, martensite):
    """Resistance of one spring."""
    resistivity = coil.resistivity_austenite + martensite * (coil.resistivity_martensite - coil.resistivity_austenite)
    return resistivity * developed_length(coil) / (math.pi * coil.wire_radius**2)


@njit(cache=True)
def _power(coil, voltage_driven, signal, martensite):
    """Return the power of one spring in W; the springs of a bundle are in series, at a voltage across the bundle or a current."""
    resistance = ohms(coil, martensite)
    current = signal / (coil.springs * resistance) if voltage_driven else signal
    return current**2 * resistance


@njit(cache=True)
def _warmed(heat, coil, voltage_driven, signal, spring, step, guess):
    """Return the temperature after a step by Heun's rule, while the fraction changes to ``guess``."""
    xi = spring.detwinned + spring.twinned
    first = _heat_rate(heat, coil, _power(coil, voltage_driven, signal, xi), spring.temperature, xi)
    predicted = spring.temperature + step * first
    last = _heat_rate(heat, coil, _power(coil, voltage_driven, signal, guess), predicted, guess)
    return spring.temperature + 0.5 * step * (first + last)


@njit(cache=True)
def _one_stress(m, coil, spring, temperature, machine, load, stiffness, origin):
    """Shear stress of a spring that lifts a load, or stretches a bias spring of that preload and stiffness."""
    if machine == DEAD_WEIGHT:
        return load / pull(coil, 1.0)
    low, high = 0.0, 3e9
    for _ in range(70):
        middle = 0.5 * (low + high)
        s, t = evolve(m, spring, temperature, middle)
        if pull(coil, middle) > load + stiffness * (origin - stretch(m, coil, middle, s, t)):
            high = middle
        else:
            low = middle
    return 0.5 * (low + high)


@njit(cache=True)
def _single(m, heat, coil, machine, load, stiffness, voltage_driven, time, signal, spring, substeps):
    out = np.empty((time.size, 5))
    origin = stretch(m, coil, spring.stress, spring.detwinned, spring.twinned)
    for k in range(time.size):
        y = stretch(m, coil, spring.stress, spring.detwinned, spring.twinned)
        out[k] = (origin - y, spring.temperature, spring.stress, spring.detwinned, spring.twinned)
        if k == time.size - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        for _ in range(substeps):
            guess, new = spring.detwinned + spring.twinned, spring
            for _ in range(2):
                temperature = _warmed(heat, coil, voltage_driven, signal[k], spring, step, guess)
                new = _brought(
                    m, spring, temperature, _one_stress(m, coil, spring, temperature, machine, load, stiffness, origin)
                )
                guess = new.detwinned + new.twinned
            spring = new
    return out


@njit(cache=True)
def _stress_at(m, coil, spring, temperature, target):
    """Return the shear stress at which a spring has the target stretch, 0 if it is slack."""
    low, high = 0.0, 3e9
    for _ in range(60):
        middle = 0.5 * (low + high)
        s, t = evolve(m, spring, temperature, middle)
        if stretch(m, coil, middle, s, t) > target:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high) if low > 0.0 else 0.0


@njit(cache=True)
def _common_stress(m, coil, first, second, t1, t2, prestretch):
    """Return the common stress of two springs in series, whose stretches add up to twice the prestretch."""
    low, high = 0.0, 3e9
    for _ in range(60):
        middle = 0.5 * (low + high)
        a, b = evolve(m, first, t1, middle), evolve(m, second, t2, middle)
        if stretch(m, coil, middle, a[0], a[1]) + stretch(m, coil, middle, b[0], b[1]) > 2.0 * prestretch:
            high = middle
        else:
            low = middle
    return 0.5 * (low + high) if low > 0.0 else 0.0


@njit(cache=True)
def _pair(m, heat, coil, prestretch, radius, voltage_driven, time, signal, first, second, substeps):
    out, lean = np.empty((time.size, 9)), 0.0
    for k in range(time.size):
        out[k, 0] = lean / radius
        for i in range(4):
            out[k, 1 + i], out[k, 5 + i] = first[i], second[i]
        if k == time.size - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        for _ in range(substeps):
            g1, g2 = first.detwinned + first.twinned, second.detwinned + second.twinned
            a, b = first, second
            for _ in range(2):
                t1 = _warmed(heat, coil, voltage_driven, signal[k, 0], first, step, g1)
                t2 = _warmed(heat, coil, voltage_driven, signal[k, 1], second, step, g2)
                stress = _common_stress(m, coil, first, second, t1, t2, prestretch)
                a, b = _brought(m, first, t1, stress), _brought(m, second, t2, stress)
                g1, g2 = a.detwinned + a.twinned, b.detwinned + b.twinned
            first, second = a, b
            short1 = prestretch - stretch(m, coil, first.stress, first.detwinned, first.twinned)
            short2 = stretch(m, coil, second.stress, second.detwinned, second.twinned) - prestretch
            lean = min(max(lean, short1), short2)  # between the angles at which spring 1 and spring 2 become taut
    return out


@njit(cache=True)
def _turning(m, heat, coil, prestretch, joint, voltage_driven, time, signal, first, second, substeps):
    radius, inertia, damping, moment = joint
    out, angle, speed = np.empty((time.size, 10)), 0.0, 0.0
    for k in range(time.size):
        out[k, 0], out[k, 9] = angle, speed
        for i in range(4):
            out[k, 1 + i], out[k, 5 + i] = first[i], second[i]
        if k == time.size - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        for _ in range(substeps):
            g1, g2 = first.detwinned + first.twinned, second.detwinned + second.twinned
            now = (
                radius * pull(coil, first.stress - second.stress) - damping * speed - moment * math.sin(angle)
            ) / inertia
            there, turning, a, b = angle + step * speed + 0.5 * step**2 * now, speed + step * now, first, second
            for _ in range(3):  # the trapezoidal rule, by fixed point
                t1 = _warmed(heat, coil, voltage_driven, signal[k, 0], first, step, g1)
                t2 = _warmed(heat, coil, voltage_driven, signal[k, 1], second, step, g2)
                a = _brought(m, first, t1, _stress_at(m, coil, first, t1, prestretch - radius * there))
                b = _brought(m, second, t2, _stress_at(m, coil, second, t2, prestretch + radius * there))
                g1, g2 = a.detwinned + a.twinned, b.detwinned + b.twinned
                then = (
                    radius * pull(coil, a.stress - b.stress) - damping * turning - moment * math.sin(there)
                ) / inertia
                turning = speed + 0.5 * step * (now + then)
                there = angle + 0.5 * step * (speed + turning)
            first, second, angle, speed = a, b, there, turning
    return out


class Run(NamedTuple):
    """Series of a simulation: ``position`` in m or rad (n,), the rest (n, springs); shear stress in Pa; ``rate`` in rad/s."""

    position: Floats
    temperature: Floats
    stress: Floats
    detwinned: Floats
    twinned: Floats
    rate: Floats


def _run(out: Floats, springs: int) -> Run:
    each = [out[:, [1 + 4 * s + i for s in range(springs)]] for i in range(4)]
    return Run(out[:, 0], *each, out[:, 9] if out.shape[1] > 9 else np.empty(0))


def _drawn(material: Shear, coil: Coil, prestretch: float) -> Spring:
    """Return the cold, slack state after stretching to the prestretch; the rest of the martensite is twinned."""
    detwinned = min(max(prestretch / stretch(material, coil, 0.0, 1.0, 0.0), 0.0), 1.0)
    return Spring(coil.ambient, 0.0, detwinned, 1.0 - detwinned)


def _floats(parts: NamedTuple) -> tuple:
    return type(parts)(
        *(
            value if isinstance(value, int) and name == "law" else float(value)
            for name, value in parts._asdict().items()
        )
    )


def dead_weight(
    material: Shear,
    heat: Heat,
    coil: Coil,
    mass: float,
    time: Floats,
    signal: Floats,
    *,
    control: str,
    substeps: int = 20,
) -> Run:
    """Springs side by side lifting a mass; all detwinned at ambient. Position: the contraction in m. Inputs are held from row to row."""
    stress = mass * GRAVITY / pull(coil, 1.0)
    start = Spring(coil.ambient, stress, 1.0, 0.0)
    arguments = (
        _floats(material),
        _floats(heat),
        _floats(coil),
        DEAD_WEIGHT,
        mass * GRAVITY,
        0.0,
        control == "voltage",
    )
    return _run(_single(*arguments, np.asarray(time, float), np.asarray(signal, float), _floats(start), substeps), 1)


def bias_spring(
    material: Shear, heat: Heat, coil: Coil, stiffness: float, preload: float, time: Floats, signal: Floats, *, control: str, substeps: int = 20
) -> Run:  # fmt: skip
    """A spring that stretches another one, F = preload + stiffness x; starts all detwinned at ambient under the preload."""
    start = Spring(coil.ambient, preload / pull(coil, 1.0), 1.0, 0.0)
    arguments = (
        _floats(material),
        _floats(heat),
        _floats(coil),
        BIAS_SPRING,
        float(preload),
        float(stiffness),
        control == "voltage",
    )
    return _run(_single(*arguments, np.asarray(time, float), np.asarray(signal, float), _floats(start), substeps), 1)


def antagonistic(
    material: Shear, heat: Heat, coil: Coil, prestretch: float, radius: float, time: Floats, signal: Floats, *,
    control: str, substeps: int = 50,
) -> Run:  # fmt: skip
    """Two springs on a light pulley, slack at angle 0 and drawn out cold by the prestretch. Position: the angle in rad; signal (n, 2)."""
    start = _floats(_drawn(material, coil, prestretch))
    arguments = (
        _floats(material),
        _floats(heat),
        _floats(coil),
        float(prestretch),
        float(radius),
        control == "voltage",
    )
    return _run(
        _pair(*arguments, np.asarray(time, float), np.ascontiguousarray(signal, float), start, start, substeps), 2
    )


def joint(
    material: Shear, heat: Heat, coil: Coil, prestretch: float, radius: float, inertia: float, damping: float, moment: float,
    time: Floats, signal: Floats, *, control: str, substeps: int = 50,
) -> Run:  # fmt: skip
    """As ``antagonistic``, turning a link: inertia theta'' + damping theta' = radius (F_1 - F_2) - moment sin(theta); kg m^2, N m s/rad, N m."""
    start = _floats(_drawn(material, coil, prestretch))
    turned = (float(radius), float(inertia), float(damping), float(moment))
    arguments = (_floats(material), _floats(heat), _floats(coil), float(prestretch), turned, control == "voltage")
    return _run(
        _turning(*arguments, np.asarray(time, float), np.ascontiguousarray(signal, float), start, start, substeps), 2
    )
