"""Modules with declared parameters, and the values of the parameters of a plant or an actuator by name."""

import dataclasses
import inspect
import math
import os
from collections.abc import Mapping
from types import UnionType
from typing import Any, ClassVar, Union, get_args, get_origin, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError, missing_members, suggestion
from smajax.parameters.checks import check_declaration, check_order, check_value
from smajax.parameters.definitions import TIES, Declaration, declarations, expand, tie_declarations
from smajax.units import as_text

# All of smajax needs double precision. JAX is switched to it here, on import, unless the environment says otherwise.
if "JAX_ENABLE_X64" not in os.environ:
    jax.config.update("jax_enable_x64", True)

_EFFECTS = "effects."


def require_x64() -> None:
    """Check that JAX computes in double precision.

    Raises:
        InputError: If it was switched off.
    """
    if not jax.config.jax_enable_x64:  # pyright: ignore[reportAttributeAccessIssue]
        raise InputError(
            "JAX computes in single precision and smajax needs double precision: call "
            'jax.config.update("jax_enable_x64", True) before making arrays, and leave JAX_ENABLE_X64 unset or 1'
        )


class CheckedModule(eqx.Module):
    """Base class of everything with declared parameters: it checks their values at construction, and its own class.

    Values that JAX traces, and the placeholders with which it rebuilds modules, are not checked; neither are leaves
    that ``equinox.tree_at`` replaces. The docstring of a derived class ends with a list of its parameters, by their
    declarations.

    Attributes:
        required_attributes: Names of the class attributes that a derived class has to define.
    """

    # ``equinox.AbstractClassVar`` would raise before ``__new__``, without the methods that are missing, too.
    required_attributes: ClassVar[tuple[str, ...]] = ()

    def __init_subclass__(cls, **options: Any) -> None:
        """Add the declared parameters to the docstring of a derived class."""
        super().__init_subclass__(**options)
        fields = {name: field for base in cls.__mro__[:0:-1] for name, field in _dataclass_fields(base).items()}
        fields |= {name: vars(cls)[name] for name in inspect.get_annotations(cls) if name in vars(cls)}
        declared = {name: getattr(field, "metadata", {}).get("declaration") for name, field in fields.items()}
        lines = [f"    {_describe(name, declaration)}" for name, declaration in declared.items() if declaration]
        if lines:
            text = inspect.cleandoc(vars(cls).get("__doc__") or f"{cls.__name__}.")
            cls.__doc__ = "\n".join([text, "", "Parameters:", *lines])

    def __new__(cls, *args: Any, **kwargs: Any) -> Any:
        """Make an instance.

        Raises:
            TypeError: If the class lacks methods, fields or class attributes that its base class demands; the message
                says what each of the methods does.
            InputError: If an argument has an unknown name.
        """
        if missing := missing_members(cls):
            raise TypeError(f"{cls.__name__} cannot be constructed: {missing}")
        _, *accepted = inspect.signature(cls.__init__).parameters.values()
        names = [argument.name for argument in accepted]
        unknown = [name for name in kwargs if name not in names]
        if unknown and inspect.Parameter.VAR_KEYWORD not in [argument.kind for argument in accepted]:
            hint = suggestion(unknown[0], names)
            raise InputError(f"{cls.__name__} has no argument '{unknown[0]}'{hint}: it has {', '.join(names)}")
        return super().__new__(cls)

    def __check_init__(self) -> None:
        """Check the values of the declared parameters.

        Raises:
            InputError: If one is missing or outside of its bounds, a transformation does not end above its start, or
                a part is of another type.
        """
        table, name = declarations(self), type(self).__name__
        for key, declared in table.items():
            value = getattr(self, key)
            if value is None and not (declared.default is not None and math.isnan(declared.default)):
                raise InputError(f"{name}.{key} is None: give a number in {declared.unit}")
            check_value(f"{name}.{key}", value, declared)
        _check_parts(self)
        # A module does not know the name of its section.
        key_of = lambda pair_member: pair_member.rpartition(".")[2]  # noqa: E731
        check_order(
            lambda n: getattr(self, key_of(n)) if key_of(n) in table else None,
            lambda n, value: f"{name}.{key_of(n)} = {as_text(value, table[key_of(n)].unit)}",
        )


