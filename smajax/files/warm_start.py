"""Start values of a fit from the parameter file of an earlier fit."""

from pathlib import Path

import numpy as np

from smajax import parameters
from smajax.errors import InputError
from smajax.files.parameter_sets import read_parameters
from smajax.files.rig_file import Rig
from smajax.plant.plant import Plant
from smajax.units import as_text


def warm_start_plant(rig: Rig, path: Path) -> Plant:
    """Return the rig's plant with the values of a parameter file.

    Parameters that the rig does not have are ignored; of values per recording the mean is taken.

    Args:
        rig: The rig to be fitted.
        path: Parameter file, such as the fit.toml of an earlier fit.

    Raises:
        InputError: if none of the parameters belongs to the rig, or a value is outside of its bounds.
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
            outside = f"{name} = {as_text(value, table[name].unit)} is outside of its bounds in {rig.name}"
            raise InputError(f"{path}: {outside}: widen these under [fit] bounds")
    return parameters.replace(rig.plant, start)
