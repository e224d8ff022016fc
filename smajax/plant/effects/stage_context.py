"""State of the wires and parts of the plant, as the hooks of the effects get them."""

from typing import NamedTuple

import jax
from jaxtyping import Array, Float

from smajax.plant.heat import AbstractHeat
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment


class WireState(NamedTuple):
    """State of the wires at one instant, as effects use it.

    Attributes:
        time: Time since the first row, s, a scalar.
        temperature: Temperatures, shape ``(wires,)``, degC.
        fractions: Martensite fractions, shape ``(wires,)`` each.
        stress: Stresses, shape ``(wires,)``, Pa.
        contraction: Minus the strain of the wire, a scalar, which grows as the wire shortens: 0 for austenite without
            stress at ambient temperature, and so below 0 for a stretched wire, also at the first row. With two wires
            half the strain of wire 2 less that of wire 1. An effect that needs the contraction since the first row
            stores the initial one in its memory, as ``load_change`` does.
        accumulated_transformation: Sum of the changes of the martensite fraction in both directions, shape
            ``(wires,)``; a full cycle counts 2.
        ambient: Recorded ambient temperature, degC, a scalar; ``None`` if it is constant (``ambient_at``).
        fan: Recorded duty or relative speed of a fan, a scalar; ``None`` if it is not recorded.
    """

    time: jax.Array
    temperature: jax.Array
    fractions: Fractions
    stress: jax.Array
    contraction: jax.Array
    accumulated_transformation: jax.Array
    ambient: jax.Array | None = None
    fan: jax.Array | None = None


class StageContext(NamedTuple):
    """Parts of the plant that an effect may use.

    Attributes:
        wire: The wire.
        environment: Its surroundings. Where the ambient temperature is recorded, ``environment.ambient`` is that of the
            instant in ``power``, that of the end of the step in ``update_memory``, and the constant elsewhere.
        material: The material law, with the moduli of the wire's geometry.
        heat: The heat stage.
    """

    wire: AbstractWire
    environment: Environment
    material: AbstractMaterial
    heat: AbstractHeat


def ambient_at(state: WireState, context: StageContext) -> Float[Array, ""]:
    """Return the ambient temperature at an instant in degC: the recorded one, or the constant.

    Args:
        state: The wires at that instant.
        context: Other parts of the plant.
    """
    return context.environment.ambient if state.ambient is None else state.ambient
