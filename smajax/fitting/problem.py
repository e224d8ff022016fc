"""The fit of a plant: free parameters, recordings, weights, and the weighted residual as a function of one vector.

The vector has the shared parameters first and then, recording by recording, each recording's own parameters. Its
entries are the parameters over their ``scale``, so that steps and bounds are of order one. All recordings get grids
of one length, one of a few (``pad_together``): their inputs are constant after their end, with weight 0, and all are
simulated as one batch. Rows at which a channel is NaN were not measured and have weight 0, so that one recording may
have channels of different sampling rates.
"""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax import parameters
from smajax.errors import InputError
from smajax.fitting.abstract_problem import AbstractFitProblem
from smajax.fitting.compilation import vmap_unless_single
from smajax.fitting.noise import difference_noise
from smajax.fitting.unknowns import MIN_RELATIVE_BAND, Settings, Unknown, bounds_of, make_unknown
from smajax.numerics.nonsmooth import maximum, minimum
from smajax.parameters.definitions import ORDERED_PAIRS
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation import run
from smajax.simulation.inputs import Inputs, discretise, recorded_surroundings
from smajax.simulation.padding import pad_together
from smajax.simulation.physical_limits import status_with_limits, within_limits
from smajax.simulation.sensitivities import Trajectory
from smajax.simulation.status import SimulationStatus

# Factor on the residual of a simulation that fails: so large that no search steps from a valid state into a failed one.
# test_a_search_takes_no_step_into_states_in_which_the_simulation_fails in tests/unit/fitting/test_fit.py holds it.
_FAILURE_FACTOR = 1e3
# Random starts and populations reach this share of a start value towards zero; chosen by trial on fits of rigs.
_SEARCH_TOWARDS_ZERO = 0.6
# The same away from zero: a factor of 2.5; chosen by trial on fits of rigs.
_SEARCH_AWAY_FROM_ZERO = 1.5
# Start values below this many scales count as zero; chosen by trial on fits of rigs.
_NEARLY_ZERO = 0.5
# Distance in scales that starts reach from such a value; chosen by trial on fits of rigs.
_SEARCH_AROUND_ZERO = 2.0


class FitData(eqx.Module):
    """Arrays of all recordings, each with a leading axis of ``r`` recordings.

    Attributes:
        inputs: Inputs on grids of one length.
        measured: Channels (r, c, n), SI and degC; 0 where not measured.
        weight: One over the noise (r, c, n); 0 where not measured.
        end_index: The grid point after which no recording has a sample; ``None`` for the end of the grid.
    """

    inputs: Inputs
    measured: jax.Array
    weight: jax.Array
    end_index: jax.Array | None = None


