"""Plausible ranges: what an alloy can have of each parameter, with sources (``data/plausible-ranges.toml``).

They judge estimates, and never bound a fit or an interval.
"""

import functools
import tomllib
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from smajax import parameters
from smajax.errors import InputError
from smajax.files.toml import flatten_keys
from smajax.plant.plant import Plant
from smajax.recordings.datasets import data_path
from smajax.units import as_text, parse_quantity

# Distance of the middles of both transformations at zero stress: no parameter, but what metallurgists know of an alloy.
HYSTERESIS = "material.hysteresis"
_ENDS = ("start", "finish")
_UNITS = {HYSTERESIS: "K"}


class PlausibleRange(NamedTuple):
    """What an alloy can have of a parameter.

    Attributes:
        lower: Smallest value, in the internal unit.
        upper: Largest value.
        source: Source, with keys of docs/references.bib.
    """

    lower: float
    upper: float
    source: str

    def excess(self, value: float) -> float:
        """Return how far a value lies outside, as a share of the width of the range; 0 inside."""
        return max(self.lower - value, value - self.upper, 0.0) / (self.upper - self.lower)


class ImplausibleValue(NamedTuple):
    """An estimate outside of what an alloy can have.

    Attributes:
        name: Name of the parameter.
        value: The estimate, in the internal unit.
        unit: The internal unit.
        plausible: The plausible range.
    """

    name: str
    value: float
    unit: str
    plausible: PlausibleRange

    @property
    def sentence(self) -> str:
        """The estimate and what an alloy can have, in one sentence."""
        low, high = as_text(self.plausible.lower, self.unit), as_text(self.plausible.upper, self.unit)
        return (
            f"implausible: {self.name} = {as_text(float(f'{self.value:.4g}'), self.unit)} lies outside of {low} to "
            f"{high}, the plausible range: the model may lack an effect, or the recordings may not determine it."
        )


@functools.cache
def _texts() -> Mapping[str, Mapping[str, str]]:
    data = tomllib.loads(data_path("plausible-ranges.toml").read_text("utf-8"))
    flat = flatten_keys({key: value for key, value in data.items() if key != "schema"})
    names = dict.fromkeys(key.rpartition(".")[0] for key in flat)
    return {name: {key: flat[f"{name}.{key}"] for key in PlausibleRange._fields} for name in names}


def plausible_range(name: str, unit: str) -> PlausibleRange | None:
    """Return the plausible range of a parameter.

    Args:
        name: Name of the parameter; that of one recording is NAME@RECORDING.
        unit: Its internal unit.

    Returns:
        The range; ``None`` if there is none.
    """
    texts = _texts().get(name.partition("@")[0])
    if texts is None:
        return None
    return PlausibleRange(parse_quantity(texts["lower"], unit), parse_quantity(texts["upper"], unit), texts["source"])


def implausible_values(plant: Plant, names: Iterable[str]) -> list[ImplausibleValue]:
    """List the fitted parameters of a plant that lie outside of what an alloy can have.

    Args:
        plant: The plant with its estimates.
        names: Names of the fitted parameters; those that the plant does not have are left out.

    Returns:
        The values outside, and the hysteresis if an end of a transformation was fitted.
    """
    found, moved = [], False
    for name in names:
        moved |= name.partition(".")[2].endswith((*(f"_{end}" for end in _ENDS), "_shift"))
        try:
            value, unit = float(parameters.get(plant, name)), parameters.declaration(plant, name).unit
        except InputError:
            continue
        allowed = plausible_range(name, unit)
        if allowed is not None and allowed.excess(value) > 0.0:
            found.append(ImplausibleValue(name, value, unit, allowed))
    allowed = plausible_range(HYSTERESIS, _UNITS[HYSTERESIS])
    if moved and allowed is not None and allowed.excess(hysteresis(plant)) > 0.0:
        found.append(ImplausibleValue(HYSTERESIS, hysteresis(plant), _UNITS[HYSTERESIS], allowed))
    return found


def hysteresis(plant: Plant) -> float:
    """Return the distance in K of the middle of the reverse from that of the forward transformation, at zero stress."""
    law = plant.material
    middle = {
        phase: sum(0.5 * float(getattr(law, f"{phase}_{end}")) for end in _ENDS) + float(getattr(law, f"{phase}_shift"))
        for phase in ("austenite", "martensite")
    }
    return middle["austenite"] - middle["martensite"]
