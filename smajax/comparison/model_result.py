"""The result of one model in a comparison."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np


@dataclasses.dataclass(frozen=True)
class ModelResult:
    """Result of one model: its predictions and fitted parameters, or the reason why it could not be fitted.

    Attributes:
        name: Name of the model.
        kind: "law" for a material law, "input-output" for an input-output model.
        parameters: Number of free parameters.
        predictions: The compared channel of the training and of the holdout recording, SI, each of shape ``(n,)``.
        wall_time: Wall time of the fit, s.
        reason: Why the model could not be fitted; empty if it was.
        shared_reason: The reason without the model's name, where other models may have the same one.
        note: How the recordings were changed for the model, and what limits its prediction.
        input_insufficient: Whether the reason is the input (files, settings) and not the numerics.
        at_bound: Parameters whose estimates are at a bound, each with that bound.
        undetermined: Parameters that the training recording does not determine.
        fitted: Value, interval and unit of each parameter by name.
    """

    name: str
    kind: str
    parameters: int = 0
    predictions: tuple[np.ndarray, ...] = ()
    wall_time: float = 0.0
    reason: str = ""
    shared_reason: str = ""
    note: str = ""
    input_insufficient: bool = False
    at_bound: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    fitted: Mapping[str, Mapping[str, Any]] = dataclasses.field(default_factory=dict)
