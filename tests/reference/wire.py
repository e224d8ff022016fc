"""One or two wires over a short step: heat content, temperature, fractions, and the stress that holds the balance of forces.

Heat is counted as a heat content per volume, so that latent heat and a capacity that depends on the phase need no rate of the fractions:

    C_mean (T1 - T0) - latent (xi1 - xi0) = heat added,      C_mean = capacity at the mean of xi0 and xi1

(the first two terms are all there is by default). The balance of every rig is one equation in one unknown, the stress s,

    c_s s + c_1 eps_1(s) + c_2 eps_2(s) = right-hand side,

whose left side rises with s, because a higher stress never makes less martensite. If it is already too large at s = 0 the wires hang slack.
"""

import math
from typing import NamedTuple

from numba import njit

from tests.reference.brinson import Material, advance, mixture, resistivity, strain_of

CURRENT, POWER, VOLTAGE = 0, 1, 2
CONTROLS = {"current": CURRENT, "power": POWER, "voltage": VOLTAGE}


class Heat(NamedTuple):
    """h(T) = h0 + h1 T + h2 T^exponent (T in degC, W/m^2/K), capacities per volume (J/m^3/K), latent heat per volume (J/m^3)."""

    h0: float
    h1: float
    h2: float
    exponent: float
    capacity_austenite: float
    capacity_martensite: float
    latent_heat: float


class Wire(NamedTuple):
    """Geometry in m, installed strain, and the temperature of the air around it in degC."""

    diameter: float
    length: float
    prestrain: float
    ambient: float


class Rig(NamedTuple):
    """Constants of a simulation; c_s, c_1, c_2 are those of the balance in the module's docstring (c_2 = 0: one wire)."""

    material: Material
    heat: Heat
    wire: Wire
    control: int
    c_s: float
    c_1: float
    c_2: float


class State(NamedTuple):
    """Temperature (degC), stress (Pa) and fractions of one wire."""

    temperature: float
    stress: float
    detwinned: float
    twinned: float


def floats(*records: tuple) -> tuple:
    """Return the records with all fields as floats for the compiled functions."""
    return tuple(type(r)(*map(float, r)) for r in records)


def polynomial_heat(h0: float, capacity: float, h1: float = 0.0, h2: float = 0.0) -> Heat:
    """h0 + h1 T + h2 T^2 and one capacity for both phases."""
    return Heat(h0, h1, h2, 2.0, capacity, capacity, 0.0)


@njit(cache=True)
def area(wire):
    """Cross-section in m^2."""
    return 0.25 * math.pi * wire.diameter**2


@njit(cache=True)
def convection(heat, temperature):
    """h(T) in W/m^2/K; a power other than 2 counts from 0 degC up."""
    if heat.exponent == 2.0:
        return heat.h0 + (heat.h1 + heat.h2 * temperature) * temperature
    return heat.h0 + heat.h1 * temperature + heat.h2 * max(temperature, 0.0) ** heat.exponent


@njit(cache=True)
def heating(rig, signal, state):
    """Return the net heat into the wire in W/m^3 for a current (A), a power (W) or a voltage (V)."""
    material, heat, wire, control = rig.material, rig.heat, rig.wire, rig.control
    rho = resistivity(material, state.detwinned + state.twinned)
    section = area(wire)
    if control == CURRENT:
        joule = rho * (signal / section) ** 2
    elif control == POWER:
        joule = signal / (section * wire.length)
    else:
        joule = (signal / wire.length) ** 2 / rho
    return joule - 4.0 / wire.diameter * convection(heat, state.temperature) * (state.temperature - wire.ambient)


@njit(cache=True)
def _to(material, state, temperature, stress):
    detwinned, twinned = advance(
        material, state.detwinned, state.twinned, state.temperature, state.stress, temperature, stress
    )
    return State(temperature, stress, detwinned, twinned)


@njit(cache=True)
def _heat_missing(material, heat, state, added, stress, temperature):
    end = _to(material, state, temperature, stress)
    before, after = state.detwinned + state.twinned, end.detwinned + end.twinned
    capacity = mixture(heat.capacity_austenite, heat.capacity_martensite, 0.5 * (before + after))
    return capacity * (temperature - state.temperature) - heat.latent_heat * (after - before) - added


@njit(cache=True)
def _interpolate(low, f_low, high, f_high):
    middle = high - f_high * (high - low) / (f_high - f_low)
    return middle if low < middle < high else 0.5 * (low + high)


