"""How the residual begins to move with the strength of every effect that is not there yet."""

import numpy as np

from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.hypothesis import Hypothesis
from smajax.diagnose.program import SLOTS

Item = tuple[str, tuple[tuple[str, float], ...]]  # an effect's key and its shape


def effect_columns(bench: Bench, hypothesis: Hypothesis, base: np.ndarray) -> dict[Item, np.ndarray]:
    """The residual's derivative by the strength of every effect that is not there yet, at each value of its shape's grid.

    Keyed by effect and shape; in units of the typical strength; on the training recording.
    """
    asked = [key for key in bench.effects if key not in (*bench.known, *hypothesis.keys)]
    wanted = [(key, shape) for key in asked for shape in bench.grid(key)]
    batches: list[list[Item]] = []
    for item in wanted:
        home = next((b for b in batches if len(b) < SLOTS and all(other[0] != item[0] for other in b)), None)
        if home is None:
            batches.append(home := [])
        home.append(item)

    def one(batch: list) -> list[np.ndarray]:
        at = hypothesis.at({f"effects.{key}.{name}": value for key, shape in batch for name, value in shape})
        _, jacobian = bench.evaluate(at, base, 0, [f"effects.{key}.strength" for key, _ in batch])
        return [jacobian[:, bench.size + j] for j in range(len(batch))]

    found = in_pairs(one, batches)
    return {item: column for batch, columns in zip(batches, found, strict=True) for item, column in zip(batch, columns, strict=True)}
