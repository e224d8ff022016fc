"""Check of what the methods of an own material or mechanism take and return, in words, before a compiler meets it.

The methods are traced and not computed. Those of smajax's own classes are left to its tests.
"""

import inspect
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.materials.one_fraction import AbstractBandKinetics, AbstractOneFraction
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext
from smajax.plant.mechanisms.single_wire import AbstractDisplacement, AbstractElasticLoad

_NUMBERS = int | float | np.generic | np.ndarray | jax.Array


def check_material(material: AbstractMaterial, shape: tuple[int, ...]) -> None:
    """Check what the methods of an own material take, and the shapes and types of what they return.

    Args:
        material: The material.
        shape: Shape of the temperatures of the plant: ``(wires,)``, with cells ``(cells, wires)``.

    Raises:
        InputError: If a method takes other arguments than it is given, returns no array, or one of another shape or
            type. What a method itself raises comes through with a note.
    """
    if is_checked(material):
        _check_arguments(material)
        _trace(lambda: _call_material(material, shape))
        _trace(lambda: _call_material(material, ()))  # for the modulus and the resistivity of austenite


def check_mechanism(mechanism: AbstractMechanism, material: AbstractMaterial, context: MechanismContext) -> None:
    """Check what the methods of an own mechanism take, and the shapes and types of what they return.

    Args:
        mechanism: The mechanism, one for which ``is_checked`` is true.
        material: A material, for the fractions as installed.
        context: Wire, environment and scale.

    Raises:
        InputError: If a method takes other arguments than it is given, returns no array, one of another shape or type,
            or other channels than it should. What a method itself raises comes through with a note.
    """
    _check_arguments(mechanism)
    _trace(lambda: _call_mechanism(mechanism, material, context))


def is_checked(module: eqx.Module) -> bool:
    """Whether a class is not of smajax, and its parameters are of double precision, without which nothing runs.

    Args:
        module: A material or a mechanism.
    """
    if _is_shipped(type(module)) or not jax.config.read("jax_enable_x64"):
        return False
    return all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(module) if eqx.is_inexact_array(leaf))


def _is_shipped(cls: type[Any]) -> bool:
    return cls.__module__.partition(".")[0] == "smajax"


def _check_arguments(module: eqx.Module) -> None:
    """Check that the methods that an own class redefines take the arguments of those of smajax."""
    cls = type(module)
    own = {name for base in cls.__mro__ if not _is_shipped(base) for name in vars(base)}
    for base in filter(_is_shipped, cls.__mro__):
        for name in sorted(own & {name for name in vars(base) if not name.startswith("_")}):
            if inspect.isfunction(expected := getattr(base, name)):
                own.discard(name)  # the bases of this one may have other arguments
                _check_parameter_list(cls, name, base, list(inspect.signature(expected).parameters))


def _check_parameter_list(cls: type[Any], method: str, base: type[Any], expected: list[str]) -> None:
    """Check that a method, which is called without keywords, can take the arguments of its base class."""
    function, cure = getattr(cls, method), f"write def {method}({', '.join(expected)}), as in {base.__name__}"
    if not callable(function):
        raise InputError(f"{cls.__name__}: {method} is a {type(function).__name__} and no method: {cure}")
    signature = inspect.signature(function)
    is_static = isinstance(inspect.getattr_static(cls, method), staticmethod | classmethod)
    try:
        signature.bind(*expected[is_static:])
    except TypeError:
        taken = f"{method}({', '.join(map(str, signature.parameters.values()))})"
        raise InputError(f"{cls.__name__}: {taken} takes other arguments than it is given: {cure}") from None


def _returned(module: Any, method: str, *arguments: Any) -> Any:
    """Return what a method returns; what it raises gets a note."""
    try:
        return getattr(module, method)(*arguments)
    except InputError:
        raise
    except Exception as error:
        error.add_note(f"raised by {method} of {type(module).__name__}, which is traced once where a plant is made")
        raise


def _trace(calls: Callable[[], None]) -> None:
    """Trace calls without computing anything; a traced function has to return an array."""

    def function() -> jax.Array:
        calls()
        return jnp.zeros(())

    jax.eval_shape(function)


def _call_material(material: AbstractMaterial, shape: tuple[int, ...]) -> None:
    array = jnp.zeros(shape)
    fractions, ends = Fractions(array, array), (array, array)
    if isinstance(material, AbstractBandKinetics):
        _check_number(material, "remaining_share", _returned(material, "remaining_share", array), shape)
    if isinstance(material, AbstractOneFraction):
        _check_number(material, "remainder", _returned(material, "remainder", array, array), shape)
    _check_fractions(material, "evolve", _returned(material, "evolve", fractions, ends, ends), shape)
    for method in ("modulus", "resistivity", "transformation_strain"):
        _check_number(material, method, _returned(material, method, fractions), shape)
    current = _returned(material, "current_transformation_strain", array)
    _check_number(material, "current_transformation_strain", current, shape)
    _check_array(material, "strain", _returned(material, "strain", fractions, array, array, array), shape)
    _check_fractions(material, "installed_fractions", _returned(material, "installed_fractions", array), shape)


