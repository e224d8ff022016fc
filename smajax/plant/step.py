"""One step of a plant as a differentiable function: the implicit function theorem at its known end.

The search for the end of a step is not differentiated. At the end z the balances left(z, start, inputs, plant) are zero, so that z moves
with whatever they depend on by -(d left / d z)^-1 d left, and the state there with both: ``land``, once. ``follow`` writes the same as
Newton steps from the known end under a slope held fixed: each makes one more order of the derivative right, so that a Jacobian of it
(a filter's) has derivatives of its own.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from smajax.plant.newton import linear
from smajax.plant.plant import Plant, State


def push(function: Callable, at: tuple, along: tuple) -> Any:
    """The tangent of ``function(*at)`` along ``along``, whose leaves may be ``None``."""
    value, tangent = eqx.filter_jvp(function, at, along)
    return jax.tree.map(lambda v, t: jnp.zeros_like(v) if t is None else t, value, tangent, is_leaf=lambda x: x is None)


def end_tangent(arrive: Callable, end: jax.Array, at: tuple, along: tuple) -> jax.Array:
    """The tangent of a step's state at its end, flat: ``arrive(end, *at)`` gives the balances left and that state, flat."""
    slope, per_end = jax.jacfwd(lambda z: arrive(z, *at))(end)
    left, state = push(lambda *at: arrive(end, *at), at, along)
    by = linear(slope, left)
    return state - sum(per_end[:, i] * by[i] for i in range(len(end)))


@eqx.filter_custom_jvp
def land(plant: Plant, state: State, signal: jax.Array, duration: jax.Array, end: jax.Array) -> State:
    """The state ``duration`` s on under a held ``signal``, for a step that is known to end at ``end`` (temperatures, then unknowns).

    Differentiable in the plant, the state and the signal, forward and reverse, once: ``end`` follows them.
    """
    return plant.arrive(state, signal, signal, duration, end)[1]


@land.def_jvp
def _land_jvp(primals: tuple, tangents: tuple) -> tuple:
    (plant, state, signal, duration, end), (plants, states, signals, _, _) = primals, tangents
    landed = land(plant, state, signal, duration, end)

    def arrive(z: jax.Array, plant: Plant, state: State, signal: jax.Array) -> tuple[jax.Array, jax.Array]:
        left, landed = plant.arrive(state, signal, signal, duration, z)
        return left, ravel_pytree(landed)[0]

    moved = end_tangent(arrive, end, (plant, state, signal), (plants, states, signals))
    return landed, ravel_pytree(landed)[1](moved)


def follow(plant: Plant, state: State, signal: jax.Array, duration: jax.Array, end: jax.Array) -> State:
    """As ``land``, differentiable twice, at three times the balances."""
    end, at = jax.lax.stop_gradient((end, (plant, state, signal)))
    slope = jax.jacfwd(lambda z: at[0].arrive(at[1], at[2], at[2], duration, z)[0])(end)
    for _ in range(2):
        end = end - linear(slope, plant.arrive(state, signal, signal, duration, end)[0])
    return plant.arrive(state, signal, signal, duration, end)[1]
