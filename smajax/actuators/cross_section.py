"""Heat equation on the cross-section of an actuator that cools after its wires were heated, in two dimensions.

    rho c dT/dt = div(k grad T),        -k dT/dn = h (T - T_ambient) at the surface

The section consists of two sheets of tape, silicone between them, and a row of wires in the silicone. Contact is
perfect, and there is no latent heat. The equation is discretised by finite volumes on half the section
(``smajax.actuators.section_grid``). The heat that leaves a cell enters its neighbour, so heat is conserved to rounding.
``smajax.actuators.conduction_stage`` integrates in time.

Source: dauksher2021, section 3.1.
"""

from typing import cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.actuators.conduction_stage import STAGES, STEPS, ConductionStage, StageRecord, ThermalNetwork
from smajax.actuators.cooling_curve import CoolingCurve
from smajax.actuators.section_grid import AbstractPlacement, Columns, graded_widths
from smajax.actuators.wire_shares import place_shares
from smajax.parameters import CheckedModule, parameter


class Layer(CheckedModule):
    """Sheet of one material."""

    thickness: jax.Array = parameter("m", "thickness of the layer", 1e-6, 0.1)
    density: jax.Array = parameter("kg/m^3", "density", 1.0, 3e4)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass", 10.0, 1e4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity", 1e-3, 1e3)


class SectionWire(CheckedModule):
    """Wires in the section, all of one diameter and material."""

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    density: jax.Array = parameter("kg/m^3", "density of the wire", 1.0, 3e4, 6450.0)
    heat_capacity: jax.Array = parameter("J/kg/K", "heat capacity per mass of the wire", 10.0, 1e4, 837.4)
    conductivity: jax.Array = parameter("W/m/K", "thermal conductivity of the wire", 1e-3, 1e3, 18.0)
    offset: jax.Array = parameter("m", "distance of the wires' row above the midplane", -0.1, 0.1, 0.0)


class Cooling(CheckedModule):
    """Air around the section, and the temperatures at which cooling begins."""

    convection: jax.Array = parameter("W/m^2/K", "convection coefficient at the surface", 0.0, 1e5, 10.0)
    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 20.0)
    wire_start: jax.Array = parameter("degC", "temperature of the wires as cooling begins", -100.0, 800.0, 80.0)
    elastomer_start: jax.Array = parameter(
        "degC", "temperature of tape and silicone as cooling begins", -100.0, 800.0, 50.0
    )


