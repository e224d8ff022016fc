"""How the cross-section of a flexural actuator cools: heat conduction in two dimensions, after the wires were heated.

    rho c dT/dt = div(k grad T),        -k dT/dn = h (T - T_ambient) at the surface        (flexural paper, section 3.1)

Two sheets of tape with silicone between them, in the silicone a row of wires; perfect contact, no latent heat. Finite volumes on half the
section (``section_grid``): what leaves a cell enters its neighbour, so that heat is conserved to rounding.

In time the L-stable SDIRK rule of two stages and second order (Alexander 1977) runs through stages of equal steps, each stage's twice as
long as the one's before: the first resolve the wires' own cooling, the last that of the whole section. A stage has one matrix, which is
factored once; it is one step of the diffrax solver here, the second place beside ``smajax.simulate`` that calls diffrax.
"""

import math
from typing import Any, NamedTuple, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.machines.block_tridiagonal import FivePoint
from smajax.machines.section_grid import AbstractPlacement, Columns, graded, place
from smajax.parameters import parameter

_STAGES, _STEPS = 10, 12
_GAMMA = 1.0 - math.sqrt(0.5)


class Layer(eqx.Module):
    """A sheet of one material."""

    thickness: jax.Array = parameter("m", "thickness of the layer", 1e-6, 0.1)
    density: jax.Array = parameter("kg/m^3", "density", 1.0, 3e4)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass", 10.0, 1e4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity", 1e-3, 1e3)


class SectionWire(eqx.Module):
    """The wires in the section, all alike."""

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    density: jax.Array = parameter("kg/m^3", "density of the wire", 1.0, 3e4, 6450.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the wire", 10.0, 1e4, 837.4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the wire", 1e-3, 1e3, 18.0)
    offset: jax.Array = parameter("m", "distance of the wires' row above the midplane", -0.1, 0.1, 0.0)


class Cooling(eqx.Module):
    """The air around the section, and the temperatures from which it cools."""

    convection: jax.Array = parameter("W/m^2/K", "convection coefficient at the surface", 0.0, 1e5, 10.0)
    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 20.0)
    wire_start: jax.Array = parameter("degC", "temperature of the wires as cooling begins", -100.0, 800.0, 80.0)
    elastomer_start: jax.Array = parameter("degC", "temperature of tape and silicone as cooling begins", -100.0, 800.0, 50.0)


class Course(NamedTuple):
    """A cooling: at ``t`` times (s, shape ``(t,)``, the first is 0) the temperature at the centre of the hottest wire (degC) and its rate
    (K/s); of every length of half the section the heat above ambient that it holds and that it has lost to the air since the start, J/m;
    and at the ends of the stages, ``s`` times, the temperatures of all cells, shape ``(s, c, r)``, degC."""

    time: jax.Array
    hottest: jax.Array
    rate: jax.Array
    stored: jax.Array
    lost: jax.Array
    ends: jax.Array
    fields: jax.Array

    def at(self, time: jax.Array | float) -> jax.Array:
        """The hottest wire's temperature at a time within the course, degC, by the cubic through both ends of the step."""
        k = jnp.clip(jnp.searchsorted(self.time, time, side="right") - 1, 0, len(self.time) - 2)
        return _cubic(self, k, (time - self.time[k]) / (self.time[k + 1] - self.time[k]))

    def cooled(self, target: jax.Array | float) -> jax.Array:
        """When the hottest wire first is down at a temperature (degC), s; infinite if that is later than the course ends."""
        below = self.hottest <= target
        k = jnp.maximum(jnp.argmax(below), 1) - 1
        step = self.time[k + 1] - self.time[k]

        def halve(_: int, ends: tuple) -> tuple:
            low, high = ends
            middle = 0.5 * (low + high)
            warm = _cubic(self, k, middle) > target
            return jnp.where(warm, middle, low), jnp.where(warm, high, middle)

        share = jax.lax.stop_gradient(jax.lax.fori_loop(0, 60, halve, (jnp.zeros(()), jnp.ones(())))[1])
        slope = jax.lax.stop_gradient(jax.grad(lambda s: _cubic(jax.lax.stop_gradient(self), k, s))(share))
        found = self.time[k] + step * (share - (_cubic(self, k, share) - target) / jnp.where(slope < 0.0, slope, -1.0))
        found = jnp.where(below[0], 0.0, jnp.where(jnp.any(below), found, jnp.inf))
        return jnp.where(jnp.isnan(self.hottest[-1]), jnp.nan, found)


