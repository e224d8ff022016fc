"""Priors of the parameters of a soft arm, from data sheets of such wires and from what alloys can have."""

from __future__ import annotations

import dataclasses

from smajax.files.plausible_ranges import plausible_range


@dataclasses.dataclass(frozen=True)
class Prior:
    """Gaussian prior of a parameter, in internal units.

    Attributes:
        mean: Its mean.
        deviation: Its standard deviation.
        is_own: Whether each log has its own value. The values of other parameters scatter about one that the wires
            share, by ``SPREAD`` of the standard deviation.
        first_deviation: Standard deviation in the first stage of a search, without ``limits``; 0.0 for the same.
        limits: Ends that are narrower than the bounds of the parameter; ``None`` for no others.
    """

    mean: float
    deviation: float
    is_own: bool = False
    first_deviation: float = 0.0
    limits: tuple[float, float] | None = None

    def stage_deviation(self, is_first: bool) -> float:
        """Return the standard deviation in the first or the last stage of a search."""
        return self.first_deviation if is_first and self.first_deviation > 0.0 else self.deviation


def limits_of_alloys(name: str, unit: str) -> tuple[float, float]:
    """Return what an alloy can have of a parameter, by ``plausible_range``."""
    found = plausible_range(name, unit)
    assert found is not None
    return found.lower, found.upper


# A pulse hardly tells latent heat from the heat that goes into the silicone: without these ends the fitted one is below
# them.
LATENT_HEATS = limits_of_alloys("effects.latent-heat.strength", "J/m^3")
SPREAD = 0.2  # of the prior's standard deviation: the wires are of one make and in one arm
# From data sheets of such wires; drive and convection are known to within a factor only. Temperatures in degC.
PRIORS = {
    "drive.supply": Prior(2.5, 0.5),
    "heat.h0": Prior(60.0, 30.0),
    "environment.ambient": Prior(22.0, 0.3, is_own=True),  # about the first reading; all is at rest then
    "initial.temperature": Prior(22.0, 0.3, is_own=True),  # the same
    "material.austenite_shift": Prior(0.0, 10.0),
    "material.austenite_finish": Prior(100.0, 15.0),
    "material.martensite_start": Prior(60.0, 15.0),
    "material.detwinning_finish_stress": Prior(1e8, 4e7),
    "material.max_transformation_strain": Prior(0.015, 0.005, is_own=True),  # with the lever of each wire
    "sensor.displacement_offset": Prior(0.0, 1e-4, is_own=True),
    "effects.grains.width": Prior(8.0, 6.0),
    # Middle of LATENT_HEATS, and a quarter of their width; at first nearly any.
    "effects.grains.latent_heat": Prior(1.2e8, 5e7, first_deviation=1.8e8, limits=LATENT_HEATS),
    "effects.grains.creep": Prior(0.003, 0.004),
    "effects.grains.creep_time": Prior(10.0, 10.0),
    "effects.coating.strength": Prior(2.0, 1.5),
    "effects.coating.time_constant": Prior(4.0, 3.0),
    "effects.body-heat.strength": Prior(0.3, 0.3),
    "effects.body-heat.time_constant": Prior(100.0, 100.0),
    "effects.thermocouple-contact.strength": Prior(1.5, 1.5, is_own=True),
    "effects.thermocouple-contact.silicone_share": Prior(0.2, 0.3),
    "effects.thermocouple-contact.silicone_time": Prior(4.0, 3.0),
    "effects.rest-offset.strength": Prior(0.0, 1.5e-4, is_own=True),
}
CONSTANT = {"effects.grains.strength": 1.0}  # parameters that are not fitted where their effect is in the model
