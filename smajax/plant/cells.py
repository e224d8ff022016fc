"""Cells along the wire: heat conduction along it, and clamps at both ends.

    C_i dT_i/dt = joule_i - (4 / d) h_i(T_i) (T_i - T_ambient) + (q_(i+1) - q_i) / l_i
    q_i = k (T_i - T_(i-1)) / d_i        C_c dT_c/dt = a q_1 - G_c (T_c - T_ambient)

with the length l_i of cell i and the distance d_i between the middles of neighbouring cells. The heat flow q_i goes
towards the clamp; k is the thermal conductivity of the alloy. The clamp comes before cell 1, with the temperature T_c,
the heat capacity C_c and the conductance G_c to the surroundings; a is the cross-section of one wire. With a large
conductance the clamp stays at ambient temperature. Both clamps are equal, so half of the wire is simulated, from a
clamp to the middle, where no heat flows. The stress is equal along the wire, its strain is the mean over the cells by
their lengths, and its resistance is the sum of theirs.

Where a cell has grains, these are spread over its length, with a temperature that is linear between the middles of the
cells: a cold end then transforms gradually in few cells.

The cells are graded by the fin length sqrt(k d / (4 h)), the distance over which a cold end is felt: with m cells in
the half wire and r half its length over the fin length, boundary i is at sinh(i / m asinh(r)) / r of the half wire.

Source: incropera2007, sections 3.6 (fins) and 4.4 (finite volumes).
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, minimum
from smajax.parameters import CheckedModule, parameter
from smajax.plant.effects.memory import first_order_lag
from smajax.plant.heat import AbstractHeat
from smajax.plant.wire import AbstractWire, Environment


class CellGeometry(eqx.Module):
    """What the equations need of the cells that does not change over a simulation.

    Attributes:
        boundaries: Boundaries of the simulated cells, from the clamp at 0 to the middle of the wire, m. With an odd
            number of cells the last one is half of the middle cell.
        shares: Lengths of the cells over that of all of them.
        inflow: Heat that conduction brings into each cell per kelvin of each cell (last axis), W/m^3/K.
        from_clamp: The same per kelvin of the clamp.
        uneven: Excess of the convection coefficient of each cell over h(T), as a share.
        grain_weights: Weights of the temperatures of all cells (last axis) in the temperature of each grain; ``None``
            without grains.
    """

    boundaries: Float[Array, " ends"]
    shares: Float[Array, " cells"]
    inflow: Float[Array, "cells cells"]
    from_clamp: Float[Array, " cells"]
    uneven: Float[Array, " cells"]
    grain_weights: Float[Array, "grains cells cells"] | None


class Cells(CheckedModule):
    """Cells along each wire, with heat conduction between them and into the clamps.

    Attributes:
        count: Number of cells over the whole wire, at least 2.
    """

    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity along the wire", 1e-3, 1e3, 18.0)
    clamp_conductance: jax.Array = parameter("W/K", "conductance from one clamp to the surroundings", 1e-6, 1e3, 0.1)
    clamp_capacity: jax.Array = parameter("J/K", "heat capacity of one clamp", 1e-6, 1e4, 1.0)
    uneven_convection: jax.Array = parameter(
        "1",
        "excess of the convection at the ends over its mean, as a share; the middle has as much less",
        -0.9,
        0.9,
        0.0,
    )
    thermocouple_place: jax.Array = parameter(
        "1", "distance of a thermocouple from one clamp, as a share of the length", 0.0, 1.0, 0.5
    )
    count: int = eqx.field(static=True, default=9)

    @property
    def simulated(self) -> int:
        """Number of cells that are simulated: those of half the wire, with half of the middle one."""
        return (self.count + 1) // 2

    def geometry(
        self, wire: AbstractWire, heat: AbstractHeat, environment: Environment, grains: int | None
    ) -> CellGeometry:
        """Compute what the equations need of the cells.

        Args:
            wire: The wire.
            heat: The heat stage; its conductance at ambient temperature gives the fin length.
            environment: Surroundings of the wire; the cells do not follow a recorded ambient temperature.
            grains: Number of grains in each cell; ``None`` without grains.
        """
        half = 0.5 * wire.length_between_clamps
        ratio = half / jnp.sqrt(self.conductivity / heat.conductance(environment.ambient, wire))
        # In an odd number of cells the middle one counts half.
        place = jnp.minimum(jnp.arange(self.simulated + 1) / (0.5 * self.count), 1.0)
        boundaries = half * jnp.sinh(place * jnp.arcsinh(ratio)) / ratio
        inflow, from_clamp = self._conduction_matrix(boundaries)
        return CellGeometry(
            boundaries,
            jnp.diff(boundaries) / boundaries[-1],
            inflow,
            from_clamp,
            self.convection_factors(boundaries) - 1.0,
            None if grains is None else self._grain_weights(boundaries, grains),
        )

    def convection_factors(self, boundaries: Float[Array, " ends"]) -> Float[Array, " cells"]:
        """Compute the convection coefficient of each cell over that of h(T): 1 + u cos(2 pi x / L), averaged over it.

        Args:
            boundaries: Boundaries of the cells, m.
        """
        angle = jnp.pi * boundaries / boundaries[-1]
        return 1.0 + self.uneven_convection * jnp.diff(jnp.sin(angle)) / jnp.diff(angle)

    def net_heat(
        self,
        temperature: Float[Array, "cells wires"],
        clamp: Float[Array, " wires"],
        geometry: CellGeometry,
        wire: AbstractWire,
        heat: AbstractHeat,
        ambient: Float[Array, ""],
    ) -> Float[Array, "cells wires"]:
        """Compute the heat that conduction brings into each cell, and the difference of its convection from the mean.

        Args:
            temperature: Temperatures of the cells, degC.
            clamp: Temperature of the clamps, degC.
            geometry: What the equations need of the cells.
            wire: The wire.
            heat: The heat stage.
            ambient: Temperature of the surroundings, degC.

        Returns:
            Heat per volume, W/m^3.
        """
        # The temperatures of clamp and cells times a matrix that is constant over a simulation: faster than differences
        # of neighbours, which a compiled loop computes entry by entry (experiments/speed/cells_and_grains.py).
        inflow = jnp.sum(geometry.inflow[:, :, None] * temperature[None], axis=1)
        inflow = inflow + geometry.from_clamp[:, None] * clamp[None]
        uneven = geometry.uneven[:, None] * heat.conductance(temperature, wire)
        return inflow - uneven * (temperature - ambient)

    def _conduction_matrix(
        self, boundaries: Float[Array, " ends"]
    ) -> tuple[Float[Array, "cells cells"], Float[Array, " cells"]]:
        """Heat that conduction brings into each cell per kelvin of each cell (last axis) and of the clamp, W/m^3/K."""
        length = jnp.diff(boundaries)
        per_distance = self.conductivity / jnp.diff(self._middles(boundaries), prepend=0.0)
        before = per_distance / length
        after = per_distance[1:] / length[:-1]
        matrix = jnp.diag(after, 1) + jnp.diag(before[1:], -1) - jnp.diag(before + jnp.append(after, 0.0))
        return matrix, jnp.append(before[:1], jnp.zeros(self.simulated - 1))

    def clamp_temperature(
        self,
        clamp: Float[Array, " wires"],
        ends: tuple[Any, Any],
        ambient: tuple[Any, Any],
        step: Float[Array, ""],
        geometry: CellGeometry,
        wire: AbstractWire,
    ) -> Float[Array, " wires"]:
        """Compute the temperature of the clamps after a step in which their surroundings change linearly.

        Args:
            clamp: Temperature of the clamps at the start, degC.
            ends: Temperatures of the cells next to them, at start and end, degC.
            ambient: Temperature of the surroundings at start and end, degC.
            step: Duration, s.
            geometry: What the equations need of the cells.
            wire: The wire.

        Returns:
            Temperature of the clamps at the end, degC.
        """
        conductance = self.conductivity * jnp.pi / 4 * wire.diameter**2 / (0.5 * geometry.boundaries[1])
        total = conductance + self.clamp_conductance
        first, last = (
            (conductance * end + self.clamp_conductance * at) / total for end, at in zip(ends, ambient, strict=True)
        )
        return first_order_lag(clamp, first, last, step, self.clamp_capacity / total)

    def reading(self, temperature: Float[Array, "cells wires"], geometry: CellGeometry) -> Float[Array, " wires"]:
        """Compute the temperature at the place of the thermocouple, linear between the middles of the cells.

        Args:
            temperature: Temperatures of the cells, degC.
            geometry: What the equations need of the cells.
        """
        boundaries = geometry.boundaries
        place = minimum(self.thermocouple_place, 1.0 - self.thermocouple_place)
        middles = self._middles(boundaries)
        weights = clip((2.0 * place * boundaries[-1] - middles[:-1]) / jnp.diff(middles), 0.0, 1.0)
        return temperature[0] + weights @ jnp.diff(temperature, axis=0)

    def _grain_weights(self, boundaries: Float[Array, " ends"], grains: int) -> Float[Array, "grains cells cells"]:
        """Weights of the temperatures of all cells (last axis) in the temperature of each grain.

        The grains of a cell are spread over its length, with a temperature that is linear between the middles of the
        cells, so that a cold end transforms gradually in few cells. Their mean temperature is that of the cell.
        """
        if self.simulated == 1:
            return jnp.ones((grains, 1, 1))
        middles, length = self._middles(boundaries), jnp.diff(boundaries)
        places, cells = self._grain_places(grains), jnp.eye(self.simulated)
        offset = boundaries[None, :-1] + (0.5 + places) * length[None] - middles[None]
        slope = jnp.diff(cells, axis=0) / jnp.diff(middles)[:, None]
        before = jnp.concatenate([slope[:1], slope])
        after = jnp.concatenate([slope, jnp.zeros_like(slope[:1])])
        # The middle of an odd number of cells is at the end of the last one, so all of its grains come before it.
        is_after = (places > 0.0) & (np.arange(self.simulated) < self.simulated - self.count % 2)
        difference = offset[:, :, None] * jnp.where(is_after[:, :, None], after[None], before[None])
        return cells[None] + difference - jnp.mean(difference, axis=0, keepdims=True)

    def _grain_places(self, grains: int) -> np.ndarray:
        """Places of the grains in their cells, from -1/2 to 1/2, shape ``(grains, cells)``.

        Their order differs from that of the transformation temperatures, and between neighbouring cells.
        """
        golden = next(n for n in range(round(0.618 * grains), grains + 2) if n > 0 and math.gcd(n, grains) == 1)
        places = ((np.arange(grains) * golden) % grains + 0.5) / grains - 0.5
        return np.where(np.arange(self.simulated) % 2, -places[:, None], places[:, None])

    def _middles(self, boundaries: jax.Array) -> jax.Array:
        """Distances of the middles of the cells from the clamp; that of an odd number of cells is at half the wire."""
        middles = 0.5 * (boundaries[1:] + boundaries[:-1])
        return jnp.append(middles[:-1], boundaries[-1]) if self.count % 2 else middles
