"""Dissipation check: whether the stresses of a study stay where Lagoudas' law satisfies the second law."""

from collections.abc import Iterable, Mapping

import numpy as np

from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.plant import Plant
from smajax.units import as_text


def check_dissipation(plant: Plant, channels: Iterable[Mapping[str, np.ndarray]]) -> list[str]:
    """Warn if stresses exceed that at which the lines of Lagoudas' law cross (``Lagoudas.crossing_stress``).

    Args:
        plant: The plant; laws other than that of Lagoudas give no warning.
        channels: Channels of each recording by name, in SI.

    Returns:
        A list with the warning, or an empty list.
    """
    law = plant.effective_material
    if not isinstance(law, Lagoudas):
        return []
    maxima = [
        np.nanmax(values)
        for recording in channels
        for name, values in recording.items()
        if name.partition("_")[0] == "stress" and np.any(np.isfinite(values))
    ]
    highest, crossing = max(maxima, default=0.0), law.crossing_stress()
    if not highest > crossing:
        return []
    slope_austenite, slope_martensite = (
        as_text(float(f"{v:.4g}"), "Pa/K")
        for v in (law.clausius_clapeyron_austenite, law.clausius_clapeyron_martensite)
    )
    crossing_text, highest_text = (f"{stress / 1e6:.4g} MPa" for stress in (crossing, highest))
    return [
        f"clausius_clapeyron_austenite ({slope_austenite}) is above clausius_clapeyron_martensite "
        f"({slope_martensite}), so that from {crossing_text} on Lagoudas' lines of heating and cooling cross and "
        f"hysteresis is lost, which the second law forbids, and the stress reaches {highest_text}: give slopes that "
        "are closer to each other, or stay below that stress."
    ]
