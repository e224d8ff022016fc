"""Checks that rows are in the order in which they were recorded, and that no single row is an outlier.

Noise of a thermometer is independent of the strain. A row in the wrong position differs from its neighbours in both
channels, so that the deviations of temperature and strain are correlated, as the channels are along the curve. And the
temperature does not change by a third of its range between two rows. All constants were chosen by trial;
tests/unit/properties/test_properties.py holds them on shuffled and on noisy rows.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from smajax.errors import InputError
from smajax.properties.minor_loops import noise_of_averages

# Largest change of the temperature between two rows, as a share of its range. Chosen by trial.
_MAX_JUMP = 0.35
# A row deviates where its temperature differs from the running median by more than this share of the range ...
_TEMPERATURE_DEVIATION = 0.01
# ... and its strain by more than this share.
_STRAIN_DEVIATION = 0.02
# An outlier differs from the running median by more than this share of the range of the medians ...
_OUTLIER_SHARE = 0.5
# ... and by more than this number of standard deviations of the noise.
_OUTLIER_STANDARD_DEVIATIONS = 8.0
# More outliers than this are not errors of single readings.
_MAX_OUTLIERS = 3
# Rows of the running median.
_MEDIAN_ROWS = 5
# Least number of deviating rows whose correlation is tested: of up to 16 rows it cannot exceed 4 standard deviations.
_MIN_DEVIATING_ROWS = 20
# Rows are in the wrong order where the correlation of the deviations exceeds this ...
_MIN_CORRELATION = 0.3
# ... and this number of standard deviations of a correlation by noise, 1 / sqrt(rows).
_CHANCE_STANDARD_DEVIATIONS = 4.0
_HINT = "not in the order in which they were recorded; sort them by time"


def check_row_order(name: str, temperature: Float[np.ndarray, " n"], strain: Float[np.ndarray, " n"]) -> None:
    """Check that rows can have been recorded in this order.

    Args:
        name: The recording, for the message.
        temperature: Temperatures (n,), degC.
        strain: Strains (n,).

    Raises:
        InputError: They cannot, or a temperature is an outlier; the message names a row, counted from 1.
    """
    jumps = np.abs(np.diff(temperature))
    largest = int(np.argmax(jumps))
    if jumps[largest] > _MAX_JUMP * np.ptp(temperature):
        check_outliers(name, "a temperature (degC) of", temperature)
        raise InputError(
            f"{name}: row {largest + 2} of the data: the temperature jumps by {jumps[largest]:.3g} K from the row "
            f"before: rows are missing, or {_HINT}"
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
            f"{name}: row {k + 1} of the data deviates from its neighbouring rows by {abs(off_t[k]):.3g} K and a "
            f"strain of {abs(off_e[k]):.2g}, and {len(both) - 1} other rows deviate in the same way, more than by "
            f"noise: the rows are {_HINT}"
        )


def check_outliers(name: str, quantity: str, values: Float[np.ndarray, " n"]) -> None:
    """Check that no single value is an outlier, as by an error of one reading.

    Args:
        name: The recording, for the message.
        quantity: The values in words, for the message, such as "a strain of".
        values: Values (n,) of one channel.

    Raises:
        InputError: A value is an outlier; the message names its row, counted from 1.
    """
    medians = median_filter(values, _MEDIAN_ROWS, mode="nearest")
    deviation = np.abs(values - medians)
    noise = noise_of_averages(values, 1) if len(values) > 2 else 0.0
    limit = max(_OUTLIER_SHARE * np.ptp(medians), _OUTLIER_STANDARD_DEVIATIONS * noise)
    outliers = np.flatnonzero(deviation > limit)
    if 0 < len(outliers) <= _MAX_OUTLIERS and np.ptp(medians) > 0.0:
        k = int(outliers[np.argmax(deviation[outliers])])
        raise InputError(
            f"{name}: row {k + 1} of the data: {quantity} {values[k]:.4g} is an outlier among rows of about "
            f"{medians[k]:.4g}: correct it, or remove its row"
        )
