"""A study: what is asked of every design. ``evaluate`` takes one design to its metrics; ``evaluate_batch`` many, compiled once."""

from collections.abc import Mapping
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters, simulate
from smajax.kinks import swing
from smajax.plant.material.base import Fractions
from smajax.plant.plant import Plant
from smajax.recording import Floats, Recording
from smajax.simulate import Code, Inputs
from smajax.sweep.bandwidth import Reached, find
from smajax.sweep.metrics import BANDWIDTH, METRICS, Response, settling, still
from smajax.sweep.wave import Span, Wave, lay, span
from smajax.units import CHANNELS, numbered

INPUT = "input."
_LEAST_STEPS = 40
# Another program is worth its compilation if it spares so many steps of designs.
_WORTH = 3_000_000
CODES = tuple(code.name for code in Code)


class AbstractStudy(eqx.Module):
    """Base class; ``names`` are those of the axes."""

    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """The metrics' names with their units."""
        raise NotImplementedError

    @property
    def batch(self) -> int:
        """Designs in one call of the compiled program on a processor: so many that its caches hold them."""
        return 64

    def numbers(self, steps: int) -> int:
        """How many numbers the simulation of one design holds at once, about."""
        return 1

    def longest(self, steps: int) -> str:
        """What to say of a design of so many steps that it is too large, and after it, in ``shorter``, what to do."""
        return f"a design takes {steps:,} steps"

    @property
    def shorter(self) -> str:
        """See ``longest``."""
        return "narrow the parameters"

    def steps(self, designs: Floats) -> np.ndarray:
        """How finely each design, ``(m, axes)``, has to be resolved: whole numbers, shape ``(m,)``."""
        raise NotImplementedError

    def programs(self, designs: Floats) -> np.ndarray:
        """The steps with which each design is simulated, shape ``(m,)``: as few different ones as pay, each a program of its own."""
        return programs(self.steps(designs))

    def program(self, design: Floats) -> int:
        """Steps that resolve a design, ``(axes,)``, and those around it, which share a program."""
        return _doubled(int(self.steps(np.asarray(design)[None])[0]))

    def alike(self, designs: Floats) -> Floats:
        """A number for each design, shape ``(m,)``, near for designs that do alike, which are the cheapest in one batch."""
        return np.zeros(len(designs))

    def evaluate(self, design: jax.Array, steps: int, differentiable: bool = False) -> tuple[dict[str, jax.Array], jax.Array]:
        """Metrics by name, scalars in the units of ``units``, of one design, shape ``(axes,)``; and the result code (``Code``).

        Metrics of a design whose simulation failed are NaN. Only a ``differentiable`` evaluation has derivatives.
        """
        raise NotImplementedError


