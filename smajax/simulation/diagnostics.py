"""A plant's parameters as text, for error messages."""

from smajax import parameters
from smajax.plant.plant import Plant


def describe_parameters(plant: Plant) -> str:
    """List all parameters of a plant in one line, in internal units.

    Parameters of sensors and start values are left out; a tie replaces its members.

    Args:
        plant: The plant.
    """
    values = {
        name: float(parameters.get(plant, name))
        for name in parameters.all_declarations(plant)
        if not name.startswith(("sensor.", "initial."))
    }
    tied = {member for tie, members in parameters.TIES.items() if tie in values for member in members}
    return ", ".join(
        f"{name} = {value:.6g} {parameters.declaration(plant, name).unit}"
        for name, value in values.items()
        if name not in tied
    )
