"""Hand-compiled loop with the exact kinetics: a reference for speed, not for accuracy.

The same kinetics as ``brinson.py`` (relative form, exact over a step), as one would write them for speed: one second-order (Heun) step of the heat
balance for each of ``substeps`` parts of a sample, cosines evaluated only inside their bands, the rotary's balance of forces by a safeguarded
Newton iteration with the analytic slope. Plain float arithmetic (no fast-math). The batch versions share designs among numba's threads.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange


class Design(NamedTuple):
    """All parameters of a simulation in degC and SI; those that a rig does not have (mass, prestrain, radius) are ignored."""

    martensite_start: float
    martensite_finish: float
    austenite_start: float
    austenite_finish: float
    clausius_clapeyron_austenite: float
    clausius_clapeyron_martensite: float
    modulus_austenite: float
    modulus_martensite: float
    resistivity_austenite: float
    resistivity_martensite: float
    detwinning_start_stress: float
    detwinning_finish_stress: float
    max_transformation_strain: float
    thermal_expansion: float
    h0: float
    h1: float
    h2: float
    capacity: float
    diameter: float
    length: float
    ambient: float
    mass: float
    prestrain: float
    radius: float


@njit(cache=True, inline="always")
def _cosine(phase):
    if phase <= 0.0:
        return 1.0
    if phase >= 1.0:
        return 0.0
    c = math.cos(0.5 * math.pi * phase)
    return c * c


@njit(cache=True)
def _constant_stress(p, stress, t0, t1, detwinned, twinned):
    """Fractions after a change of temperature at constant stress."""
    if t1 > t0:
        start, per_kelvin = (
            p.austenite_start + stress / p.clausius_clapeyron_austenite,
            1.0 / (p.austenite_finish - p.austenite_start),
        )
        if t1 > start and detwinned + twinned > 0.0:
            before = _cosine((t0 - start) * per_kelvin)
            ratio = _cosine((t1 - start) * per_kelvin) / before if before > 0.0 else 0.0
            return detwinned * ratio, twinned * ratio
    elif detwinned < 1.0:
        per_pascal = 1.0 / (p.detwinning_finish_stress - p.detwinning_start_stress)
        above0, above1 = max(t0 - p.martensite_start, 0.0), max(t1 - p.martensite_start, 0.0)
        drive = stress - p.detwinning_start_stress - p.clausius_clapeyron_martensite * above1
        if above0 > 0.0 and drive > 0.0:
            before = _cosine(
                (stress - p.detwinning_start_stress - p.clausius_clapeyron_martensite * above0) * per_pascal
            )
            ratio = _cosine(drive * per_pascal) / before if before > 0.0 else 0.0
            detwinned, twinned = 1.0 - (1.0 - detwinned) * ratio, twinned * ratio
        if t1 < p.martensite_start and detwinned + twinned < 1.0:
            per_kelvin = 1.0 / (p.martensite_start - p.martensite_finish)
            before = _cosine((p.martensite_start - t0) * per_kelvin)
            ratio = _cosine((p.martensite_start - t1) * per_kelvin) / before if before > 0.0 else 0.0
            twinned = 1.0 - detwinned - (1.0 - detwinned - twinned) * ratio
    return detwinned, twinned


@njit(cache=True, inline="always")
def _warming(p, joule, t, fraction):
    """dT/dt; ``joule`` is 1 / (area^2 capacity) I^2, ``p.h..`` act over 4 / (d C)."""
    rho = p.resistivity_austenite + fraction * (p.resistivity_martensite - p.resistivity_austenite)
    return rho * joule - 4.0 / (p.diameter * p.capacity) * (p.h0 + (p.h1 + p.h2 * t) * t) * (t - p.ambient)


@njit(cache=True)
def _dead_weight(p, time, current, linear, substeps, out):
    area = 0.25 * math.pi * p.diameter**2
    stress, per_square = p.mass * 9.81 / area, 1.0 / (area * area * p.capacity)
    t, detwinned, twinned = p.ambient, 1.0, 0.0
    start = stress / p.modulus_martensite + p.max_transformation_strain
    out[0] = 0.0
    for k in range(time.size - 1):
        h = (time[k + 1] - time[k]) / substeps
        slope = (current[k + 1] - current[k]) / substeps if linear else 0.0
        for j in range(substeps):
            u0 = current[k] + j * slope
            u1 = u0 + slope
            r0 = _warming(p, u0 * u0 * per_square, t, detwinned + twinned)
            guess = t + h * r0
            a, b = _constant_stress(p, stress, t, guess, detwinned, twinned)
            t_new = t + 0.5 * h * (r0 + _warming(p, u1 * u1 * per_square, guess, a + b))
            detwinned, twinned = _constant_stress(p, stress, t, t_new, detwinned, twinned)
            t = t_new
        modulus = p.modulus_austenite + (detwinned + twinned) * (p.modulus_martensite - p.modulus_austenite)
        strain = stress / modulus + p.max_transformation_strain * detwinned + p.thermal_expansion * (t - p.ambient)
        out[k + 1] = p.length * (start - strain)


@njit(cache=True)
def _leg(p, t0, s0, t1, s1, detwinned, twinned):
    """Fractions after a leg on one side of M_s, and their slopes d(detwinned)/ds1, d(fraction)/ds1."""
    slope, slope_all = 0.0, 0.0
    width = p.austenite_finish - p.austenite_start
    a0 = t0 - p.austenite_start - s0 / p.clausius_clapeyron_austenite
    a1 = t1 - p.austenite_start - s1 / p.clausius_clapeyron_austenite
    if a1 > a0 and a1 > 0.0:
        before = _cosine(a0 / width)
        ratio = _cosine(a1 / width) / before if before > 0.0 else 0.0
        if ratio > 0.0 and a1 < width:
            fall = 0.5 * math.pi / width * math.sin(math.pi * a1 / width) / (before * p.clausius_clapeyron_austenite)
            slope, slope_all = detwinned * fall, (detwinned + twinned) * fall
        detwinned, twinned = detwinned * ratio, twinned * ratio
    if detwinned < 1.0:
        start = p.detwinning_start_stress
        width = p.detwinning_finish_stress - start
        d0 = s0 - start - p.clausius_clapeyron_martensite * max(t0 - p.martensite_start, 0.0)
        d1 = s1 - start - p.clausius_clapeyron_martensite * max(t1 - p.martensite_start, 0.0)
        if d1 > d0 and d1 > 0.0:
            before = _cosine(d0 / width)
            ratio = _cosine(d1 / width) / before if before > 0.0 else 0.0
            if ratio > 0.0 and d1 < width:
                rise = 0.5 * math.pi / width * math.sin(math.pi * d1 / width) / before
                slope, slope_all = (1.0 - detwinned) * rise, (1.0 - detwinned - twinned) * rise
            detwinned, twinned = 1.0 - (1.0 - detwinned) * ratio, twinned * ratio
        if t1 < t0 and t1 < p.martensite_start and detwinned + twinned < 1.0:
            width = p.martensite_start - p.martensite_finish
            before = _cosine((p.martensite_start - t0) / width)
            ratio = _cosine((p.martensite_start - t1) / width) / before if before > 0.0 else 0.0
            twinned = 1.0 - detwinned - (1.0 - detwinned - twinned) * ratio
            slope_all *= ratio
    return detwinned, twinned, slope, slope_all


@njit(cache=True)
def _stretch(p, t0, s0, t1, s1, detwinned, twinned):
    """Strain at the end of a step, its slope in s1, and the fractions there."""
    above0, above1 = t0 - p.martensite_start, t1 - p.martensite_start
    if above0 * above1 < 0.0:
        middle = s0 + (s1 - s0) * above0 / (above0 - above1)
        detwinned, twinned, _, _ = _leg(p, t0, s0, p.martensite_start, middle, detwinned, twinned)
        t0, s0 = p.martensite_start, middle
    detwinned, twinned, slope, slope_all = _leg(p, t0, s0, t1, s1, detwinned, twinned)
    change = p.modulus_martensite - p.modulus_austenite
    compliance = 1.0 / (p.modulus_austenite + (detwinned + twinned) * change)
    strain = s1 * compliance + p.max_transformation_strain * detwinned + p.thermal_expansion * (t1 - p.ambient)
    return (
        strain,
        compliance - s1 * compliance * compliance * change * slope_all + p.max_transformation_strain * slope,
        detwinned,
        twinned,
    )


@njit(cache=True)
def _balance(p, s0, guess, t1, t1_new, x1, y1, t2, t2_new, x2, y2):
    """Common stress (0: slack) with the fractions and strains of both wires there."""
    low, high, s = 0.0, 1e300, max(guess, 0.0)
    for _ in range(60):
        e1, slope1, a1, b1 = _stretch(p, t1, s0, t1_new, s, x1, y1)
        e2, slope2, a2, b2 = _stretch(p, t2, s0, t2_new, s, x2, y2)
        miss = e1 + e2 - 2.0 * p.prestrain
        if miss > 0.0:
            high = s
        else:
            low = s
        new = s - miss / (slope1 + slope2)
        if not low <= new <= high:
            new = 0.5 * (low + high) if high < 1e300 else 2.0 * s + 1e6
        if abs(new - s) <= 1e-3 or (s == 0.0 and miss >= 0.0):
            return s, a1, b1, a2, b2, e1, e2
        s = new
    return s, a1, b1, a2, b2, e1, e2


@njit(cache=True)
def _rotary(p, time, current, linear, substeps, out):
    area = 0.25 * math.pi * p.diameter**2
    per_square = 1.0 / (area * area * p.capacity)
    t1 = t2 = p.ambient
    x1 = x2 = min(p.prestrain / p.max_transformation_strain, 1.0)
    y1 = y2 = 1.0 - x1
    s, lean = 0.0, 0.0
    out[0] = 0.0
    for k in range(time.size - 1):
        h = (time[k + 1] - time[k]) / substeps
        step1 = (current[k + 1, 0] - current[k, 0]) / substeps if linear else 0.0
        step2 = (current[k + 1, 1] - current[k, 1]) / substeps if linear else 0.0
        for j in range(substeps):
            u1, u2 = current[k, 0] + j * step1, current[k, 1] + j * step2
            r1, r2 = _warming(p, u1 * u1 * per_square, t1, x1 + y1), _warming(p, u2 * u2 * per_square, t2, x2 + y2)
            g1, g2 = t1 + h * r1, t2 + h * r2
            guess, a1, b1, a2, b2, _, _ = _balance(p, s, s, t1, g1, x1, y1, t2, g2, x2, y2)
            u1, u2 = u1 + step1, u2 + step2
            g1 = t1 + 0.5 * h * (r1 + _warming(p, u1 * u1 * per_square, g1, a1 + b1))
            g2 = t2 + 0.5 * h * (r2 + _warming(p, u2 * u2 * per_square, g2, a2 + b2))
            s, x1, y1, x2, y2, e1, e2 = _balance(p, s, guess, t1, g1, x1, y1, t2, g2, x2, y2)
            t1, t2 = g1, g2
            lean = min(max(lean, p.prestrain - e1), e2 - p.prestrain)
        out[k + 1] = p.length / p.radius * lean


@njit(cache=True)
def _design(row):
    return Design(
        row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8], row[9], row[10], row[11],
        row[12], row[13], row[14], row[15], row[16], row[17], row[18], row[19], row[20], row[21], row[22], row[23],
    )  # fmt: skip


@njit(cache=True, parallel=True)
def _dead_weights(rows, time, current, linear, substeps, out):
    for i in prange(rows.shape[0]):
        _dead_weight(_design(rows[i]), time, current, linear, substeps, out[i])


@njit(cache=True, parallel=True)
def _rotaries(rows, time, current, linear, substeps, out):
    for i in prange(rows.shape[0]):
        _rotary(_design(rows[i]), time, current, linear, substeps, out[i])


def dead_weight(
    design: Design, time: np.ndarray, current: np.ndarray, *, linear: bool = True, substeps: int = 1
) -> np.ndarray:
    """Contraction in m, (n,), of one design; ``time`` and ``current`` are (n,)."""
    out = np.empty(time.size)
    _dead_weight(Design(*map(float, design)), time, current, linear, substeps, out)
    return out


def rotary(
    design: Design, time: np.ndarray, current: np.ndarray, *, linear: bool = False, substeps: int = 8
) -> np.ndarray:
    """Angle in rad, (n,), of one design; ``current`` is (n, 2)."""
    out = np.empty(time.size)
    _rotary(Design(*map(float, design)), time, current, linear, substeps, out)
    return out


def dead_weight_batch(
    rows: np.ndarray, time: np.ndarray, current: np.ndarray, *, linear: bool = True, substeps: int = 1
) -> np.ndarray:
    """Contractions (m, n) of the designs in ``rows`` (m, 24), the columns as in ``Design``, all on numba's threads."""
    out = np.empty((len(rows), time.size))
    _dead_weights(np.ascontiguousarray(rows, float), time, current, linear, substeps, out)
    return out


def rotary_batch(
    rows: np.ndarray, time: np.ndarray, current: np.ndarray, *, linear: bool = False, substeps: int = 8
) -> np.ndarray:
    """Angles (m, n) of the designs in ``rows`` (m, 24)."""
    out = np.empty((len(rows), time.size))
    _rotaries(np.ascontiguousarray(rows, float), time, current, linear, substeps, out)
    return out
