"""Start values for a law from the tangents of thermal cycles under constant stresses: a parameter set to begin a fit with."""

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from smajax.errors import InputError
from smajax.parameter_file import Entry
from smajax.parameters import declarations
from smajax.rig_schema import MATERIALS, as_text
from smajax.thermal_cycles import NAMES, Value

_USUAL = 7e6  # Pa/K, where one stress does not tell
_SLOPES = (1e6, 3e7)  # Pa/K, plausible ones
# What thermal cycles under constant stress hardly tell, and a law needs: Pa, and the ends of what is plausible.
_BRINSON = "usual: the material of Brinson (1993), which the cycles do not tell"
_USUALLY = {"modulus_austenite": (67e9, 20e9, 110e9), "modulus_martensite": (26.3e9, 8e9, 60e9)}
_GUESSES = ("usual", "plausible")  # words of the sources of values that are not read off the cycles
_FALL = "the temperatures fall"
_APART = 10e6  # Pa between stresses that tell the slope of the lines
_LEVELS = 3  # stresses that tell how strain grows
_LARGEST = declarations(MATERIALS["brinson"])["max_strain"]  # as all laws have it
_STRAINS = (_LARGEST.lower, _LARGEST.upper)
_ALIKE = 0.02  # of the largest strain: by less it does not grow
# Detwinning stresses: what the misfit of start and finish (K), of the strain (its share) and, faintly, of the stresses (Pa) counts by; a
# usual distance between them (Pa); where the search begins, in shares of the lowest stress and in Pa; and what is plausible, Pa.
_START, _FINISH, _SHARE, _FAINT, _BAND = 1.0, 10.0, 0.03, 3e8, 7e7
_BEGIN = ((0.0, 0.3, 0.8), (2e7, 7e7, 1.5e8, 3e8))
_FIRST, _BETWEEN = (0.0, 3e8), (5e6, 5e8)


class Level(NamedTuple):
    """What was read at one stress: the recording's name, the stress (Pa; ``None`` where it was not recorded), and the mean properties."""

    name: str
    stress: float | None
    mean: Mapping[str, Value]


def parameter_set(levels: Sequence[Level], model: str) -> dict[str, Entry]:
    """Start values for a law: temperatures at zero stress, slopes of the lines, and the largest transformation strain.

    Compression counts like tension: both raise the temperatures. The lines' slopes follow from the recordings' stresses where these differ
    by 10 MPa or more; else they are 7 MPa/K, and said to be. Raises ``InputError`` where the stress is not known, or no strain transforms.
    """
    unknown = [one.name for one in levels if one.stress is None]
    if unknown:
        raise InputError(
            f"{unknown[0]} has no column stress, so its temperatures cannot be brought to zero stress: add one, as in 'stress [MPa]'"
        )
    stress = np.abs(np.array([one.stress for one in levels], float))
    means = [one.mean for one in levels]
    values = {n: np.array([m[n].value for m in means]) for n in (*NAMES, "transformation_strain")}
    strain = np.abs(values["transformation_strain"])
    if not np.max(strain) >= _STRAINS[0]:
        told = f"the largest transformation strain is {100 * float(np.max(strain)):.2g} %, less than any law has"
        raise InputError(f"{levels[int(np.argmax(strain))].name}: {told}: write a set of cycles under more stress")
    entries: dict[str, Entry] = {}
    for phase, letter in (("martensite", "C_M"), ("austenite", "C_A")):
        slope, told = _slope(stress, 0.5 * (values[f"{phase}_start"] + values[f"{phase}_finish"]), letter)
        entries[f"material.clausius_clapeyron_{phase}"] = Entry(slope, "Pa/K", 0.3 * slope, 3.0 * slope, source=told)
        for end in ("start", "finish"):
            name = f"{phase}_{end}"
            at_zero = float(np.mean(values[name] - stress / slope))
            away = 40.0 + max(0.5 * (m[name].upper95 - m[name].lower95) for m in means)
            entries[f"material.{name}"] = Entry(at_zero, "degC", at_zero - away, at_zero + away, source="tangents, brought to zero stress")
    entries |= {f"material.{n}": Entry(value, "Pa", low, high, source=_BRINSON) for n, (value, low, high) in _USUALLY.items()}
    entries["material.max_strain"] = _strain(float(np.max(strain)), "largest transformation strain")
    if model == "brinson":
        slope = entries["material.clausius_clapeyron_martensite"].value
        entries |= _detwinning(stress, values["martensite_start"], values["martensite_finish"], strain, slope)
    if model == "lagoudas":
        entries |= {f"material.{n}": Entry(0.5, "1", 0.01, 1.0, source="usual") for n in ("n1", "n2", "n3", "n4")}
        unsure = max(0.5 * (m["transformation_strain"].upper95 - m["transformation_strain"].lower95) for m in means)
        grows = np.ptp(strain) > max(_ALIKE * float(np.max(strain)), unsure)
        if len(set(stress)) >= _LEVELS and np.ptp(stress) > _APART and grows:
            entries |= _growing_strain(stress, strain)
    return {n: e for n, e in entries.items() if math.isfinite(e.value)}


def guessed(entries: Mapping[str, Entry]) -> str:
    """A sentence that says which start values were not read off the cycles, and where each comes from instead."""
    by_source: dict[str, list[str]] = {}
    for name, entry in entries.items():
        if any(word in entry.source for word in _GUESSES):
            by_source.setdefault(entry.source, []).append(f"{name.removeprefix('material.')} = {as_text(entry.value, entry.unit)}")
    told = [f"{', '.join(names)} ({source})" for source, names in by_source.items()]
    if any(_FALL in source for source in by_source):
        told.append("no shape-memory alloy's temperatures fall as the stress rises: check which stress belongs to which cycle")
    return f"not read off the cycles: {'; '.join(told)}"


