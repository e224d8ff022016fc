"""A design as files that a simulation reads: its rig, and its input as a recording; and what to buy for it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from smajax import parameters
from smajax.channels import numbered
from smajax.recordings.recording import Recording
from smajax.sweeps.excitation import discretise_excitation
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.schema import INPUT
from smajax.sweeps.space import Axis
from smajax.sweeps.subject import RigSubject, Subject
from smajax.units import as_text


class DesignInput(NamedTuple):
    """A design as files.

    Attributes:
        rig: Text of its rig file, whose interpolation is that of the recording.
        recording: Its input; ``None`` for an actuator.
        cycles: Number of cycles of the recording.
    """

    rig: str
    recording: Recording | None
    cycles: int


def design_input(
    subject: Subject, problem: AbstractSweepProblem, axes: tuple[Axis, ...], design: Float[np.ndarray, " axes"]
) -> DesignInput:
    """Return a design as files.

    The recording has a row at each step with which a refinement simulates the design, so that a simulation of it takes
    the same steps. Square waves are held between the rows, others are linear.

    Args:
        subject: The rig or actuator.
        problem: Problem that maps a design to its metrics.
        axes: Axes of the space.
        design: The design in internal units, shape ``(axes,)``.
    """
    values = {axis.name: float(value) for axis, value in zip(axes, design, strict=True)}
    own = {n: v for n, v in values.items() if not n.startswith(INPUT)}
    if not isinstance(subject, RigSubject):
        return DesignInput(subject.to_toml(own), None, 0)
    source = subject.source
    if isinstance(source, Recording):
        names = subject.rig.plant.driving_channels(source.channels)
        units = {n: unit for n, unit in source.units.items() if n in names or n == "time"}
        recording = Recording.from_arrays("input.csv", source.time, {n: source.channels[n] for n in names}, units)
        return DesignInput(subject.to_toml(own), recording, subject.cycles)
    of_input = {n.removeprefix(INPUT): jnp.asarray(v) for n, v in values.items() if n.startswith(INPUT)}
    shape = source.all_shapes[int(of_input.get("wave", 0))]
    wires, control = subject.rig.plant.mechanism.wires, subject.rig.plant.drive.control
    inputs = discretise_excitation(source, wires, problem.shared_steps(design), of_input)
    signals = np.asarray(inputs.sample_signals)
    channels = {n: signals[:, k] for k, n in enumerate(numbered(control, wires))}
    rig = replace(subject.rig, interpolation="hold" if shape == "square" else "linear")
    recording = Recording.from_arrays("input.csv", np.asarray(inputs.time), channels)
    return DesignInput(rig.to_toml(own), recording, source.cycles)


def refined_files(number: int) -> tuple[str, str]:
    """Return the names of the rig and the input of a refined design.

    Args:
        number: Its number, from 1.
    """
    return f"rig-refined-{number}.toml", f"input-refined-{number}.csv"


def show_command(subject: Subject, number: int) -> str:
    """Return the command that shows the metrics of a refined design again; empty for an actuator.

    Args:
        subject: The rig or actuator.
        number: Number of the design, from 1.
    """
    if not isinstance(subject, RigSubject):
        return ""
    rig, recording = refined_files(number)
    return f"smajax simulate {rig} {recording} --cycles {subject.cycles} --out shown-{number}"


def what_to_buy(subject: Subject, axes: tuple[Axis, ...], values: Mapping[str, float]) -> str:
    """Return what is to be bought for a design, in words; empty for an actuator.

    Args:
        subject: The rig or actuator.
        axes: Axes of the space.
        values: Values of the design by axis, in internal units.
    """
    if not isinstance(subject, RigSubject):
        return ""
    own = {n: v for n, v in values.items() if not n.startswith(INPUT)}
    plant = parameters.replace(subject.rig.plant, own)
    diameter, length = float(plant.wire.diameter), float(plant.wire.length)
    count = plant.mechanism.wires * round(float(plant.mechanism.parallel_wires))
    pieces = f"{count} pieces of {as_text(_rounded(length), 'm')}" if count > 1 else as_text(_rounded(length), "m")
    catalogue = next((axis.catalogue for axis in axes if axis.catalogue), "")
    wire = f"{catalogue} wire" if catalogue else "wire"
    words = f"{pieces} of {wire} of {as_text(_rounded(diameter), 'm')}, and a length for the clamps"
    if not catalogue and any(axis.name == "wire.diameter" and not axis.values for axis in axes):
        words += '; wire.diameter = { catalogue = "flexinol" } takes stock diameters only'
    return words


def _rounded(length: float) -> float:
    """A length to four significant digits."""
    return float(f"{length:.4g}")
