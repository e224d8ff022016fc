"""The sweep problem of a rig: its response to a periodic input or a recording, and the metrics that are read off it."""

from collections.abc import Mapping
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.channels import CHANNELS, numbered
from smajax.numerics.nonsmooth import peak_to_peak
from smajax.plant.materials.base import Fractions
from smajax.plant.plant import Plant
from smajax.recordings.recording import Floats, Recording
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import simulate_channels
from smajax.simulation.status import SimulationStatus
from smajax.simulation.step_size import resolving_step, time_constant_bounds
from smajax.sweeps.bandwidth import FrequencyPoint, find_bandwidth
from smajax.sweeps.excitation import Excitation, GridParts, discretise_excitation, grid_parts
from smajax.sweeps.metrics import BANDWIDTH, METRICS, Response, motionless_stroke, settling
from smajax.sweeps.problem import INPUT, AbstractSweepProblem

# Steps of a cycle at least, so that a slow wire's input and extremes are resolved, too. Chosen by trial;
# test_metrics_agree_with_the_exact_reference of tests/unit/sweeps/test_sweeps.py holds the accuracy.
_MIN_STEPS = 40
# Temperature in degC at which designs are compared by how hot their input would hold the wire; it only sorts batches.
_WARM = 80.0
# Rounding of a recording's times, relative to a cycle.
_TIME_TOLERANCE = 1e-9


