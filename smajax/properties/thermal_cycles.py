"""Properties of thermal cycles under constant stress after ASTM E3097, with 95 % intervals.

A cycle is a cooling and a heating branch. The properties of each branch come from ``branch_properties``, with
bootstrap samples of the branch for the intervals.

Where a transformation begins or ends slowly, its start or finish depends on the definition by more than the interval
covers: for a slow end, the tangent at the steepest point gives an early finish, the tangent of a symmetrical sigmoid
through all rows (as fitted by other programs) a late one, and three lines one in between. The NiTiHf of NASA in the
data sets begins sharply on cooling and ends slowly: its M_f is some kelvins above that of the sigmoid.

Source: astm_e3097.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import t as student

from smajax.errors import InputError
from smajax.properties.bootstrap import SAMPLES
from smajax.properties.branch_properties import Tangent, branch_properties
from smajax.properties.cycle_rows import find_cycles
from smajax.properties.minor_loops import minor_loops
from smajax.properties.refused_cycles import RefusedCycle
from smajax.properties.row_order import check_outliers, check_row_order

TEMPERATURE_NAMES = ("martensite_start", "martensite_finish", "austenite_start", "austenite_finish")
PROPERTY_NAMES = (*TEMPERATURE_NAMES, "transformation_strain", "actuation_strain", "width", "span")

# Quantile of the samples' deviations below which a further sample lies with a probability of 95 %.
_QUANTILE = 0.95 * (SAMPLES + 1) / SAMPLES
# Probability below the upper end of a two-sided 95 % interval.
_UPPER_PROBABILITY = 0.975
# Largest amount by which cooling may transform above heating, as a share of the temperature range: less is an error of
# the estimates, more means that the rows are in the wrong order. Chosen by trial;
# tests/unit/properties/test_properties.py holds it.
_MAX_NEGATIVE_WIDTH = 0.02


@dataclasses.dataclass(frozen=True)
class Value:
    """A property with its 95 % interval.

    Attributes:
        value: Estimate; temperatures in degC, ``width`` and ``span`` in K, strains as fractions.
        lower95: Lower end of the interval, in the same unit.
        upper95: Upper end of the interval.
    """

    value: float
    lower95: float
    upper95: float


@dataclasses.dataclass(frozen=True)
class Cycle:
    """The properties of one cycle.

    Attributes:
        number: Number of the cycle in its recording, from 1.
        rows: Its first and last row.
        values: The properties by the names in ``PROPERTY_NAMES``. ``transformation_strain`` is the distance of the
            plateaus on heating at austenite start and finish, ``actuation_strain`` at the coldest and the hottest row.
            ``width`` (K) is the distance of the middles of the branches, ``span`` (K) from martensite finish to
            austenite finish.
        loops: First and last rows of its minor loops, which are left out.
    """

    number: int
    rows: tuple[int, int]
    values: dict[str, Value]
    loops: tuple[tuple[int, int], ...] = ()


def analyse_cycles(
    name: str,
    temperature: Float[np.ndarray, " n"],
    strain: Float[np.ndarray, " n"],
    *,
    smooth: int = 1,
    seed: int = 0,
    tangent: Tangent = "lines",
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[list[Cycle], list[RefusedCycle]]:
    """Estimate the properties of every cycle of a recording.

    Args:
        name: The recording, for messages.
        temperature: Temperatures (n,), degC.
        strain: Strains (n,).
        smooth: Rows of the running median of the temperatures, an odd number.
        seed: Seed of the bootstrap.
        tangent: The line along the transformation: that of three lines fitted by least squares ("lines"), or the
            tangent where the transformation is steepest ("steepest").
        progress: Called with the name of each cycle before it is analysed.

    Returns:
        The cycles, and the reason for each one that cannot be analysed.

    Raises:
        InputError: The rows are not in the order in which they were recorded, a value is an outlier, there is no
            complete cycle, or ``smooth`` is even.
    """
    if np.ptp(temperature) > 0.0:
        check_row_order(name, temperature, strain)
        check_outliers(name, "a strain of", strain)
    pairs = find_cycles(name, temperature, smooth=smooth)
    analysed, refused = [], []
    for number, (cooling, heating) in enumerate(pairs, 1):
        rows = (int(min(cooling[0], heating[0])), int(max(cooling[-1], heating[-1])))
        progress(f"analysing {name}: cycle {number} of {len(pairs)}")
        try:
            loops = [loop for branch in (cooling, heating) for loop in minor_loops(temperature, branch)]
            inner = np.concatenate([np.arange(first, last + 1) for first, last in loops]) if loops else np.zeros(0, int)
            branches = [branch[~np.isin(branch, inner)] for branch in (cooling, heating)]
            values = _cycle_values(
                temperature, strain, branches, smooth, tangent, np.random.default_rng([seed, number])
            )
        except InputError as error:
            refused.append(RefusedCycle(name, error, number, rows))
            continue
        analysed.append(Cycle(number, rows, values, tuple(sorted(loops))))
    return analysed, refused


def mean_properties(cycles: Sequence[Cycle]) -> dict[str, Value]:
    """Average the properties of cycles.

    The half-width of the 95 % interval follows from the scatter between the cycles, with Student's t, or from the
    cycles' own intervals if these give a wider one.

    Args:
        cycles: At least one cycle.

    Returns:
        The means by the names in ``PROPERTY_NAMES``.
    """
    count, means = len(cycles), {}
    for name in cycles[0].values:
        values = np.array([cycle.values[name].value for cycle in cycles])
        own = np.array([0.5 * (cycle.values[name].upper95 - cycle.values[name].lower95) for cycle in cycles])
        half = math.sqrt(float(np.mean(own**2)) / count)
        if count > 1:
            half = max(
                half, float(student.ppf(_UPPER_PROBABILITY, count - 1) * np.std(values, ddof=1)) / math.sqrt(count)
            )
        mean = float(values.mean())
        means[name] = Value(mean, mean - half, mean + half)
    return means


def _cycle_values(
    temperature: np.ndarray,
    strain: np.ndarray,
    branches: Sequence[np.ndarray],
    smooth: int,
    tangent: Tangent,
    rng: np.random.Generator,
) -> dict[str, Value]:
    """Values of a cycle; 95 % of the bootstrap samples deviate by less than half of each interval."""
    results = [
        branch_properties(temperature[rows], strain[rows], branch, smooth, tangent, rng)
        for rows, branch in zip(branches, ("cooling", "heating"), strict=True)
    ]
    best = _combine_branches(*(estimate for estimate, _ in results))[0]
    half = np.quantile(np.abs(_combine_branches(*(deviations for _, deviations in results))), _QUANTILE, axis=0)
    index = PROPERTY_NAMES.index("width")
    width = float(best[index])
    if width < -max(float(half[index]), _MAX_NEGATIVE_WIDTH * float(np.ptp(temperature))):
        raise InputError(
            f"it transforms on cooling {-width:.3g} K above heating, which no shape-memory alloy does: the rows run "
            "backwards, or the measured temperature lags far behind the wire's: give them in the order of time",
            code="cooling-above-heating",
        )
    return {n: Value(float(v), float(v - h), float(v + h)) for n, v, h in zip(PROPERTY_NAMES, best, half, strict=True)}


def _combine_branches(cooling: np.ndarray, heating: np.ndarray) -> np.ndarray:
    """Combine temperatures and strains (samples, 4) of both branches into the properties (samples, 8)."""
    martensite_finish, martensite_start, *_ = cooling.T
    austenite_start, austenite_finish, transformation, actuation = heating.T
    width = 0.5 * (austenite_start + austenite_finish) - 0.5 * (martensite_start + martensite_finish)
    span = austenite_finish - martensite_finish
    return np.stack(
        [
            martensite_start,
            martensite_finish,
            austenite_start,
            austenite_finish,
            transformation,
            actuation,
            width,
            span,
        ],
        axis=1,
    )
