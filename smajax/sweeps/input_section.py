"""The section ``[input]`` of a SWEEP.toml: a periodic input, or a recording."""

import numpy as np

from smajax.channels import CHANNELS, numbered
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import quantity_at, show
from smajax.recordings.recording import Recording
from smajax.sweeps.excitation import Excitation
from smajax.sweeps.schema import MAX_FREQUENCY, InputSection
from smajax.sweeps.space import Axis

_DEFAULT_DUTY = 0.5
_DEFAULT_CYCLES = 4


def check_input_recording(rig: Rig, settings: InputSection, recording: Recording) -> None:
    """Check a recording as the input of a rig.

    Args:
        rig: The rig.
        settings: The section ``[input]``.
        recording: The recording.

    Raises:
        InputError: If there are keys of a wave next to the recording, or it heats no wire.
    """
    names = ("wave", "amplitude", "offset", "frequency", "duty", "highest")
    values = tuple(getattr(settings, "shape" if n == "wave" else n) for n in names)
    if extra := [name for name, value in zip(names, values, strict=True) if value is not None]:
        raise InputError(f"input.{extra[0]} has no place next to input.recording: take one of the two out")
    control = rig.plant.drive.control
    heating = numbered(control, rig.plant.mechanism.wires) if control else ()
    if heating and not any(np.any(recording.channels[n]) for n in heating):
        raise InputError(
            f"input.recording: {' and '.join(heating)} is 0 throughout, so that no wire is heated: name another one"
        )


def read_excitation(rig: Rig, settings: InputSection) -> Excitation:
    """Return the periodic input of a section.

    Args:
        rig: The rig, whose control determines the unit of the input.
        settings: The section ``[input]``.

    Raises:
        InputError: If a value is missing or not possible.
    """
    for key, field in (("wave", "shape"), ("amplitude", "amplitude"), ("frequency", "frequency")):
        if getattr(settings, field) is None:
            examples = InputSection.model_fields[field].examples
            raise InputError(
                f"input.{key} is missing: add a line like {key} = {examples[0] if examples else ''} to [input], "
                "or a recording"
            )
    control = CHANNELS[rig.plant.drive.control]
    amplitude = quantity_at(settings.amplitude, control.unit, "input.amplitude")
    frequency = quantity_at(settings.frequency, "Hz", "input.frequency")
    duty = _DEFAULT_DUTY if settings.duty is None else quantity_at(settings.duty, "1", "input.duty")
    if not 0.0 < amplitude <= control.plausible_range[1]:
        allowed = f"above 0, up to {control.plausible_range[1]:g} {control.unit}".removesuffix(" 1")
        raise InputError(
            f"input.amplitude = {show(settings.amplitude)} is not possible: give one {allowed}, since nothing else "
            "heats a wire"
        )
    if not 0.0 < frequency <= MAX_FREQUENCY:
        raise InputError(
            f"input.frequency = {show(settings.frequency)} is not possible: give one above 0, up to 10 kHz"
        )
    if not 0.0 < duty < 1.0:
        raise InputError(
            f"input.duty = {show(settings.duty)} is not possible: give the share of a cycle that is on, between 0 and 1"
        )
    offset = 0.0 if settings.offset is None else quantity_at(settings.offset, control.unit, "input.offset")
    if not 0.0 <= offset <= control.plausible_range[1] - amplitude:
        allowed = f"from 0 to {control.plausible_range[1] - amplitude:g} {control.unit}".removesuffix(" 1")
        raise InputError(
            f"input.offset = {show(settings.offset)} is not possible with an amplitude of {show(settings.amplitude)}, "
            f"which is added to it: give one {allowed}"
        )
    return Excitation(str(settings.shape), amplitude, frequency, duty, settings.cycles or _DEFAULT_CYCLES, offset)


def check_duties(axis: Axis, source: Excitation, wires: int) -> None:
    """Check a range of duties.

    Args:
        axis: The axis of the duty.
        source: The periodic input.
        wires: Number of wires.

    Raises:
        InputError: If the range contains a phase at which another edge of the input lies: the order of the edges must
            be the same in all designs.
    """
    if not 0.0 < axis.lower <= axis.upper < 1.0:
        raise InputError(
            f"parameters.{axis.name} from {axis.lower:g} to {axis.upper:g} is not possible: give shares of a cycle "
            "between 0 and 1"
        )
    inside = [phase for phase in source.fixed_phases(wires) if axis.lower <= phase <= axis.upper]
    if inside and axis.lower < axis.upper:
        why = "the second wire is switched on" if wires > 1 else "another wave has its reversal"
        raise InputError(
            f"parameters.{axis.name} from {axis.lower:g} to {axis.upper:g} contains {inside[0]:g}, where {why}: "
            "take the range below it, and that above it in another sweep"
        )
