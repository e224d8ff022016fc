"""Plants from one sample of a controller to the next: a rig's plant, or a linear transfer function in its place.

``step`` advances the state by one period under constant commands, ``observe`` returns the channels at a sample. Steps
that solve an implicit equation have a second form, ``differentiable_step``, which takes the solutions of ``step`` and
is differentiable without solving again.
"""

import abc
import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jax.typing import ArrayLike
from jaxtyping import Array, Complex, Float, Int

from smajax import parameters
from smajax.control.pulse_width import on_fraction
from smajax.errors import InputError
from smajax.laws.transfer_function import TransferFunction
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import CheckedModule
from smajax.plant.implicit_step import differentiable_step, twice_differentiable_step
from smajax.plant.plant import Plant
from smajax.simulation.step_size import default_step

# Steps of the plant in one period of the carrier: the pulses are resolved to an eighth of a period. Chosen by trial;
# tests/unit/control/test_control.py holds it.
_STEPS_PER_PULSE = 8.0
# Tolerance for the rounding error of a quotient of two durations: double precision rounds quotients up to 1e6 to 1e-10.
_ROUNDING = 1e-9


class AbstractSampledSystem(CheckedModule):
    """Base class of the systems that a loop controls, sampled once a period.

    Attributes:
        period: Period of the samples, s.
    """

    if TYPE_CHECKING:  # type checkers take abstract variables for constructor arguments

        @property
        def period(self) -> float: ...
    else:
        period: eqx.AbstractVar[float]

    @property
    def is_implicit(self) -> bool:
        """Whether ``step`` solves implicit equations, whose solutions ``differentiable_step`` reuses; default: no."""
        return False

    @property
    @abc.abstractmethod
    def wires(self) -> int:
        """Number of commands."""

    @abc.abstractmethod
    def start(self) -> Any:
        """Return the state at rest without any command."""

    @abc.abstractmethod
    def with_parameters(self, values: Mapping[str, ArrayLike]) -> "AbstractSampledSystem":
        """Return the system with other values of some parameters, scalars in internal units by name."""

    @abc.abstractmethod
    def step(self, state: Any, command: Float[Array, " wires"]) -> tuple[Any, Any, Int[Array, ""]]:
        """Take one period.

        Args:
            state: State at the beginning.
            command: Commands during the period, in the unit of the drive.

        Returns:
            The state at the end, the solutions that ``differentiable_step`` takes, and the number of steps that could
            not be solved.
        """

    def differentiable_step(self, state: Any, command: Float[Array, " wires"], step_solutions: Any) -> Any:
        """Return the state at the end of a period, differentiable once, in both modes; by default that of ``step``.

        Args:
            state: State at the beginning.
            command: Commands during the period, in the unit of the drive.
            step_solutions: Solutions that ``step`` has returned for this state and these commands.
        """
        return self.step(state, command)[0]

    def twice_differentiable_step(self, state: Any, command: Float[Array, " wires"], step_solutions: Any) -> Any:
        """Return the state at the end of a period, differentiable twice; by default that of ``step``.

        Args:
            state: State at the beginning.
            command: Commands during the period, in the unit of the drive.
            step_solutions: Solutions that ``step`` has returned for this state and these commands.
        """
        return self.step(state, command)[0]

    @abc.abstractmethod
    def observe(self, state: Any, command: Float[Array, " wires"]) -> dict[str, Float[Array, ""]]:
        """Return the channels at a sample by name.

        Args:
            state: State at the sample.
            command: Commands, under which the electrical channels are computed.
        """

    def estimated_leaves(self, state: Any) -> Any:
        """Return which leaves of a state a Kalman filter estimates: a pytree of booleans of the state's structure."""
        return jax.tree.map(eqx.is_inexact_array, state)

    def frequency_response(
        self,
        state: Any,
        command: Float[Array, " wires"],
        direction: Float[Array, " wires"],
        channel: str,
        z: Complex[Array, " points"],
    ) -> Complex[Array, " points"]:
        """Return the frequency response of a channel to the command, linearised about a state.

        Args:
            state: Operating point.
            command: Commands at the operating point.
            direction: Direction of the change of the commands.
            channel: Name of the channel.
            z: Points of the unit circle.

        Returns:
            C (z I - A)^-1 B at these points.
        """
        flat, unflatten = ravel_pytree(state)

        def next_state(flat: Float[Array, " states"], amplitude: Float[Array, ""]) -> Float[Array, " states"]:
            end = self.differentiable_step(unflatten(flat), command + amplitude * direction, step_solutions)
            return ravel_pytree(end)[0]

        _, step_solutions, _ = self.step(state, command)
        a, b = jax.jacfwd(next_state, argnums=(0, 1))(flat, jnp.zeros(()))
        c = jax.jacfwd(lambda flat: self.observe(unflatten(flat), command)[channel])(flat)
        return jax.vmap(lambda z: c @ jnp.linalg.solve(z * jnp.eye(len(flat)) - a, b.astype(z.dtype)))(z)


