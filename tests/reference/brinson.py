"""Brinson's law without smoothing: cosine kinetics with the correction of Chung, Heo and Lee (2007).

Fractions: ``detwinned`` (stress-induced martensite), ``twinned`` (temperature-induced), the rest is austenite. Temperatures in degC, stresses in
Pa, tension positive. With A the austenite 1 - detwinned - twinned, the three transformations are, along a leg of monotone driving variable,

    detwinning  d = sigma - C_M max(T - M_s, 0) rising:   1 - detwinned, twinned and A   all multiply by  g(d1) / g(d0)
    twinning    T falling:                                A alone                         multiplies by    t(T1) / t(T0)
    reverse     a = T - A_s - sigma / C_A rising:         detwinned and twinned           multiply by      f(a1) / f(a0)

with g, t, f the half cosines that fall from 1 at the start of their band to 0 at its finish. This *relative form* restarts from the current
fractions, needs no memory of the leg and completes from inside a band. A leg that starts outside its band agrees with the integrated form
of the literature (``forward_from_leg_start``, ``reverse_from_leg_start``). Factors of detwinning and twinning commute, so the result depends on the ends of a
monotone path only.

Sources: Brinson, J. Intell. Mater. Syst. Struct. 4 (1993) 229; Chung, Heo, Lee, Smart Mater. Struct. 16 (2007) N1.
"""

import math
from typing import NamedTuple

from numba import njit


class Material(NamedTuple):
    """Constants of a wire: degC, Pa, Pa/K, ohm m, 1/K."""

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
    thermal_expansion_austenite: float
    thermal_expansion_martensite: float


@njit(cache=True)
def half_cosine(phase):
    """Return (1 + cos(pi phase)) / 2, which is 1 below phase 0 and 0 above phase 1; the square keeps the precision near 0."""
    if phase <= 0.0:
        return 1.0
    if phase >= 1.0:
        return 0.0
    return math.sin(0.5 * math.pi * (1.0 - phase)) ** 2


@njit(cache=True)
def detwinning_drive(m, temperature, stress):
    """Return d in Pa: the stress minus the shift of the critical stresses above M_s."""
    return stress - m.clausius_clapeyron_martensite * max(temperature - m.martensite_start, 0.0)


@njit(cache=True)
def reverse_drive(m, temperature, stress):
    """Return a in K: the temperature above the start of the reverse transformation."""
    return temperature - m.austenite_start - stress / m.clausius_clapeyron_austenite


@njit(cache=True)
def detwinning_cosine(m, drive):
    """Return g(d)."""
    return half_cosine((drive - m.detwinning_start_stress) / (m.detwinning_finish_stress - m.detwinning_start_stress))


@njit(cache=True)
def twinning_cosine(m, temperature):
    """Return t(T)."""
    return half_cosine((m.martensite_start - temperature) / (m.martensite_start - m.martensite_finish))


@njit(cache=True)
def reverse_cosine(m, drive):
    """Return f(a)."""
    return half_cosine(drive / (m.austenite_finish - m.austenite_start))


@njit(cache=True)
def _ratio(after, before):
    # A cosine of 0 belongs to a complete transformation.
    return after / before if before > 0.0 else 0.0


@njit(cache=True)
def _monotone_leg(m, detwinned, twinned, t0, s0, t1, s1):
    a0, a1 = reverse_drive(m, t0, s0), reverse_drive(m, t1, s1)
    if a1 > a0 and a1 > 0.0:
        ratio = _ratio(reverse_cosine(m, a1), reverse_cosine(m, a0))
        detwinned *= ratio
        twinned *= ratio
    d0, d1 = detwinning_drive(m, t0, s0), detwinning_drive(m, t1, s1)
    if d1 > d0 and d1 > m.detwinning_start_stress:
        ratio = _ratio(detwinning_cosine(m, d1), detwinning_cosine(m, d0))
        detwinned = 1.0 - (1.0 - detwinned) * ratio
        twinned *= ratio
    if t1 < t0 and t1 < m.martensite_start:
        ratio = _ratio(twinning_cosine(m, t1), twinning_cosine(m, t0))
        twinned = 1.0 - detwinned - (1.0 - detwinned - twinned) * ratio
    return detwinned, twinned


@njit(cache=True)
def advance(m, detwinned, twinned, t0, s0, t1, s1):
    """Return the fractions after a straight path from (t0, s0) to (t1, s1): relative form, exact.

    d bends where the path crosses M_s, so the path is cut there; on both halves every driving variable is monotone.
    """
    above0, above1 = t0 - m.martensite_start, t1 - m.martensite_start
    if above0 * above1 < 0.0:
        middle = s0 + (s1 - s0) * above0 / (above0 - above1)
        detwinned, twinned = _monotone_leg(m, detwinned, twinned, t0, s0, m.martensite_start, middle)
        return _monotone_leg(m, detwinned, twinned, m.martensite_start, middle, t1, s1)
    return _monotone_leg(m, detwinned, twinned, t0, s0, t1, s1)


