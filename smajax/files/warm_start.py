"""Start values of a fit from the parameter set of an earlier fit."""

from pathlib import Path

import numpy as np

from smajax import parameters
from smajax.errors import InputError
from smajax.files.parameter_sets import read_parameters
from smajax.files.rig_file import Rig
from smajax.plant.plant import Plant
from smajax.units import as_text


def warm_start_plant(rig: Rig, path: Path) -> Plant:
    """Return the plant of a rig with the values of a parameter set.

    Parameters that the rig does not have are ignored; values per recording are averaged.

    Args:
        rig: The rig to be fitted.
        path: Parameter set, such as the fit.toml of an earlier fit.

    Raises:
        InputError: If the rig has none of the parameters, or a value is outside of its bounds.
    """
    table = parameters.all_declarations(rig.plant)
    values: dict[str, list[float]] = {}
    for label, entry in read_parameters(path).items():
        name = label.partition("@")[0]
        if name in table and table[name].unit == entry.unit:
            values.setdefault(name, []).append(entry.value)
    if not values:
        cure = "name the fit.toml of a fit of the same kind"
        raise InputError(f"{path}: none of its parameters belongs to this rig: {cure}")
    start = {name: float(np.mean(samples)) for name, samples in values.items()}
    for name, value in start.items():
        low, high = rig.fit.bounds.get(name, (table[name].lower, table[name].upper))
        if not low <= value <= high:
            problem = f"{name} = {as_text(value, table[name].unit)} is outside of its bounds in {rig.name}"
            raise InputError(f"{path}: {problem}: widen these under [fit] bounds")
    return parameters.replace(rig.plant, start)
