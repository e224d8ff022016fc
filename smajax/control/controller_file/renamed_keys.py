"""Old and current names of sections and keys of controller.toml; files with old names stay readable."""

from collections.abc import Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.renamed_keys import current_name, with_current_keys

# The old and the current name of each section.
RENAMED_SECTIONS: Mapping[str, str] = {
    "guard": "temperature_limiter",
    "observer": "estimator",
    "meters": "instruments",
}
# The old and the current name of each key, SECTION.KEY under the current name of the section.
RENAMED_KEYS: Mapping[str, str] = {
    "estimator.trust": "estimator.gain",
    "estimator.drift": "estimator.temperature_process_noise",
    "estimator.walk": "estimator.fraction_process_noise",
    "estimator.steers": "estimator.use_estimate",
}


def with_current_controller_keys(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a controller file under their current names, with the current names of their keys.

    Args:
        data: Sections of the file by name.

    Raises:
        InputError: if a section or a key is given under both names.
    """
    for old, new in RENAMED_SECTIONS.items():
        if old in data and new in data:
            raise InputError(
                f"[{old}] is the old name of [{new}], and both are given: move the keys of [{old}] to [{new}]"
            )
    return with_current_keys(
        {RENAMED_SECTIONS.get(name, name): section for name, section in data.items()}, RENAMED_KEYS
    )


def with_current_parameters(values: Mapping[str, Any], place: str) -> dict[str, Any]:
    """Return a table of parameters under their current names.

    Args:
        values: Anything by parameter name.
        place: Section and key of the table, for the error message.

    Raises:
        InputError: if a parameter is given under both names.
    """
    for name in values:
        if current_name(name) != name and current_name(name) in values:
            raise InputError(
                f"{place}: {name} is the old name of {current_name(name)}, and both are given: take {name} out"
            )
    return {current_name(name): value for name, value in values.items()}