@njit(cache=True)
def _narrow(low, f_low, high, f_high, middle, f_middle):
    """Return the bracket (f_low < 0 < f_high) with one end moved and the value of the other scaled (Anderson, Bjorck 1973)."""
    if f_middle == 0.0:
        return middle, f_middle, middle, f_middle
    if f_middle < 0.0:
        scale = 1.0 - f_middle / f_low
        return middle, f_middle, high, f_high * (scale if scale > 0.0 else 0.5)
    scale = 1.0 - f_middle / f_high
    return low, f_low * (scale if scale > 0.0 else 0.5), middle, f_middle


@njit(cache=True)
def at_stress(material, heat, state, added, stress):
    """Return the state after absorbing ``added`` J/m^3 while the stress changes to ``stress``."""
    if heat.latent_heat == 0.0 and heat.capacity_austenite == heat.capacity_martensite:
        return _to(material, state, state.temperature + added / heat.capacity_austenite, stress)
    # The missing heat increases with the temperature: bracket the root from the old temperature.
    low = high = state.temperature
    f_low = f_high = _heat_missing(material, heat, state, added, stress, low)
    reach = 1e-9 + abs(added) / max(heat.capacity_austenite, heat.capacity_martensite)
    while f_low > 0.0:
        high, f_high = low, f_low
        low -= reach
        f_low = _heat_missing(material, heat, state, added, stress, low)
        reach *= 2.0
    while f_high < 0.0:
        low, f_low = high, f_high
        high += reach
        f_high = _heat_missing(material, heat, state, added, stress, high)
        reach *= 2.0
    last = low
    for _ in range(200):
        if f_low == 0.0 or f_high == 0.0:
            return _to(material, state, low if f_low == 0.0 else high, stress)
        middle = _interpolate(low, f_low, high, f_high)
        if abs(middle - last) <= 1e-15 * abs(middle) or middle == low or middle == high:
            return _to(material, state, middle, stress)
        last = middle
        f_middle = _heat_missing(material, heat, state, added, stress, middle)
        low, f_low, high, f_high = _narrow(low, f_low, high, f_high, middle, f_middle)
    return _to(material, state, 0.5 * (low + high), stress)


@njit(cache=True)
def strain(material, wire, state):
    """Strain of a wire that is taut (the free strain of one at zero stress)."""
    return strain_of(material, state.temperature, state.stress, state.detwinned, state.twinned, wire.ambient)


@njit(cache=True)
def _excess(rig, first, second, added1, added2, right, stress):
    value = rig.c_s * stress - right
    if rig.c_1 != 0.0:
        value += rig.c_1 * strain(rig.material, rig.wire, at_stress(rig.material, rig.heat, first, added1, stress))
    if rig.c_2 != 0.0:
        value += rig.c_2 * strain(rig.material, rig.wire, at_stress(rig.material, rig.heat, second, added2, stress))
    return value


@njit(cache=True)
def balance(rig, first, second, added1, added2, right):
    """The stress s >= 0 of the balance in the module's docstring: bracketed regula falsi, to rounding.

    For slack wires it is negative: minus the excess of the left side without tension.
    """
    if rig.c_1 == 0.0 and rig.c_2 == 0.0:
        return right / rig.c_s
    low = 0.0
    f_low = _excess(rig, first, second, added1, added2, right, low)
    if f_low >= 0.0:
        return -f_low
    # The new stress is near the old one: bracket it from there, with a reach that grows.
    reach, high = 1e4, first.stress
    f_high = _excess(rig, first, second, added1, added2, right, high)
    if f_high >= 0.0:
        while f_high >= 0.0 and high - reach > 0.0:
            trial = high - reach
            f_trial = _excess(rig, first, second, added1, added2, right, trial)
            if f_trial < 0.0:
                low, f_low = trial, f_trial
                break
            high, f_high = trial, f_trial
            reach *= 8.0
    else:
        while f_high < 0.0:
            low, f_low = high, f_high
            high += reach
            f_high = _excess(rig, first, second, added1, added2, right, high)
            reach *= 8.0
    last = low
    for _ in range(200):
        if f_high == 0.0:
            return high
        middle = _interpolate(low, f_low, high, f_high)
        if abs(middle - last) <= 1e-15 * high or middle == low or middle == high:
            return middle
        last = middle
        f_middle = _excess(rig, first, second, added1, added2, right, middle)
        low, f_low, high, f_high = _narrow(low, f_low, high, f_high, middle, f_middle)
    return 0.5 * (low + high)


@njit(cache=True)
def resistance(material, wire, fraction):
    """Resistance in ohm at a martensite fraction; the wire's own shape is taken as constant."""
    return resistivity(material, fraction) * wire.length / area(wire)
