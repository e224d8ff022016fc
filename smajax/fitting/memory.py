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

# Bytes of a number of double precision.
_NUMBER = 8
# Numbers for each step of a search: the trajectory and its tangents. Measured 15 to 17 by XLA's memory analysis of one
# step of the search of a dead-weight rig; a rig with two wires has twice the states.
_PER_STEP = 17
# Numbers for each step of a simulation that chooses starts; measured 2 in the same way.
_PER_SCREENED_STEP = 2
# Numbers for each step of the responses at the end, which have all states and channels of one recording at a time.
_PER_RESPONSE_STEP = 60
# Residual and Jacobian of a search are there before and after a step, and once more while they are copied.
_COPIES = 3
# Bytes of Python, JAX and the compiled programs. Measured 0.5 to 0.7 GB.
_PROGRAMS = 700_000_000
# Share of the free memory that a fit may take; the rest is for other programs and for what the estimate leaves out.
_FREE_SHARE = 0.8
_GIGABYTE = 1e9
_CONTROL_GROUP = Path("/sys/fs/cgroup")
_PROCESSES = Path("/proc")


class FitMemory(NamedTuple):
    """Steps and memory of a fit.

    Attributes:
        steps: Steps of one simulation of all training recordings, which are filled up to one length.
        search: Bytes of the search from one start.
        others: Bytes of everything else: programs, inputs, and the responses at the end.
        screened: Bytes of one simulation that chooses starts.
        starts: Number of starts.
    """

    steps: int
    search: int
    others: int
    screened: int
    starts: int

    @property
    def least(self) -> int:
        """Bytes of the fit with one start after another."""
        # The residuals and Jacobians of all starts are kept; they are a third to a half of a search.
        return self.others + self.search + (self.starts - 1) * self.search // 2

    @property
    def most(self) -> int:
        """Bytes of the fit with all starts as one batch."""
        return self.others + self.starts * self.search

    def sentence(self) -> str:
        """Say how many steps and how much memory the fit takes."""
        return (
            f"A simulation of these recordings takes {self.steps:,} steps, and a fit about "
            f"{self.most / _GIGABYTE:.1f} GB of memory."
        )


def fit_memory(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str = "hold",
    step: float | None = None,
) -> FitMemory:
    """Compute the steps and the memory of a fit; nothing is simulated.

    Args:
        plant: The plant.
        recordings: Training recordings.
        settings: Free parameters, observed channels and starts.
        holdout: Recordings that are only predicted.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``.
        step: Longest step in s; the plant's default if not given.
    """
    counts = [count_steps(plant, r, interpolation=interpolation, step=step) for r in (*recordings, *holdout)]
    steps = len(recordings) * max(counts[: len(recordings)])
    samples = len(recordings) * max(map(len, recordings)) * len(settings.observe)
    own = len(recordings) * len({*settings.per_recording, *settings.initial})
    unknowns = len(settings.free) + own
    wires = plant.mechanism.wires
    signals = 2 * (len(plant.signals) + 1)
    return FitMemory(
        steps,
        _NUMBER * (wires * _PER_STEP * steps + _COPIES * (unknowns + 1) * samples),
        _PROGRAMS + _NUMBER * (2 * signals * steps + wires * _PER_RESPONSE_STEP * max(counts)),
        _NUMBER * wires * _PER_SCREENED_STEP * steps,
        settings.starts,
    )


def search_in_parts(memory: FitMemory, name: str, free: float | None = None) -> tuple[bool, int]:
    """Decide whether the starts of a fit are searched one after another, so that it fits into the free memory.

    Args:
        memory: Memory of the fit.
        name: Name of the recordings in the message.
        free: Free memory in bytes; ``free_memory()`` if not given.

    Returns:
        Whether the starts are searched one after another, and how many simulations that choose starts fit into the
        memory at once.

    Raises:
        InputError: If the fit does not fit even so.
    """
    free = free_memory() if free is None else free
    allowed = _FREE_SHARE * free
    if memory.least > allowed:
        raise InputError(
            f"{name}: this fit takes {memory.steps:,} steps and about {memory.least / _GIGABYTE:.1f} GB of memory, and "
            f"{free / _GIGABYTE:.1f} GB are free: cut the recordings into parts, sample them more coarsely, or lower "
            "the number of starts"
        )
    screened = int((allowed - memory.others) // max(memory.screened, 1))
    return memory.most > allowed, max(screened, 1)


def free_memory() -> float:
    """Return the free memory in bytes: the least of that of the machine, of its control group and of the process."""
    limits = [_machine_memory(), _group_memory(), _process_memory()]
    return min((limit for limit in limits if limit is not None), default=math.inf)


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
