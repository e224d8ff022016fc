"""Size of a sweep: the memory of its table and the time of its simulations, known before designs are drawn."""

from collections.abc import Sequence
from dataclasses import dataclass

from smajax.errors import InputError
from smajax.fitting.memory import free_memory
from smajax.numerics.process import count_cores
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis, draw_designs

# Copies of the table in memory at the end: the parts of the chunks, the joined and the sorted table, and that which is
# written; the designs are there twice more.
_COPIES = 5
# Share of the free memory that the table may take, as of a fit.
_FREE_SHARE = 0.8
# Seconds of one step of one design on one core, rounded up from the throughput that
# experiments/speed/sweep_throughput.py prints.
_SECONDS_PER_STEP = 2e-6
_SECONDS_PER_HOUR = 3600.0
# Designs from which the number of steps is estimated.
_SAMPLE = 64
# Hours from which the progress line says how many: shorter sweeps show their end soon.
_LONG = 0.1


@dataclass(frozen=True)
class SweepSize:
    """Estimated size of a sweep.

    Attributes:
        designs: Number of designs, with those of the Sobol indices.
        bytes: Memory of the table while it is put together, in bytes.
        hours: Time of the simulations in hours on this computer.
    """

    designs: int
    bytes: float
    hours: float

    @property
    def time_text(self) -> str:
        """The time in words for a progress line; empty if it is short."""
        return f", about {_hours_text(self.hours)}" if self.hours > _LONG else ""


def sweep_size(problem: AbstractSweepProblem, axes: Sequence[Axis], designs: int, gradients: bool) -> SweepSize:
    """Return the estimated size of a sweep.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space.
        designs: Number of designs.
        gradients: Whether derivatives are computed.
    """
    count = len(axes)
    columns = 2 + count + len(problem.units) * (1 + count if gradients else 1)
    steps = float(problem.grouped_steps(draw_designs(axes, "latin-hypercube", _SAMPLE, seed=0)).mean())
    seconds = _SECONDS_PER_STEP * steps * designs * (1 + count if gradients else 1) / count_cores()
    return SweepSize(designs, 8.0 * designs * (columns * _COPIES + 2 * count), seconds / _SECONDS_PER_HOUR)


def require_size(size: SweepSize, free: float | None = None) -> None:
    """Refuse a sweep whose table does not fit into the memory.

    Args:
        size: Size of the sweep.
        free: Memory in bytes that this process can have; ``free_memory()`` if not given.

    Raises:
        InputError: If it does not fit.
    """
    free = free_memory() if free is None else free
    if size.bytes > _FREE_SHARE * free:
        need = f"need {size.bytes:,.0f} bytes of memory ({size.bytes / 1e9:.1f} GB), and {free / 1e9:.1f} GB are free"
        time = f"their simulation would take about {_hours_text(size.hours)} on this computer"
        raise InputError(f"{size.designs:,} designs {need}; {time}: take fewer designs, or fewer points of a grid")


def _hours_text(hours: float) -> str:
    return f"{hours:,.0f} h" if hours >= 10 else f"{hours:.1f} h"