class RigSweepProblem(AbstractSweepProblem):
    """A rig under a periodic input, or under a recording whose last of ``cycles`` equal parts is its last cycle.

    The settling gap of a design is that at its own frequency, or that at its bandwidth where it is larger there.

    Args:
        plant: The rig's plant.
        metrics: Metrics to evaluate.
        source: The input.
        cycles: Number of cycles of the input.
        interpolation: How a recording is interpolated between its rows.
        max_frequency: Frequency in Hz up to which a bandwidth is searched for.
    """

    plant: Plant
    metrics: tuple[str, ...] = eqx.field(static=True)
    source: Excitation | Recording = eqx.field(static=True)
    cycles: int = eqx.field(static=True)
    interpolation: str = eqx.field(static=True)
    max_frequency: float = eqx.field(static=True)

    @property
    def units(self) -> dict[str, str]:
        """Internal units by metric."""
        own = CHANNELS[self.plant.mechanism.coordinate].unit
        return {n: BANDWIDTH.unit if n == "bandwidth" else METRICS[n].unit or own for n in self.metrics}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the metrics read."""
        wires = self.plant.mechanism.wires
        reads = [c for n in self.metrics if n in METRICS for c in METRICS[n].reads]
        return (self.plant.mechanism.coordinate, *dict.fromkeys(n for c in reads for n in numbered(c, wires)))

    def numbers(self, steps: int) -> int:
        """Return about how many numbers one design holds: channels at all steps; a bandwidth takes three runs."""
        runs = 1 + (3 if "bandwidth" in self.metrics else 0)
        return runs * (self.cycles + 1) * steps * (len(self.channels) + 2 * len(self.plant.signals))

    def size_message(self, steps: int) -> str:
        """Return what to say of a design that needs too much memory: the key to blame, and the steps of its cycles."""
        slow = "input.frequency" if isinstance(self.source, Excitation) else "input.recording"
        cycles = f"{self.cycles:,} cycles" if self.cycles > 1 else "1 cycle"
        return f"{slow}: at the slowest input, or with the fastest wire, {cycles} take {steps:,} steps each"

    @property
    def size_hint(self) -> str:
        """What to change where a design needs too much memory."""
        if isinstance(self.source, Excitation):
            return "raise input.frequency, lower input.cycles, or begin wire.diameter higher"
        return "take a shorter recording, or begin wire.diameter higher"

    def steps(self, designs: Floats) -> np.ndarray:
        """Return the steps of a cycle that resolve each design; see ``simulation.step_size.resolving_step``."""

        def steps_of(design: jax.Array) -> jax.Array:
            plant, values = self._apply(design)
            return self._period(values) / resolving_step(plant)

        steps = np.asarray(jax.jit(jax.vmap(steps_of))(jnp.asarray(designs)))
        return np.maximum(_MIN_STEPS, np.ceil(np.where(np.isfinite(steps), steps, 0.0))).astype(int)

    def batch_order(self, designs: Floats) -> Floats:
        """Return how hot the input would hold each design's wire, by which designs are sorted into batches."""

        def excess(design: jax.Array) -> jax.Array:
            plant, values = self._apply(design)
            amplitude = values.get("amplitude", jnp.ones(()))
            austenite = Fractions(jnp.zeros(()), jnp.zeros(()))
            joule = plant.drive.joule(amplitude, plant.material.resistivity(austenite), plant.wire)
            return joule / plant.heat.conductance(jnp.asarray(_WARM), plant.wire)

        return np.nan_to_num(np.asarray(jax.jit(jax.vmap(excess))(jnp.asarray(designs))))

    def evaluate(
        self, design: jax.Array, steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], jax.Array]:
        """Simulate one design; see ``AbstractSweepProblem``."""
        plant, values = self._apply(design)
        wires = plant.mechanism.wires
        rests = "time_to_cool" in self.metrics
        if isinstance(self.source, Excitation):
            where = grid_parts(self.source, wires, steps, rests)
            modes = time_constant_bounds(plant) if rests else None
            inputs = discretise_excitation(self.source, wires, steps, values, modes)
        else:
            inputs, where = self._recorded_input(plant, steps)
        channels, code = simulate_channels(plant, inputs, self.channels)
        response = self._response(plant, inputs, channels)
        parts = {"cycle": response.cut(where.cycle), "rest": response.cut(where.rest), "all": response}
        metrics = {n: METRICS[n].read(parts[METRICS[n].part]) for n in self.metrics if n in METRICS}
        if "bandwidth" in self.metrics:
            metrics["bandwidth"], gap, worst_code = self._bandwidth(plant, values, steps, differentiable)
            code = jnp.maximum(code, worst_code)
            if "settling" in self.metrics:
                metrics["settling"] = jnp.maximum(metrics["settling"], gap)
        return {n: jnp.where(code == SimulationStatus.done, metrics[n], jnp.nan) for n in self.metrics}, code

    def _apply(self, design: jax.Array) -> tuple[Plant, dict[str, jax.Array]]:
        """The plant of a design, and its values of the input by key."""
        values = {n: design[k] for k, n in enumerate(self.names)}
        own = {n: v for n, v in values.items() if not n.startswith(INPUT)}
        return parameters.replace(self.plant, own), {
            n[len(INPUT) :]: v for n, v in values.items() if n.startswith(INPUT)
        }

    def _period(self, values: Mapping[str, jax.Array]) -> jax.Array:
        if isinstance(self.source, Excitation):
            return 1.0 / jnp.asarray(values.get("frequency", self.source.frequency))
        return jnp.asarray((self.source.time[-1] - self.source.time[0]) / self.cycles)

    def _recorded_input(self, plant: Plant, steps: int) -> tuple[Inputs, GridParts]:
        recording = cast(Recording, self.source)
        length = float(recording.time[-1] - recording.time[0])
        inputs = discretise(plant, recording, interpolation=self.interpolation, step=length / self.cycles / steps)
        last_start = recording.time[-1] - length / self.cycles * (1 + _TIME_TOLERANCE)
        last = int(np.searchsorted(recording.time, last_start))
        return inputs, GridParts(slice(last, len(recording)), slice(0, 0))

    def _response(self, plant: Plant, inputs: Inputs, channels: dict[str, jax.Array]) -> Response:
        mechanism = plant.mechanism
        time, motion = inputs.time[inputs.sample_indices], plant.wire.motion_per_strain
        return Response(
            time,
            channels,
            mechanism.coordinate,
            mechanism.wires,
            motion,
            plant.environment.ambient,
            mechanism.parallel_wires,
        )

    def _bandwidth(
        self, plant: Plant, values: Mapping[str, jax.Array], steps: int, differentiable: bool
    ) -> tuple[jax.Array, ...]:
        """The bandwidth, the largest settling gap of the simulations that it is read off, and the worst code of all."""
        excitation = cast(Excitation, self.source)
        cycle = grid_parts(excitation, plant.mechanism.wires, steps, False).cycle

        def respond(plant: Plant, values: Mapping[str, jax.Array], frequency: jax.Array) -> FrequencyPoint:
            at_frequency = {**values, "frequency": frequency}
            inputs = discretise_excitation(excitation, plant.mechanism.wires, steps, at_frequency)
            channels, code = simulate_channels(plant, inputs, self.channels)
            last = self._response(plant, inputs, channels).cut(cycle)
            return FrequencyPoint(
                peak_to_peak(last.channels[last.coordinate]),
                settling(last) if "settling" in self.metrics else jnp.zeros(()),
                code,
            )

        lowest = jnp.asarray(values.get("frequency", excitation.frequency), jnp.float64)
        constant_plant, constant_values = jax.lax.stop_gradient((plant, dict(values)))
        return find_bandwidth(
            lambda frequency: respond(constant_plant, constant_values, frequency),
            lowest,
            self.max_frequency,
            (lambda frequency: respond(plant, values, frequency)) if differentiable else None,
            motionless_stroke(constant_plant),
        )
