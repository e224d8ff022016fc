"""The task of a tuning: what a loop has to do, which gains are free, and what counts."""

from collections.abc import Mapping
from dataclasses import dataclass

from smajax.control.analysis.closed_loop_checks import ControlTask


@dataclass(frozen=True, eq=False)
class TuningTask(ControlTask):
    """A control task whose gains are tuned.

    Args:
        bounds: Lower and upper bound of the free gains by name, internal units.
        weights: Weights of the objective's terms by name (``objective.TERMS``).
        settle: Whether the settling time is minimised, not the terms.
        starts: Number of starts of the search.
    """

    bounds: Mapping[str, tuple[float, float]]
    weights: Mapping[str, float]
    settle: bool
    starts: int