class Problem(AbstractFitProblem):
    """A plant, the data, and the free parameters; ``residual`` and ``predict`` are pure functions of the vector.

    Attributes:
        plant: The plant with all parameters that are not free.
        data: Recordings and weights.
        scales: Scales of the unknowns (p,); an array, so that other values need no new compiled program.
        unknowns: The entries of the vector.
        channels: Channels that are fitted.
        shared: Names of the parameters that all recordings share.
        per_recording: Names of the parameters that each recording has its own value of.
    """

    plant: Plant
    data: FitData
    scales: jax.Array
    unknowns: tuple[Unknown, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)
    shared: tuple[str, ...] = eqx.field(static=True)
    per_recording: tuple[str, ...] = eqx.field(static=True)

    @property
    def has_structure(self) -> bool:
        """Whether the plant has cells or grains: its derivatives then cost as much as many simulations."""
        return self.plant.cells is not None or self.plant.grains is not None

    @property
    def nominal(self) -> np.ndarray:
        """The vector of the rig's own values, shape ``(p,)``."""
        return np.array([u.nominal / u.scale for u in self.unknowns])

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector, each of shape ``(p,)``."""
        lower = np.array([u.lower / u.scale for u in self.unknowns])
        return lower, np.array([u.upper / u.scale for u in self.unknowns])

    def search_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return finite bounds within ``bounds``, each of shape ``(p,)``, for random starts and populations.

        The range reaches from 0.4 to 2.5 times the nominal value, or two scales to either side where that is zero,
        as far as the bounds allow.
        """
        lower, upper = self.bounds
        middle = self.nominal
        near = np.where(np.abs(middle) > _NEARLY_ZERO, _SEARCH_TOWARDS_ZERO * np.abs(middle), _SEARCH_AROUND_ZERO)
        far = np.where(np.abs(middle) > _NEARLY_ZERO, _SEARCH_AWAY_FROM_ZERO * np.abs(middle), _SEARCH_AROUND_ZERO)
        below = np.where(middle > 0, near, far)
        above = np.where(middle > 0, far, near)
        return np.maximum(lower, middle - below), np.minimum(upper, middle + above)

    def values(self, vector: Float[Array, " p"]) -> tuple[dict[str, Float[Array, ""]], dict[str, Float[Array, " r"]]]:
        """Return the parameter values of a vector: shared ones (scalars), and each recording's own, shape ``(r,)``.

        Two free ends of a transformation that are in the wrong order are exchanged: a search may cross the line at
        which they are equal, and has the same plant on both sides.

        Args:
            vector: The problem's vector (p,).

        Returns:
            The shared values and the recordings' own values, each by parameter name, in internal units.
        """
        natural = vector * self.scales
        shared = {name: natural[i] for i, name in enumerate(self.shared)}
        own = natural[len(self.shared) :].reshape(-1, len(self.per_recording)).T if self.per_recording else []
        per_recording = {name: own[i] for i, name in enumerate(self.per_recording)}
        return _order_ends(shared), _order_ends(per_recording)

    def order_transformation_ends(
        self, vector: Float[np.ndarray, " p"], jacobian: Float[np.ndarray, "m p"]
    ) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, "m p"]]:
        """Return the vector of the same plant with all ends of transformations in order, and the Jacobian there.

        Args:
            vector: The problem's vector (p,).
            jacobian: Jacobian (m, p) of the residual.

        Returns:
            The ordered vector (p,) and the Jacobian (m, p) with its columns exchanged and scaled in the same way.
        """
        vector, jacobian, scales = vector.copy(), jacobian.copy(), np.asarray(self.scales)
        places = {(u.name, u.recording): i for i, u in enumerate(self.unknowns)}
        for (name, recording), i in places.items():
            for low, high in ORDERED_PAIRS:
                k = places.get((high, recording))
                if name == low and k is not None and vector[i] * scales[i] > vector[k] * scales[k]:
                    ratio = scales[k] / scales[i]
                    vector[i], vector[k] = vector[k] * ratio, vector[i] / ratio
                    jacobian[:, i], jacobian[:, k] = jacobian[:, k] / ratio, jacobian[:, i] * ratio
        return vector, jacobian

    def predict(
        self, vector: Float[Array, " p"], trajectories: Trajectory | None = None
    ) -> tuple[Float[Array, "r c n"], Int[Array, " r"]]:
        """Simulate all recordings at a vector.

        Args:
            vector: The problem's vector (p,).
            trajectories: Result of ``trajectories`` at this vector, if it has been computed.

        Returns:
            The modelled channels (r, c, n), SI and degC, and the status code of each recording (r,).
        """

        def single(plant: Plant, inputs: Inputs, trajectory: Trajectory | None) -> tuple[jax.Array, jax.Array]:
            values, status = run.simulate_channels(plant, inputs, self.channels, self.data.end_index, trajectory)
            return jnp.stack([values[c] for c in self.channels]), status

        return self._for_each_recording(single, vector, trajectories)

    def trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Return the trajectories of all recordings, for ``predict`` and ``residual``; leading axis of ``r``."""

        def single(plant: Plant, inputs: Inputs, _: None) -> Trajectory:
            return run.trajectory(plant, inputs, self.data.end_index)

        return self._for_each_recording(single, vector, None)

    def statuses(self, vector: Float[Array, " p"], trajectories: Trajectory) -> Int[Array, " r"]:
        """Return the status code of each recording, with the limits of a wire (``physical_limits``).

        Args:
            vector: The problem's vector (p,).
            trajectories: Result of ``trajectories`` at this vector.
        """

        def single(plant: Plant, inputs: Inputs, trajectory: Trajectory) -> jax.Array:
            states = run.states_along(plant, inputs, trajectory)
            return status_with_limits(trajectory.status, within_limits(plant, states)[1])

        return self._for_each_recording(single, vector, trajectories)

    def blank_trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Return trajectories of zeros with the right shapes, to compile with."""
        return self._for_each_recording(lambda plant, inputs, _: run.blank_trajectory(plant, inputs), vector, None)

    def _for_each_recording(self, single: Callable[[Plant, Inputs, Any], Any], vector: jax.Array, more: Any) -> Any:
        """Map a function over each recording's plant, inputs and entry of ``more``."""
        shared, own = self.values(vector)
        plant = parameters.replace(self.plant, shared, ordered=False)

        def of_recording(own: dict[str, jax.Array], inputs: Inputs, entry: Any) -> Any:
            return single(parameters.replace(plant, own, ordered=False), inputs, entry)

        return vmap_unless_single(of_recording, self.data.measured.shape[0], own, self.data.inputs, more)

    def residual(self, vector: Float[Array, " p"], trajectories: Trajectory | None = None) -> Float[Array, " size"]:
        """Return measurement minus model over the noise, shape ``(r * c * n,)``; zero where a recording has no sample.

        The residual of a simulation that fails is 1000 times as large.

        Args:
            vector: The problem's vector (p,).
            trajectories: Result of ``trajectories`` at this vector, if it has been computed.
        """
        model, status = self.predict(vector, trajectories)
        weight = self.data.weight * jnp.where(status == SimulationStatus.done, 1.0, _FAILURE_FACTOR)[:, None, None]
        return jnp.where(weight > 0, (self.data.measured - model) * weight, 0.0).ravel()


