"""Sensitivity of the residual to the strength of every effect that is not in the model."""

import numpy as np
from jaxtyping import Float

from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.numerics.ensemble import share_among_cores

EffectShape = tuple[str, tuple[tuple[str, float], ...]]  # key and shape of an effect


def effect_sensitivities(
    problem: DiagnosisProblem, effect_set: EffectSet, base: Float[np.ndarray, " p"]
) -> dict[EffectShape, Float[np.ndarray, " m"]]:
    """Differentiate the training residual with respect to the strength of every other effect, at each shape.

    ``SLOTS`` effects, each with one of its shapes, share a simulation with derivatives.

    Args:
        problem: The diagnosis problem.
        effect_set: The effects that are in the model.
        base: The base vector, shape ``(p,)``.

    Returns:
        The derivatives, shape ``(m,)``, in units of the typical strength, by effect and shape.
    """
    keys = [key for key in problem.effects if key not in (*problem.modelled_effects, *effect_set.keys)]
    effect_shapes = [(key, shape) for key in keys for shape in problem.shape_grid(key)]
    batches: list[list[EffectShape]] = []
    for item in effect_shapes:
        batch = next((b for b in batches if len(b) < SLOTS and all(other[0] != item[0] for other in b)), None)
        if batch is None:
            batches.append(batch := [])
        batch.append(item)

    def differentiate(batch: list[EffectShape]) -> list[np.ndarray]:
        shapes = {f"effects.{key}.{name}": value for key, shape in batch for name, value in shape}
        strengths = [f"effects.{key}.strength" for key, _ in batch]
        _, jacobian = problem.evaluate(effect_set.with_values(shapes), base, TRAIN, strengths)
        return [jacobian[:, problem.size + j] for j in range(len(batch))]

    results = share_among_cores(differentiate, batches)
    return {
        item: derivative
        for batch, derivatives in zip(batches, results, strict=True)
        for item, derivative in zip(batch, derivatives, strict=True)
    }
