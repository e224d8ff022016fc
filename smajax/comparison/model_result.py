"""The result of one model in a comparison."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class ModelResult:
    """One model of a comparison: its predictions and its fitted parameters, or the reason why there are none.

    Attributes:
        name: The model.
        kind: "law" for a material law, "input-output" for an input-output model.
        parameters: Number of free parameters.
        predictions: The compared channel (n,) of the training and of the holdout recording, SI units.
        wall_time: Wall time of the fit, s.
        reason: Why the model could not be fitted; empty if it was.
        note: What was done to the recordings for it, and what limits its prediction.
        input_insufficient: Whether the reason is the input (files, settings) rather than the numerics.
        at_bound: Parameters that ended at a bound, each with that bound.
        undetermined: Parameters that the training recording does not determine.
        fitted: Value, interval and unit of each parameter by name.
    """

    name: str
    kind: str
    parameters: int = 0
    predictions: tuple[np.ndarray, ...] = ()
    wall_time: float = 0.0
    reason: str = ""
    note: str = ""
    input_insufficient: bool = False
    at_bound: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    fitted: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
