"""What an effect may do to its stage. An effect is a nested extension of the plant: with its strength at 0 it is not there.

Each stage has a base class with that stage's hooks; an effect derives from one of them, overrides the hooks it needs and leaves the rest.
Hooks are pure functions and add to what the stage does without them, so effects can be combined. What an effect has to remember is an
array of its own in the plant's state (``start``, ``remember``). The derivative with respect to the strength has to exist at 0, to be
finite and not to be 0: a dead zone or a saturation has to be written with the sign of the motion, not with a threshold.
"""

import functools
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import declarations
from smajax.plant.heat import AbstractHeat
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment


class Instant(NamedTuple):
    """What effects see of a plant at one instant: arrays of shape ``(wires,)``, but for ``time`` and ``contraction`` (a strain).

    ``travel`` is the martensite fraction transformed so far in either direction, a full cycle counting 2.
    """

    time: jax.Array
    temperature: jax.Array
    fractions: Fractions
    stress: jax.Array
    contraction: jax.Array
    travel: jax.Array


class Where(NamedTuple):
    """The parts of the plant that an effect may look at."""

    wire: AbstractWire
    environment: Environment
    material: AbstractMaterial
    heat: AbstractHeat


class AbstractEffect(eqx.Module):
    """Base class of all effects.

    ``strength`` is declared by the effect (``parameter``), its bounds being the plausible range; other declared fields are shapes, such as
    a time constant, and ``shapes`` holds the values at which a search for the effect tries them (an ``instant`` as a share of the
    recording's length). From the share ``absorbed_from`` of its influence on that free parameters make up for, it counts as absorbed; where
    the little that is left rests on nominal values that nobody measured, the share is lower. ``needs`` names what a rig must have for the
    effect to exist: words of ``Plant.traits``. ``sees`` names the channels that ``carry`` or ``read`` looks at beside the one they add to.
    """

    key: ClassVar[str]
    stage: ClassVar[str]
    typical: ClassVar[float]
    source: ClassVar[str]
    confused_with: ClassVar[tuple[str, ...]] = ()
    needs: ClassVar[tuple[str, ...]] = ()
    sees: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[tuple[tuple[str, tuple[float, ...]], ...]] = ()
    no_mean_effect: ClassVar[str] = ""
    absorbed_from: ClassVar[float] = 1.0 - 1e-7
    strength: eqx.AbstractVar[jax.Array]

    @classmethod
    def unit(cls) -> str:
        """Internal unit of the strength."""
        return declarations(cls)["strength"].unit

    @classmethod
    def plausible(cls) -> tuple[float, float]:
        """Least and largest plausible strength."""
        strength = declarations(cls)["strength"]
        return strength.lower, strength.upper

    @classmethod
    def obstacle(cls, traits: frozenset[str]) -> str:
        """Why a rig with these traits cannot have or show the effect; empty if it can."""
        missing = sorted(set(cls.needs) - traits)
        return cls.no_mean_effect or (f"it needs {', '.join(missing)}" if missing else "")

    def start(self, instant: Instant, where: Where) -> Any:
        """What is remembered at the first row; by default nothing."""
        return ()

    def remember(self, memory: Any, before: Instant, after: Instant, step: jax.Array, where: Where) -> Any:
        """What is remembered after a step from one instant to another."""
        return memory


def asleep_at_zero(hook: Callable) -> Callable:
    """A hook that is not computed while the strength is 0 and nobody asks for the derivative by it: the base class's is, in its place.

    A search that only wants to know where a step ends need not pay for the powers and logarithms of what is not there. The hook has to be
    that of the concrete class itself.
    """
    name = hook.__name__

    def absent(effect: AbstractEffect, args: tuple) -> Any:
        return getattr(super(type(effect), effect), name)(*args)

    @eqx.filter_custom_jvp
    def asked(effect: AbstractEffect, args: tuple) -> Any:
        return jax.lax.cond(effect.strength == 0.0, lambda: absent(effect, args), lambda: hook(effect, *args))

    @asked.def_jvp
    def _(primals: tuple, tangents: tuple) -> tuple:
        def moved(function: Callable) -> Callable:
            value, known = jax.eval_shape(lambda: asked(*primals)), functools.partial(eqx.filter_jvp, function, primals, tangents)

            def whole() -> tuple:
                result, tangent = known()
                return result, jax.tree.map(lambda v, t: jnp.zeros_like(v) if t is None else t, value, tangent, is_leaf=lambda x: x is None)

            return whole

        there = moved(lambda effect, args: hook(effect, *args))
        if tangents[0].strength is not None:
            return there()
        return jax.lax.cond(primals[0].strength == 0.0, moved(absent), there)

    @functools.wraps(hook)
    def method(self: AbstractEffect, *args: Any) -> Any:
        return asked(self, args)

    return method


