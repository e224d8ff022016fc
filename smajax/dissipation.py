"""Whether a law was used where its transformation dissipates: a remark on a simulation or a fit that went beyond."""

from collections.abc import Iterable, Mapping

import numpy as np

from smajax.plant.material.lagoudas import Lagoudas
from smajax.plant.plant import Plant
from smajax.rig_schema import as_text


def crossed(plant: Plant, channels: Iterable[Mapping[str, np.ndarray]]) -> list[str]:
    """A sentence if a stress in the ``channels`` of any recording (SI) lies where lines of Lagoudas' law have crossed; else none."""
    law = plant.law
    if not isinstance(law, Lagoudas):
        return []
    met = [np.nanmax(v) for one in channels for name, v in one.items() if name.partition("_")[0] == "stress" and np.any(np.isfinite(v))]
    highest, crossing = max(met, default=0.0), law.crossing()
    if not highest > crossing:
        return []
    warm, cold = (as_text(float(f"{v:.4g}"), "Pa/K") for v in (law.clausius_clapeyron_austenite, law.clausius_clapeyron_martensite))
    at, reached = (f"{stress / 1e6:.4g} MPa" for stress in (crossing, highest))
    return [
        f"clausius_clapeyron_austenite ({warm}) is above clausius_clapeyron_martensite ({cold}), so that from {at} on Lagoudas' lines of "
        f"heating and cooling cross and hysteresis is lost, which the second law forbids, and the stress reaches {reached}: give slopes "
        "that are closer to each other, or stay below that stress."
    ]