def _cubic(course: Course, k: jax.Array, share: jax.Array) -> jax.Array:
    """The hottest temperature within step ``k``, at a share of 0..1 of it."""
    step, other = course.time[k + 1] - course.time[k], 1.0 - share
    ends = other**2 * (1.0 + 2.0 * share) * course.hottest[k] + share**2 * (3.0 - 2.0 * share) * course.hottest[k + 1]
    return ends + share * other * step * (other * course.rate[k] - share * course.rate[k + 1])


class _Network(NamedTuple):
    """Half the section as a network of ``(c, r)`` cells, per length: heat capacities (J/m/K), the part of each that is wire, conductances
    between columns ``(c - 1, r)`` and rows ``(c, r - 1)``, and to the air ``(c, r)`` (W/m/K)."""

    capacity: jax.Array
    wire: jax.Array
    columns: jax.Array
    rows: jax.Array
    air: jax.Array

    def matrix(self, weight: jax.Array) -> FivePoint:
        """Capacity plus ``weight`` times the conductances, its blocks along the shorter side of the grid."""
        leaving = self.air.at[1:].add(self.columns).at[:-1].add(self.columns).at[:, 1:].add(self.rows).at[:, :-1].add(self.rows)
        parts = self.capacity + weight * leaving, weight * self.rows, weight * self.columns
        return FivePoint(parts[0].T, parts[2].T, parts[1].T) if self.tall else FivePoint(*parts)

    @property
    def tall(self) -> bool:
        """Whether there are more rows than columns."""
        return self.capacity.shape[0] < self.capacity.shape[1]


class _Record(NamedTuple):
    """What a stage leaves: the cells' excess over ambient at its end, the heat lost by then, and its ``_STEPS`` rows of a ``Course``."""

    excess: jax.Array
    gone: jax.Array
    hottest: jax.Array
    rate: jax.Array
    stored: jax.Array
    lost: jax.Array


class _Stage(dfx.AbstractSolver):
    """A stage of ``_STEPS`` equal steps of Alexander's rule as one step of diffrax.

    ``args`` is the network, and for each wire the weights of the cells around its centre, shape ``(w, c, r)``.
    """

    term_structure = dfx.AbstractTerm
    interpolation_cls = dfx.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> None:
        return None

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        network, centres = args
        step = (t1 - t0) / _STEPS
        matrix = network.matrix(_GAMMA * step)
        factors = matrix.factor()

        def solve(excess: jax.Array) -> tuple[jax.Array, jax.Array]:
            """The state of an implicit stage, and its rate."""
            right = network.capacity * excess
            end = matrix.solve(factors, right.T).T if network.tall else matrix.solve(factors, right)
            return end, (end - excess) / (_GAMMA * step)

        def single(carry: tuple, _: None) -> tuple[tuple, tuple]:
            excess, gone = carry
            early, rate = solve(excess)
            late, rate = solve(excess + (1.0 - _GAMMA) * step * rate)
            gone = gone + step * jnp.sum(network.air * ((1.0 - _GAMMA) * early + _GAMMA * late))
            temperatures, rates = (jnp.einsum("wcr,cr->w", centres, field) for field in (late, rate))
            hottest = jnp.argmax(temperatures)
            return (late, gone), (temperatures[hottest], rates[hottest], jnp.sum(network.capacity * late), gone)

        carry, rows = jax.lax.scan(single, (y0.excess, y0.gone), None, length=_STEPS)
        y1 = _Record(*carry, *rows)
        return y1, None, dict(y0=y0, y1=y1), None, dfx.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        return y0


