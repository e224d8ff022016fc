"""Note on a rig whose heat balance has no latent heat, with the value of a data sheet and how to add it."""

from smajax.files.fit_settings import FitSettings
from smajax.plant.effects.latent_heat import LatentHeat
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant

# Flexinol: 5.78 cal/g of 4184 J/kg each, at 6450 kg/m^3. Source: dynalloy.
FLEXINOL_LATENT_HEAT = 5.78 * 4184.0 * 6450.0
_STRENGTH = f"{FLEXINOL_LATENT_HEAT / 1e6:.0f} MJ/m^3"


def latent_heat_note(plant: Plant, fit: FitSettings) -> str:
    """Return a sentence on a heat balance without latent heat, without its full stop.

    Args:
        plant: The plant.
        fit: Settings of the fit.

    Returns:
        The sentence; empty if the plant has latent heat, if a fit may find it, or if there is no heat balance.
    """
    if isinstance(plant.heat, PrescribedTemperature):
        return ""
    name = f"effects.{LatentHeat.key}.strength"
    if name in fit.names or any(e.key == LatentHeat.key and float(e.strength) != 0.0 for e in plant.effects):
        return ""
    return (
        "the heat balance has no latent heat of the transformation, which the data sheet of an alloy gives: that of "
        f"Flexinol wire (Dynalloy F1140) gives 5.78 cal/g, {_STRENGTH} at its density of 6450 kg/m^3; to add it, write "
        f'[effects.{LatentHeat.key}] and below it strength = "{_STRENGTH}", or the value of your alloy'
    )