@njit(cache=True)
def mixture(austenite, martensite, fraction):
    """A property that follows the martensite fraction linearly."""
    return austenite + fraction * (martensite - austenite)


@njit(cache=True)
def modulus(m, fraction):
    """E(xi) in Pa."""
    return mixture(m.modulus_austenite, m.modulus_martensite, fraction)


@njit(cache=True)
def resistivity(m, fraction):
    """rho_e(xi) in ohm m."""
    return mixture(m.resistivity_austenite, m.resistivity_martensite, fraction)


@njit(cache=True)
def strain_of(m, temperature, stress, detwinned, twinned, reference):
    """Strain of a taut wire; thermal strain counts from the temperature ``reference``."""
    fraction = detwinned + twinned
    thermal = mixture(m.thermal_expansion_austenite, m.thermal_expansion_martensite, fraction) * (
        temperature - reference
    )
    return stress / modulus(m, fraction) + m.max_transformation_strain * detwinned + thermal


@njit(cache=True)
def stress_of(m, temperature, strain, detwinned, twinned, reference):
    """Stress of a wire at given fractions; a wire cannot push."""
    return max(
        0.0, modulus(m, detwinned + twinned) * (strain - strain_of(m, temperature, 0.0, detwinned, twinned, reference))
    )


# The integrated forms below take the fractions at the start of the leg. They are for tests of the kinetics, not used by the simulators.


@njit(cache=True)
def _critical(m, temperature):
    shift = m.clausius_clapeyron_martensite * max(temperature - m.martensite_start, 0.0)
    return m.detwinning_start_stress + shift, m.detwinning_finish_stress + shift


@njit(cache=True)
def _detwinned_at(m, temperature, stress, detwinned0):
    start, finish = _critical(m, temperature)
    if stress >= finish:
        return 1.0
    if stress <= start:
        return detwinned0
    return 0.5 * (1.0 - detwinned0) * math.cos(math.pi / (start - finish) * (stress - finish)) + 0.5 * (
        1.0 + detwinned0
    )


@njit(cache=True)
def chung_d(m, temperature, detwinned0, twinned0, cooling):
    """Return the twinned fraction after cooling alone: the corrected D of eq. 5; complete below M_f."""
    if not cooling or temperature >= m.martensite_start:
        return twinned0
    angle = (
        math.pi
        * (max(temperature, m.martensite_finish) - m.martensite_finish)
        / (m.martensite_start - m.martensite_finish)
    )
    return 0.5 * (1.0 - detwinned0 - twinned0) * math.cos(angle) + 0.5 * (1.0 - detwinned0 + twinned0)


@njit(cache=True)
def forward_from_leg_start(m, temperature, stress, detwinned0, twinned0, cooling):
    """Integrated kinetics of a forward leg that started outside its bands: branches (i), (ii), (iii). Returns (detwinned, twinned)."""
    detwinned = _detwinned_at(m, temperature, stress, detwinned0)
    twinned = chung_d(m, temperature, detwinned0, twinned0, cooling)
    if detwinned0 < 1.0:
        twinned -= twinned * (detwinned - detwinned0) / (1.0 - detwinned0)
    return detwinned, twinned


@njit(cache=True)
def reverse_from_leg_start(m, temperature, stress, detwinned0, twinned0):
    """Integrated kinetics of a reverse leg that started outside its band: branch (iv). Returns (detwinned, twinned)."""
    drive = reverse_drive(m, temperature, stress)
    width = m.austenite_finish - m.austenite_start
    remainder = 0.5 * (math.cos(math.pi / width * min(max(drive, 0.0), width)) + 1.0)
    return detwinned0 * remainder, twinned0 * remainder


@njit(cache=True)
def brinson_original(m, temperature, stress, detwinned0, twinned0):
    """Brinson's uncorrected law of 1993 for M_f <= T < M_s on cooling: the sum of the fractions can pass 1. Returns (detwinned, twinned)."""
    detwinned = _detwinned_at(m, temperature, stress, detwinned0)
    angle = math.pi * (temperature - m.martensite_finish) / (m.martensite_start - m.martensite_finish)
    cooled = 0.5 * (1.0 - twinned0) * (math.cos(angle) + 1.0)
    return detwinned, twinned0 - twinned0 / (1.0 - detwinned0) * (detwinned - detwinned0) + cooled