class SampledPlant(AbstractSampledSystem):
    """A plant sampled at the period of a controller.

    With a carrier, a duty cycle is applied as the pulses of a pulse-width modulator and not as its mean. The
    transformed fraction then differs from that under the mean, however fast the carrier is: kinetics in relative form
    have no memory of the highest temperature so far, so that every pulse transforms a part of the remaining fraction
    and the pause after it transforms nothing back. Real wires have that memory, and the mean is closer to them.

    Attributes:
        plant: The plant.
        period: Period of the controller, s.
        substeps: Steps of the plant in one period.
        carrier: Frequency of the pulse-width modulator, Hz; ``None``: the mean of the pulses.
    """

    plant: Plant
    period: float = eqx.field(static=True)
    substeps: int = eqx.field(static=True)
    carrier: float | None = eqx.field(static=True, default=None)

    @property
    def is_implicit(self) -> bool:
        """True: each step of the plant solves its heat and force balance."""
        return True

    @classmethod
    def of(
        cls, plant: Plant, period: float, *, step: float | None = None, carrier: float | None = None
    ) -> "SampledPlant":
        """Build the sampled plant.

        Args:
            plant: The plant; it needs a drive.
            period: Period of the controller, s.
            step: Longest step of the plant, s; default: ``smajax.simulation.step_size.default_step``, and with a
                carrier an eighth of its period.
            carrier: Frequency of the pulse-width modulator, Hz; ``None``: the mean of the pulses.

        Raises:
            InputError: if the plant has no drive or its motion is prescribed, or if a carrier is given and the drive
                takes no duty cycle.
        """
        if not plant.drive.control or plant.signals != plant.signals[: plant.mechanism.wires]:
            raise InputError(
                "this rig has no drive, or a motion that is prescribed: there is nothing that a controller could steer"
            )
        if carrier is not None and plant.drive.control != "duty":
            raise InputError(
                f'a carrier is given and the drive takes a {plant.drive.control}: only control = "duty" is pulsed'
            )
        longest = min(step or default_step(plant), 1.0 / (_STEPS_PER_PULSE * carrier) if carrier else math.inf)
        substeps = max(1, math.ceil(period / longest - _ROUNDING))
        return cls(plant=plant, period=period, substeps=substeps, carrier=carrier)

    def without_carrier(self) -> "SampledPlant":
        """Return the sampled plant under the mean of the pulses."""
        return replace(self, carrier=None)

    @property
    def wires(self) -> int:
        """Number of wires."""
        return self.plant.mechanism.wires

    def start(self) -> Any:
        """Return the plant's state at rest without any command, and the time since then, 0 s."""
        return self.plant.init(jnp.zeros(self.wires)), jnp.zeros(())

    def with_parameters(self, values: Mapping[str, ArrayLike]) -> "SampledPlant":
        """Return the sampled plant with other values of some parameters, named as in ``smajax.parameters``."""
        return eqx.tree_at(lambda d: d.plant, self, parameters.replace(self.plant, values))

    def step(
        self, state: Any, command: Float[Array, " wires"]
    ) -> tuple[Any, Float[Array, "substeps unknowns"], Int[Array, ""]]:
        """Take one period; the solutions are temperatures and unknowns of each substep."""
        duration = jnp.asarray(self.period / self.substeps)

        def substep(carry: tuple[Any, ...], _: Any) -> tuple[tuple[Any, ...], Float[Array, " unknowns"]]:
            state, time, unsolved = carry
            signal = self._signal(command, time)
            state, failed = self.plant.solve_step(state, signal, signal, duration)
            return (state, time + duration, unsolved + failed), state.step_unknowns

        (plant_state, time, unsolved), solutions = jax.lax.scan(
            substep, (*state, jnp.asarray(0)), None, length=self.substeps
        )
        return (plant_state, time), solutions, unsolved

    def differentiable_step(
        self, state: Any, command: Float[Array, " wires"], step_solutions: Float[Array, "substeps unknowns"]
    ) -> Any:
        """Return the state at the end of the period, differentiable once by the implicit function theorem."""
        return self._scan_substeps(differentiable_step, state, command, step_solutions)

    def twice_differentiable_step(
        self, state: Any, command: Float[Array, " wires"], step_solutions: Float[Array, "substeps unknowns"]
    ) -> Any:
        """Return the state at the end of the period, differentiable twice by the implicit function theorem."""
        return self._scan_substeps(twice_differentiable_step, state, command, step_solutions)

    def _scan_substeps(
        self,
        step: Callable[..., Any],
        state: Any,
        command: Float[Array, " wires"],
        step_solutions: Float[Array, "substeps unknowns"],
    ) -> Any:
        """The state after all substeps, each by ``step`` at its solution."""
        duration = jnp.asarray(self.period / self.substeps)

        def substep(carry: tuple[Any, ...], solution: Float[Array, " unknowns"]) -> tuple[tuple[Any, ...], None]:
            state, time = carry
            return (step(self.plant, state, self._signal(command, time), duration, solution), time + duration), None

        return jax.lax.scan(substep, state, step_solutions)[0]

    def _signal(self, command: Float[Array, " wires"], time: Float[Array, ""]) -> Float[Array, " wires"]:
        """Signal of the drive in the substep that begins at ``time``."""
        if self.carrier is None:
            return command
        return on_fraction(command, time, jnp.asarray(self.period / self.substeps), self.carrier)

    def observe(self, state: Any, command: Float[Array, " wires"]) -> dict[str, Float[Array, ""]]:
        """Return the observed channels of the plant by name."""
        return self.plant.observe(state[0], command)

    def estimated_leaves(self, state: Any) -> Any:
        """Return which leaves are estimated: the numbers of the plant's state except the memories of its effects."""
        plant_state, _ = jax.tree.map(eqx.is_inexact_array, state)
        return plant_state._replace(memory=jax.tree.map(lambda _: False, state[0].memory)), False