class RigStudy(AbstractStudy):
    """A rig under a wave, or under a recording whose last of ``cycles`` equal parts is its last cycle.

    ``highest`` is the frequency in Hz up to which a bandwidth is looked for. How far a design is from settled is said for its own
    frequency, or for its bandwidth where it is farther there.
    """

    plant: Plant
    wanted: tuple[str, ...] = eqx.field(static=True)
    source: Wave | Recording = eqx.field(static=True)
    cycles: int = eqx.field(static=True)
    interpolation: str = eqx.field(static=True)
    highest: float = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """See ``AbstractStudy``."""
        own = CHANNELS[self.plant.mechanism.coordinate].unit
        return {n: BANDWIDTH.unit if n == "bandwidth" else METRICS[n].unit or own for n in self.wanted}

    @property
    def channels(self) -> tuple[str, ...]:
        """The channels that the metrics read."""
        wires = self.plant.mechanism.wires
        reads = [c for n in self.wanted if n in METRICS for c in METRICS[n].reads]
        return (self.plant.mechanism.coordinate, *dict.fromkeys(n for c in reads for n in numbered(c, wires)))

    def numbers(self, steps: int) -> int:
        """See ``AbstractStudy``: the channels at all steps; a bandwidth is read off three simulations."""
        runs = 1 + (3 if "bandwidth" in self.wanted else 0)
        return runs * (self.cycles + 1) * steps * (len(self.channels) + 2 * len(self.plant.signals))

    def longest(self, steps: int) -> str:
        """See ``AbstractStudy``."""
        slow = "input.frequency" if isinstance(self.source, Wave) else "input.recording"
        cycles = f"{self.cycles:,} cycles" if self.cycles > 1 else "1 cycle"
        return f"{slow}: at the slowest input, or with the fastest wire, {cycles} take {steps:,} steps each"

    @property
    def shorter(self) -> str:
        """See ``AbstractStudy``."""
        if isinstance(self.source, Wave):
            return "raise input.frequency, lower input.cycles, or begin wire.diameter higher"
        return "take a shorter recording, or begin wire.diameter higher"

    def steps(self, designs: Floats) -> np.ndarray:
        """See ``AbstractStudy``: steps in a cycle, each a thirtieth of the wire's time constant."""

        def of(design: jax.Array) -> jax.Array:
            plant, values = self._of(design)
            return self._period(values) / simulate.resolving_step(plant)

        found = np.asarray(jax.jit(jax.vmap(of))(jnp.asarray(designs)))
        return np.maximum(_LEAST_STEPS, np.ceil(np.where(np.isfinite(found), found, 0.0))).astype(int)

    def alike(self, designs: Floats) -> Floats:
        """See ``AbstractStudy``: how hot the input would hold the wire."""

        def of(design: jax.Array) -> jax.Array:
            plant, values = self._of(design)
            top = values.get("amplitude", jnp.ones(()))
            joule = plant.drive.joule(top, plant.material.resistivity(Fractions(jnp.zeros(()), jnp.zeros(()))), plant.wire)
            return joule / plant.heat.conductance(jnp.asarray(80.0), plant.wire)

        return np.nan_to_num(np.asarray(jax.jit(jax.vmap(of))(jnp.asarray(designs))))

    def evaluate(self, design: jax.Array, steps: int, differentiable: bool = False) -> tuple[dict[str, jax.Array], jax.Array]:
        """See ``AbstractStudy``."""
        plant, values = self._of(design)
        wires = plant.mechanism.wires
        resting = "time_to_cool" in self.wanted
        if isinstance(self.source, Wave):
            where = span(self.source, wires, steps, resting)
            inputs = lay(self.source, wires, steps, values, simulate.modes(plant) if resting else None)
        else:
            inputs, where = self._recorded(plant, steps)
        channels, code = simulate.watch(plant, inputs, self.channels)
        response = self._response(plant, inputs, channels)
        parts = {"cycle": response.cut(where.cycle), "rest": response.cut(where.rest), "all": response}
        found = {n: METRICS[n].read(parts[METRICS[n].part]) for n in self.wanted if n in METRICS}
        if "bandwidth" in self.wanted:
            found["bandwidth"], gap, worst = self._bandwidth(plant, values, steps, differentiable)
            code = jnp.maximum(code, worst)
            if "settling" in self.wanted:
                found["settling"] = jnp.maximum(found["settling"], gap)
        return {n: jnp.where(code == Code.done, found[n], jnp.nan) for n in self.wanted}, code

    def _of(self, design: jax.Array) -> tuple[Plant, dict[str, jax.Array]]:
        """The plant of a design, and what it says of the wave."""
        values = {n: design[k] for k, n in enumerate(self.names)}
        own = {n: v for n, v in values.items() if not n.startswith(INPUT)}
        return parameters.replace(self.plant, own), {n[len(INPUT) :]: v for n, v in values.items() if n.startswith(INPUT)}

    def _period(self, values: Mapping[str, jax.Array]) -> jax.Array:
        if isinstance(self.source, Wave):
            return 1.0 / jnp.asarray(values.get("frequency", self.source.frequency))
        return jnp.asarray((self.source.time[-1] - self.source.time[0]) / self.cycles)

    def _recorded(self, plant: Plant, steps: int) -> tuple[Inputs, Span]:
        recording = cast(Recording, self.source)
        length = float(recording.time[-1] - recording.time[0])
        inputs = simulate.lay_out(plant, recording, interpolation=self.interpolation, step=length / self.cycles / steps)
        last = int(np.searchsorted(recording.time, recording.time[-1] - length / self.cycles * (1 + 1e-9)))
        return inputs, Span(slice(last, len(recording)), slice(0, 0))

    def _response(self, plant: Plant, inputs: Inputs, channels: dict[str, jax.Array]) -> Response:
        mechanism = plant.mechanism
        time, motion = inputs.time[inputs.rows], plant.wire.motion_per_strain
        return Response(time, channels, mechanism.coordinate, mechanism.wires, motion, plant.environment.ambient, mechanism.parallel)

    def _bandwidth(self, plant: Plant, values: Mapping[str, jax.Array], steps: int, differentiable: bool) -> tuple[jax.Array, ...]:
        """The bandwidth, how far the least settled simulation that it is read off is from settled, and the worst code of all."""
        wave = cast(Wave, self.source)
        cycle = span(wave, plant.mechanism.wires, steps, False).cycle

        def reach(plant: Plant, values: Mapping[str, jax.Array], frequency: jax.Array) -> Reached:
            inputs = lay(wave, plant.mechanism.wires, steps, {**values, "frequency": frequency})
            channels, code = simulate.watch(plant, inputs, self.channels)
            last = self._response(plant, inputs, channels).cut(cycle)
            return Reached(swing(last.channels[last.coordinate]), settling(last) if "settling" in self.wanted else jnp.zeros(()), code)

        lowest = jnp.asarray(values.get("frequency", wave.frequency), jnp.float64)
        held, fixed = jax.lax.stop_gradient((plant, dict(values)))
        again = (lambda frequency: reach(plant, values, frequency)) if differentiable else None
        return find(lambda frequency: reach(held, fixed, frequency), lowest, self.highest, again, still(held))


