"""Exact simulator of a wire with the laws of Tanaka or of Liang and Rogers against a spring: the published closed forms, with memory of their legs.

    cooling   1 - xi = (1 - xi_0) g(p) / g(p_0),    p = (M_s + sigma / C_M - T) / (M_s - M_f)
    heating       xi =      xi_0  g(q) / g(q_0),    q = (T - A_s - sigma / C_A) / (A_f - A_s)

with g = 0.01^p (Tanaka) or half a cosine, and xi_0, p_0, q_0 where the driving variable last began to rise (Elahinia and Ahmadian 2005).
Heat by the classical Runge-Kutta rule, the stress by bisection at each of its stages; time is not cut at events. The wire's heat, strain
and resistance are those of the other references (``wire.py``, ``brinson.py``); the kinetics are its own.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tests.reference.brinson import Material, half_cosine, strain_of
from tests.reference.wire import CURRENT, Heat, State, Wire, area, floats, heating

Floats = NDArray[np.float64]
NONE, FORWARD, REVERSE = 0, 1, 2


class Rig(NamedTuple):
    """The law is Tanaka's or not; all martensite is detwinned. A spring in N/m with its preload in N; without stiffness a dead weight."""

    tanaka: bool
    material: Material
    heat: Heat
    wire: Wire
    stiffness: float
    preload: float
    control: int = CURRENT


class Leg(NamedTuple):
    """State of the wire, and the start of its leg: kind, driving variable and fraction."""

    martensite: float
    temperature: float
    stress: float
    kind: int
    begun: float
    had: float


@njit(cache=True)
def left(tanaka, share):
    """Return g, the fraction not yet transformed."""
    if tanaka:
        return math.exp(-max(share, 0.0) * math.log(100.0))
    return half_cosine(share)


@njit(cache=True)
def drives(m, temperature, stress):
    """Return p and q."""
    p = (m.martensite_start + stress / m.clausius_clapeyron_martensite - temperature) / (
        m.martensite_start - m.martensite_finish
    )
    q = (temperature - m.austenite_start - stress / m.clausius_clapeyron_austenite) / (
        m.austenite_finish - m.austenite_start
    )
    return p, q


@njit(cache=True)
def follow(r, leg, temperature, stress):
    """Return the state at a temperature and a stress, along a path with monotone driving variables."""
    p0, q0 = drives(r.material, leg.temperature, leg.stress)
    p, q = drives(r.material, temperature, stress)
    if p > p0 and p > 0.0:
        begun, had = (leg.begun, leg.had) if leg.kind == FORWARD else (p0, leg.martensite)
        whole = left(r.tanaka, begun)
        martensite = 1.0 - (1.0 - had) * left(r.tanaka, p) / whole if whole > 0.0 else 1.0
        return Leg(martensite, temperature, stress, FORWARD, begun, had)
    if q > q0 and q > 0.0:
        begun, had = (leg.begun, leg.had) if leg.kind == REVERSE else (q0, leg.martensite)
        whole = left(r.tanaka, begun)
        martensite = had * left(r.tanaka, q) / whole if whole > 0.0 else 0.0
        return Leg(martensite, temperature, stress, REVERSE, begun, had)
    return Leg(leg.martensite, temperature, stress, NONE, 0.0, leg.martensite)


@njit(cache=True)
def strain(r, leg):
    """Total strain; thermal strain counts from ambient."""
    return strain_of(r.material, leg.temperature, leg.stress, leg.martensite, 0.0, r.wire.ambient)


@njit(cache=True)
def _settled(r, leg, temperature, origin):
    """Return the state at a temperature in force balance with the spring."""
    section, low, high = area(r.wire), 0.0, 3e9
    if r.stiffness == 0.0:
        return follow(r, leg, temperature, r.preload / section)
    for _ in range(70):
        middle = 0.5 * (low + high)
        wire_strain = strain(r, follow(r, leg, temperature, middle))
        if middle * section > r.preload + r.stiffness * r.wire.length * (origin - wire_strain):
            high = middle
        else:
            low = middle
    return follow(r, leg, temperature, 0.5 * (low + high))


@njit(cache=True)
def _rate(r, leg, current):
    return heating(r, current, State(leg.temperature, leg.stress, leg.martensite, 0.0)) / r.heat.capacity_austenite


@njit(cache=True)
def _march(r, time, current, substeps):
    leg = Leg(1.0, r.wire.ambient, r.preload / area(r.wire), NONE, 0.0, 1.0)
    origin = strain(r, leg)
    out = np.empty((time.size, 4))
    for k in range(time.size):
        out[k] = (r.wire.length * (origin - strain(r, leg)), leg.temperature, leg.stress, leg.martensite)
        if k == time.size - 1:
            break
        step = (time[k + 1] - time[k]) / substeps
        for _ in range(substeps):
            warm = leg.temperature
            a = _rate(r, leg, current[k])
            b = _rate(r, _settled(r, leg, warm + 0.5 * step * a, origin), current[k])
            c = _rate(r, _settled(r, leg, warm + 0.5 * step * b, origin), current[k])
            d = _rate(r, _settled(r, leg, warm + step * c, origin), current[k])
            leg = _settled(r, leg, warm + step / 6.0 * (a + 2.0 * (b + c) + d), origin)
    return out


def simulate(rig: Rig, time: Floats, current: Floats, substeps: int = 20) -> Floats:
    """Simulate a wire that starts detwinned at ambient under its preload; the current is constant between rows.

    Returns contraction in m, temperature, stress and martensite fraction, shape (n, 4). Both phases have the capacity of austenite.
    """
    own_rig = rig._replace(
        **dict(zip(("material", "heat", "wire"), floats(rig.material, rig.heat, rig.wire), strict=True))
    )
    return _march(own_rig, np.ascontiguousarray(time, float), np.ascontiguousarray(current, float), substeps)
