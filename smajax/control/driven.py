"""What a controller steers: a rig's plant, or a linear transfer function that stands for one.

Both are sampled: ``advance`` takes the state through one period of the controller under held commands, and ``read`` gives the channels at a
sample. Commands have the shape ``(wires,)``.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from smajax import parameters
from smajax.blackbox.transfer_function import TransferFunction
from smajax.control.allocation import pulsed
from smajax.errors import InputError
from smajax.kinks import larger
from smajax.plant.plant import Plant
from smajax.plant.step import follow, land
from smajax.simulate import default_step


class AbstractDriven(eqx.Module):
    """Base class of what can be steered."""

    @property
    def searches(self) -> bool:
        """Whether ``advance`` has to search for its ends, so that remembering them for ``land`` is worth it."""
        raise NotImplementedError

    @property
    def wires(self) -> int:
        """Number of commands."""
        raise NotImplementedError

    def start(self) -> Any:
        """The state at rest without any command."""
        raise NotImplementedError

    def changed(self, values: Mapping[str, jax.Array]) -> "AbstractDriven":
        """The same with other values of some parameters, scalars: a load that is added, a draught."""
        raise NotImplementedError

    def advance(self, state: Any, command: jax.Array) -> tuple[Any, Any, jax.Array]:
        """The state a period on, what ``land`` needs to know of the way, and how many of its steps could not be solved."""
        raise NotImplementedError

    def land(self, state: Any, command: jax.Array, way: Any) -> Any:
        """The state a period on, differentiable, without searching for it: ``way`` is known from ``advance``."""
        raise NotImplementedError

    def follow(self, state: Any, command: jax.Array, way: Any) -> Any:
        """As ``land``, and differentiable twice."""
        raise NotImplementedError

    def read(self, state: Any, command: jax.Array) -> dict[str, jax.Array]:
        """The channels at a sample, scalars, by name; electrical ones under ``command``."""
        raise NotImplementedError

    def response(self, state: Any, command: jax.Array, direction: jax.Array, channel: str, z: jax.Array) -> jax.Array:
        """Frequency response of a channel to the command along ``direction``, shape ``(wires,)``, at points ``z`` of the unit circle.

        Linearised about ``state``; complex, of the shape of ``z``.
        """
        flat, unflatten = ravel_pytree(state)

        def moved(flat: jax.Array, u: jax.Array) -> jax.Array:
            return ravel_pytree(self.land(unflatten(flat), command + u * direction, way))[0]

        _, way, _ = self.advance(state, command)
        nothing = jnp.zeros(())
        rates, drive = jax.jacfwd(moved, argnums=(0, 1))(flat, nothing)
        row = jax.jacfwd(lambda flat: self.read(unflatten(flat), command)[channel])(flat)
        return jax.vmap(lambda z: row @ jnp.linalg.solve(z * jnp.eye(len(flat)) - rates, drive.astype(z.dtype)))(z)


class DrivenPlant(AbstractDriven):
    """A plant under a controller of period ``period`` s, each period in ``pieces`` steps of the plant.

    With a ``carrier`` in Hz, a duty is what a pulse-width modulator makes of it, and not its mean. What transforms then is not that of the
    mean, however fast the carrier: kinetics in relative form have no memory of how far a wire was warmed before, so that every pulse
    transforms some of what is left, and the pause after it nothing back. Real wires remember, and the mean is nearer to what they do.
    """

    plant: Plant
    period: float = eqx.field(static=True)
    pieces: int = eqx.field(static=True)
    carrier: float | None = eqx.field(static=True, default=None)

    @property
    def searches(self) -> bool:
        """See ``AbstractDriven.searches``."""
        return True

    @classmethod
    def of(cls, plant: Plant, period: float, *, step: float | None = None, carrier: float | None = None) -> "DrivenPlant":
        """With steps no longer than ``step`` s (default: ``simulate.default_step``, and an eighth of the carrier's period).

        Raises ``InputError`` if no controller can steer the plant.
        """
        if not plant.drive.control or plant.signals != plant.signals[: plant.mechanism.wires]:
            raise InputError("this rig has no drive, or a motion that is prescribed: there is nothing that a controller could steer")
        if carrier is not None and plant.drive.control != "duty":
            raise InputError(f'a carrier is given and the drive takes a {plant.drive.control}: only control = "duty" is pulsed')
        longest = min(step or default_step(plant), 1.0 / (8.0 * carrier) if carrier else math.inf)
        return cls(plant=plant, period=period, pieces=max(1, math.ceil(period / longest - 1e-9)), carrier=carrier)

    def averaged(self) -> "DrivenPlant":
        """The same without its carrier."""
        return replace(self, carrier=None)

    @property
    def wires(self) -> int:
        """Number of wires."""
        return self.plant.mechanism.wires

    def start(self) -> Any:
        """See ``AbstractDriven.start``; the state and the time since then, s."""
        return self.plant.start(jnp.zeros(self.wires)), jnp.zeros(())

    def changed(self, values: Mapping[str, jax.Array]) -> "DrivenPlant":
        """See ``AbstractDriven.changed``; names as in ``smajax.parameters``."""
        return eqx.tree_at(lambda d: d.plant, self, parameters.replace(self.plant, values))

    def advance(self, state: Any, command: jax.Array) -> tuple[Any, jax.Array, jax.Array]:
        """See ``AbstractDriven.advance``; ``way`` are the ends of the steps, shape ``(pieces, ...)``."""
        duration = jnp.asarray(self.period / self.pieces)

        def single(carry: tuple, _: Any) -> tuple[tuple, jax.Array]:
            state, time, unsolved = carry
            signal = self._signal(command, time)
            state, failed = self.plant.advance(state, signal, signal, duration)
            return (state, time + duration, unsolved + failed), jnp.concatenate([state.temperature, state.unknown])

        (plant_state, time, unsolved), ends = jax.lax.scan(single, (*state, jnp.asarray(0)), None, length=self.pieces)
        return (plant_state, time), ends, unsolved

    def land(self, state: Any, command: jax.Array, way: jax.Array) -> Any:
        """See ``AbstractDriven.land``."""
        return self._along(land, state, command, way)

    def follow(self, state: Any, command: jax.Array, way: jax.Array) -> Any:
        """See ``AbstractDriven.follow``."""
        return self._along(follow, state, command, way)

    def _along(self, step: Callable, state: Any, command: jax.Array, way: jax.Array) -> Any:
        duration = jnp.asarray(self.period / self.pieces)

        def single(carry: tuple, end: jax.Array) -> tuple[tuple, None]:
            state, time = carry
            return (step(self.plant, state, self._signal(command, time), duration, end), time + duration), None

        return jax.lax.scan(single, state, way)[0]

    def _signal(self, command: jax.Array, time: jax.Array) -> jax.Array:
        return command if self.carrier is None else pulsed(command, time, jnp.asarray(self.period / self.pieces), self.carrier)

    def read(self, state: Any, command: jax.Array) -> dict[str, jax.Array]:
        """See ``AbstractDriven.read``: the plant's channels as its sensors give them."""
        return self.plant.outputs(state[0], command)


class DrivenTransferFunction(AbstractDriven):
    """A transfer function from one command to the channel ``channel``, stepped exactly, its delay included.

    ``period`` is the controller's in s; the delay is ``whole`` of them and a rest. The plant stands still before the first command.
    """

    function: TransferFunction
    channel: str = eqx.field(static=True)
    period: float = eqx.field(static=True)
    whole: int = eqx.field(static=True)

    @property
    def searches(self) -> bool:
        """See ``AbstractDriven.searches``."""
        return False

    @classmethod
    def of(cls, function: TransferFunction, channel: str, period: float) -> "DrivenTransferFunction":
        """With the whole periods that its delay has."""
        return cls(function=function, channel=channel, period=period, whole=int(float(function.delay) / period + 1e-9))

    @property
    def wires(self) -> int:
        """One."""
        return 1

    def start(self) -> Any:
        """See ``AbstractDriven.start``: the states, the commands on their way (a ring), and where it is filled next."""
        return jnp.zeros(self.function.order), jnp.zeros(self.whole + 2), jnp.asarray(0)

    def changed(self, values: Mapping[str, jax.Array]) -> "DrivenTransferFunction":
        """See ``AbstractDriven.changed``; names are the function's fields, but for the delay, whose whole periods are fixed."""
        function = self.function
        for name, value in values.items():
            function = eqx.tree_at(lambda f, n=name: getattr(f, n), function, value)
        return eqx.tree_at(lambda d: d.function, self, function)

    def advance(self, state: Any, command: jax.Array) -> tuple[Any, Any, jax.Array]:
        """See ``AbstractDriven.advance``; nothing is searched for."""
        return self.land(state, command, ()), (), jnp.asarray(0)

    def land(self, state: Any, command: jax.Array, way: Any) -> Any:
        """See ``AbstractDriven.land``."""
        inner, ring, place = state
        size = self.whole + 2
        ring = ring.at[place].set(command[0])
        # In the delay's rest of this period the command of one period earlier still acts.
        rest = larger(self.function.delay - self.whole * self.period, 0.0)
        for duration, age in ((rest, self.whole + 1), (self.period - rest, self.whole)):
            kept, entering = self.function.held(duration)
            inner = kept @ inner + entering * ring[(place - age) % size]
        return inner, ring, (place + 1) % size

    def follow(self, state: Any, command: jax.Array, way: Any) -> Any:
        """See ``AbstractDriven.follow``."""
        return self.land(state, command, way)

    def read(self, state: Any, command: jax.Array) -> dict[str, jax.Array]:
        """See ``AbstractDriven.read``."""
        return {self.channel: self.function.rest + self.function.gain * state[0][0]}

    def response(self, state: Any, command: jax.Array, direction: jax.Array, channel: str, z: jax.Array) -> jax.Array:
        """See ``AbstractDriven.response``; exact, since it is linear. ``state`` does not matter."""
        rest = larger(self.function.delay - self.whole * self.period, 0.0)
        (late, entering), (kept, later) = self.function.held(rest), self.function.held(self.period - rest)
        size = self.function.order

        def at(z: jax.Array) -> jax.Array:
            drive = kept @ entering / z + later  # what comes one period later, and at once
            return jnp.linalg.solve(z * jnp.eye(size) - kept @ late, drive)[0] * z ** (-self.whole)

        return self.function.gain * direction[0] * jax.vmap(at)(z)
