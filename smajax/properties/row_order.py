"""Checks that rows are in the order in which they were recorded, and that no single row is an outlier.

A noisy thermometer scatters about its neighbours, and the strain does not follow it. A row from elsewhere differs
from its neighbours in both channels at once: temperature and strain are correlated, as everywhere on the curve. And
no specimen passes a third of its cycle between two rows. All constants were chosen by trial;
tests/unit/properties/test_properties.py holds them on shuffled and on noisy rows.
"""

import numpy as np
from scipy.ndimage import median_filter

from smajax.errors import InputError
from smajax.properties.minor_loops import noise_of_averages

# Largest change of the temperature between two rows, as a share of its range.
_MAX_JUMP = 0.35
# A row deviates where it is off the median of its neighbours by more than these shares of the ranges of temperature and
# strain.
_TEMPERATURE_DEVIATION = 0.01
_STRAIN_DEVIATION = 0.02
# A row is an outlier beyond this share of the range of its neighbours' medians, and beyond so many standard deviations
# of the noise.
_OUTLIER_SHARE = 0.5
_OUTLIER_STANDARD_DEVIATIONS = 8.0
# More outliers than this are no slips of a reading.
_MAX_OUTLIERS = 3
# Rows of the running median.
_MEDIAN_ROWS = 5
# Fewer deviating rows than this cannot correlate by 4 standard deviations.
_MIN_DEVIATING_ROWS = 20
# Least correlation of the deviations that counts as disorder, and its multiple of the standard deviation by noise, 1 /
# sqrt(rows).
_MIN_CORRELATION = 0.3
_CHANCE_STANDARD_DEVIATIONS = 4.0
_HINT = "not in the order in which they were recorded; sort them by time"


def check_row_order(name: str, temperature: np.ndarray, strain: np.ndarray) -> None:
    """Check that rows can have been recorded in this order.

    Args:
        name: The recording, for the message.
        temperature: Temperatures (n,), degC.
        strain: Strains (n,).

    Raises:
        InputError: With a row (counted from 1) where they cannot.
    """
    jumps = np.abs(np.diff(temperature))
    largest = int(np.argmax(jumps))
    if jumps[largest] > _MAX_JUMP * np.ptp(temperature):
        check_outliers(name, "a temperature (degC) of", temperature)
        raise InputError(
            f"{name}: row {largest + 2} of the data: the temperature jumps by {jumps[largest]:.3g} K from the row "
            "before: "
            f"rows are missing, or {_HINT}"
        )
    off_t, off_e = (values - median_filter(values, _MEDIAN_ROWS, mode="nearest") for values in (temperature, strain))
    both = np.flatnonzero(
        (np.abs(off_t) > _TEMPERATURE_DEVIATION * np.ptp(temperature))
        & (np.abs(off_e) > _STRAIN_DEVIATION * np.ptp(strain))
    )
    if len(both) < _MIN_DEVIATING_ROWS or not np.ptp(off_t[both]) or not np.ptp(off_e[both]):
        return
    correlation = float(np.corrcoef(off_t[both], off_e[both])[0, 1])
    if abs(correlation) > max(_MIN_CORRELATION, _CHANCE_STANDARD_DEVIATIONS / np.sqrt(len(both))):
        k = int(both[np.argmax(np.abs(off_t[both] * off_e[both]))])
        raise InputError(
            f"{name}: row {k + 1} of the data lies {abs(off_t[k]):.3g} K and {abs(off_e[k]):.2g} of strain off its "
            "neighbouring rows, "
            f"and so do {len(both) - 1} others, which noise does not explain: the rows are {_HINT}"
        )


def check_outliers(name: str, what: str, values: np.ndarray) -> None:
    """Check that no single value stands far off all others, as a slip of a reading does.

    Args:
        name: The recording, for the message.
        what: The values in words, for the message, as in "a strain of".
        values: Values (n,) of one channel.

    Raises:
        InputError: With the row (counted from 1) of an outlier.
    """
    medians = median_filter(values, _MEDIAN_ROWS, mode="nearest")
    deviation = np.abs(values - medians)
    noise = noise_of_averages(values, 1) if len(values) > 2 else 0.0
    limit = max(_OUTLIER_SHARE * np.ptp(medians), _OUTLIER_STANDARD_DEVIATIONS * noise)
    outliers = np.flatnonzero(deviation > limit)
    if 0 < len(outliers) <= _MAX_OUTLIERS and np.ptp(medians) > 0.0:
        k = int(outliers[np.argmax(deviation[outliers])])
        raise InputError(
            f"{name}: row {k + 1} of the data: {what} {values[k]:.4g} stands alone among rows of about "
            f"{medians[k]:.4g}: "
            "correct it, or take its row out"
        )
