"""Start values of a material law's parameters from the properties of thermal cycles."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smajax.errors import InputError, suggestion
from smajax.files.parameter_sets import Entry
from smajax.plant.materials.registry import MATERIALS
from smajax.properties.strain_start_values import (
    STRAIN_BOUNDS,
    brinson_start_values,
    lagoudas_strain_start_values,
    strain_entry,
)
from smajax.properties.stress_levels import count_stresses
from smajax.properties.thermal_cycles import TEMPERATURE_NAMES, Value
from smajax.units import as_text

# Least range of the stresses (Pa) that determines the slope of the transformation lines and the growth of the strain.
# Chosen by trial; tests/unit/properties/test_properties.py holds it.
_MIN_STRESS_RANGE = 10e6
# Slope of the transformation lines (Pa/K) where one stress does not determine it: usual for NiTi.
_USUAL_SLOPE = 7e6
# Plausible slopes (Pa/K): a larger slope follows from temperatures that hardly depend on the stress.
_SLOPE_BOUNDS = (1e6, 3e7)
# Bounds of a slope in the set, as multiples of its value; chosen by trial.
_SLOPE_FACTORS = (0.3, 3.0)
# Bounds of a transformation temperature in the set (K to either side), in addition to its own uncertainty; chosen by
# trial.
_TEMPERATURE_MARGIN = 40.0
# Young's moduli (Pa) with plausible bounds, since thermal cycles under constant stress hardly determine them. The
# values are those of brinson1993.
_MODULI = {"modulus_austenite": (67e9, 20e9, 110e9), "modulus_martensite": (26.3e9, 8e9, 60e9)}
_MODULI_SOURCE = "usual: the material of Brinson (1993), which the cycles do not determine"
# Exponents of the hardening of Lagoudas' law.
_EXPONENTS = ("n1", "n2", "n3", "n4")
# Start value of the exponents: the middle of their usual range.
_USUAL_EXPONENT = 0.5
_EXPONENT_BOUNDS = (0.01, 1.0)
# Least number of stresses that determines the growth of the strain: its law has three unknowns.
_MIN_STRESSES_OF_GROWTH = 3
# Least range of the strains that counts as growth, as a share of the largest strain; chosen by trial.
_MIN_GROWTH = 0.02
# Words in the sources of values that do not come from the cycles.
_ASSUMED_WORDS = ("usual", "plausible")
_FALLING = "the temperatures fall"


class StressLevel(NamedTuple):
    """Mean properties of the cycles at one stress.

    Attributes:
        recording: Name of the recording.
        stress: Stress (Pa), negative in compression; ``None`` where it was not recorded.
        properties: Mean properties by the names in ``thermal_cycles.PROPERTY_NAMES``.
    """

    recording: str
    stress: float | None
    properties: Mapping[str, Value]


def make_start_values(levels: Sequence[StressLevel], model: str) -> dict[str, Entry]:
    """Make start values of a law: temperatures at zero stress, slopes of its transformation lines, strains.

    Stresses count by their absolute values, since tension and compression both raise the temperatures. The slopes
    follow from the recorded stresses where these differ by more than 10 MPa; otherwise they are 7 MPa/K, and their
    source says so.

    Args:
        levels: Mean properties at each stress.
        model: The material law, a key of ``MATERIALS``.

    Returns:
        Entries of a parameter set by parameter name, in internal units; values that are not finite are left out.

    Raises:
        InputError: The law is unknown, a stress was not recorded, or the largest transformation strain is below the
            bounds of all laws.
    """
    if model not in MATERIALS:
        raise InputError(
            f"'{model}' is not a material law{suggestion(model, MATERIALS)}: choose {', '.join(MATERIALS)}"
        )
    unknown = [level.recording for level in levels if level.stress is None]
    if unknown:
        raise InputError(
            f"{unknown[0]} has no column stress, so its temperatures cannot be extrapolated to zero stress: add one, "
            "as in 'stress [MPa]'"
        )
    stress = np.abs(np.array([level.stress for level in levels], float))
    means = [level.properties for level in levels]
    values = {n: np.array([m[n].value for m in means]) for n in (*TEMPERATURE_NAMES, "transformation_strain")}
    strain = np.abs(values["transformation_strain"])
    largest = float(np.max(strain))
    if not largest >= STRAIN_BOUNDS[0]:
        raise InputError(
            f"{levels[int(np.argmax(strain))].recording}: the largest transformation strain is {100 * largest:.2g} %, "
            "below the lower bound of every law: give cycles under more stress"
        )
    entries = _transformation_lines(stress, values, means)
    entries |= {
        f"material.{n}": Entry(v, "Pa", low, high, source=_MODULI_SOURCE) for n, (v, low, high) in _MODULI.items()
    }
    entries["material.max_transformation_strain"] = strain_entry(largest, "largest transformation strain")
    if model == "brinson":
        slope = entries["material.clausius_clapeyron_martensite"].value
        entries |= brinson_start_values(stress, values["martensite_start"], values["martensite_finish"], strain, slope)
    if model == "lagoudas":
        low, high = _EXPONENT_BOUNDS
        entries |= {f"material.{n}": Entry(_USUAL_EXPONENT, "1", low, high, source="usual") for n in _EXPONENTS}
        if _strain_grows(stress, strain, means):
            entries |= lagoudas_strain_start_values(stress, strain)
    return {n: e for n, e in entries.items() if math.isfinite(e.value)}


def assumed_values(entries: Mapping[str, Entry]) -> str:
    """List in one sentence the start values that do not come from the cycles, with their sources.

    Args:
        entries: Entries by parameter name, see ``make_start_values``.
    """
    by_source: dict[str, list[str]] = {}
    for name, entry in entries.items():
        if any(word in entry.source for word in _ASSUMED_WORDS):
            by_source.setdefault(entry.source, []).append(
                f"{name.removeprefix('material.')} = {as_text(entry.value, entry.unit)}"
            )
    parts = [f"{', '.join(names)} ({source})" for source, names in by_source.items()]
    if any(_FALLING in source for source in by_source):
        parts.append(
            "no shape-memory alloy's temperatures fall as the stress rises: check which stress belongs to which cycle"
        )
    return f"not determined by the cycles: {'; '.join(parts)}"


def _transformation_lines(
    stress: np.ndarray, values: Mapping[str, np.ndarray], means: Sequence[Mapping[str, Value]]
) -> dict[str, Entry]:
    """Slopes of the transformation lines and the temperatures at zero stress."""
    entries: dict[str, Entry] = {}
    for phase, letter in (("martensite", "C_M"), ("austenite", "C_A")):
        middle = 0.5 * (values[f"{phase}_start"] + values[f"{phase}_finish"])
        slope, source = _line_slope(stress, middle, letter)
        low, high = (factor * slope for factor in _SLOPE_FACTORS)
        entries[f"material.clausius_clapeyron_{phase}"] = Entry(slope, "Pa/K", low, high, source=source)
        for end in ("start", "finish"):
            name = f"{phase}_{end}"
            at_zero = float(np.mean(values[name] - stress / slope))
            margin = _TEMPERATURE_MARGIN + max(0.5 * (m[name].upper95 - m[name].lower95) for m in means)
            entries[f"material.{name}"] = Entry(
                at_zero, "degC", at_zero - margin, at_zero + margin, source="tangents, extrapolated to zero stress"
            )
    return entries


def _line_slope(stress: np.ndarray, middle: np.ndarray, letter: str) -> tuple[float, str]:
    """Slope (Pa/K) of a line through the middles of a transformation at several stresses, and its source."""
    if not np.ptp(stress) > _MIN_STRESS_RANGE:
        return _USUAL_SLOPE, f"{letter} is a usual value: one stress does not determine it"
    per_stress = float(np.polyfit(stress, middle, 1)[0])
    if not per_stress > 0.0:
        falling = f"through {count_stresses(stress)} stresses {_FALLING}, by {-1e6 * per_stress:.3g} K/MPa"
        return _USUAL_SLOPE, f"{letter} is a usual value: {falling}"
    slope, source = 1.0 / per_stress, f"{letter} by a straight line through {count_stresses(stress)} stresses"
    if not _SLOPE_BOUNDS[0] <= slope <= _SLOPE_BOUNDS[1]:
        source += f", cut from {slope / 1e6:.3g} MPa/K to the nearest plausible one"
    return float(np.clip(slope, *_SLOPE_BOUNDS)), source


def _strain_grows(stress: np.ndarray, strain: np.ndarray, means: Sequence[Mapping[str, Value]]) -> bool:
    """Whether there are enough stresses, and strains that differ by more than their uncertainty."""
    intervals = [m["transformation_strain"] for m in means]
    uncertainty = max(0.5 * (value.upper95 - value.lower95) for value in intervals)
    grows = np.ptp(strain) > max(_MIN_GROWTH * float(np.max(strain)), uncertainty)
    return bool(count_stresses(stress) >= _MIN_STRESSES_OF_GROWTH and np.ptp(stress) > _MIN_STRESS_RANGE and grows)
