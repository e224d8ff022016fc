"""The task of a tuning: a control task, its free gains and its objective."""

from collections.abc import Mapping
from dataclasses import dataclass

from smajax.control.analysis.closed_loop_checks import ControlTask


@dataclass(frozen=True, eq=False)
class TuningTask(ControlTask):
    """A control task whose gains are tuned.

    Attributes:
        bounds: Lower and upper bound of each free gain by name, internal units.
        weights: Weights of the objective's terms by name (``objective.TERMS``).
        settle: Whether the settling time is minimised instead of the terms.
        starts: Number of starts of the search, at least 1.
    """

    bounds: Mapping[str, tuple[float, float]]
    weights: Mapping[str, float]
    settle: bool
    starts: int
