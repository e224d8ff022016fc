"""A wire of cells along its length, each of several grains: kinetics, heat and length over one fine step.

Kinetics: each grain has logistic branches in the relative form, about the middles of the rig file's bands. With a = T - sigma / C_A,
d = sigma - C_M max(T - M_s, 0) and the remaining shares F(u) = 1 / (1 + exp(u)),

    reverse     a rising:   detwinned and twinned            multiply by F((a1 - A) / w_A) / F((a0 - A) / w_A)
    detwinning  d rising:   1 - detwinned, twinned, 1 - xi   multiply by F((d1 - D) / w_D) / F((d0 - D) / w_D)
    twinning    T falling:  1 - xi                           multiplies by F((M - T1) / w_M) / F((M - T0) / w_M)

where A = (A_s + A_f) / 2, D is the middle of the critical stresses and M = (M_s + M_f) / 2. Each grain has its shifts of A and of M_s
(with M). A logistic of w = band / (2 pi) has the slope of the half cosine of the band in the middle; each grain has a share of that.
A step in which d first rises and then falls, as T passes M_s, is taken as one leg: an error of second order in the step.

Heat: capacity dT/dt - latent dxi/dt = rho (i / section)^2 - 4 h (T - air) / diameter + conduction along the wire, to clamps that have a
capacity. Rates by the Adams-Bashforth rule of second order. The heat content is what is stepped, the temperature follows from it by one
linearised step, and what that misses stays in the content for the next step: so the balance of energy is exact.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]
LARGEST = 600.0  # exponent that does not overflow, also with a grain's factor
NOTHING = 42.0  # minus the exponent at which a branch, also with a grain's factor, moves less than 1e-13
WARM = 40.0  # K above M_s at which no grain is in the bands of cooling at rest or under little stress


class Constants(NamedTuple):
    """What the compiled functions know of a rig, SI and degC; arrays are of shape ``(cells,)`` or ``(grains,)``."""

    reverse_middle: float
    reverse_width: float
    slope_austenite: float
    detwinning_middle: float
    detwinning_width: float
    slope_martensite: float
    martensite_start: float
    twinning_middle: float
    twinning_width: float
    modulus_austenite: float
    modulus_martensite: float
    max_strain: float
    expansion_austenite: float
    expansion_martensite: float
    resistivity_austenite: float
    resistivity_martensite: float
    capacity: float
    h0: float
    h1: float
    h2: float
    ambient: float
    diameter: float
    section: float
    length: float
    clamp_capacity: float
    clamp_loss: float
    austenite_factor: Floats
    martensite_shift: Floats
    detwinning_factor: Floats
    twinning_factor: Floats
    share: Floats
    conductance: Floats


class Wire(NamedTuple):
    """State of one wire; arrays of shape ``(cells,)``, ``(cells, grains)``, and of the two clamps.

    ``trial_detwinned`` and ``trial_twinned`` are the fractions at the end of the step that is being solved, ``slope`` is -dxi/dT there.
    ``lost`` and ``conducted`` (W/m^3), ``rho``, ``clamp_gain`` and ``clamp_lost`` (W) are those at the start of the last step. ``energy`` sums up the electric heat, the heat lost to the air and that lost by the clamps, J.
    """

    cooling: Floats
    temperature: Floats
    before: Floats
    content: Floats
    xi: Floats
    slope: Floats
    lost: Floats
    conducted: Floats
    rho: Floats
    detwinned: Floats
    twinned: Floats
    trial_detwinned: Floats
    trial_twinned: Floats
    clamp: Floats
    clamp_gain: Floats
    clamp_lost: Floats
    energy: Floats


@njit(cache=True, fastmath=True)
def _reverse(c, d, w, p0, p1):
    """Apply the reverse transformation to the grains; return the rates per unit of its argument of detwinned and of all martensite."""
    by_d = by_xi = 0.0
    for g in range(d.size):
        p = p1 * c.austenite_factor[g]
        rest = 1.0 / (1.0 + p)
        factor = (1.0 + p0 * c.austenite_factor[g]) * rest
        d[g] *= factor
        w[g] *= factor
        by_d += d[g] * p * rest
        by_xi += (d[g] + w[g]) * p * rest
    return by_d, by_xi


@njit(cache=True, fastmath=True)
def _detwin(c, d, w, t0, t1, cold0, cold1, warm0, warm1):
    """Apply detwinning to the grains; return the rates per unit of its argument: detwinned, all, and all above M_s."""
    by_d = by_xi = by_warm = 0.0
    for g in range(d.size):
        start = c.martensite_start + c.martensite_shift[g]
        q0 = warm0 * c.detwinning_factor[g] if t0 > start else cold0
        q = warm1 * c.detwinning_factor[g] if t1 > start else cold1
        rest = 1.0 / (1.0 + q)
        factor = (1.0 + q0) * rest if q > q0 else 1.0
        rate = q * rest if q > q0 else 0.0
        austenite = (1.0 - d[g] - w[g]) * factor
        d[g] = 1.0 - (1.0 - d[g]) * factor
        w[g] *= factor
        by_d += (1.0 - d[g]) * rate
        by_xi += austenite * rate
        by_warm += austenite * rate if t1 > start else 0.0
    return by_d, by_xi, by_warm


@njit(cache=True, fastmath=True)
def _twin(c, d, w, r0, r1):
    """Apply twinning to the grains; return the rate of all martensite per unit of its argument."""
    by_xi = 0.0
    for g in range(d.size):
        r = r1 * c.twinning_factor[g]
        rest = 1.0 / (1.0 + r)
        austenite = (1.0 - d[g] - w[g]) * (1.0 + r0 * c.twinning_factor[g]) * rest
        w[g] = 1.0 - d[g] - austenite
        by_xi += austenite * r * rest
    return by_xi


@njit(cache=True)
def transform(c, d0, w0, d, w, t0, s0, t1, s1):
    """Write the fractions of the grains of a cell after a step into ``d`` and ``w``.

    Returns:
        Detwinned and all martensite, the derivative of the detwinned with respect to the stress, and those of all martensite to stress and
        temperature. Derivatives serve Newton's rule only, and leave out that two transformations may act in one step.
    """
    grains = d.size
    d[:] = d0
    w[:] = w0
    d_s = xi_s = xi_t = 0.0
    a0 = min((t0 - s0 / c.slope_austenite - c.reverse_middle) / c.reverse_width, LARGEST)
    a1 = min((t1 - s1 / c.slope_austenite - c.reverse_middle) / c.reverse_width, LARGEST)
    if a1 > a0 and a1 > -NOTHING:
        by_d, by_xi = _reverse(c, d, w, math.exp(a0), math.exp(a1))
        per_stress = 1.0 / (c.reverse_width * c.slope_austenite)
        d_s, xi_s, xi_t = by_d * per_stress, by_xi * per_stress, -by_xi / c.reverse_width
    u0, u1 = (s0 - c.detwinning_middle) / c.detwinning_width, (s1 - c.detwinning_middle) / c.detwinning_width
    per_kelvin = c.slope_martensite / c.detwinning_width
    v0, v1 = u0 - per_kelvin * (t0 - c.martensite_start), u1 - per_kelvin * (t1 - c.martensite_start)
    if (v1 > v0 and v1 > -NOTHING) or (u1 > u0 and t1 < c.martensite_start + WARM):
        cold0, cold1 = math.exp(min(u0, LARGEST)), math.exp(min(u1, LARGEST))
        warm0, warm1 = math.exp(min(v0, LARGEST)), math.exp(min(v1, LARGEST))
        by_d, by_xi, by_warm = _detwin(c, d, w, t0, t1, cold0, cold1, warm0, warm1)
        d_s, xi_s = d_s + by_d / c.detwinning_width, xi_s + by_xi / c.detwinning_width
        xi_t -= by_warm * per_kelvin
    if t1 < t0 and t1 < c.martensite_start + WARM:
        r0 = math.exp(min((c.twinning_middle - t0) / c.twinning_width, LARGEST))
        r1 = math.exp(min((c.twinning_middle - t1) / c.twinning_width, LARGEST))
        xi_t -= _twin(c, d, w, r0, r1) / c.twinning_width
    detwinned = np.sum(d)
    return detwinned / grains, (detwinned + np.sum(w)) / grains, d_s / grains, xi_s / grains, xi_t / grains


@njit(cache=True)
def strain_after(c, x, s0, s1):
    """Try the end of a step at the stress ``s1``: return the wire's strain and its derivative with respect to ``s1``."""
    strain = by_stress = 0.0
    for j in range(x.temperature.size):
        t = x.temperature[j]
        d, xi, d_s, xi_s, xi_t = transform(
            c, x.detwinned[j], x.twinned[j], x.trial_detwinned[j], x.trial_twinned[j], x.before[j], s0, t, s1
        )
        x.xi[j], x.slope[j] = xi, max(-xi_t, 0.0)
        softer = c.modulus_martensite - c.modulus_austenite
        modulus = c.modulus_austenite + xi * softer
        expansion = c.expansion_austenite + xi * (c.expansion_martensite - c.expansion_austenite)
        strain += c.share[j] * (s1 / modulus + c.max_strain * d + expansion * (t - c.ambient))
        by_stress += c.share[j] * (1.0 / modulus - s1 * softer / modulus**2 * xi_s + c.max_strain * d_s)
    return strain, max(by_stress, 1e-12)


