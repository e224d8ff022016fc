"""Note on a rig whose heat balance has no latent heat, with the value of a data sheet and how to add it.

The note on a template needs no plant, so that ``smajax init`` does not load JAX.
"""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from smajax.files.fit_settings import FitSettings
    from smajax.plant.plant import Plant

# Flexinol: 5.78 cal/g of 4184 J/kg each, at 6450 kg/m^3. Source: dynalloy.
FLEXINOL_LATENT_HEAT = 5.78 * 4184.0 * 6450.0
_STRENGTH = f"{FLEXINOL_LATENT_HEAT / 1e6:.0f} MJ/m^3"
_KEY = "latent-heat"
_NOTE = (
    "the heat balance has no latent heat of the transformation, which the data sheet of an alloy gives: that of "
    f"Flexinol wire (Dynalloy F1140) gives 5.78 cal/g, {_STRENGTH} at its density of 6450 kg/m^3; to add it, write "
    f'[effects.{_KEY}] and below it strength = "{_STRENGTH}", or the value of your alloy'
)


def template_note(data: Mapping[str, Any]) -> str:
    """Return the note of ``latent_heat_note`` on a template.

    Args:
        data: Data of the template, in which latent heat is not free; whether it has a strength is not looked at.
    """
    rig = data["rig"]
    has_heat_balance = rig["kind"] != "path" and rig.get("control") != "temperature"
    return _NOTE if has_heat_balance and _KEY not in data.get("effects", {}) else ""


def latent_heat_note(plant: "Plant", fit: "FitSettings") -> str:
    """Return a sentence on a heat balance without latent heat, without its full stop.

    Args:
        plant: The plant.
        fit: Settings of the fit.

    Returns:
        The sentence; empty if the plant has latent heat, if a fit may find it, or if there is no heat balance.
    """
    from smajax.plant.heat import PrescribedTemperature  # loads JAX

    if isinstance(plant.heat, PrescribedTemperature):
        return ""
    if f"effects.{_KEY}.strength" in fit.names:
        return ""
    return "" if any(e.key == _KEY and float(e.strength) != 0.0 for e in plant.effects) else _NOTE