def _order_ends(values: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """The values with the ends of each transformation in order, and at least ``MIN_RELATIVE_BAND`` apart."""
    for low, high in ORDERED_PAIRS:
        if low in values and high in values:
            first, second = minimum(values[low], values[high]), maximum(values[low], values[high])
            values = values | {low: first, high: maximum(second, first + MIN_RELATIVE_BAND * jnp.abs(first))}
    return values


def require_channels(plant: Plant, recordings: Sequence[Recording], observe: Sequence[str]) -> None:
    """Check that recordings have the channels that drive a plant and those that are observed.

    Args:
        plant: The plant.
        recordings: The recordings.
        observe: Names of the observed channels.

    Raises:
        InputError: A channel is missing.
    """
    for recording in recordings:
        missing = [c for c in (*plant.signals, *observe) if c not in recording.channels]
        if missing:
            raise InputError(f"{recording.name} has no channel '{missing[0]}'; it has {', '.join(recording.channels)}")


def build_problem(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    interpolation: str | None = None,
    step: float | None = None,
) -> Problem:
    """Build the fit problem of a plant and recordings.

    Args:
        plant: The plant with its start values.
        recordings: Recordings to fit to.
        settings: Free parameters, observed channels, bounds and noise.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plant's default if not given.

    Returns:
        The problem, with a weight of one over the noise where a channel was measured.

    Raises:
        InputError: A channel is missing, a parameter does not exist, or nothing is free.
    """
    require_channels(plant, recordings, settings.observe)
    own = tuple(dict.fromkeys((*settings.per_recording, *(f"initial.{name}" for name in settings.initial))))
    shared = tuple(name for name in settings.free if name not in own)
    if not shared and not own:
        raise InputError("nothing is free: name the parameters to fit under [fit] free")
    bounds = {name: bounds_of(plant, name, settings, (*shared, *own)) for name in (*shared, *own)}
    unknowns = [make_unknown(plant, name, None, bounds[name], recordings[0]) for name in shared]
    unknowns += [make_unknown(plant, name, r.name, bounds[name], r) for r in recordings for name in own]
    noise = {
        c: settings.noise.get(c) or max(difference_noise(r.channels[c]) for r in recordings) for c in settings.observe
    }
    for name in own:  # a start value that the plant would derive becomes a leaf
        if name.startswith("initial."):
            plant = parameters.replace(plant, {name: next(u.nominal for u in unknowns if u.name == name)})
    surroundings = recorded_surroundings(plant, recordings)
    grid = {"interpolation": interpolation, "step": step, "surroundings": surroundings}
    inputs = [discretise(plant, r, **grid) for r in recordings]
    return Problem(
        plant=plant,
        data=_fit_data(inputs, recordings, tuple(settings.observe), noise),
        scales=jax.device_put(np.array([u.scale for u in unknowns])),
        unknowns=tuple(unknowns),
        channels=tuple(settings.observe),
        shared=shared,
        per_recording=own,
    )


def _fit_data(
    inputs: Sequence[Inputs],
    recordings: Sequence[Recording],
    channels: tuple[str, ...],
    noise: dict[str, float],
) -> FitData:
    """Inputs, measurements and weights of all recordings, padded to one length."""
    padded = pad_together(inputs)
    samples = len(padded[0].sample_indices)
    batch = jax.tree.map(lambda *leaves: jax.device_put(np.stack(leaves)), *padded)
    measured = np.zeros((len(recordings), len(channels), samples))
    weight = np.zeros_like(measured)
    for k, recording in enumerate(recordings):
        for j, channel in enumerate(channels):
            values = recording.channels[channel]
            finite = np.isfinite(values)
            measured[k, j, : len(values)] = np.where(finite, values, 0.0)
            weight[k, j, : len(values)] = np.where(finite, 1.0 / noise[channel], 0.0)
    return FitData(batch, jax.device_put(measured), jax.device_put(weight))