def _check_parts(module: CheckedModule) -> None:
    """Check that the parts of a module, which are modules themselves, are of the types that its fields name."""
    for field in dataclasses.fields(module):
        annotation = field_annotation(type(module), field)
        if get_origin(annotation) not in (None, Union, UnionType):  # such as a function that returns a module
            continue
        types, value = module_types(type(module), field), getattr(module, field.name)
        if types and not isinstance(value, tuple(types)) and not (value is None and field.default is None):
            kind = f"the class {value.__name__}" if isinstance(value, type) else f"a {type(value).__name__}"
            raise InputError(
                f"{type(module).__name__}: {field.name} cannot be {kind}: give a "
                f"{' or '.join(t.__name__ for t in types)}"
            )


def _dataclass_fields(cls: type[Any]) -> dict[str, dataclasses.Field]:
    return vars(cls).get("__dataclass_fields__", {})


def _describe(name: str, declaration: Declaration) -> str:
    """A parameter in one line: name, unit, meaning, bounds and default."""
    lower, upper, default = f"{declaration.lower:g}", f"{declaration.upper:g}", declaration.default
    start = "required" if default is None else ("derived" if math.isnan(default) else f"{default:g}") + " by default"
    return f"{name} [{declaration.unit}]: {declaration.meaning}; {lower} to {upper}, {start}."


def field_annotation(cls: type[Any], field: dataclasses.Field[Any]) -> Any:
    """Return the type of a field, also where it is written as text.

    Args:
        cls: The class that has the field.
        field: The field.
    """
    return get_type_hints(cls)[field.name] if isinstance(field.type, str) else field.type


def module_types(cls: type[Any], field: dataclasses.Field[Any]) -> list[type[eqx.Module]]:
    """Return the classes of modules in the type of a field: ``[Sheath]`` for ``sheath: Sheath | None``.

    Args:
        cls: The class that has the field.
        field: The field.
    """
    annotation = field_annotation(cls, field)
    return [t for t in (annotation, *get_args(annotation)) if isinstance(t, type) and issubclass(t, eqx.Module)]


def as_float(value: Any) -> Any:
    """Convert a number, or an array of integers or of float64, to a float64 array of JAX.

    Args:
        value: A number or an array of NumPy or JAX; anything else, such as ``None``, is returned unchanged.

    Raises:
        InputError: If JAX computes in single precision, or the value is an array of another type: its digits are lost
            already, or it is not an array of real numbers.
    """
    if isinstance(value, bool | str) or not isinstance(value, int | float | np.generic | np.ndarray | jax.Array):
        return value
    require_x64()
    kind = getattr(value, "dtype", np.float64)
    if kind != np.float64 and not jnp.issubdtype(kind, np.integer):
        raise InputError(
            f"a parameter is an array of {kind} and smajax needs double precision: make it with dtype=jnp.float64"
        )
    if isinstance(value, jax.Array):
        return value if kind == np.float64 else value.astype(jnp.float64)
    return jax.device_put(np.asarray(value, np.float64))  # nothing is compiled


def parameter(
    unit: str,
    meaning: str,
    lower: float = -math.inf,
    upper: float = math.inf,
    default: float | None = None,
    *,
    whole: bool = False,
) -> Any:
    """Declare a parameter as a field of a module.

    Args:
        unit: Internal unit.
        meaning: Meaning in a few words, for messages and reports.
        lower: Lower bound of the values for which the equations hold.
        upper: Upper bound of the values for which the equations hold.
        default: Default value; ``None`` for a required parameter, NaN for one that the plant derives from others.
        whole: Whether the parameter is a count.

    Returns:
        The dataclass field, with a ``Declaration`` in its metadata.

    Raises:
        InputError: If unit or meaning is not a string, the bounds are not in order, or the default is not between them.
    """
    check_declaration(unit, meaning, lower, upper, default)
    declaration = Declaration(unit, meaning, lower, upper, default, whole)
    metadata = {"declaration": declaration}
    if default is None:
        return eqx.field(converter=as_float, metadata=metadata)
    if math.isnan(default):
        return eqx.field(converter=as_float, default=None, metadata=metadata)
    return eqx.field(converter=as_float, default=default, metadata=metadata)