class DriveEffect(AbstractEffect):
    """An effect between the recorded input and the current in the wire."""

    stage = "drive"

    def signal(self, signal: jax.Array, resistance: jax.Array) -> jax.Array:
        """What is added to the recorded inputs, shape ``(wires,)``; ``resistance`` of the wires is over that of austenite."""
        return jnp.zeros_like(signal)

    def voltage(self, current: jax.Array) -> jax.Array:
        """What is added to the measured voltage in V."""
        return jnp.zeros_like(current)


class HeatEffect(AbstractEffect):
    """An effect on the heat balance of a wire."""

    stage = "heat"

    def begin(self, memory: Any, time: jax.Array, step: jax.Array) -> Any:
        """What is remembered throughout a step that begins at ``time`` and takes ``step``; by default what the last one left."""
        return memory

    def power(self, now: Instant, memory: Any, where: Where) -> jax.Array:
        """Heat added to the wires, W/m^3, shape ``(wires,)``."""
        return jnp.zeros_like(now.temperature)

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """What is added to the heat capacity as a share of it, shape ``(wires,)``."""
        return jnp.zeros_like(martensite)

    def enthalpy(self, now: Instant, where: Where) -> jax.Array:
        """Heat stored beside capacity times temperature, J/m^3, shape ``(wires,)``: a function of the instant alone."""
        return jnp.zeros_like(now.temperature)


class SecondNode(HeatEffect):
    """Heat flows into a second thermal node, s times the convection at ambient per kelvin between them.

    The node's excess over ambient goes to ``share`` of the wire's with its ``time_constant``.
    """

    share: ClassVar[float] = 1.0
    time_constant: eqx.AbstractVar[jax.Array]

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The node's temperature above ambient, which it has at rest."""
        return jnp.zeros_like(instant.temperature)

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        first, last = (self.share * (at.temperature - where.environment.ambient) for at in (before, after))
        return relaxed(memory, first, last, step, self.time_constant)

    def power(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        per_kelvin = where.heat.conductance(where.environment.ambient, where.wire)
        return -self.strength * per_kelvin * (now.temperature - where.environment.ambient - memory)


# So near its end dry friction is at its end: at rest there, rounding would else pick the branch, and might pick another one for the
# derivative by the step's start than for that by its end. Such a tangent grows from step to step.
_END = 1.0 - 1e-9


def engaged(z: jax.Array, contracted: jax.Array, reversal: jax.Array | float = 5e-5) -> jax.Array:
    """How far dry friction is engaged after a contraction by so much strain: z in -1..1, from the middle to an end over ``reversal``."""
    free = z + contracted / reversal
    return jnp.where(jnp.abs(free) < _END, free, jnp.sign(free))


def relaxed(value: jax.Array, before: jax.Array, after: jax.Array, step: jax.Array, time_constant: jax.Array) -> jax.Array:
    """What a value has become after a step in which it went, with a time constant, towards another that moved evenly meanwhile."""
    share = step / time_constant
    lost = -jnp.expm1(-share)
    lag = jnp.where(share > 0.0, lost / jnp.where(share > 0.0, share, 1.0), 1.0)  # 1 for no step at all
    return value + lost * (before - value) + (after - before) * (1.0 - lag)


class MaterialEffect(AbstractEffect):
    """An effect on the material law."""

    stage = "material"

    def shift(self, now: Instant, where: Where) -> jax.Array:
        """What is added to all four transformation temperatures, K, shape ``(wires,)``."""
        return jnp.zeros_like(now.temperature)

    def alter(self, material: AbstractMaterial) -> AbstractMaterial:
        """The law with other parameters."""
        return material

    def transform(self, before: Fractions, after: Fractions) -> Fractions:
        """The fractions after a step in place of those that the law gives."""
        return after

    def strain(self, now: Instant, memory: Any, where: Where) -> jax.Array:
        """What is added to the strain, shape ``(wires,)``."""
        return jnp.zeros_like(now.temperature)

    def resistivity(self, now: Instant, where: Where) -> jax.Array:
        """What is added to the resistivity as a share of it, shape ``(wires,)``."""
        return jnp.zeros_like(now.temperature)


class MechanismEffect(AbstractEffect):
    """An effect on forces and on how the motion reaches the place where it is measured."""

    stage = "mechanism"
    drags: ClassVar[bool] = False

    def drag(self, before: Instant, after: Instant, memory: Any, step: jax.Array, where: Where) -> jax.Array:
        """Stress in Pa, scalar, that works against contraction (with ``drags`` set only): of wire 1 against wire 2 where there are two."""
        return jnp.zeros(())

    def carry(self, motion: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """What is added to the series of the mechanism's coordinate, in m at the wire, shape ``(n,)``."""
        return jnp.zeros_like(motion)


class SensorEffect(AbstractEffect):
    """An effect on the recorded series of one channel, ``channel`` or, where that is empty, the mechanism's coordinate."""

    stage = "sensor"
    channel: ClassVar[str] = ""

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """What is added to a channel's series, shape ``(n,)``, the coordinate's in m at the wire; ``seen`` holds what ``sees`` names."""
        return jnp.zeros_like(series)
