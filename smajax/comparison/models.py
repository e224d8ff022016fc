"""The models that can be compared, by name."""

from collections.abc import Sequence

from smajax.errors import InputError, suggestion
from smajax.fitting.io_models.specs import MODEL_SPECS
from smajax.plant.materials.registry import MATERIALS

TRANSFER_FUNCTION = "transfer-function"
TRANSFER_FUNCTIONS = tuple(name for name in MODEL_SPECS if name.startswith(f"{TRANSFER_FUNCTION}-"))


def model_names() -> tuple[str, ...]:
    """Return the names of all models: the material laws, registered ones among them, and the input-output models."""
    return (*MATERIALS, *MODEL_SPECS)


def select_models(names: Sequence[str]) -> list[str]:
    """Check names of models, and replace "transfer-function" by its four structures.

    Args:
        names: The names, as in ``model_names()``, or "transfer-function".

    Returns:
        The names in their order, each once.

    Raises:
        InputError: If a name is unknown, or if there is none.
    """
    selected: list[str] = []
    for name in names:
        if name == TRANSFER_FUNCTION:
            selected += TRANSFER_FUNCTIONS
        elif name in MATERIALS or name in MODEL_SPECS:
            selected.append(name)
        else:
            choices = (*model_names(), TRANSFER_FUNCTION)
            raise InputError(
                f"models: '{name}' is not known{suggestion(name, choices)}: the models are {', '.join(choices)}"
            )
    if not selected:
        raise InputError(f"models names no model: give some of {', '.join(model_names())}, with commas between")
    return list(dict.fromkeys(selected))
