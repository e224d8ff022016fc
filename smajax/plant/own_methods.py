"""Check of what the methods of an own material or mechanism return, in words, before a compiler meets it.

The methods are traced and not computed. Those of smajax's own classes are left to its tests.
"""

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
    """Check the shapes and types of what the methods of an own material return.

    Args:
        material: The material.
        shape: Shape of the temperatures of the plant: ``(wires,)``, with cells ``(cells, wires)``.

    Raises:
        InputError: If a method returns no array, or one of another shape or type.
    """
    if _is_checked(material):
        _trace(lambda: _call_material(material, shape))
        _trace(lambda: _call_material(material, ()))  # for the modulus and the resistivity of austenite


def check_mechanism(mechanism: AbstractMechanism, material: AbstractMaterial, context: MechanismContext) -> None:
    """Check the shapes and types of what the methods of an own mechanism return.

    Args:
        mechanism: The mechanism.
        material: A material, for the fractions as installed.
        context: Wire, environment and scale.

    Raises:
        InputError: If a method returns no array, one of another shape or type, or other channels than it should.
    """
    if _is_checked(mechanism):
        _trace(lambda: _call_mechanism(mechanism, material, context))


def _is_checked(module: eqx.Module) -> bool:
    """Whether a class is not of smajax, and its parameters are of double precision, without which nothing runs."""
    if type(module).__module__.partition(".")[0] == "smajax" or not jax.config.read("jax_enable_x64"):
        return False
    return all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(module) if eqx.is_inexact_array(leaf))


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
        _check_number(material, "remaining_share", material.remaining_share(array), shape)
    if isinstance(material, AbstractOneFraction):
        _check_number(material, "remainder", material.remainder(array, array), shape)
    _check_fractions(material, "evolve", material.evolve(fractions, ends, ends), shape)
    for method in ("modulus", "resistivity", "transformation_strain"):
        _check_number(material, method, getattr(material, method)(fractions), shape)
    current = material.current_transformation_strain(array)
    _check_number(material, "current_transformation_strain", current, shape)
    _check_array(material, "strain", material.strain(fractions, array, array, array), shape)
    _check_fractions(material, "installed_fractions", material.installed_fractions(array), shape)


def _call_mechanism(mechanism: AbstractMechanism, material: AbstractMaterial, context: MechanismContext) -> None:
    wires, number = (mechanism.wires,), jnp.zeros(())
    unknowns, strain = (mechanism.unknowns,), jnp.zeros(wires)
    prescribed: dict[str, Any] = dict.fromkeys(mechanism.prescribed, number)
    if isinstance(mechanism, AbstractElasticLoad):
        _check_array(mechanism, "force", mechanism.force(strain), wires)
    unknown = mechanism.initial_unknowns(prescribed, context)
    _check_array(mechanism, "initial_unknowns", unknown, unknowns)
    stress = mechanism.stress(unknown, prescribed, context)
    _check_array(mechanism, "stress", stress, wires)
    installed = mechanism.fractions(material, strain, prescribed, context)
    _check_fractions(mechanism, "fractions", installed, wires)
    motion = mechanism.initial_motion(strain)
    if isinstance(mechanism, AbstractDisplacement):
        _check_array(mechanism, "initial_motion", motion, ())
    _check_motion(mechanism, "initial_motion", motion, motion)
    balance = mechanism.balance(unknown, strain, motion, prescribed, context, number)
    _check_array(mechanism, "balance", balance, unknowns)
    after = mechanism.update_motion(unknown, strain, motion, context, number)
    _check_motion(mechanism, "update_motion", after, motion)
    _check_number(mechanism, "contraction", mechanism.contraction(strain), ())
    _check_number(mechanism, "longest_step", mechanism.longest_step(context), ())
    _check_array(mechanism, "with_drag", mechanism.with_drag(stress, number), wires)
    if not mechanism.obstacle_to_rates:
        complete = mechanism.complete_motion(unknown, strain, motion, context)
        _check_motion(mechanism, "complete_motion", complete, motion)
        _check_motion(mechanism, "motion_rates", mechanism.motion_rates(complete), motion)
        balance = mechanism.balance_at_motion(unknown, strain, complete, prescribed, context)
        _check_array(mechanism, "balance_at_motion", balance, unknowns)
    _check_channels(mechanism, mechanism.channels(strain, stress, motion, context))


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
