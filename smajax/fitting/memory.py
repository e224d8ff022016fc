"""Steps and memory of a fit, which are known before it begins."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from smajax.errors import InputError
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import count_steps
from smajax.simulation.padding import padded_length

# Bytes of a number of double precision.
_NUMBER = 8
# The following were measured by experiments/fitting/fit_memory.py as peaks of ``smajax fit`` in its own process, with
# an empty cache of compiled programs, from 100 to 200,000 rows, with 1 to 4 starts and 2 to 6 free parameters. It
# prints them next to the estimates.
# Bytes of Python, JAX, and compiling the programs of one wire: the peak with 100 rows.
_PROGRAMS = 590_000_000
# Bytes by which a further wire makes that larger: from a rotary rig with two wires and 100 rows.
_PROGRAMS_PER_WIRE = 140_000_000
# Numbers for each recorded value and each value of the model in a row: reading, responses and report. From
# 100,000 rows of a rotary rig, which have 3 recorded channels and 18 of the model, and 200,000 rows of a dead-weight
# rig, which have 2 and 9.
_PER_VALUE = 8
# Numbers for each step and wire, once for all starts: inputs, and the states of the responses at the end.
# From 20,000 rows of 9 steps each.
_PER_STEP = 21
# Numbers for each step and wire of each start: the trajectory; there are as many again as free parameters, for the
# tangents. From the same rows with 4 starts.
_PER_SEARCHED_STEP = 8
# Copies of the states of cells and grains in a trajectory, while blocks of steps are joined; counted in the program.
_STATE_COPIES = 2
# Residuals and Jacobians of each start: before and after a step, at the trial, and while they are copied. From
# 50,000 rows with 4 starts and with 1.
_COPIES = 5
# Numbers for each step of a simulation that chooses starts: 2 by XLA's memory analysis of that program.
_PER_SCREENED_STEP = 2
# Share of the free memory that a fit may take; the rest is for other programs and for what the estimate leaves out.
_FREE_SHARE = 0.8
_GIGABYTE = 1e9
_CONTROL_GROUP = Path("/sys/fs/cgroup")
_PROCESSES = Path("/proc")


class FitMemory(NamedTuple):
    """Steps and memory of a fit.

    Attributes:
        steps: Steps of one simulation of all training recordings, each as long as the longest.
        evaluation: Bytes of one evaluation of residual and Jacobian: trajectory and tangents.
        ends: Bytes of the residual and the Jacobian of one start, with their copies.
        others: Bytes of everything else: programs, recordings, inputs, and the responses at the end.
        screened: Bytes of one simulation that chooses starts.
        starts: Number of starts.
    """

    steps: int
    evaluation: int
    ends: int
    others: int
    screened: int
    starts: int

    @property
    def sequential(self) -> float:
        """Bytes of the fit with one start after another."""
        return float(self.others + self.starts * self.ends + self.evaluation)

    @property
    def batch(self) -> float:
        """Bytes of the fit with all starts at a time."""
        return float(self.others + self.starts * (self.ends + self.evaluation))

    def sentence(self, free: float | None = None) -> str:
        """Say how many steps and how much memory the fit takes, and what happens if that is not free.

        Args:
            free: Memory in bytes that this process can have; ``free_memory()`` if not given.
        """
        free = free_memory() if free is None else free
        text = f"A simulation of these recordings takes {self.steps:,} steps, and a fit about {_in_gb(self.batch)}"
        if self.sequential > _FREE_SHARE * free:
            return f"{text}; {_in_gb(free)} are free: {_REMEDY}."
        if self.batch > _FREE_SHARE * free:
            return (
                f"{text}; {_in_gb(free)} are free: it searches one start after another, in {_in_gb(self.sequential)}."
            )
        return f"{text}."


# What the user can do where a fit does not fit into the memory.
_REMEDY = "cut the recordings into parts, sample them more coarsely, or lower the number of starts"


def _in_gb(size: float) -> str:
    return f"{size / _GIGABYTE:.1f} GB of memory"


def fit_memory(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str | None = None,
    step: float | None = None,
) -> FitMemory:
    """Compute the steps and the memory of a fit; nothing is simulated.

    Args:
        plant: The plant.
        recordings: Training recordings.
        settings: Free parameters, observed channels and starts.
        holdout: Recordings that are only predicted.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plant's default if not given.
    """
    counts = [count_steps(plant, r, interpolation=interpolation, step=step) for r in (*recordings, *holdout)]
    longest = max(counts[: len(recordings)])
    steps = len(recordings) * padded_length(longest)
    samples = len(recordings) * padded_length(max(map(len, recordings))) * len(settings.observe)
    values = sum(len(r) * (1 + len(r.channels) + len(plant.observable)) for r in (*recordings, *holdout))
    own = len(recordings) * len({*settings.per_recording, *(f"initial.{name}" for name in settings.initial)})
    unknowns = len({*settings.free} - {*settings.per_recording}) + own
    wires, added = plant.mechanism.wires, _STATE_COPIES * added_states(plant)
    # All responses are simulated at once, on grids of one length.
    responses = max(steps, len(counts) * padded_length(max(counts)))
    return FitMemory(
        steps=len(recordings) * longest,
        evaluation=_NUMBER * (wires * (_PER_SEARCHED_STEP + unknowns) + added) * steps,
        ends=_NUMBER * _COPIES * (unknowns + 1) * samples,
        others=_PROGRAMS
        + (wires - 1) * _PROGRAMS_PER_WIRE
        + _NUMBER * (_PER_VALUE * values + (wires * _PER_STEP + added) * responses),
        screened=_NUMBER * wires * _PER_SCREENED_STEP * steps,
        starts=settings.starts,
    )


def added_states(plant: Plant) -> int:
    """Count the numbers by which cells and grains make a state larger.

    Args:
        plant: The plant.
    """
    grains = 1 if plant.grains is None else plant.grains.count
    clamps = 0 if plant.cells is None else plant.mechanism.wires
    return plant.temperatures * (1 + 2 * grains) + clamps - 3 * plant.mechanism.wires


def search_in_parts(memory: FitMemory, name: str, free: float | None = None) -> tuple[bool, int]:
    """Decide whether the starts of a fit are searched one after another, so that it fits into the free memory.

    Args:
        memory: Memory of the fit.
        name: Name of the recordings in the message.
        free: Memory in bytes that this process can have; ``free_memory()`` if not given.

    Returns:
        Whether the starts are searched one after another, and how many simulations that choose starts fit into the
        memory at once.

    Raises:
        InputError: If the fit does not fit even so.
    """
    free = free_memory() if free is None else free
    require_memory(f"{name}: this fit", memory.steps, memory.sequential, free, _REMEDY)
    screened = int((_FREE_SHARE * free - memory.others) // max(memory.screened, 1))
    return memory.batch > _FREE_SHARE * free, max(screened, 1)


def require_memory(task: str, steps: int, size: float, free: float, remedy: str) -> None:
    """Refuse a task that does not fit into the free memory.

    Args:
        task: The task in words, with the names of its recordings.
        steps: Steps of one simulation.
        size: Memory of the task, bytes.
        free: Memory in bytes that this process can have.
        remedy: What the user can do.

    Raises:
        InputError: If it does not fit.
    """
    if size > _FREE_SHARE * free:
        raise InputError(
            f"{task} takes {steps:,} steps and about {_in_gb(size)}, and {_in_gb(free)} are free: {remedy}"
        )


def free_memory() -> float:
    """Return the memory in bytes that this process can have: what it has, and what is free.

    What is free is the least of that of the machine, of its control group, and of the limit of the process.
    """
    limits = [_machine_memory(), _group_memory(), _process_memory()]
    return _resident_memory() + min((limit for limit in limits if limit is not None), default=math.inf)


def _resident_memory() -> float:
    """Memory that this process has, bytes; 0 where that is not known."""
    lines = _lines(_PROCESSES / "self" / "status")
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("VmRSS")), 0.0)


def _machine_memory() -> float | None:
    """Memory that Linux can give to programs, bytes; ``None`` on other systems."""
    lines = _lines(_PROCESSES / "meminfo")
    return next((1024.0 * float(line.split()[1]) for line in lines if line.startswith("MemAvailable")), None)


def _group_memory() -> float | None:
    """Memory that is left of a control group's limit, such as a container's, bytes."""
    limit, used = _lines(_CONTROL_GROUP / "memory.max"), _lines(_CONTROL_GROUP / "memory.current")
    if not limit or not used or not limit[0].isdigit():
        return None
    # Cached files count as used, and are given up where memory is short.
    cached = next((float(x.split()[1]) for x in _lines(_CONTROL_GROUP / "memory.stat") if x.startswith("file ")), 0.0)
    return float(limit[0]) - float(used[0]) + cached


def _process_memory() -> float | None:
    """Address space that is left of the limit of this process (``ulimit -v``), bytes; Linux only."""
    limits = [line.split() for line in _lines(_PROCESSES / "self" / "limits") if line.startswith("Max address space")]
    used = [line.split() for line in _lines(_PROCESSES / "self" / "status") if line.startswith("VmSize")]
    if not limits or not used or not limits[0][3].isdigit():
        return None
    return float(limits[0][3]) - 1024.0 * float(used[0][1])


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text().splitlines()
    except OSError:
        return []