class CrossSection(eqx.Module):
    """Two sheets of tape, silicone between them, and a row of wires in the silicone.

    The wires have to fit: within the silicone, and side by side. Where they do not, every temperature is NaN.
    ``cells`` (even) lie across a wire, and the rest of the grid goes with them: as many from the wire's square to either tape, twice as
    many beside it, half as many across a tape. Ten are within a hundredth of finite elements for wires from a tenth of the silicone on.
    """

    tape: Layer
    silicone: Layer
    wire: SectionWire
    placement: AbstractPlacement
    cooling: Cooling
    width: jax.Array = parameter("m", "width of the section", 1e-4, 1.0)
    cells: int = eqx.field(static=True, default=10)

    def __check_init__(self) -> None:
        if self.cells < 4 or self.cells % 2:
            raise ValueError(f"{self.cells} cells across a wire are not an even number of at least 4")

    def grid(self) -> tuple[Columns, jax.Array]:
        """The columns, and the heights of the rows from below (m, shape ``(r,)``): tape, silicone, the wire's square, silicone, tape."""
        half, across = self.cells // 2, self.wire.diameter / self.cells
        aside = 0.5 * (self.silicone.thickness - self.wire.diameter)
        lower, upper = (graded(across, aside + side * self.wire.offset, self.cells) for side in (1.0, -1.0))
        tape = jnp.broadcast_to(self.tape.thickness / half, (half,))
        heights = jnp.concatenate([tape, lower[::-1], jnp.broadcast_to(across, (self.cells,)), upper, tape])
        return self.placement.columns(self.width, self.wire.diameter, self.cells), heights

    @property
    def _square(self) -> int:
        """The row in which the wires' squares begin."""
        return self.cells // 2 + self.cells

    def network(self) -> tuple[_Network, tuple[tuple[int, bool], ...]]:
        """The network of cells, and the wires' columns."""
        columns, heights = self.grid()
        shares = place(self.cells, columns.wires, self._square, (len(columns.widths), len(heights)))
        half, count = self.cells // 2, len(heights)
        is_tape = jnp.asarray((np.arange(count) < half) | (np.arange(count) >= count - half))
        around = jnp.where(is_tape, self.tape.conductivity, self.silicone.conductivity)
        stored = jnp.where(is_tape, self.tape.density * self.tape.heat_capacity, self.silicone.density * self.silicone.heat_capacity)
        x, z = columns.widths[:, None], heights[None, :]
        wire = x * z * shares.area * self.wire.density * self.wire.heat_capacity
        capacity = wire + x * z * (1.0 - shares.area) * stored[None, :]

        def resistance(part: np.ndarray, depth: jax.Array) -> jax.Array:
            """Of half a cell, per area of each lane."""
            return 0.5 * depth[:, :, None] * (part / self.wire.conductivity + (1.0 - part) / around[None, :, None])

        left, right = (resistance(part, x) for part in (shares.left, shares.right))
        lower, upper = (resistance(part, z) for part in (shares.lower, shares.upper))
        between_columns = z * jnp.mean(1.0 / (right[:-1] + left[1:]), axis=2)
        between_rows = x * jnp.mean(1.0 / (upper[:, :-1] + lower[:, 1:]), axis=2)

        def to_air(size: jax.Array, resistance: jax.Array) -> jax.Array:
            h = self.cooling.convection
            return size * jnp.mean(h / (1.0 + h * resistance), axis=1)

        air = jnp.zeros(capacity.shape)
        air = air.at[:, 0].add(to_air(columns.widths, lower[:, 0])).at[:, -1].add(to_air(columns.widths, upper[:, -1]))
        air = air.at[-1].add(to_air(heights, right[-1])) if columns.open else air
        return _Network(capacity, wire, between_columns, between_rows, air), columns.wires

    def cool(self, duration: jax.Array | float) -> Course:
        """Cools for ``duration`` seconds; differentiable in every parameter, forward and reverse."""
        network, wires = self.network()
        cooling, half = self.cooling, self.cells // 2
        over = (cooling.wire_start - cooling.elastomer_start) * network.wire / network.capacity
        excess = cooling.elastomer_start - cooling.ambient + over
        centres = np.zeros((len(wires), *excess.shape))
        rows = slice(self._square + half - 1, self._square + half + 1)
        for weights, (start, outer_half) in zip(centres, wires, strict=True):
            weights[start if outer_half else slice(start + half - 1, start + half + 1), rows] = 0.5 if outer_half else 0.25

        none = jnp.zeros((_STEPS,))
        ends = jnp.asarray(duration) * np.concatenate([[0.0], (2.0 ** np.arange(1, _STAGES + 1) - 1.0) / (2.0**_STAGES - 1.0)])
        solution = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, args: y),  # not asked for: the solver's increments are its own
            _Stage(),
            ends[0],
            ends[-1],
            None,
            _Record(excess, jnp.zeros(()), none, none, none, none),
            args=(network, jnp.asarray(centres)),
            stepsize_controller=dfx.StepTo(ends),
            saveat=dfx.SaveAt(steps=True),
            max_steps=_STAGES,
            adjoint=dfx.DirectAdjoint(),
            throw=False,
        )
        record = cast(_Record, solution.ys)
        shares = (np.arange(_STEPS) + 1.0)[None, :] / _STEPS
        time = jnp.concatenate([ends[:1], (ends[:-1, None] + (ends[1:] - ends[:-1])[:, None] * shares).ravel()])
        start = jnp.max(jnp.einsum("wcr,cr->w", centres, excess))

        def joined(first: jax.Array, rows: jax.Array) -> jax.Array:
            return jnp.concatenate([first[None], rows.ravel()])

        return Course(
            time,
            joined(start, record.hottest) + cooling.ambient,
            joined(jnp.zeros(()), record.rate),
            joined(jnp.sum(network.capacity * excess), record.stored),
            joined(jnp.zeros(()), record.lost),
            ends[1:],
            record.excess + cooling.ambient,
        )
