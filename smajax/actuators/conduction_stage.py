"""Time integration of heat conduction in a network of cells: the L-stable SDIRK rule of two stages and second order.

A cooling runs through ``STAGES`` stages of ``STEPS`` equal steps. The steps of each stage are twice as long as those of
the stage before: the first stages resolve the cooling of the wires, the last ones that of the whole section. What this
buys: a stage has one matrix, which is factored once, and a stage is one step of the diffrax solver here.

Source: alexander1977.
"""

import math
from typing import Any, ClassVar, NamedTuple

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.block_tridiagonal import FivePointMatrix

# Number of stages, and of steps in a stage; chosen by trial, tests/unit/actuators/test_cross_section.py holds them
# against series and finite elements.
STAGES = 10
STEPS = 12
# Diagonal coefficient of the L-stable rule. Source: alexander1977.
_GAMMA = 1.0 - math.sqrt(0.5)


class ThermalNetwork(NamedTuple):
    """Half a section as a thermal network of ``c`` columns and ``r`` rows of cells, per length of the actuator.

    Attributes:
        capacity: Heat capacities of the cells, shape ``(c, r)``, J/m/K.
        wire: Heat capacities of the wire in the cells, shape ``(c, r)``, J/m/K.
        columns: Conductances between columns, shape ``(c - 1, r)``, W/m/K.
        rows: Conductances between rows, shape ``(c, r - 1)``, W/m/K.
        air: Conductances to the air, shape ``(c, r)``, W/m/K.
    """

    capacity: jax.Array
    wire: jax.Array
    columns: jax.Array
    rows: jax.Array
    air: jax.Array

    def matrix(self, weight: Float[Array, ""]) -> FivePointMatrix:
        """Assemble the matrix of an implicit step: the capacities plus ``weight`` times the conductances.

        Args:
            weight: Weight of the conductances, s.

        Returns:
            The matrix in J/m/K, its blocks along the shorter side of the grid.
        """
        # Sum of the conductances of each cell, neighbour by neighbour.
        leaving = self.air.at[1:].add(self.columns).at[:-1].add(self.columns)
        leaving = leaving.at[:, 1:].add(self.rows).at[:, :-1].add(self.rows)
        diagonal, rows, columns = self.capacity + weight * leaving, weight * self.rows, weight * self.columns
        if self.is_tall:
            return FivePointMatrix(diagonal.T, columns.T, rows.T)
        return FivePointMatrix(diagonal, rows, columns)

    @property
    def is_tall(self) -> bool:
        """Whether there are more rows than columns."""
        return self.capacity.shape[0] < self.capacity.shape[1]


class StageRecord(NamedTuple):
    """Results of a stage.

    Attributes:
        excess: Excess temperature of the cells over ambient at the end of the stage, shape ``(c, r)``, K.
        total_lost: Heat lost to the air from the start of the cooling to the end of the stage, J/m.
        hottest: Excess of the hottest wire at the end of each step, shape ``(STEPS,)``, K.
        rate: Its rate of change, shape ``(STEPS,)``, K/s.
        stored: Heat above ambient at the end of each step, shape ``(STEPS,)``, J/m.
        lost: Heat lost to the air by the end of each step, shape ``(STEPS,)``, J/m.
    """

    excess: jax.Array
    total_lost: jax.Array
    hottest: jax.Array
    rate: jax.Array
    stored: jax.Array
    lost: jax.Array


class ConductionStage(dfx.AbstractSolver[Any]):
    """Stage of ``STEPS`` equal steps of Alexander's rule, as one step of a diffrax solver.

    ``args`` holds the network, and for each wire the weights of the cells around its centre, shape ``(w, c, r)``.
    """

    term_structure: ClassVar[type[dfx.AbstractTerm[Any, Any]]] = dfx.AbstractTerm
    interpolation_cls: ClassVar[type[dfx.LocalLinearInterpolation]] = dfx.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        """Return the order of the rule."""
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        """Return the solver's state: none."""
        return None

    def step(
        self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any
    ) -> tuple[Any, ...]:
        """Return the record of the stage from ``t0`` to ``t1``."""
        network, centres = args
        step = (t1 - t0) / STEPS
        matrix = network.matrix(_GAMMA * step)
        factors = matrix.factor()

        def solve(excess: jax.Array) -> tuple[jax.Array, jax.Array]:
            """Excess at the end of an implicit stage of the rule, and its rate of change."""
            right = network.capacity * excess
            end = matrix.solve(factors, right.T).T if network.is_tall else matrix.solve(factors, right)
            return end, (end - excess) / (_GAMMA * step)

        def advance(carry: tuple[Any, ...], _: None) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
            """Advance the excess temperatures and the lost heat by one step of the SDIRK rule."""
            excess, lost = carry
            early, rate = solve(excess)
            late, rate = solve(excess + (1.0 - _GAMMA) * step * rate)
            lost = lost + step * jnp.sum(network.air * ((1.0 - _GAMMA) * early + _GAMMA * late))
            temperatures, rates = (jnp.einsum("wcr,cr->w", centres, field) for field in (late, rate))
            hottest = jnp.argmax(temperatures)
            return (late, lost), (temperatures[hottest], rates[hottest], jnp.sum(network.capacity * late), lost)

        carry, rows = jax.lax.scan(advance, (y0.excess, y0.total_lost), None, length=STEPS)
        y1 = StageRecord(*carry, *rows)
        return y1, None, dict(y0=y0, y1=y1), None, dfx.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        """Return the state unchanged: diffrax requires this method, but the solver does not use it."""
        return y0
