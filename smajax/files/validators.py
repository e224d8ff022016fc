"""Validators of single values in files, for the models of their sections."""

from collections.abc import Callable, Collection, Mapping
from typing import Annotated, Any

from pydantic import BaseModel, BeforeValidator, create_model

from smajax.errors import InputError, suggestion
from smajax.files.toml import STRICT, show
from smajax.parameters.checks import bounds_error
from smajax.parameters.definitions import Declaration
from smajax.units import parse_quantity


def quantity(value: Any, declaration: Declaration) -> float:
    """Return a quantity from a file in the unit of its declaration.

    Args:
        value: Value in the file.
        declaration: Declaration of the parameter.

    Raises:
        InputError: If its unit cannot be converted, or it is outside of the bounds of the declaration.
    """
    number = parse_quantity(value, declaration.unit)
    if not declaration.lower <= number <= declaration.upper:
        raise InputError(bounds_error(show(value), declaration))
    return number


def section_model(section: str, keys: Mapping[str, Declaration]) -> type[BaseModel]:
    """Return the pydantic model of a parameter section.

    Args:
        section: Name of the section.
        keys: Declarations by key. No key is required, since its value may come from a parameter set.
    """

    def field_type(declaration: Declaration) -> Any:
        return Annotated[Any, BeforeValidator(lambda value: quantity(value, declaration))]

    fields: dict[str, Any] = {key: (field_type(d), None) for key, d in keys.items()}
    return create_model(section, __config__=STRICT, **fields)


def one_of(choices: Collection[str] | Callable[[], Collection[str]]) -> BeforeValidator:
    """Return a validator that accepts one of some words; it suggests the most similar one for any other.

    Args:
        choices: The words, or a function that returns them, which is called anew at each check.
    """

    return BeforeValidator(OneOf(choices))


class OneOf:
    """Check that a value is one of some words."""

    def __init__(self, choices: Collection[str] | Callable[[], Collection[str]]):
        """Make the check.

        Args:
            choices: The words, or a function that returns them.
        """
        self._choices = choices

    @property
    def choices(self) -> Collection[str]:
        """The words."""
        return self._choices() if callable(self._choices) else self._choices

    def __call__(self, value: Any) -> str:
        """Return the word.

        Args:
            value: Value in the file.

        Raises:
            InputError: If it is none of the words.
        """
        choices = self.choices
        if isinstance(value, str) and value in choices:
            return value
        shown = [word if word.isidentifier() or "-" in word else repr(word) for word in choices]
        hint = suggestion(str(value), shown)
        raise InputError(f"{show(value)} is not known{hint}: it is one of {', '.join(shown)}")
