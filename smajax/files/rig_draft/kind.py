"""The kind of rig and the control that the channels of recordings suggest."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smajax.channels import numbered
from smajax.errors import InputError, suggestion
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording

# The answer for no rig at all.
NO_RIG = "none"
# Inputs of a drive, in the order in which one of several recorded ones is taken: what heats the wire first.
ELECTRICAL = ("current", "voltage", "power", "duty")
# Relative change of a force from which on it is that of a spring and not of a weight. A load cell under a constant
# weight shows friction and acceleration of a few per cent.
_SPRING_FORCE = 0.2
# Channels of which a rig with one wire can fit one.
_OUTPUTS = ("temperature", "displacement", "strain", "force", "stress", "resistance")


@dataclass(frozen=True)
class RigKind:
    """Kind of a rig.

    Attributes:
        kind: Kind, a key of ``MECHANISMS``.
        control: Electrical input, or that the temperature is prescribed; ``None`` for a path.
        reason: Why, in a few words.
    """

    kind: str
    control: str | None
    reason: str


def template_kinds() -> tuple[str, ...]:
    """Return the kinds of which there is a template."""
    return tuple(kind for kind in MECHANISMS if data_path("templates", f"{kind}.toml").is_file())


def suggest_kind(recordings: Sequence[Recording], kind: str | None = None) -> RigKind:
    """Return the kind of rig that recordings suggest, with its control.

    Args:
        recordings: The recordings.
        kind: Kind that was chosen, whose control is looked for.

    Raises:
        InputError: If the recordings suggest none, with what is missing.
    """
    names, has_clock = set(recordings[0].channels), recordings[0].has_clock
    if kind is not None:
        return _chosen_kind(kind, names)
    pair = next((c for c in ELECTRICAL if set(numbered(c, 2)) <= names), None)
    single = next((c for c in ELECTRICAL if c in names), None)
    control = pair or single
    if control and not has_clock:
        cure = "give the time between two rows, as in --sample-period '20 ms' (sample_period in Python)"
        raise InputError(f"{control} heats the wire in the course of time, and the recording has no time: {cure}")
    if pair and "angle" in names:
        return RigKind("antagonistic-rotary", pair, f"{' and '.join(numbered(pair, 2))} turn one angle")
    if single:
        return _heated_kind(recordings, names, single)
    if pair:
        cure = "name the kind of the rig by --rig (rig in Python)"
        raise InputError(f"{' and '.join(numbered(pair, 2))} are recorded, and no angle: {cure}")
    return _unheated_kind(recordings, names, has_clock)


def _chosen_kind(kind: str, names: set[str]) -> RigKind:
    kinds = template_kinds()
    if kind not in kinds:
        cure = f"it is one of {', '.join(kinds)}, or {NO_RIG}"
        raise InputError(f"rig = '{kind}' is not a kind of rig{suggestion(kind, kinds)}: {cure}")
    if kind == "path":
        return RigKind(kind, None, "it was named")
    wires = MECHANISMS[kind].wires
    control = next((c for c in ELECTRICAL if set(numbered(c, wires)) <= names), None)
    if control is None and wires == 1 and "temperature" in names:
        control = PRESCRIBED_TEMPERATURE
    if control is None:
        inputs = " or ".join(" and ".join(numbered(c, wires)) for c in ELECTRICAL)
        raise InputError(f"no recorded channel heats the wire of a {kind} rig: name a column {inputs} by --channel")
    return RigKind(kind, control, "it was named")


def _heated_kind(recordings: Sequence[Recording], names: set[str], control: str) -> RigKind:
    if {"strain", "stress"} <= names:
        return RigKind("testing-machine", control, f"strain and stress are recorded, and {control} heats the wire")
    outputs = [c for c in _OUTPUTS if c in names and varies(recordings, c)]
    if not outputs:
        changing = "angle" in names and "; for an angle name the kind of the rig by --rig, such as elbow"
        outputs_text = ", ".join(_OUTPUTS)
        raise InputError(f"{control} is recorded, and nothing that a fit could follow ({outputs_text}){changing or ''}")
    return RigKind(*_mechanism(recordings, control, f"{control} heats the wire"))


def _unheated_kind(recordings: Sequence[Recording], names: set[str], has_clock: bool) -> RigKind:
    if "temperature" not in names:
        missing = f"neither an input that heats the wire ({', '.join(ELECTRICAL)}) nor its temperature is recorded"
        raise InputError(f"{missing}: name such a column by --channel (channels in Python), if the file has one")
    if {"strain", "stress"} <= names:
        reason = "temperature, stress and strain are recorded, and nothing that heats the wire"
        return RigKind("path", None, reason)
    outputs = [c for c in ("displacement", "strain", "force", "stress") if c in names and varies(recordings, c)]
    if not outputs:
        others = ", ".join(c for c in names if c != "temperature") or "nothing else"
        raise InputError(f"temperature is recorded, and {others}: a fit needs what heats the wire, or its motion")
    if not has_clock:
        cure = "give any time between two rows, as in --sample-period '1 s' (sample_period in Python)"
        raise InputError(f"a wire that follows its temperature needs a time, though its speed has no effect: {cure}")
    reason = "temperature is recorded, and nothing that heats the wire"
    return RigKind(*_mechanism(recordings, PRESCRIBED_TEMPERATURE, reason))


def _mechanism(recordings: Sequence[Recording], control: str, reason: str) -> tuple[str, str, str]:
    """Return dead weight or bias spring, by whether the force changes."""
    if any("force" in r.channels for r in recordings):
        forces = np.concatenate([r.channels["force"] for r in recordings])
        if np.ptp(forces) > _SPRING_FORCE * np.max(np.abs(forces)):
            return "bias-spring", control, f"{reason}, and the force changes"
        return "dead-weight", control, f"{reason}, and the force stays"
    return "dead-weight", control, f"{reason}, and no force is recorded"


def varies(recordings: Sequence[Recording], channel: str) -> bool:
    """Return whether a channel changes in every recording; an observed one has to.

    Args:
        recordings: The recordings.
        channel: The channel.
    """
    return all(channel in r.channels and np.ptp(r.channels[channel]) > 0 for r in recordings)
