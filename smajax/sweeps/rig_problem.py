"""Sweep problem of a rig: its response to a periodic input or a recording, and the metrics of that response."""

from collections.abc import Mapping
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax import parameters
from smajax.channels import CHANNELS, numbered
from smajax.numerics.nonsmooth import peak_to_peak
from smajax.plant.materials.base import Fractions
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import Inputs, discretise
from smajax.simulation.run import simulate_channels
from smajax.simulation.status import SimulationStatus
from smajax.simulation.step_size import resolving_step, time_constant_bounds
from smajax.sweeps.bandwidth import FrequencyPoint, find_bandwidth
from smajax.sweeps.excitation import Excitation, GridParts, discretise_excitation, grid_parts
from smajax.sweeps.margins import Margins, evaluate_with_margins
from smajax.sweeps.metrics import BANDWIDTH, METRICS, Response, motionless_stroke, response_of, settling
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.schema import INPUT

# Smallest number of steps of a cycle, so that the input and the extremes of a slow wire are resolved. Chosen by trial;
# test_metrics_agree_with_the_exact_reference of tests/unit/sweeps/test_sweeps.py checks the accuracy.
_MIN_STEPS = 40
# Temperature in degC at which the heat loss of designs is compared; it only sorts designs into batches.
_WARM = 80.0
# Rounding error of a recording's times, relative to a cycle.
_TIME_TOLERANCE = 1e-9