class MachineStudy(AbstractStudy):
    """A machine that is no rig: a module with declared parameters that gives its own metrics."""

    machine: Any
    wanted: tuple[str, ...] = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """See ``AbstractStudy``."""
        return {n: self.machine.units[n] for n in self.wanted}

    @property
    def batch(self) -> int:
        """See ``AbstractStudy``: the machine's own."""
        return self.machine.batch

    def steps(self, designs: Floats) -> np.ndarray:
        """See ``AbstractStudy``: a machine resolves itself, but in one layout."""
        return np.array([self.machine.layout(dict(zip(self.names, map(float, design), strict=True))) for design in designs], int)

    def programs(self, designs: Floats) -> np.ndarray:
        """See ``AbstractStudy``: no layout stands in for another."""
        return self.steps(designs)

    def program(self, design: Floats) -> int:
        """See ``AbstractStudy``: the design's layout."""
        return int(self.steps(np.asarray(design)[None])[0])

    def evaluate(self, design: jax.Array, steps: int, differentiable: bool = False) -> tuple[dict[str, jax.Array], jax.Array]:
        """See ``AbstractStudy``."""
        machine = parameters.replace(self.machine, {n: design[k] for k, n in enumerate(self.names)}).laid_out(steps)
        found = machine.metrics()
        # An infinite figure is one: a wire that never warms has no end to its heating time.
        failed = jnp.any(jnp.stack([jnp.isnan(found[n]) for n in self.wanted]))
        return {n: found[n] for n in self.wanted}, jnp.where(failed, Code.diverged, Code.done)


def _evaluate_batch(study: AbstractStudy, designs: jax.Array, steps: int) -> tuple[dict[str, jax.Array], jax.Array]:
    """Metrics by name, each ``(m,)``, and codes, ``(m,)``, of designs ``(m, axes)``."""
    return jax.vmap(lambda design: study.evaluate(design, steps))(designs)


# As for ``simulate_batch``: wide vectors are what a batch is made of.
evaluate_batch: Any = eqx.filter_jit(_evaluate_batch, compiler_options={"xla_cpu_prefer_vector_width": 512})  # pyright: ignore[reportCallIssue]


@eqx.filter_jit
def differentiate_batch(study: AbstractStudy, designs: jax.Array, steps: int) -> tuple[dict, dict, jax.Array]:
    """As ``evaluate_batch``, with the metrics' derivatives in the axes, each ``(m, axes)``, between metrics and codes."""

    def both(design: jax.Array) -> tuple[dict, tuple[dict, jax.Array]]:
        found, code = study.evaluate(design, steps, differentiable=True)
        return found, (found, code)

    slopes, (found, codes) = jax.vmap(jax.jacfwd(both, has_aux=True))(designs)
    return found, slopes, codes


def programs(wanted: np.ndarray) -> np.ndarray:
    """The steps with which each design is simulated, shape ``(m,)``, from those that it wants: as few different ones as pay."""
    levels = sorted({_doubled(n) for n in wanted}, reverse=True)
    chosen = levels[:1]
    for level in levels[1:]:
        if np.sum(wanted <= level) * (chosen[-1] - level) > _WORTH:
            chosen.append(level)
    given = np.empty_like(wanted)
    for level in chosen:
        inside = wanted <= level
        given[inside] = wanted[inside].max()
    return given


def _doubled(steps: int) -> int:
    """The next power of two."""
    return 1 << (int(steps) - 1).bit_length()
