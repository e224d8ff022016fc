"""Lagoudas' law with smooth hardening, exact and slow: bisection for every condition, many small steps on stress paths.

The formulas are those of Lagoudas, Hartl, Chemisky, Machado, Popov 2012, written from the free energy: the driving force

    pi = sigma Lambda + dS sigma^2 / 2 + ds T - du - f(xi)

has to reach +Y for forward and -Y for reverse transformation, with the hardening f, the difference du of internal energies and the threshold
Y = Y0 + D sigma Lambda that follow from the transformation temperatures at zero stress and the slopes at the calibration stress.
"""

import math
from typing import NamedTuple


class Law(NamedTuple):
    """Parameters: temperatures in degC, moduli and slopes in Pa and Pa/K."""

    martensite_start: float
    martensite_finish: float
    austenite_start: float
    austenite_finish: float
    clausius_clapeyron_austenite: float
    clausius_clapeyron_martensite: float
    modulus_austenite: float
    modulus_martensite: float
    max_transformation_strain: float
    min_strain_share: float
    strain_saturation: float
    critical_stress: float
    calibration_stress: float
    n1: float
    n2: float
    n3: float
    n4: float
    voigt_share: float = 0.0


class Energy(NamedTuple):
    """Constants of the free energy per volume: entropy and internal energy differences, hardening, threshold."""

    ds: float
    du: float
    a1: float
    a2: float
    a3: float
    y0: float
    d: float


class State(NamedTuple):
    """Martensite fraction and transformation strain."""

    martensite: float
    strain: float


def current_strain(law: Law, stress: float) -> float:
    """H_cur."""
    low = law.min_strain_share * law.max_transformation_strain
    return low + (law.max_transformation_strain - low) * (
        1.0 - math.exp(-law.strain_saturation * max(stress - law.critical_stress, 0.0))
    )


def energy(law: Law) -> Energy:
    """Return the constants for the parameters of the law; the slope of H_cur is a central difference."""
    at, warm, cold = law.calibration_stress, law.clausius_clapeyron_austenite, law.clausius_clapeyron_martensite
    softer = 1.0 / law.modulus_martensite - 1.0 / law.modulus_austenite
    slope = (current_strain(law, at + 10.0) - current_strain(law, at - 10.0)) / 20.0 if at > 10.0 else 0.0
    work = current_strain(law, at) + at * slope
    ds = -2.0 * warm * cold * (work + at * softer) / (warm + cold)
    a1, a2 = ds * (law.martensite_finish - law.martensite_start), ds * (law.austenite_start - law.austenite_finish)
    a3 = -a1 / 4 * (1 + 1 / (law.n1 + 1) - 1 / (law.n2 + 1)) + a2 / 4 * (1 + 1 / (law.n3 + 1) - 1 / (law.n4 + 1))
    du = 0.5 * ds * (law.martensite_start + law.austenite_finish)
    y0 = 0.5 * ds * (law.martensite_start - law.austenite_finish) - a3
    d = (cold - warm) * (work + at * softer) / ((cold + warm) * work)
    return Energy(ds, du, a1, a2, a3, y0, d)


def forward_force(law: Law, e: Energy, temperature: float, stress: float, martensite: float) -> float:
    """Return pi - Y; the forward transformation proceeds while it is positive."""
    softer = 1.0 / law.modulus_martensite - 1.0 / law.modulus_austenite
    direction = current_strain(law, stress)
    f = 0.5 * e.a1 * (1 + martensite**law.n1 - (1 - martensite) ** law.n2) + e.a3
    return (
        stress * direction
        + 0.5 * softer * stress**2
        + e.ds * temperature
        - e.du
        - f
        - (e.y0 + e.d * stress * direction)
    )


def reverse_force(law: Law, e: Energy, temperature: float, stress: float, martensite: float, direction: float) -> float:
    """Return -pi - Y; the reverse transformation proceeds while it is positive."""
    softer = 1.0 / law.modulus_martensite - 1.0 / law.modulus_austenite
    f = 0.5 * e.a2 * (1 + martensite**law.n3 - (1 - martensite) ** law.n4) - e.a3
    return -(stress * direction + 0.5 * softer * stress**2 + e.ds * temperature - e.du - f) - (
        e.y0 + e.d * stress * direction
    )


def advance(law: Law, state: State, temperature: float, stress: tuple[float, float], parts: int = 1) -> State:
    """Return the state at a temperature and stress; the stress changes linearly in ``parts`` steps."""
    e = energy(law)
    for k in range(parts):
        before, after = (stress[0] + (stress[1] - stress[0]) * j / parts for j in (k, k + 1))
        if forward_force(law, e, temperature, after, state.martensite) > 0.0:
            low, high = state.martensite, 1.0
            if forward_force(law, e, temperature, after, high) < 0.0:
                for _ in range(200):
                    middle = 0.5 * (low + high)
                    low, high = (
                        (middle, high) if forward_force(law, e, temperature, after, middle) > 0.0 else (low, middle)
                    )
            else:
                low = high
            mean = 0.5 * (current_strain(law, before) + current_strain(law, after))
            state = State(low, state.strain + mean * (low - state.martensite))
        elif state.martensite > 0.0:
            direction = state.strain / state.martensite
            if reverse_force(law, e, temperature, after, state.martensite, direction) > 0.0:
                low, high = 0.0, state.martensite
                if reverse_force(law, e, temperature, after, low, direction) < 0.0:
                    for _ in range(1100):  # fractions of 1e-300 are reached, too
                        middle = 0.5 * (low + high)
                        low, high = (
                            (low, middle)
                            if reverse_force(law, e, temperature, after, middle, direction) > 0.0
                            else (middle, high)
                        )
                        if high - low < 1e-16:
                            break
                else:
                    high = low
                state = State(high, direction * high)
    return state


def strain(law: Law, state: State, stress: float) -> float:
    """Total strain without thermal expansion; Young's modulus lies by ``voigt_share`` between the mixtures of compliances and of moduli."""
    xi, warm, cold = state.martensite, law.modulus_austenite, law.modulus_martensite
    modulus = (1 - law.voigt_share) / ((1 - xi) / warm + xi / cold) + law.voigt_share * ((1 - xi) * warm + xi * cold)
    return stress / modulus + state.strain