class RigSweepProblem(AbstractSweepProblem):
    """Sweep problem of a rig under a periodic input or a recording.

    A recording is divided into ``cycles`` equal parts, and the last part is its last cycle. If a bandwidth is
    evaluated, the settling gap of a design is the largest of those at its own frequency and at its bandwidth.

    Attributes:
        plant: The rig's plant.
        metrics: Names of the metrics to evaluate.
        source: The periodic input or the recording.
        cycles: Number of cycles of the input.
        interpolation: Interpolation of a recording between its rows, ``hold`` or ``linear``.
        max_frequency: Frequency in Hz up to which a bandwidth is searched for.
        margins: Deviations of parameters, with which each design is simulated as well; ``None`` for none.
    """

    plant: Plant
    metrics: tuple[str, ...] = eqx.field(static=True)
    source: Excitation | Recording = eqx.field(static=True)
    cycles: int = eqx.field(static=True)
    interpolation: str = eqx.field(static=True)
    max_frequency: float = eqx.field(static=True)
    margins: Margins | None = eqx.field(static=True, default=None)

    @property
    def units(self) -> dict[str, str]:
        """Internal units by metric."""
        own = CHANNELS[self.plant.mechanism.coordinate].unit
        units = {n: BANDWIDTH.unit if n == "bandwidth" else METRICS[n].unit or own for n in self.metrics}
        if self.margins is None:
            return units
        return units | {n: units[self.margins.metric_of(n)] for n in self.margins.metrics}

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that the metrics read."""
        wires = self.plant.mechanism.wires
        reads = [c for n in self.metrics if n in METRICS for c in METRICS[n].reads]
        return (self.plant.mechanism.coordinate, *dict.fromkeys(n for c in reads for n in numbered(c, wires)))

    def numbers(self, steps: int) -> int:
        """Return about how many numbers one design stores: channels at all steps; a bandwidth adds three runs."""
        runs = 1 + (3 if "bandwidth" in self.metrics else 0)
        runs *= len(self.margins.deviations) if self.margins else 1
        return runs * (self.cycles + 1) * steps * (len(self.channels) + 2 * len(self.plant.signals))

    def size_message(self, steps: int) -> str:
        """Return the key that causes the memory demand of a design, and the steps of its cycles."""
        slow = "input.frequency" if isinstance(self.source, Excitation) else "input.recording"
        cycles = f"{self.cycles:,} cycles" if self.cycles > 1 else "1 cycle"
        return f"{slow}: with the slowest input or the fastest wire, {cycles} take {steps:,} steps each"

    @property
    def size_hint(self) -> str:
        """Hint what to change if a design needs too much memory."""
        if isinstance(self.source, Excitation):
            return "raise input.frequency, lower input.cycles, or raise the lower end of wire.diameter"
        return "take a shorter recording, or raise the lower end of wire.diameter"

    def steps(self, designs: Float[np.ndarray, "designs axes"]) -> Int[np.ndarray, " designs"]:
        """Return the steps of a cycle that resolve each design; see ``simulation.step_size.resolving_step``."""

        def steps_of(design: Float[Array, " axes"]) -> Float[Array, ""]:
            plant, values = self._apply(design)
            return self._period(values) / resolving_step(plant)

        steps = np.asarray(jax.jit(jax.vmap(steps_of))(jnp.asarray(designs)))
        return np.maximum(_MIN_STEPS, np.ceil(np.where(np.isfinite(steps), steps, 0.0))).astype(int)

    def batch_order(self, designs: Float[np.ndarray, "designs axes"]) -> Float[np.ndarray, " designs"]:
        """Return the steady excess temperature of each design's wire in K under a constant input of its amplitude."""

        def excess(design: Float[Array, " axes"]) -> Float[Array, ""]:
            plant, values = self._apply(design)
            amplitude = values.get("amplitude", jnp.ones(()))
            austenite = Fractions(jnp.zeros(()), jnp.zeros(()))
            joule = plant.drive.joule(amplitude, plant.material.resistivity(austenite), plant.wire)
            return joule / plant.heat.conductance(jnp.asarray(_WARM), plant.wire)

        return np.nan_to_num(np.asarray(jax.jit(jax.vmap(excess))(jnp.asarray(designs))))

    def evaluate(
        self, design: Float[Array, " axes"], steps: int, differentiable: bool = False
    ) -> tuple[dict[str, jax.Array], Int[Array, ""]]:
        """Simulate the rig with one design, and read the metrics from its response, with margins if there are any."""
        return evaluate_with_margins(
            self.margins, lambda deviations: self._evaluate(design, steps, differentiable, deviations)
        )

    def _evaluate(
        self,
        design: Float[Array, " axes"],
        steps: int,
        differentiable: bool,
        deviations: Mapping[str, Float[Array, ""]],
    ) -> tuple[dict[str, jax.Array], Int[Array, ""]]:
        """The metrics of a design with deviations of some parameters, and the number of the status."""
        plant, values = self._apply(design, deviations)
        wires = plant.mechanism.wires
        with_rest = "time_to_cool" in self.metrics
        if isinstance(self.source, Excitation):
            parts = grid_parts(self.source, wires, steps, with_rest)
            modes = time_constant_bounds(plant) if with_rest else None
            inputs = discretise_excitation(self.source, wires, steps, values, modes)
        else:
            inputs, parts = self._recorded_input(plant, steps)
        channels, code = simulate_channels(plant, inputs, self.channels)
        response = self._response(plant, inputs, channels)
        responses = {"cycle": response.cut(parts.cycle), "rest": response.cut(parts.rest), "all": response}
        metrics = {n: METRICS[n].read(responses[METRICS[n].part]) for n in self.metrics if n in METRICS}
        if "bandwidth" in self.metrics:
            metrics["bandwidth"], gap, worst_code = self._bandwidth(plant, values, steps, differentiable)
            code = jnp.maximum(code, worst_code)
            if "settling" in self.metrics:
                metrics["settling"] = jnp.maximum(metrics["settling"], gap)
        return {n: jnp.where(code == SimulationStatus.done, metrics[n], jnp.nan) for n in self.metrics}, code

    def _apply(
        self, design: Float[Array, " axes"], deviations: Mapping[str, Float[Array, ""]] | None = None
    ) -> tuple[Plant, dict[str, jax.Array]]:
        """The plant of a design with deviations of some parameters, and its values of the input by key."""
        values = {n: design[k] for k, n in enumerate(self.names)}
        for name, deviation in (deviations or {}).items():
            values[name] = (values[name] if name in values else self._nominal(name)) + deviation
        own = {n: v for n, v in values.items() if not n.startswith(INPUT)}
        return parameters.replace(self.plant, own), {
            n[len(INPUT) :]: v for n, v in values.items() if n.startswith(INPUT)
        }

    def _nominal(self, name: str) -> jax.Array:
        """The value of a parameter of the rig or the input that does not vary."""
        if name.startswith(INPUT):
            return jnp.asarray(getattr(self.source, name[len(INPUT) :]), jnp.float64)
        return jnp.asarray(parameters.get(self.plant, name))

    def _period(self, values: Mapping[str, jax.Array]) -> Float[Array, ""]:
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
        return response_of(plant, inputs.time[inputs.sample_indices], channels)

    def _bandwidth(
        self, plant: Plant, values: Mapping[str, jax.Array], steps: int, differentiable: bool
    ) -> tuple[Float[Array, ""], Float[Array, ""], Int[Array, ""]]:
        """Bandwidth, largest settling gap of the simulations that determine it, and worst code of all simulations."""
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