class CrossSection(CheckedModule):
    """Two sheets of tape, silicone between them, and a row of wires in the silicone.

    The wires have to fit within the silicone and next to each other; otherwise every temperature is NaN.

    Attributes:
        tape: Both outer sheets.
        silicone: The layer between them.
        wire: The wires.
        placement: Positions of the wires across the width.
        cooling: The air, and the temperatures at the start.
        width: Width of the section, m.
        cells: Number of cells across a wire, even, at least 4. The rest of the grid follows from it: as many cells
            from the wire's square to either tape, twice as many in the gap next to it, half as many across a tape. With
            10 cells, results agree with finite elements within 1 % for wires of at least a tenth of the silicone's
            thickness (tests/unit/actuators/test_cross_section.py).
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

    def grid(self) -> tuple[Columns, Float[Array, " rows"]]:
        """Compute the grid of cells on half the section.

        Returns:
            The columns, and the heights of the rows, shape ``(r,)``, m. From below the rows are tape, silicone, the
            wire's square, silicone, tape.
        """
        half, across = self.cells // 2, self.wire.diameter / self.cells
        aside = 0.5 * (self.silicone.thickness - self.wire.diameter)
        lower, upper = (graded_widths(across, aside + side * self.wire.offset, self.cells) for side in (1.0, -1.0))
        tape = jnp.broadcast_to(self.tape.thickness / half, (half,))
        heights = jnp.concatenate([tape, lower[::-1], jnp.broadcast_to(across, (self.cells,)), upper, tape])
        return self.placement.columns(self.width, self.wire.diameter, self.cells), heights

    @property
    def _first_wire_row(self) -> int:
        return self.cells // 2 + self.cells

    def network(self) -> tuple[ThermalNetwork, tuple[tuple[int, bool], ...]]:
        """Assemble the thermal network of the cells.

        Returns:
            The network, and the columns of the wires as in ``Columns.wires``.
        """
        columns, heights = self.grid()
        shares = place_shares(self.cells, columns.wires, self._first_wire_row, (len(columns.widths), len(heights)))
        conductivity, volumetric_capacity = self._layer_properties(len(heights))
        x, z = columns.widths[:, None], heights[None, :]
        wire = x * z * shares.area * self.wire.density * self.wire.heat_capacity
        capacity = wire + x * z * (1.0 - shares.area) * volumetric_capacity[None, :]

        def resistance(part: np.ndarray, depth: jax.Array) -> jax.Array:
            """Thermal resistance of half a cell per area, of each lane, shape ``(c, r, LANES)``, m^2 K/W."""
            return (
                0.5 * depth[:, :, None] * (part / self.wire.conductivity + (1.0 - part) / conductivity[None, :, None])
            )

        left, right = (resistance(part, x) for part in (shares.left, shares.right))
        lower, upper = (resistance(part, z) for part in (shares.lower, shares.upper))
        between_columns = z * jnp.mean(1.0 / (right[:-1] + left[1:]), axis=2)
        between_rows = x * jnp.mean(1.0 / (upper[:, :-1] + lower[:, 1:]), axis=2)
        air = jnp.zeros(capacity.shape)
        air = air.at[:, 0].add(self._to_air(columns.widths, lower[:, 0]))
        air = air.at[:, -1].add(self._to_air(columns.widths, upper[:, -1]))
        air = air.at[-1].add(self._to_air(heights, right[-1])) if columns.open else air
        return ThermalNetwork(capacity, wire, between_columns, between_rows, air), columns.wires

    def _layer_properties(self, rows: int) -> tuple[jax.Array, jax.Array]:
        """Conductivity and heat capacity per volume of each row without its wires, shape ``(r,)``."""
        half, tape, silicone = self.cells // 2, self.tape, self.silicone
        is_tape = jnp.asarray((np.arange(rows) < half) | (np.arange(rows) >= rows - half))
        conductivity = jnp.where(is_tape, tape.conductivity, silicone.conductivity)
        capacity = jnp.where(is_tape, tape.density * tape.heat_capacity, silicone.density * silicone.heat_capacity)
        return conductivity, capacity

    def _to_air(self, size: jax.Array, resistance: jax.Array) -> jax.Array:
        """Conductance to the air of the cells at a surface, with the resistance of the cells in series, W/m/K."""
        h = self.cooling.convection
        return size * jnp.mean(h / (1.0 + h * resistance), axis=1)

    def cool(self, duration: Float[Array, ""] | float) -> CoolingCurve:
        """Simulate the cooling of the section; differentiable in every parameter, in both modes.

        Args:
            duration: Duration of the cooling, s.
        """
        network, wires = self.network()
        excess = self._initial_excess(network)
        centres = self._centre_weights(wires, excess.shape)
        zeros = jnp.zeros((STEPS,))
        # Each stage takes twice as long as the one before.
        ends = jnp.asarray(duration) * np.concatenate(
            [[0.0], (2.0 ** np.arange(1, STAGES + 1) - 1.0) / (2.0**STAGES - 1.0)]
        )
        solution = dfx.diffeqsolve(
            dfx.ODETerm(lambda t, y, args: y),  # unused: the solver computes its own increments
            ConductionStage(),
            ends[0],
            ends[-1],
            None,
            StageRecord(excess, jnp.zeros(()), zeros, zeros, zeros, zeros),
            args=(network, jnp.asarray(centres)),
            stepsize_controller=dfx.StepTo(ends),
            saveat=dfx.SaveAt(steps=True),
            max_steps=STAGES,
            adjoint=dfx.DirectAdjoint(),
            throw=False,
        )
        start = jnp.max(jnp.einsum("wcr,cr->w", centres, excess)), jnp.sum(network.capacity * excess)
        return self._curve(cast(StageRecord, solution.ys), ends, *start)

    def _initial_excess(self, network: ThermalNetwork) -> jax.Array:
        """Excess of the cells over ambient as cooling begins, ``(c, r)``; a cut cell has its mean temperature."""
        cooling = self.cooling
        over_elastomer = (cooling.wire_start - cooling.elastomer_start) * network.wire / network.capacity
        return cooling.elastomer_start - cooling.ambient + over_elastomer

    def _centre_weights(self, wires: tuple[tuple[int, bool], ...], shape: tuple[int, ...]) -> np.ndarray:
        """For each wire, the weights of the cells around its centre, shape ``(w, c, r)``."""
        half = self.cells // 2
        centres = np.zeros((len(wires), *shape))
        rows = slice(self._first_wire_row + half - 1, self._first_wire_row + half + 1)
        for weights, (start, is_half) in zip(centres, wires, strict=True):
            columns = start if is_half else slice(start + half - 1, start + half + 1)
            weights[columns, rows] = 0.5 if is_half else 0.25
        return centres

    def _curve(self, record: StageRecord, ends: jax.Array, hottest: jax.Array, stored: jax.Array) -> CoolingCurve:
        """Join the records of the stages, after the hottest excess and the stored heat at the start."""
        shares = (np.arange(STEPS) + 1.0)[None, :] / STEPS
        time = jnp.concatenate([ends[:1], (ends[:-1, None] + (ends[1:] - ends[:-1])[:, None] * shares).ravel()])

        def join(first: jax.Array, rows: jax.Array) -> jax.Array:
            return jnp.concatenate([first[None], rows.ravel()])

        return CoolingCurve(
            time=time,
            hottest=join(hottest, record.hottest) + self.cooling.ambient,
            rate=join(jnp.zeros(()), record.rate),
            stored=join(stored, record.stored),
            lost=join(jnp.zeros(()), record.lost),
            stage_ends=ends[1:],
            temperatures=record.excess + self.cooling.ambient,
        )
