"""Parameters of the effects that a rig could have: values, scales, bounds, and grids of shapes."""

import dataclasses
import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from smajax import parameters
from smajax.diagnosis.candidates import EffectSet
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording

# Scale of a shape parameter as a share of its value, or of its range where the value is 0. Chosen by trial; it scales
# the steps of the searches and changes no optimum.
_SHARE_OF_VALUE = 0.3
_SHARE_OF_RANGE = 0.15


class EffectParameters:
    """The parameters of effects, in the order of ``names``.

    Attributes:
        names: Names of all parameters.
        values: The rig's own values, SI, shape ``(names,)``.

    Args:
        effects: The effects by key.
        plant: A plant that has them all.
        duration: Length of the longest training recording, s, the upper bound of onset times.
    """

    def __init__(self, effects: Mapping[str, AbstractEffect], plant: Plant, duration: float):
        self.effects: dict[str, AbstractEffect] = dict(effects)
        self.duration = duration
        self.names: tuple[str, ...] = tuple(
            f"effects.{key}.{name}" for key, kind in effects.items() for name in declarations(kind)
        )
        self.values: np.ndarray = np.array([float(parameters.get(plant, name)) for name in self.names])

    def value(self, name: str) -> float:
        """Return the rig's own value of a parameter, SI."""
        return float(self.values[self.names.index(name)])

    def scale(self, name: str) -> float:
        """Return the scale of a parameter, SI: the typical strength, or a share of a shape's value or range.

        It is 1 for a shape without bounds whose value is 0.
        """
        _, key, field = name.split(".")
        if field == "strength":
            return self.effects[key].typical
        declared = declarations(self.effects[key])[field]
        by_range = _SHARE_OF_RANGE * (declared.upper - declared.lower)
        return _SHARE_OF_VALUE * abs(self.values[self.names.index(name)]) or (
            by_range if math.isfinite(by_range) else 1.0
        )

    def bounds(self, names: Sequence[str]) -> tuple[list[float], list[float]]:
        """Return lower and upper bounds of parameters in units of their scales."""
        declared = [declarations(self.effects[name.split(".")[1]])[name.split(".")[2]] for name in names]
        highest = [
            min(d.upper, self.duration) if name.endswith(".instant") else d.upper
            for d, name in zip(declared, names, strict=True)
        ]
        lower = [d.lower / self.scale(name) for d, name in zip(declared, names, strict=True)]
        upper = [high / self.scale(name) for high, name in zip(highest, names, strict=True)]
        return lower, upper

    def plausible_range(self, key: str) -> tuple[float, float]:
        """Return the lowest and highest plausible strength of an effect in units of the typical strength."""
        low, high = self.effects[key].plausible_range()
        return low / self.effects[key].typical, high / self.effects[key].typical

    def free(self, effect_set: EffectSet) -> list[str]:
        """Return the names of the parameters that a fit frees: all strengths, then all shapes."""
        strengths = [f"effects.{key}.strength" for key in effect_set.keys]
        shapes = [f"effects.{key}.{shape}" for key in effect_set.keys for shape, _ in self.effects[key].shapes]
        return [*strengths, *shapes]

    def shape_grid(self, key: str) -> list[tuple[tuple[str, float], ...]]:
        """Return the shapes at which an effect is tried: each usual value of its first shape parameter, SI.

        Usual onset times are shares of the duration, usual places of a stop those of the recorded motion.
        """
        shapes = self.effects[key].shapes
        if not shapes:
            return [()]
        (name, values), *_ = shapes
        unit = {"instant": self.duration, "place": self.value(f"effects.{key}.place") if name == "place" else 1.0}
        return [((name, v * unit.get(name, 1.0)),) for v in values]


def effect_kinds(plant: Plant) -> dict[str, type[AbstractEffect]]:
    """Return the classes of all effects by key: those of the catalogue, and further ones that a plant has."""
    return dict(sorted({**{e.key: type(e) for e in plant.effects}, **catalogue()}.items()))


def possible_effects(
    plant: Plant,
    free: Collection[str],
    recordings: Sequence[Recording],
    capabilities: frozenset[str],
    only: Collection[str] | None = None,
) -> tuple[tuple[str, ...], dict[str, AbstractEffect]]:
    """Collect the effects that a rig has or could have.

    Args:
        plant: The plant of the rig file.
        free: Names of the rig's free parameters.
        recordings: The training recordings.
        capabilities: What the rig can have and show (``Plant.capabilities``).
        only: Keys to which those that the rig could have are limited; ``None`` for all.

    Returns:
        The keys of the effects that the rig file models (free, or of a nonzero strength), and all effects by key: the
        modelled ones, then every other effect of ``effect_kinds`` that the rig can have, at strength 0.
    """
    fitted = {name.split(".")[1] for name in free if name.startswith("effects.")}
    modelled: dict[str, AbstractEffect] = {
        e.key: e for e in plant.effects if e.key in fitted or float(e.strength) != 0.0
    }
    in_plant = {e.key: dataclasses.replace(e, strength=0.0) for e in plant.effects}
    candidates = {
        key: _zero_effect(kind, plant, recordings) if key in catalogue() else in_plant[key]
        for key, kind in effect_kinds(plant).items()
        if key not in modelled and (only is None or key in only) and not kind.unavailable_reason(capabilities)
    }
    return tuple(modelled), modelled | candidates


def _zero_effect(kind: type[AbstractEffect], plant: Plant, recordings: Sequence[Recording]) -> AbstractEffect:
    """An effect of strength 0; its reference current and its place, where it has them, are those of the recordings."""
    values, declared = {"strength": 0.0}, declarations(kind)
    if "reference" in declared:
        currents = [np.max(np.abs(v)) for r in recordings for c, v in r.channels.items() if c.startswith("current")]
        values["reference"] = float(max(currents, default=0.0)) or 1.0
    if "place" in declared and (motion := _largest_motion(plant, recordings)):
        values["place"] = motion
    limited = {name: min(max(v, declared[name].lower), declared[name].upper) for name, v in values.items()}
    return kind(**limited)  # pyright: ignore[reportCallIssue, reportArgumentType]


def _largest_motion(plant: Plant, recordings: Sequence[Recording]) -> float:
    """Largest motion of the wire since the first row, m; 0 if it is not recorded."""
    series = (r.channels.get(plant.mechanism.coordinate) for r in recordings)
    motions = [float(np.nanmax(values - values[0])) for values in series if values is not None]
    return float(max(motions, default=0.0) * plant.mechanism.wire_motion_per_coordinate)