def _call_mechanism(mechanism: AbstractMechanism, material: AbstractMaterial, context: MechanismContext) -> None:
    wires, number = (mechanism.wires,), jnp.zeros(())
    unknowns, strain = (mechanism.unknowns,), jnp.zeros(wires)
    prescribed: dict[str, Any] = dict.fromkeys(mechanism.prescribed, number)
    if isinstance(mechanism, AbstractElasticLoad):
        _check_array(mechanism, "force", _returned(mechanism, "force", strain), wires)
    unknown = _returned(mechanism, "initial_unknowns", prescribed, context)
    _check_array(mechanism, "initial_unknowns", unknown, unknowns)
    stress = _returned(mechanism, "stress", unknown, prescribed, context)
    _check_array(mechanism, "stress", stress, wires)
    installed = _returned(mechanism, "fractions", material, strain, prescribed, context)
    _check_fractions(mechanism, "fractions", installed, wires)
    motion = _returned(mechanism, "initial_motion", strain)
    if isinstance(mechanism, AbstractDisplacement):
        _check_array(mechanism, "initial_motion", motion, ())
    _check_motion(mechanism, "initial_motion", motion, motion)
    balance = _returned(mechanism, "balance", unknown, strain, motion, prescribed, context, number)
    _check_array(mechanism, "balance", balance, unknowns)
    after = _returned(mechanism, "update_motion", unknown, strain, motion, context, number)
    _check_motion(mechanism, "update_motion", after, motion)
    _check_number(mechanism, "contraction", _returned(mechanism, "contraction", strain), ())
    _check_number(mechanism, "longest_step", _returned(mechanism, "longest_step", context), ())
    _check_array(mechanism, "with_drag", _returned(mechanism, "with_drag", stress, number), wires)
    if not mechanism.obstacle_to_rates:
        complete = _returned(mechanism, "complete_motion", unknown, strain, motion, context)
        _check_motion(mechanism, "complete_motion", complete, motion)
        _check_motion(mechanism, "motion_rates", _returned(mechanism, "motion_rates", complete), motion)
        balance = _returned(mechanism, "balance_at_motion", unknown, strain, complete, prescribed, context)
        _check_array(mechanism, "balance_at_motion", balance, unknowns)
    _check_channels(mechanism, _returned(mechanism, "channels", strain, stress, motion, context))


def _check_array(module: eqx.Module, method: str, result: Any, shape: tuple[int, ...]) -> None:
    """Check that a method returned an array of a shape."""
    if not isinstance(result, _NUMBERS) or jnp.shape(result) != shape:
        raise _error(module, method, _described(result), f"an array of shape {shape}")
    if not isinstance(result, int | float) and result.dtype != np.float64:
        raise _error(module, method, f"an array of {result.dtype}", "one of float64")


def _check_number(module: eqx.Module, method: str, result: Any, shape: tuple[int, ...]) -> None:
    """Check that a method returned an array of a shape, or one number."""
    single = isinstance(result, _NUMBERS) and jnp.shape(result) == ()
    _check_array(module, method, result, () if single else shape)


def _check_fractions(module: eqx.Module, method: str, result: Any, shape: tuple[int, ...]) -> None:
    if not isinstance(result, Fractions):
        raise _error(module, method, _described(result), "Fractions(detwinned, twinned)")
    for part, name in zip(result, Fractions._fields, strict=True):
        _check_array(module, f"{name} of {method}", part, shape)


def _check_motion(mechanism: AbstractMechanism, method: str, result: Any, initial: Any) -> None:
    """Check that a method returned a state of motion like that of ``initial_motion``."""
    for leaf in jax.tree.leaves(result):
        if not isinstance(leaf, _NUMBERS) or jnp.result_type(leaf) != np.float64:
            kind = jnp.result_type(leaf) if isinstance(leaf, _NUMBERS) else type(leaf).__name__
            raise _error(mechanism, method, f"a state with {kind}", "floating-point numbers or arrays of float64")
    forms = [(jax.tree.structure(tree), list(map(jnp.shape, jax.tree.leaves(tree)))) for tree in (result, initial)]
    if forms[0] != forms[1]:
        shapes = [f"a state of shapes {jax.tree.map(jnp.shape, tree)}" for tree in (result, initial)]
        raise _error(mechanism, method, shapes[0], f"{shapes[1]} as that of initial_motion")


def _check_channels(mechanism: AbstractMechanism, result: Any) -> None:
    names = (mechanism.coordinate, *mechanism.extra_channels)
    if not isinstance(result, dict) or set(result) != set(names):
        returned = f"the channels {', '.join(map(str, result))}" if isinstance(result, dict) else _described(result)
        raise _error(mechanism, "channels", returned, f"a dictionary with {', '.join(names)}")
    for name, value in result.items():
        _check_array(mechanism, f"{name} of channels", value, ())


def _error(module: eqx.Module, method: str, returned: str, expected: str) -> InputError:
    return InputError(f"{type(module).__name__}: {method} returned {returned}, expected {expected}")


def _described(result: Any) -> str:
    if result is None:
        return "None"
    return f"shape {jnp.shape(result)}" if isinstance(result, _NUMBERS) else f"a {type(result).__name__}"
