"""Recorded channels: their names, internal units and plausible values."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from smajax.errors import InputError, suggestion

# Channels that every wire has, apart from its strain; ``Plant.observe`` gives each of them.
_WIRE_CHANNELS = ("temperature", "stress", "force", "resistance", "current", "voltage", "power")


@dataclass(frozen=True)
class Channel:
    """A kind of recorded signal.

    Attributes:
        unit: Internal unit.
        description: The measured quantity in a few words, with the sign convention.
        units: Usual units, in the order in which they are tried to guess the unit of implausible values.
        plausible_range: Lower and upper bound of every value, in the internal unit.
        faint: Smallest plausible peak magnitude of a recording, in the internal unit; below it the unit counts as wrong
            (0: no limit).
        commanded: Whether it is an input, which may change by any factor from row to row.
        usual: Magnitude beyond which such a change of a commanded channel counts as a change of unit.
    """

    unit: str
    description: str
    units: tuple[str, ...]
    plausible_range: tuple[float, float] = (-np.inf, np.inf)
    faint: float = 0.0
    commanded: bool = False
    usual: float = 0.0


# ``plausible_range``, ``faint`` and ``usual`` are those of benches with shape-memory alloys (currents of 1 mA to 50 A,
# strokes up to 1 m); tests/unit/recordings/test_bad_recordings.py holds them. A rig beyond them sets ``any_scale``.
CHANNELS: Mapping[str, Channel] = MappingProxyType(
    {
        "time": Channel("s", "time of the row, strictly increasing", ("s", "ms", "min")),
        "current": Channel(
            "A", "current through the wire", ("A", "mA", "uA"), (-50.0, 50.0), 1e-3, commanded=True, usual=10.0
        ),
        "voltage": Channel(
            "V", "voltage across the wire", ("V", "mV", "uV"), (-400.0, 400.0), commanded=True, usual=100.0
        ),
        "power": Channel(
            "W", "electrical power into the wire", ("W", "mW", "uW"), (-10.0, 2000.0), commanded=True, usual=500.0
        ),
        "duty": Channel(
            "1",
            "fraction of the time in which the drive is on, 0 to 1",
            ("1", "%"),
            (0.0, 1.0),
            commanded=True,
            usual=1.0,
        ),
        "temperature": Channel("degC", "temperature of the wire", ("degC", "K", "mK", "degF"), (-200.0, 900.0)),
        "ambient": Channel("degC", "temperature of the surroundings", ("degC", "K", "mK", "degF"), (-200.0, 500.0)),
        "fan": Channel(
            "1",
            "duty or relative speed of a fan that cools the wire, 0 to 1",
            ("1", "%"),
            (0.0, 1.0),
            commanded=True,
            usual=1.0,
        ),
        "displacement": Channel(
            "m", "displacement of the load, positive when the wire shortens", ("m", "mm", "um", "nm"), (-1.0, 1.0)
        ),
        "angle": Channel(
            "rad", "angle of the pulley, positive when wire 1 is heated", ("rad", "deg", "mrad"), (-20.0, 20.0)
        ),
        "rate": Channel("rad/s", "rate of the angle", ("deg/s", "rad/s", "mrad/s"), (-500.0, 500.0)),
        "force": Channel("N", "force along the wire, tension positive", ("N", "mN", "uN", "kN"), (-1e5, 1e5)),
        "torque": Channel("N m", "torque on the pulley", ("N m", "N mm", "uN m"), (-1000.0, 1000.0)),
        "stress": Channel(
            "Pa", "stress in the wire, tension positive", ("MPa", "Pa", "kPa", "GPa"), (-5e9, 5e9), faint=1e4
        ),
        "strain": Channel("1", "strain of the wire, elongation positive", ("1", "%", "ppm"), (-0.5, 0.5)),
        "resistance": Channel("ohm", "electrical resistance of the wire", ("ohm", "mohm", "uohm"), (-1.0, 1000.0)),
    }
)
# Examples of the noise of a meter by electrical input, for messages.
NOISE_EXAMPLES: Mapping[str, str] = MappingProxyType(
    {"current": "1 mA", "voltage": "5 mV", "power": "10 mW", "duty": "1 %"}
)
# Common column headers and the channels that they usually mean; used for suggestions only.
_USUAL_HEADERS = {
    "t": "time",
    "i": "current",
    "u": "voltage",
    "v": "voltage",
    "p": "power",
    "pwm": "duty",
    "temp": "temperature",
    "f": "force",
}


def channel_of(name: str) -> str | None:
    """Return the kind of a channel, such as ``current`` for ``current_2``.

    Args:
        name: Name of a channel.

    Returns:
        A key of ``CHANNELS``; ``None`` for an unknown name.
    """
    base = re.sub(r"_[1-9][0-9]*$", "", name, flags=re.ASCII)
    return base if base in CHANNELS else None


def numbered(name: str, wires: int) -> tuple[str, ...]:
    """Return the names of the channels of one kind: ``name`` for one wire, else ``name_1``, ``name_2``.

    Args:
        name: Kind of the channels.
        wires: Number of wires.
    """
    return (name,) if wires == 1 else tuple(f"{name}_{i + 1}" for i in range(wires))


def observable_channels(wires: int, coordinate: str, extra: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the names of the channels that a plant computes.

    Args:
        wires: Number of wires.
        coordinate: Channel of the motion.
        extra: Further channels of the mechanism.
    """
    names = tuple(n for c in _WIRE_CHANNELS for n in numbered(c, wires))
    return tuple(dict.fromkeys((coordinate, *numbered("strain", wires), *names, *extra)))


def driving_signals(control: str, wires: int, has_temperature: bool, prescribed: Iterable[str]) -> tuple[str, ...]:
    """Return the names of the recorded channels that drive a plant.

    Args:
        control: Electrical input; empty if there is none.
        wires: Number of wires.
        has_temperature: Whether the wire has the recorded temperature.
        prescribed: Recorded channels that the mechanism follows.
    """
    inputs = numbered(control, wires) if control else ()
    return (*inputs, *(("temperature",) if has_temperature else ()), *prescribed)


def channel_unit(name: str, *, difference: bool = False) -> str:
    """Return the internal unit of a channel's values, or of differences of them.

    Args:
        name: A channel such as ``temperature`` or ``current_2``.
        difference: Whether to return the unit of a difference: K instead of degC.

    Raises:
        InputError: If the channel is unknown.
    """
    kind = channel_of(name)
    if kind is None:
        kinds = f"the known ones are {', '.join(CHANNELS)}, and NAME_1, NAME_2"
        raise InputError(f"'{name}' is not a known channel{channel_suggestion(name)}: {kinds}")
    unit = CHANNELS[kind].unit
    return "K" if difference and unit == "degC" else unit


def channel_suggestion(name: str) -> str:
    """Return the suggestion `` (did you mean 'x'?)`` of a similar channel, for an error message.

    Args:
        name: An unknown name of a channel.

    Returns:
        The suggestion with a leading space; empty if no channel is similar.
    """
    if re.search(r"_0\d*$", name) and channel_of(name.rpartition("_")[0]):
        return f" (did you mean '{name.rpartition('_')[0]}_1'?)"
    base, _, number = name.lower().rpartition("_") if re.search(r"_\d+$", name) else (name.lower(), "", "")
    suffix = f"_{number}" if number else ""
    if base in _USUAL_HEADERS:
        return f" (did you mean '{_USUAL_HEADERS[base]}{suffix}'?)"
    return suggestion(base + suffix, [kind + suffix for kind in CHANNELS])