def sections(plant: Any) -> dict[str, Any]:
    """Return the sections of a plant or an actuator by name.

    Args:
        plant: A plant or an actuator.

    Returns:
        The parts that have parameters: those of the plant, of its mechanism, and its effects; of an actuator its own.
    """
    parts = {}
    for owner in (plant, plant.mechanism) if hasattr(plant, "mechanism") else (plant,):
        for field in dataclasses.fields(owner):
            part = getattr(owner, field.name)
            if isinstance(part, eqx.Module) and declarations(part):
                parts.setdefault(field.name, part)
    return parts | {f"{_EFFECTS}{e.key}": e for e in getattr(plant, "effects", ())}


def all_declarations(plant: Any) -> dict[str, Declaration]:
    """Return the declarations of all parameters by name, ties included.

    Args:
        plant: A plant or an actuator.
    """
    table = {
        f"{section}.{key}": d for section, part in sections(plant).items() for key, d in declarations(part).items()
    }
    if hasattr(plant, "sensor"):
        table.update({f"sensor.{name}": d for name, d in plant.sensor.declarations().items()})
    return table | tie_declarations(table)


def declaration(plant: Any, name: str) -> Declaration:
    """Return the declaration of one parameter.

    Args:
        plant: A plant or an actuator.
        name: Name of the parameter, or of a tie.

    Raises:
        InputError: If there is no such parameter; it suggests the most similar name.
    """
    return _find(all_declarations(plant), name)


def _find(table: Mapping[str, Declaration], name: str) -> Declaration:
    if name not in table:
        raise InputError(f"there is no parameter '{name}' in this plant{suggestion(name, table)}")
    return table[name]


def _leaf(plant: Any, name: str) -> Any:
    section, key = name.rsplit(".", 1)
    if section.startswith(_EFFECTS):
        return getattr(next(e for e in plant.effects if e.key == section[len(_EFFECTS) :]), key)
    if section == "sensor":
        return plant.sensor.leaf(key)
    if any(f.name == section for f in dataclasses.fields(plant)):
        return getattr(getattr(plant, section), key)
    return getattr(getattr(plant.mechanism, section), key)


def get(plant: Any, name: str) -> jax.Array:
    """Return the value of a parameter in its internal unit.

    Args:
        plant: A plant or an actuator.
        name: Name of the parameter; for a tie the value of its first member is returned.

    Returns:
        A scalar array; NaN for a value that the plant derives from others.

    Raises:
        InputError: If there is no such parameter.
    """
    declaration(plant, name)
    value = _leaf(plant, TIES.get(name, (name,))[0])
    return jnp.asarray(jnp.nan) if value is None else value


def replace(plant: Any, values: Mapping[str, Any], *, ordered: bool = True) -> Any:
    """Return the plant with the named parameters set; works under ``jax.jit``.

    Args:
        plant: A plant or an actuator.
        values: Values by name, scalars in internal units. They are applied in order, so a tie followed by one of its
            members gives this member its own value.
        ordered: Whether a transformation has to end above its start, and so on (``ORDERED_PAIRS``); not so for a plant
            to which further values are given afterwards, as in a fit.

    Returns:
        The plant or actuator with the new values.

    Raises:
        InputError: If there is no such parameter, a value that JAX does not trace is outside of its bounds or not above
            its lower neighbour, or a value is ``None``, or an array of another type than float64 or an integer one.
    """
    if not isinstance(values, Mapping):
        raise InputError(
            f"parameters are set by a dictionary such as {{'heat.h0': 100.0}}, not by an object of type "
            f"{type(values).__name__}"
        )
    table = all_declarations(plant) if values else {}
    for name, number in values.items():
        declared, value = _find(table, name), as_float(number)
        if value is None:
            raise InputError(f"{name} is None: give a number in {declared.unit}")
        check_value(name, value, declared)
        for member in TIES.get(name, (name,)):
            plant = eqx.tree_at(
                lambda p, m=member: _leaf(p, m), plant, jnp.asarray(value, jnp.float64), is_leaf=lambda x: x is None
            )
    if ordered:
        check_order(
            lambda n: _leaf(plant, n) if n in table else None,
            lambda n, value: f"{n} = {as_text(value, table[n].unit)}",
            expand(values),
        )
    return plant
