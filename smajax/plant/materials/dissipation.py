"""Dissipation check: whether a law was used only where its transformation dissipates, as the second law demands."""

from collections.abc import Iterable, Mapping

import numpy as np

from smajax.plant.materials.lagoudas import Lagoudas
from smajax.plant.plant import Plant
from smajax.units import as_text


def check_dissipation(plant: Plant, channels: Iterable[Mapping[str, np.ndarray]]) -> list[str]:
    """Warn of stresses above that at which the lines of Lagoudas' law cross (``Lagoudas.crossing_stress``).

    Args:
        plant: The plant; another law than that of Lagoudas gives no warning.
        channels: Channels of each recording by name, in SI.

    Returns:
        A sentence, or nothing.
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
    warm, cold = (
        as_text(float(f"{v:.4g}"), "Pa/K")
        for v in (law.clausius_clapeyron_austenite, law.clausius_clapeyron_martensite)
    )
    crossing_text, highest_text = (f"{stress / 1e6:.4g} MPa" for stress in (crossing, highest))
    return [
        f"clausius_clapeyron_austenite ({warm}) is above clausius_clapeyron_martensite ({cold}), so that from "
        f"{crossing_text} on Lagoudas' lines of heating and cooling cross and hysteresis is lost, which the second law "
        f"forbids, and the stress reaches {highest_text}: give slopes that are closer to each other, or stay below "
        "that stress."
    ]
