"""Start values of transformation strains that grow with the stress: laws of Brinson and Lagoudas."""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from smajax.files.parameter_sets import Entry
from smajax.parameters import declarations
from smajax.plant.materials.brinson import Brinson
from smajax.properties.stress_levels import count_stresses

_DECLARED_STRAIN = declarations(Brinson)["max_transformation_strain"]
# Bounds of the largest transformation strain, which are the same in all laws.
STRAIN_BOUNDS = (_DECLARED_STRAIN.lower, _DECLARED_STRAIN.upper)

# Bounds of the largest strain in a set, as multiples of its value; chosen by trial.
_STRAIN_FACTORS = (0.3, 2.5)
# Scale (K) of the misfit of the start in the search for Brinson's parameters. Chosen by trial, like the constants
# below; tests/unit/properties/test_properties.py holds the result.
_START_SCALE = 1.0
# Scale (K) of the misfit of the finish, which is larger since the tangents locate it less well.
_FINISH_SCALE = 10.0
# Scale of the misfit of the strain, as a share of the largest strain.
_STRAIN_SCALE = 0.03
# Scale (Pa) of a weak prior on sigma_s, with mean 0, and on sigma_f - sigma_s, for cycles that do not determine them.
_PRIOR_SCALE = 3e8
# Mean (Pa) of the prior on sigma_f - sigma_s.
_USUAL_DETWINNING_RANGE = 7e7
# Start points of sigma_s, as shares of the lowest stress.
_START_SHARES = (0.0, 0.3, 0.8)
# Start points of sigma_f - sigma_s (Pa).
_START_RANGES = (2e7, 7e7, 1.5e8, 3e8)
# Bounds of sigma_s (Pa).
_DETWINNING_START_BOUNDS = (0.0, 3e8)
# Bounds of sigma_f - sigma_s (Pa).
_DETWINNING_RANGE_BOUNDS = (5e6, 5e8)
# Bounds of M_s: K below and above the mean of the starts extrapolated to zero stress.
_START_TEMPERATURE_MARGINS = (5.0, 80.0)
# Scale of the stresses in the search (Pa).
_STRESS_SCALE = 1e7
# Bounds of M_s in the set, K to either side.
_TEMPERATURE_MARGIN = 40.0
# Bounds of sigma_f in the set, as multiples of its value.
_DETWINNING_FINISH_FACTORS = (0.2, 5.0)
# Start points of the rate k in H_cur of Lagoudas' law, times the largest stress.
_START_RATES = (0.5, 2.0, 8.0)
_RATE_BOUNDS = (0.1, 50.0)
# Start point of the least strain in H_cur, as a share of the largest.
_START_SHARE = 0.3


def strain_entry(largest: float, source: str) -> Entry:
    """Make the entry of a largest transformation strain, with bounds about it within those of the laws.

    Args:
        largest: The largest transformation strain, a fraction.
        source: Its origin in words.
    """
    low, high = (factor * largest for factor in _STRAIN_FACTORS)
    return Entry(largest, "1", max(low, STRAIN_BOUNDS[0]), min(high, STRAIN_BOUNDS[1]), source=source)


def brinson_start_values(
    stress: Float[np.ndarray, " levels"],
    start: Float[np.ndarray, " levels"],
    finish: Float[np.ndarray, " levels"],
    strain: Float[np.ndarray, " levels"],
    slope: float,
) -> dict[str, Entry]:
    """Find M_s, detwinning stresses and largest strain with which Brinson's law has the measured tangents and strains.

    On cooling under a stress sigma above sigma_s, the transformation begins at M_s + (sigma - sigma_s) / C_M. Where
    sigma is above sigma_f it ends at M_s + (sigma - sigma_f) / C_M, otherwise at M_s with the share of the strain that
    the stress detwins. Where several values fit equally well, as at a single stress, sigma_s is low and
    sigma_f - sigma_s is near a usual value.

    Args:
        stress: Absolute stresses (levels,), Pa.
        start: Measured martensite start temperatures (levels,), degC.
        finish: Measured martensite finish temperatures (levels,), degC.
        strain: Absolute transformation strains (levels,).
        slope: Slope C_M of the transformation lines, Pa/K.

    Returns:
        Entries of a parameter set by parameter name, in internal units.

    Source: brinson1993, equations 15 and 16.
    """

    def residual(unknowns: np.ndarray) -> np.ndarray:
        start_temperature, first, width, largest = unknowns
        share = 0.5 - 0.5 * np.cos(np.pi * np.clip((stress - first) / width, 0.0, 1.0))
        begins, ends = (start_temperature + np.maximum(stress - at, 0.0) / slope for at in (first, first + width))
        misfit = [
            (begins - start) / _START_SCALE,
            (ends - finish) / _FINISH_SCALE,
            (largest * share - strain) / (_STRAIN_SCALE * np.max(strain)),
        ]
        return np.concatenate([*misfit, [first / _PRIOR_SCALE, (width - _USUAL_DETWINNING_RANGE) / _PRIOR_SCALE]])

    low, top, middle = float(np.min(stress)), float(np.max(strain)), float(np.mean(start - stress / slope))
    below, above = _START_TEMPERATURE_MARGINS
    stresses = (_DETWINNING_START_BOUNDS, _DETWINNING_RANGE_BOUNDS)
    lower, upper = (
        [temperature, *(ends[side] for ends in stresses), STRAIN_BOUNDS[side]]
        for side, temperature in enumerate((middle - below, middle + above))
    )
    starts = [
        [middle + share * low / slope, share * low, width, 1.1 * top]
        for share, width in itertools.product(_START_SHARES, _START_RANGES)
    ]
    best = _minimise(residual, starts, (lower, upper), [_FINISH_SCALE, _STRESS_SCALE, _STRESS_SCALE, 0.1 * top])
    start_temperature, first, width, largest = map(float, best)
    first = round(first, -3)  # to a kilopascal: a search ends near 0, not at it
    count = count_stresses(stress)
    source = f"tangents and strains of {count} stress{'es' if count > 1 else ''}, as Brinson's law would give them"
    return _brinson_entries(start_temperature, first, first + width, largest, source)


