"""Are the rows of a recording in the order in which they were recorded, and does none stand alone?

A noisy thermometer scatters about its neighbours, and the strain does not follow it. A row from elsewhere lies off its neighbours in both:
temperature and strain go together, as everywhere on the curve. And between one row and the next no specimen passes a third of its cycle.
"""

import numpy as np
from scipy.ndimage import median_filter

from smajax.errors import InputError
from smajax.inner_loops import scatter

_JUMP = 0.35  # of the temperatures' range, from one row to the next
_OFF_T, _OFF_E = 0.01, 0.02  # of their ranges, from the median of the rows about
_ALONE, _STRAYS = 0.5, 3  # of the others' range, from the median of the rows about; more rows than these are no slips
_OF_NOISE = 8.0  # standard deviations
_ABOUT = 5
_FEWEST = 20  # rows: of fewer, none can correlate by 4 standard deviations
_TOGETHER = 0.3  # least correlation that counts
_BY_CHANCE = 4.0  # standard deviations of the correlation of so many rows, by noise alone
_CURE = "not in the order in which they were recorded; sort them by time"


def refuse_disorder(name: str, temperature: np.ndarray, strain: np.ndarray) -> None:
    """Raises ``InputError``, with a row (counted from 1), where rows (n,) cannot have been recorded in this order."""
    steps = np.abs(np.diff(temperature))
    worst = int(np.argmax(steps))
    if steps[worst] > _JUMP * np.ptp(temperature):
        refuse_strays(name, "a temperature (degC) of", temperature)
        told = f"{name}: row {worst + 2} of the data: the temperature jumps by {steps[worst]:.3g} K from the row before"
        raise InputError(f"{told}: rows are missing, or {_CURE}")
    off_t, off_e = (values - median_filter(values, _ABOUT, mode="nearest") for values in (temperature, strain))
    both = np.flatnonzero((np.abs(off_t) > _OFF_T * np.ptp(temperature)) & (np.abs(off_e) > _OFF_E * np.ptp(strain)))
    if len(both) < _FEWEST or not np.ptp(off_t[both]) or not np.ptp(off_e[both]):
        return
    together = float(np.corrcoef(off_t[both], off_e[both])[0, 1])
    if abs(together) > max(_TOGETHER, _BY_CHANCE / np.sqrt(len(both))):
        k = int(both[np.argmax(np.abs(off_t[both] * off_e[both]))])
        told = f"{name}: row {k + 1} of the data lies {abs(off_t[k]):.3g} K and {abs(off_e[k]):.2g} of strain off the rows about it"
        raise InputError(f"{told}, and {len(both) - 1} others likewise, which noise does not do: the rows are {_CURE}")


def refuse_strays(name: str, what: str, values: np.ndarray) -> None:
    """Raises ``InputError``, with a row (counted from 1), where single values (n,) stand far off all others, as slips of a reading do."""
    about = median_filter(values, _ABOUT, mode="nearest")
    off = np.abs(values - about)
    noise = scatter(values, 1) if len(values) > 2 else 0.0
    alone = np.flatnonzero(off > max(_ALONE * np.ptp(about), _OF_NOISE * noise))
    if 0 < len(alone) <= _STRAYS and np.ptp(about) > 0.0:
        k = int(alone[np.argmax(off[alone])])
        told = f"{name}: row {k + 1} of the data: {what} {values[k]:.4g} stands alone among rows of about {about[k]:.4g}"
        raise InputError(f"{told}: correct it, or take its row out")
