"""The equations of one implicit step: the heat balance of each wire and the mechanism's force balance.

The unknowns ``end`` of a step, shape ``(unknowns,)``, are the temperatures of the wires in degC, the unknowns of the
mechanism in Pa and, if an effect has a drag, that drag in Pa. The residual has one equation for each of them, in K and
Pa. Both balances are evaluated with the martensite fractions of the material law at the end of the step, so heat, phase
fractions, stress and motion are consistent at that instant.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.effects.base import HeatEffect, MaterialEffect, MechanismEffect, WireState
from smajax.plant.effects.hook_results import checked_result
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.materials.base import Fractions
from smajax.plant.stages import PlantStages
from smajax.plant.state import State


class StepEquations(PlantStages):
    """Equations of a plant over one step, and the state that follows from their unknowns."""

    def step_residual(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
        end: Float[Array, " unknowns"],
    ) -> tuple[Float[Array, " unknowns"], State]:
        """Evaluate the residual of the heat and force balance of a step, for trial unknowns at its end; differentiable.

        Args:
            state: The state at the start of the step.
            before: Signals at the start, in the order of ``signals``.
            after: Signals at the end.
            step: Duration, s.
            end: Unknowns at the end: temperatures in degC, unknowns of the mechanism and drag in Pa.

        Returns:
            The residual in K and Pa, which is zero if ``end`` solves the step, and the state at ``end``.
        """
        state = self._begin_step(state, step)
        rate = self._net_heat(self._wire_state(state), state.memory, before)
        return self._residual(state, rate, before, after, step, end)

    def step_jacobian(
        self,
        state: State,
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
        end: Float[Array, " unknowns"],
    ) -> Float[Array, "unknowns unknowns"]:
        """Compute the derivative of the residual of ``step_residual`` by ``end``; not differentiable.

        Args:
            state: The state at the start of the step.
            before: Signals at the start, in the order of ``signals``.
            after: Signals at the end.
            step: Duration, s.
            end: Unknowns at the end: temperatures in degC, unknowns of the mechanism and drag in Pa.
        """
        state = self._begin_step(state, step)
        rate = self._net_heat(self._wire_state(state), state.memory, before)
        return jax.jacfwd(lambda z: self._residual(state, rate, before, after, step, z, local=True)[0])(end)

    def _residual(
        self,
        state: State,
        rate: Float[Array, "*cells wires"],
        before: Float[Array, " signals"],
        after: Float[Array, " signals"],
        step: Float[Array, ""],
        end: Float[Array, " unknowns"],
        coarse: bool = False,
        local: bool = False,
    ) -> tuple[Float[Array, " unknowns"], State]:
        """``step_residual`` with the net heat ``rate`` at the start; by the trapezoidal rule if ``coarse``.

        The trapezoidal rule is accurate enough for a search, since the last Newton step uses the Hermite-Simpson rule.
        If ``local``, the residual has the right value and the right derivative by ``end`` only, and the fractions of
        the state are not those at the end (``_mean_fractions``).
        """
        context, prescribed = self._mechanism_context(), self._prescribed_channels(after)
        first, heats = self._wire_state(state), self.temperatures
        first = self._in_surroundings(first, self._prescribed_channels(before))
        unknown = end[heats : heats + self.mechanism.unknowns]
        last, fractions, memory = self._end_of_step(state, first, unknown, prescribed, step, end, local=local)
        strain = self._strain(last, memory)
        if self.all_effects:
            last = last._replace(contraction=self.mechanism.contraction(strain))
            memory |= self._updated_memory((MechanismEffect,), memory, first, last, step)
            memory |= self._shared_memory(last)
        if isinstance(self.heat, PrescribedTemperature):
            heat = end[:heats].reshape(self.temperature_shape) - last.temperature
        else:
            heat = self._heat_residual(state, first, last, memory, (rate, before, after), step, (coarse, local))
        balance = self.mechanism.balance(unknown, strain, state.motion, prescribed, context, step)
        motion = self.mechanism.update_motion(unknown, strain, state.motion, context, step)
        residual = [heat.ravel(), balance]
        if self._has_drag:
            residual.append((end[-1] - self._drag(first, last, memory, step))[None])
        return jnp.concatenate(residual), State(last.temperature, fractions, last.stress, end[heats:], motion, memory)

    def _end_of_step(
        self,
        state: State,
        first: WireState,
        unknown: Float[Array, " balances"],
        prescribed: dict[str, Any],
        step: Float[Array, ""],
        end: Float[Array, " unknowns"],
        share: Float[Array, "*grains wires"] | None = None,
        local: bool = False,
    ) -> tuple[WireState, Fractions, dict[str, Any]]:
        """The wires at the end, with the contraction of the start, all fractions, and the memory without mechanism.

        Of the transformation only a ``share`` takes place, if it is given.
        """
        temperature = end[: self.temperatures].reshape(self.temperature_shape)
        if "temperature" in prescribed:
            temperature = self._specimen_temperature(prescribed, state.memory)
        stress = self.mechanism.stress(unknown, prescribed, self._mechanism_context())
        if self._has_drag:
            stress = self.mechanism.with_drag(stress, end[-1])
        if local:
            fractions, mean = state.fractions, self._mean_fractions(state, first, temperature, stress)
        else:
            fractions = self._evolve_fractions(first, state.fractions, temperature, stress)
            mean = self._mean_over_grains(fractions)
        if share is not None:
            fractions = Fractions(*(a + share * (b - a) for a, b in zip(state.fractions, fractions, strict=True)))
            mean = self._mean_over_grains(fractions)
        last = WireState(
            first.time + step,
            temperature,
            mean,
            stress,
            first.contraction,
            first.accumulated_transformation,
        )
        last = self._in_surroundings(last, prescribed)
        memory = dict(state.memory) | self._clamp_temperature(state.memory, first, last, step)
        if self.all_effects:
            transformed = jnp.abs(last.fractions.martensite - first.fractions.martensite)
            last = last._replace(accumulated_transformation=first.accumulated_transformation + transformed)
            memory |= self._updated_memory((HeatEffect, MaterialEffect), memory, first, last, step)
        return last, fractions, memory

    def _drag(
        self, first: WireState, last: WireState, memory: dict[str, Any], step: Float[Array, ""]
    ) -> Float[Array, ""]:
        """Stress in Pa with which all effects with a drag oppose the contraction at the end of a step."""
        context, first, last = self._stage_context(), self._whole_wires(first), self._whole_wires(last)
        effects = [e for e in self._effects_of(MechanismEffect) if e.has_drag]
        total: Any = sum(
            checked_result(e, "drag", e.drag(first, last, memory[e.key], step, context), ()) for e in effects
        )
        return total

    def _heat_residual(
        self,
        state: State,
        first: WireState,
        last: WireState,
        memory_at_end: dict[str, Any],
        inputs: tuple[Any, ...],
        step: Float[Array, ""],
        search: tuple[bool, bool],
    ) -> Float[Array, "*cells wires"]:
        """Residual of the heat balance in K, by the Hermite-Simpson (``smajax.plant.heat``) or the trapezoidal rule.

        Args:
            state: The state at the start of the step.
            first: The wires there.
            last: The wires at the end.
            memory_at_end: Memory of the effects at the end.
            inputs: Net heat at the start in W/m^3, and the signals at start and end.
            step: Duration, s.
            search: Whether to use the trapezoidal rule, and derivatives by the unknowns only (``_residual``).
        """
        (rate, before, after), (coarse, local) = inputs, search
        ends = (first.temperature, last.temperature)
        rates = (rate, self._net_heat(last, memory_at_end, after))
        capacity = (self._heat_capacity(first.fractions.martensite), self._heat_capacity(last.fractions.martensite))
        stored = self._stored_heat(first, last)
        if coarse:
            return self.heat.trapezoidal_residual(ends, capacity, rates, stored, step)
        half = self.heat.midpoint_temperature(ends, capacity, rates, step)
        middle, memory = self._middle_of_step(state, first, last, half, step, local), state.memory
        memory_at_middle = memory | self._updated_memory((HeatEffect,), memory, first, middle, 0.5 * step)
        memory_at_middle |= self._clamp_temperature(memory, first, middle, 0.5 * step)
        rates = (rates[0], self._net_heat(middle, memory_at_middle, 0.5 * (before + after)), rates[1])
        capacities = (capacity[0], self._heat_capacity(middle.fractions.martensite), capacity[1])
        return self.heat.residual(ends, capacities, rates, stored, step)

    def _middle_of_step(
        self,
        state: State,
        first: WireState,
        last: WireState,
        temperature: Float[Array, "*cells wires"],
        step: Float[Array, ""],
        local: bool,
    ) -> WireState:
        """The wires in the middle of a step, at a temperature and the mean stress of both ends."""
        stress = 0.5 * (first.stress + last.stress)
        ambient, fan = (
            None if end is None or start is None else 0.5 * (start + end)
            for start, end in ((first.ambient, last.ambient), (first.fan, last.fan))
        )
        if local:
            fractions = self._mean_fractions(state, first, temperature, stress)
        else:
            fractions = self._mean_over_grains(self._evolve_fractions(first, state.fractions, temperature, stress))
        return WireState(
            first.time + 0.5 * step,
            temperature,
            fractions,
            stress,
            0.5 * (first.contraction + last.contraction),
            0.5 * (first.accumulated_transformation + last.accumulated_transformation),
            ambient,
            fan,
        )

    def _mean_fractions(
        self, state: State, first: WireState, temperature: Float[Array, "*cells wires"], stress: Float[Array, " wires"]
    ) -> Fractions:
        """The fractions of the cells after a step, with their derivatives by temperature and stress only.

        A grain depends on its temperature and its stress alone, so two tangents of all grains give the derivatives by
        all unknowns.
        """

        def evolve(temperature: jax.Array, stress: jax.Array) -> Fractions:
            return self._evolve_grains(first, state.fractions, temperature, stress)

        temperatures = self._grain_temperatures(temperature)
        at = jax.lax.stop_gradient((temperatures, stress))

        def with_slopes(temperature: jax.Array, stress: jax.Array) -> tuple[Fractions, Fractions, Fractions]:
            value, tangent = jax.linearize(evolve, temperature, stress)
            ones, zeros = jnp.ones_like, jnp.zeros_like
            by_stress = zeros(temperature), ones(stress)
            no_slope = jax.tree.map(jnp.zeros_like, value)
            has_unknown = self.mechanism.unknowns or self._has_drag
            return value, tangent(ones(temperature), zeros(stress)), tangent(*by_stress) if has_unknown else no_slope

        value, by_temperature, by_stress = jax.lax.stop_gradient(with_slopes(*at))
        moved = temperature - jax.lax.stop_gradient(temperature), self._per_cell(stress - at[1])
        slopes = Fractions(*map(self._mean_slope, by_temperature)), self._mean_over_grains(by_stress)
        return Fractions(
            *(
                v + self._change_in_cells(t, moved[0]) + s * moved[1]
                for v, t, s in zip(self._mean_over_grains(value), *slopes, strict=True)
            )
        )