class SampledTransferFunction(AbstractSampledSystem):
    """A transfer function from one command to one channel, stepped exactly, including its delay.

    The system is at rest before the first command.

    Attributes:
        function: The transfer function.
        channel: Name of its output.
        period: Period of the controller, s.
        delay_periods: Number of whole periods in the delay; the remainder follows from the function.
    """

    function: TransferFunction
    channel: str = eqx.field(static=True)
    period: float = eqx.field(static=True)
    delay_periods: int = eqx.field(static=True)

    @classmethod
    def of(cls, function: TransferFunction, channel: str, period: float) -> "SampledTransferFunction":
        """Build the sampled system.

        Args:
            function: The transfer function.
            channel: Name of its output.
            period: Period of the controller, s.
        """
        delay_periods = int(float(function.delay) / period + _ROUNDING)
        return cls(function=function, channel=channel, period=period, delay_periods=delay_periods)

    @property
    def wires(self) -> int:
        """Number of wires: one."""
        return 1

    def start(self) -> Any:
        """Return the state at rest: states, ring buffer of delayed commands, and index of its next entry."""
        return jnp.zeros(self.function.order), jnp.zeros(self.delay_periods + 2), jnp.asarray(0)

    def with_parameters(self, values: Mapping[str, ArrayLike]) -> "SampledTransferFunction":
        """Return the system with other values of the function's fields; the whole periods of the delay are fixed."""
        function = self.function
        for name, value in values.items():
            function = eqx.tree_at(lambda f, n=name: getattr(f, n), function, value)
        return eqx.tree_at(lambda d: d.function, self, function)

    def step(self, state: Any, command: Float[Array, " wires"]) -> tuple[Any, Any, Int[Array, ""]]:
        """Take one period; there are no step solutions, and every step succeeds."""
        return self.differentiable_step(state, command, ()), (), jnp.asarray(0)

    def differentiable_step(self, state: Any, command: Float[Array, " wires"], step_solutions: Any) -> Any:
        """Return the state at the end of the period; ``step_solutions`` is not used."""
        states, ring, index = state
        size = self.delay_periods + 2
        ring = ring.at[index].set(command[0])
        # In the remainder of the delay, the command of one period earlier still acts.
        remainder = maximum(self.function.delay - self.delay_periods * self.period, 0.0)
        for duration, age in ((remainder, self.delay_periods + 1), (self.period - remainder, self.delay_periods)):
            transition, input_gain = self.function.zero_order_hold(duration)
            states = transition @ states + input_gain * ring[(index - age) % size]
        return states, ring, (index + 1) % size

    def observe(self, state: Any, command: Float[Array, " wires"]) -> dict[str, Float[Array, ""]]:
        """Return the output under the name of its channel."""
        return {self.channel: self.function.rest + self.function.gain * state[0][0]}

    def frequency_response(
        self,
        state: Any,
        command: Float[Array, " wires"],
        direction: Float[Array, " wires"],
        channel: str,
        z: Complex[Array, " points"],
    ) -> Complex[Array, " points"]:
        """Return the exact frequency response at the points ``z``; it does not depend on ``state`` and ``command``."""
        remainder = maximum(self.function.delay - self.delay_periods * self.period, 0.0)
        first_transition, first_gain = self.function.zero_order_hold(remainder)
        second_transition, second_gain = self.function.zero_order_hold(self.period - remainder)
        size = self.function.order

        def response(z: Complex[Array, ""]) -> Complex[Array, ""]:
            # The command of one period earlier, and that of this one.
            drive = second_transition @ first_gain / z + second_gain
            transition = second_transition @ first_transition
            return jnp.linalg.solve(z * jnp.eye(size) - transition, drive)[0] * z ** (-self.delay_periods)

        return self.function.gain * direction[0] * jax.vmap(response)(z)