def _strain(largest: float, told: str) -> Entry:
    return Entry(largest, "1", max(0.3 * largest, _STRAINS[0]), min(2.5 * largest, _STRAINS[1]), source=told)


def _nearest(away: Callable, begin: Sequence[Sequence[float]], bounds: tuple, sizes: Sequence[float]) -> np.ndarray:
    """Where ``away`` is least, searched between the bounds from each beginning, or from the nearest point between them."""
    found = (least_squares(away, np.clip(at, *bounds), bounds=bounds, x_scale=sizes) for at in begin)
    return min(found, key=lambda one: one.cost).x


def _slope(stress: np.ndarray, middle: np.ndarray, letter: str) -> tuple[float, str]:
    """A line's slope in Pa/K through the middles of a transformation at several stresses, and where it comes from."""
    if not np.ptp(stress) > _APART:
        return _USUAL, f"{letter} is a usual value: one stress does not tell it"
    per_stress = float(np.polyfit(stress, middle, 1)[0])
    if not per_stress > 0.0:
        return _USUAL, f"{letter} is a usual value: through {len(stress)} stresses {_FALL}, by {-1e6 * per_stress:.3g} K/MPa"
    slope, told = 1.0 / per_stress, f"{letter} by a straight line through {len(stress)} stresses"
    told += "" if _SLOPES[0] <= slope <= _SLOPES[1] else f", cut from {slope / 1e6:.3g} MPa/K to the nearest plausible one"
    return float(np.clip(slope, *_SLOPES)), told


def _detwinning(stress: np.ndarray, start: np.ndarray, finish: np.ndarray, strain: np.ndarray, slope: float) -> dict[str, Entry]:
    """M_s, detwinning stresses and largest strain with which Brinson's law transforms where the tangents lie, by as much strain.

    On cooling under a stress above sigma_s it begins at M_s + (stress - sigma_s) / C_M and ends at M_s + (stress - sigma_f) / C_M, or,
    where the stress is below sigma_f, at M_s with the share of its strain that the stress detwins there (Brinson 1993 eq. 15, 16). Where
    several do it equally well, as at a single stress, sigma_s is as low and sigma_f as usual as may be.
    """

    def away(unknown: np.ndarray) -> np.ndarray:
        warm, first, between, largest = unknown
        share = 0.5 - 0.5 * np.cos(np.pi * np.clip((stress - first) / between, 0.0, 1.0))
        begins, ends = (warm + np.maximum(stress - at, 0.0) / slope for at in (first, first + between))
        told = [(begins - start) / _START, (ends - finish) / _FINISH, (largest * share - strain) / (_SHARE * np.max(strain))]
        return np.concatenate([*told, [first / _FAINT, (between - _BAND) / _FAINT]])

    low, top, middle = float(np.min(stress)), float(np.max(strain)), float(np.mean(start - stress / slope))
    bounds = ([middle - 5.0, _FIRST[0], _BETWEEN[0], _STRAINS[0]], [middle + 80.0, _FIRST[1], _BETWEEN[1], _STRAINS[1]])
    begin = [[middle + share * low / slope, share * low, between, 1.1 * top] for share, between in itertools.product(*_BEGIN)]
    best = _nearest(away, begin, bounds, [_FINISH, 1e7, 1e7, 0.1 * top])
    warm, first, between, largest = map(float, best)
    first = round(first, -3)  # to a kilopascal: a search ends beside 0
    told = f"tangents and strains of {len(stress)} stress{'es' if len(stress) > 1 else ''}, as Brinson's law would give them"
    last = first + between
    return {
        "material.martensite_start": Entry(warm, "degC", warm - 40.0, warm + 40.0, source=told),
        "material.max_strain": _strain(largest, told),
        "material.detwinning_start_stress": Entry(first, "Pa", *_FIRST, source=told),
        "material.detwinning_finish_stress": Entry(last, "Pa", 0.2 * last, 5.0 * last, source=told),
    }


def _growing_strain(stress: np.ndarray, strain: np.ndarray) -> dict[str, Entry]:
    """H_cur(sigma) = H_sat (1 - (1 - share) exp(-k sigma)) through the transformation strains of several stresses.

    The critical stress, which a few stresses do not tell from k, starts at none; the lines' slopes hold at the middle of the stresses.
    """
    top, told = float(np.max(stress)), f"transformation strains at {len(stress)} stresses"

    def away(unknown: np.ndarray) -> np.ndarray:
        largest, share, rate = unknown
        return (largest * (1.0 - (1.0 - share) * np.exp(-rate * stress / top)) - strain) / np.max(strain)

    bounds = ([_STRAINS[0], 0.0, 0.1], [_STRAINS[1], 1.0, 50.0])
    begin = [[1.2 * float(np.max(strain)), 0.3, rate] for rate in (0.5, 2.0, 8.0)]
    best = _nearest(away, begin, bounds, begin[0])
    # To a millionth: a search ends beside 0.
    largest, share, saturation = float(best[0]), round(float(best[1]), 6), float(best[2]) / top
    return {
        "material.max_strain": _strain(largest, told),
        "material.min_strain_share": Entry(share, "1", 0.0, 1.0, source=told),
        "material.strain_saturation": Entry(saturation, "1/Pa", 0.1 * saturation, 10.0 * saturation, source=told),
        "material.critical_stress": Entry(0.0, "Pa", 0.0, max(2.0 * float(np.min(stress)), 1e6), source="usual"),
        "material.calibration_stress": Entry(float(np.mean(stress)), "Pa", 0.0, top, source="the middle of the stresses"),
    }
