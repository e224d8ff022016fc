"""The sections of a controller file as far as they need no rig: their names, their keys and the types of their values.

A command makes these checks before JAX is loaded, too (``check_controller_sections``).
"""

from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel

from smajax.control.controller_file.renamed_keys import with_current_controller_keys
from smajax.control.controller_file.schema import (
    SECTIONS,
    ChangeSection,
    EstimatorSection,
    FeedforwardSection,
    InstrumentsSection,
    LimitsSection,
    ReferenceSection,
    RobustSection,
    SensorSection,
    TemperatureLimiterSection,
    TuneSection,
    controller_section,
)
from smajax.errors import InputError
from smajax.files.toml import advice, check_schema, parse_toml, validate

_EXAMPLES = {"controller": 'kind = "pid"', "gains": 'kp = "..."', "reference": 'kind = "step"'}
_KEYS_OF_KIND = {
    "step": ("duration", "low", "high", "at"),
    "staircase": ("duration", "levels", "hold"),
    "sine": ("duration", "low", "high", "frequency"),
    "recorded": ("file",),
}
# Models of sections that need no more than their own keys, in the order in which a file is read.
_BEFORE_REFERENCE: Mapping[str, type[BaseModel]] = {
    "temperature_limiter": TemperatureLimiterSection,
    "estimator": EstimatorSection,
    "sensor": SensorSection,
    "instruments": InstrumentsSection,
}
_AFTER_REFERENCE: Mapping[str, type[BaseModel]] = {
    "limits": LimitsSection,
    "feedforward": FeedforwardSection,
    "robust": RobustSection,
}


def current_sections(data: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the sections under their current names.

    Args:
        data: Sections of the file by name.

    Raises:
        InputError: If a section is not known, or one is missing.
    """
    data = with_current_controller_keys(data)
    for key in data:
        if key not in SECTIONS:
            sections = advice(key, SECTIONS[1:], "the sections are")
            raise InputError(f"[{key}] is not a section of a controller{sections}")
    check_schema(data)
    for section, example in _EXAMPLES.items():
        if section not in data:
            raise InputError(f"the section [{section}] is missing: add it, with lines like {example}")
    return data


def reference_section(data: Any) -> ReferenceSection:
    """Read [reference], with only keys of its kind.

    Args:
        data: The section.

    Raises:
        InputError: for a wrong, missing or unsuitable key or value.
    """
    if isinstance(data, dict) and (kind := str(data.get("kind"))) in _KEYS_OF_KIND:
        unknown = [key for key in data if key not in ReferenceSection.model_fields]
        if unknown:  # the message lists the keys of this kind only
            keys = advice(unknown[0], _KEYS_OF_KIND[kind], f"the keys of a {kind} are")
            raise InputError(f"reference.{unknown[0]} is not known{keys}")
    section = validate(ReferenceSection, data, "reference")
    for key in ("duration", "low", "high", "at", "levels", "hold", "frequency", "file"):
        if getattr(section, key) not in (None, []) and key not in _KEYS_OF_KIND[section.kind]:
            raise InputError(
                f"reference.{key} does not belong to a {section.kind}, "
                f"whose keys are {', '.join(_KEYS_OF_KIND[section.kind])}: take it out"
            )
    return section


def check_controller_sections(text: str, name: str) -> None:
    """Check the text of a controller file as far as it needs no rig.

    Args:
        text: The text.
        name: Name of the file in messages.

    Raises:
        InputError: As ``smajax.control.controller_file.read.read_controller``.
    """
    data = parse_toml(text, name)
    try:
        data = current_sections(data)
        controller_section(data["controller"])
        validate(TuneSection, data.get("tune", {}), "tune")
        _validate_all(data, _BEFORE_REFERENCE)
        reference_section(data["reference"])
        changes = data.get("change", [])
        for change in changes if isinstance(changes, list) else [changes]:
            validate(ChangeSection, change, "change")
        _validate_all(data, _AFTER_REFERENCE)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _validate_all(data: Mapping[str, Any], models: Mapping[str, type[BaseModel]]) -> None:
    for section, model in models.items():
        if section in data:
            validate(model, data[section], section)
