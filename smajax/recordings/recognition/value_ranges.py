"""Units, full scales and counts of a converter, judged by the values where a header does not say them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_unit
from smajax.recordings.unit_checks import looks_like_kelvin
from smajax.units import to_si

Floats = NDArray[np.float64]

# Largest magnitude that is usual in a recording of a rig with shape-memory wires, in internal units: wires of 25 um to
# 1 mm, metres of wire, coils and strips. Narrower than the plausible range of a channel; chosen from the rigs of the
# references and of the public recordings.
_USUAL_PEAKS = {
    "current": (0.02, 20.0),
    "voltage": (0.05, 100.0),
    "power": (0.01, 500.0),
    "displacement": (2e-5, 0.3),
    "angle": (0.01, 7.0),
    "rate": (0.05, 100.0),
    "force": (0.01, 5000.0),
    "torque": (1e-5, 100.0),
    "stress": (1e6, 2e9),
    "strain": (5e-4, 0.12),
    "resistance": (0.05, 500.0),
}
# Units that are tried where the header has none, the most usual first.
_USUAL_UNITS = {
    "current": ("A", "mA"),
    "voltage": ("V", "mV"),
    "power": ("W", "mW"),
    "displacement": ("mm", "m", "um"),
    "angle": ("deg", "rad"),
    "rate": ("deg/s", "rad/s"),
    "force": ("N", "gf"),
    "torque": ("N m", "N mm"),
    "stress": ("MPa", "Pa", "GPa"),
    "strain": ("%", "1"),
    "resistance": ("ohm", "mohm"),
}
# Largest number of a duty that is a fraction, per cent, or of 8, 10 or 12 bits.
_FRACTION, _PERCENT = 1.0, 100.0
_FULL_SCALES = (255.0, 1023.0, 4095.0)
# Share of the values that may lie above a full scale: corrupt packets of a serial line.
_CORRUPT_SHARE = 0.01
# Quantile of the magnitudes that counts as the peak.
_PEAK_QUANTILE = 0.995
# Whole numbers from here on need more than 8 bits, and look like counts of a converter where they have no unit.
_LEAST_COUNTS = 256
# Channels that are measured by converters, and are not given as whole numbers in another way.
_CONVERTED = ("force", "displacement", "angle", "resistance", "temperature", "stress", "strain", "torque")
# Highest temperature (degC) at which a recording may begin in a room, and lowest that may also be one in K.
_ROOM_TO = 45.0
_KELVIN_FROM, _KELVIN_TO = 250.0, 900.0
# Temperatures (degC) between which the hottest row of a recording lies.
_COLD, _HOTTEST = 30.0, 400.0
# A recording may be one in degF where it begins between these values.
_ROOM_FAHRENHEIT = (60.0, 95.0)


@dataclass(frozen=True)
class Scale:
    """What the values of a column are taken for.

    Attributes:
        unit: Unit of the values; empty where it cannot be decided.
        reason: Why.
        doubt: What else is possible, as a sentence; empty if nothing is.
        others: Other units, as in ``[mA]`` or ``full_scale=100``.
        full_scale: Number that stands for 1.
    """

    unit: str
    reason: str
    doubt: str = ""
    others: tuple[str, ...] = ()
    full_scale: float = 1.0


def range_text(values: Floats) -> str:
    """Return the range of values as text."""
    low, high = float(values.min()), float(values.max())
    return f"{low:.5g} to {high:.5g}" if low < high else f"{low:.5g} in every row"


def are_whole(values: Floats) -> bool:
    """Return whether all values are whole numbers."""
    return bool(np.all(values == np.round(values)))


def are_counts(channel: str, values: Floats) -> bool:
    """Return whether values without a unit look like counts of a converter.

    Args:
        channel: The channel.
        values: Finite values.
    """
    changes = values.min() < values.max()
    return channel in _CONVERTED and are_whole(values) and bool(changes and abs(values).max() >= _LEAST_COUNTS)


def scale_of(channel: str, values: Floats) -> Scale:
    """Return the unit of a channel by its values.

    Args:
        channel: The channel, other than time.
        values: Finite values.
    """
    if channel in ("temperature", "ambient"):
        return _temperature_scale(values)
    if channel in ("duty", "fan"):
        return _duty_scale(values)
    low, high = _USUAL_PEAKS[channel]
    # Single rows, such as the drop-out of a laser, do not decide.
    peak, numbers = float(np.quantile(abs(values), _PEAK_QUANTILE)), range_text(values)
    units = _USUAL_UNITS[channel]
    if peak == 0:
        return Scale(units[0], f"no unit, and 0 in every row: {units[0]} as is usual")
    fitting = [unit for unit in units if low <= abs(to_si(peak, unit, channel_unit(channel))) <= high]
    if not fitting:
        tried = " or ".join(_shown(unit) for unit in units)
        doubt = f"the values are {numbers}, which is not usual in {tried}, and the header has no unit"
        return Scale("", "", doubt, tuple(f"[{unit}]" for unit in units))
    if len(fitting) == 1:
        return Scale(fitting[0], f"no unit, and {numbers} is usual in {_shown(fitting[0])} only")
    others = [_shown(unit) for unit in fitting[1:]]
    doubt = f"the header has no unit, and {numbers} may be in {_shown(fitting[0])} or {' or '.join(others)}"
    return Scale(fitting[0], "no unit", doubt, tuple(f"[{unit}]" for unit in fitting[1:]))


def _shown(unit: str) -> str:
    return "fractions" if unit == "1" else unit


def _temperature_scale(values: Floats) -> Scale:
    """Return K or degC: a recording begins in a room, and wires stay between freezing and a few hundred degC."""
    numbers, start = range_text(values), float(values[0])
    if looks_like_kelvin(values):
        return Scale("K", f"no unit, and {numbers} begins at room temperature in K")
    if values.min() >= _KELVIN_FROM and values.max() <= _KELVIN_TO:
        doubt = f"the header has no unit, and {numbers} may be in K or in degC"
        return Scale("K", "no unit", doubt, ("[degC]",))
    if _ROOM_FAHRENHEIT[0] <= start <= _ROOM_FAHRENHEIT[1] and values.min() >= _ROOM_TO:
        doubt = f"the header has no unit, and {numbers} may be a hot wire in degC or one that begins in a room in degF"
        return Scale("degC", "no unit", doubt, ("[degF]",))
    begins = "begins at room temperature in degC" if start <= _ROOM_TO else "goes below any temperature of a wire in K"
    return Scale("degC", f"no unit, and {numbers} {begins}")


def _duty_scale(values: Floats) -> Scale:
    """Return the number that stands for full: 1, 100, or the largest of 8, 10 or 12 bits."""
    peak, numbers = float(values.max()), range_text(values)
    if peak <= _FRACTION:
        return Scale("1", f"{numbers} is a fraction")
    if peak <= _PERCENT:
        if are_whole(values) and peak < _PERCENT:
            doubt = f"the header has no unit, and {numbers} may be per cent or a PWM of 8 bits, 0 to 255"
            return Scale("%", "no unit", doubt, ("full_scale=255",))
        return Scale("%", f"no unit, and {numbers} does not exceed 100 per cent")
    for full, bits in zip(_FULL_SCALES, (8, 10, 12), strict=True):
        above = int(np.count_nonzero((values > full) | (values < 0)))
        if above <= _CORRUPT_SHARE * len(values):
            usual = values[values <= full]
            reason = f"{range_text(usual)} is a PWM of {bits} bits, 0 to {full:.0f}"
            rows = f"{above} row{'s' * (above > 1)}"
            doubt = f"{rows} outside 0 to {full:.0f} (up to {peak:.5g}) would be corrupt" if above else ""
            others = tuple(f"full_scale={other:.0f}" for other in _FULL_SCALES if other >= peak and other != full)
            return Scale("1", reason, doubt, others, full)
    doubt = f"the values are {numbers}, and the number that stands for full cannot be known"
    return Scale("", "", doubt, (f"full_scale={peak:.0f}",))


def likely_channels(values: Floats) -> tuple[str, ...]:
    """Return channels with units that the values of a column without a name may be, for examples only.

    Args:
        values: Finite values.
    """
    steps = np.diff(values)
    likely = ["time [s]"] if len(steps) and steps.min() > 0 else []
    if values.min() > -_HOTTEST and _COLD < values.max() < _HOTTEST and values.min() < values.max():
        likely.append("temperature [degC]")
    for channel in ("strain", "stress"):
        scale = scale_of(channel, values)
        likely += [f"{channel} [{scale.unit}]"] if scale.unit and not scale.doubt and values.max() > 0 else []
    return tuple(likely) or ("current [A]", "displacement [mm]")
