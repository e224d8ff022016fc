"""Replacement of the material law of a plant, with the settings of its fit."""

import dataclasses
from typing import Any

import equinox as eqx

from smajax import parameters
from smajax.errors import InputError
from smajax.parameters import declarations
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.plant import Plant

# Start values of parameters that not every law has. Those of the first table are fitted: the hardening exponents of
# Lagoudas' law, which start at the middle of their usual range. Those of the second table are held.
_FREE_START_VALUES: dict[str, dict[str, float]] = {"lagoudas": {"n1": 0.5, "n2": 0.5, "n3": 0.5, "n4": 0.5}}
# Detwinning stresses of Brinson's law, Pa, of a wire that is detwinned under its usual load.
_HELD_START_VALUES: dict[str, dict[str, float]] = {
    "brinson": {"detwinning_start_stress": 0.0, "detwinning_finish_stress": 1e8}
}


def with_law(plant: Plant, settings: Any, name: str) -> tuple[Plant, Any]:
    """Replace the material law of a plant.

    Parameters that both laws have keep their values and stay free if they were; those that only the new law has get
    start values.

    Args:
        plant: The plant.
        settings: The settings of its fit, a dataclass like ``FitSettings``.
        name: The new law, as in ``MATERIALS``.

    Returns:
        The plant and the settings with the new law.

    Raises:
        InputError: If the new law has a parameter without a default that the old one does not have.
    """
    law, old_material = MATERIALS[name], plant.material
    if type(old_material) is law:
        return plant, settings
    free, held = _FREE_START_VALUES.get(name, {}), _HELD_START_VALUES.get(name, {})
    old_keys = declarations(old_material)
    common = {key: float(getattr(old_material, key)) for key in declarations(law) if key in old_keys}
    values: dict[str, Any] = held | free | common  # numbers, which the law turns into arrays
    missing = [key for key, d in declarations(law).items() if d.default is None and key not in values]
    if missing:
        raise InputError(
            f"{name} has no start value of material.{missing[0]}: give it a default in the class, or start from a rig "
            f'with [fit] model = "{name}"'
        )
    changed = eqx.tree_at(lambda p: p.material, plant, law(**values))
    declared = parameters.all_declarations(changed)
    return changed, dataclasses.replace(
        settings,
        free=tuple(n for n in settings.free if n in declared) + tuple(f"material.{key}" for key in free),
        bounds={n: ends for n, ends in settings.bounds.items() if n in declared},
        per_recording=tuple(n for n in settings.per_recording if n in declared),
    )


def law_name(plant: Plant) -> str | None:
    """Return the name of a plant's law in ``MATERIALS``; ``None`` if it is not registered.

    Args:
        plant: The plant.
    """
    return next((name for name, law in MATERIALS.items() if type(plant.material) is law), None)
