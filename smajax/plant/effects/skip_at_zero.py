"""Compile-time machinery: skip the hook of an absent effect.

The search for the end of a step should not evaluate the powers and logarithms of an effect of strength 0. A hook marked
with ``@skip_at_zero`` is not evaluated while the strength is 0 and no derivative with respect to it is requested. What
this buys: a diagnosis has dozens of absent effects in one program at little cost.
"""

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp

if TYPE_CHECKING:
    from smajax.plant.effects.base import AbstractEffect


def skip_at_zero(hook: Callable[..., Any]) -> Callable[..., Any]:
    """Decorate a hook so that it is evaluated only if the strength is not 0 or is differentiated.

    Otherwise the hook of the base class is evaluated.

    Args:
        hook: The hook, defined in the body of the concrete class.
    """
    name = hook.__name__

    def base_hook(effect: "AbstractEffect", args: tuple[Any, ...]) -> Any:
        return getattr(super(type(effect), effect), name)(*args)

    @eqx.filter_custom_jvp
    def evaluate(effect: "AbstractEffect", args: tuple[Any, ...]) -> Any:
        return jax.lax.cond(effect.strength == 0.0, lambda: base_hook(effect, args), lambda: hook(effect, *args))

    @evaluate.def_jvp
    def _(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
        def with_tangent(function: Callable[..., Any]) -> Callable[..., Any]:
            return _dense_jvp(function, jax.eval_shape(lambda: evaluate(*primals)), primals, tangents)

        full = with_tangent(lambda effect, args: hook(effect, *args))
        if tangents[0].strength is not None:
            return full()
        return jax.lax.cond(primals[0].strength == 0.0, with_tangent(base_hook), full)

    @functools.wraps(hook)
    def method(self: "AbstractEffect", *args: Any) -> Any:
        return evaluate(self, args)

    return method


def _dense_jvp(
    function: Callable[..., Any], shapes: Any, primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> Callable[..., Any]:
    """A function without arguments that returns value and tangent, with zeros in place of tangents of ``None``."""

    def jvp() -> tuple[Any, ...]:
        result, tangent = eqx.filter_jvp(function, primals, tangents)
        filled = jax.tree.map(
            lambda shape, t: jnp.zeros_like(shape) if t is None else t, shapes, tangent, is_leaf=lambda x: x is None
        )
        return result, filled

    return jvp