def lagoudas_strain_start_values(
    stress: Float[np.ndarray, " levels"], strain: Float[np.ndarray, " levels"]
) -> dict[str, Entry]:
    """Fit the growth of the transformation strain with the stress in Lagoudas' law to strains at several stresses.

        H_cur(sigma) = H_sat (1 - (1 - share) exp(-k sigma))

    The critical stress starts at 0, since a few stresses do not distinguish it from k; the slopes of the transformation
    lines are those at the mean stress.

    Args:
        stress: Absolute stresses (levels,), Pa.
        strain: Absolute transformation strains (levels,).

    Returns:
        Entries of a parameter set by parameter name, in internal units.

    Source: lagoudas2012.
    """
    top = float(np.max(stress))

    def residual(unknowns: np.ndarray) -> np.ndarray:
        largest, share, rate = unknowns
        return (largest * (1.0 - (1.0 - share) * np.exp(-rate * stress / top)) - strain) / np.max(strain)

    lower, upper = ([STRAIN_BOUNDS[side], share, _RATE_BOUNDS[side]] for side, share in enumerate((0.0, 1.0)))
    starts = [[1.2 * float(np.max(strain)), _START_SHARE, rate] for rate in _START_RATES]
    best = _minimise(residual, starts, (lower, upper), starts[0])
    # To a millionth: a search ends near 0, not at it.
    largest, share, saturation = float(best[0]), round(float(best[1]), 6), float(best[2]) / top
    source = f"transformation strains at {count_stresses(stress)} stresses"
    return {
        "material.max_transformation_strain": strain_entry(largest, source),
        "material.min_strain_share": Entry(share, "1", 0.0, 1.0, source=source),
        "material.strain_saturation": Entry(saturation, "1/Pa", 0.1 * saturation, 10.0 * saturation, source=source),
        "material.critical_stress": Entry(0.0, "Pa", 0.0, max(2.0 * float(np.min(stress)), 1e6), source="usual"),
        "material.calibration_stress": Entry(
            float(np.mean(stress)), "Pa", 0.0, top, source="the middle of the stresses"
        ),
    }


def _brinson_entries(start: float, first: float, last: float, largest: float, source: str) -> dict[str, Entry]:
    low, high = start - _TEMPERATURE_MARGIN, start + _TEMPERATURE_MARGIN
    finish_bounds = (factor * last for factor in _DETWINNING_FINISH_FACTORS)
    return {
        "material.martensite_start": Entry(start, "degC", low, high, source=source),
        "material.max_transformation_strain": strain_entry(largest, source),
        "material.detwinning_start_stress": Entry(first, "Pa", *_DETWINNING_START_BOUNDS, source=source),
        "material.detwinning_finish_stress": Entry(last, "Pa", *finish_bounds, source=source),
    }


def _minimise(
    residual: Callable[[np.ndarray], np.ndarray],
    starts: Sequence[Sequence[float]],
    bounds: tuple[list[float], list[float]],
    scales: Sequence[float],
) -> np.ndarray:
    """Minimise a sum of squares within bounds from each start, clipped to the bounds, and return the best point."""
    results = (least_squares(residual, np.clip(start, *bounds), bounds=bounds, x_scale=scales) for start in starts)
    return min(results, key=lambda result: result.cost).x