@njit(cache=True)
def accept(x):
    """Take the fractions that were tried last."""
    x.detwinned[:] = x.trial_detwinned
    x.twinned[:] = x.trial_twinned


@njit(cache=True)
def resistance(c, x):
    """Resistance of a wire in ohm."""
    ohms = 0.0
    for j in range(x.xi.size):
        rho = c.resistivity_austenite + x.xi[j] * (c.resistivity_martensite - c.resistivity_austenite)
        ohms += rho * c.share[j] * c.length / c.section
    return ohms


@njit(cache=True)
def _conduct(c, x, flow, clamp_flow):
    """Write the heat conducted into each cell (W) and into each clamp."""
    cells = x.temperature.size
    flow[:] = 0.0
    for j in range(cells - 1):
        between = c.conductance[j + 1] * (x.temperature[j] - x.temperature[j + 1])
        flow[j] -= between
        flow[j + 1] += between
    clamp_flow[0] = c.conductance[0] * (x.temperature[0] - x.clamp[0])
    clamp_flow[1] = c.conductance[cells] * (x.temperature[cells - 1] - x.clamp[1])
    flow[0] -= clamp_flow[0]
    flow[cells - 1] -= clamp_flow[1]


@njit(cache=True)
def heat_up(c, hidden, x, other, current, air, wind, step, ratio, flow, clamp_flow):
    """Advance heat contents and temperatures by a step under a current (A).

    Args:
        c: Constants.
        hidden: Hidden effects; ``latent_heat`` and ``crosstalk`` are used here.
        x: The wire.
        other: The other wire, from whose cells heat crosses over; the wire itself if it is alone.
        current: Current in the middle of the step.
        air: Temperature of the air.
        wind: Convection relative to that of the rig.
        step: Duration in s.
        ratio: Half of this duration over that of the last step; 0 in the first step.
        flow: Scratch, shape ``(cells,)``.
        clamp_flow: Scratch, shape ``(2,)``.
    """
    _conduct(c, x, flow, clamp_flow)
    base = c.h0 + (c.h1 + c.h2 * c.ambient) * c.ambient
    for j in range(x.temperature.size):
        t, volume = x.temperature[j], c.share[j] * c.length * c.section
        h = c.h0 + (c.h1 + c.h2 * t) * t
        lost = 4.0 / c.diameter * x.cooling[j] * h * wind * (t - air)
        lost += 4.0 / c.diameter * base * hidden.crosstalk * (t - other.before[j])
        conducted = flow[j] / volume
        rho = c.resistivity_austenite + x.xi[j] * (c.resistivity_martensite - c.resistivity_austenite)
        joule = (rho + ratio * (rho - x.rho[j])) * (current / c.section) ** 2
        out = lost + ratio * (lost - x.lost[j])
        x.content[j] += step * (joule - out + conducted + ratio * (conducted - x.conducted[j]))
        x.lost[j], x.conducted[j], x.rho[j] = lost, conducted, rho
        x.energy[0] += step * volume * joule
        x.energy[1] += step * volume * out
        missing = x.content[j] - c.capacity * t + hidden.latent_heat * x.xi[j]
        x.temperature[j] = t + missing / (c.capacity + hidden.latent_heat * x.slope[j])
    for k in range(2):
        lost = c.clamp_loss * (x.clamp[k] - air)
        gain, out = clamp_flow[k] + ratio * (clamp_flow[k] - x.clamp_gain[k]), lost + ratio * (lost - x.clamp_lost[k])
        x.clamp[k] += step * (gain - out) / c.clamp_capacity
        x.energy[2] += step * out
        x.clamp_gain[k], x.clamp_lost[k] = clamp_flow[k], lost


@njit(cache=True)
def stored(c, hidden, x):
    """Heat in a wire and its clamps, J: that of its temperatures and fractions."""
    heat = c.clamp_capacity * (x.clamp[0] + x.clamp[1])
    for j in range(x.temperature.size):
        volume = c.share[j] * c.length * c.section
        heat += volume * (c.capacity * x.temperature[j] - hidden.latent_heat * x.xi[j])
    return heat
