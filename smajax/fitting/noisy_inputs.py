"""What noise of the electrical inputs does to a fit: the share that the wire gets, and the covariance of the estimates.

The fit's residual is simulated again with changed inputs at the estimates. Its change D by the scatter of an input
about its plateaus shows the share w of that scatter which the wire gets, since the residual e of the fit then is

    e + J d + w D + E = noise

with its Jacobian J, changes d of the parameters, and the change E by the errors of the plateaus' means. The errors of
the inputs that remain are drawn at random; with the change E of each draw the estimates change by -J^+ E, and the mean
of the products of these changes is added to their covariance.

Source: carroll2006 (errors in variables).
"""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from smajax.fitting.compilation import SEARCH_OPTIONS
from smajax.fitting.electrical_noise import InputNoise, NoiseKind, with_share
from smajax.fitting.intervals import score_covariance, student_quantile
from smajax.fitting.noise import difference_noise
from smajax.fitting.problem import Problem
from smajax.numerics.stored_programs import stored
from smajax.recordings.recording import Recording
from smajax.simulation.status import SimulationStatus

# Draws of the inputs' errors: the standard deviation of an estimate is then known within 7 %.
DRAWS = 100
# Draws that are simulated as one batch; fewer where the memory does not allow it. Chosen by trial for speed.
_AT_ONCE = 20
# Singular values of the Jacobian (columns of length 1) below this share of the largest are rounding.
_FLAT = 1e-7


class FitEnd(NamedTuple):
    """The end of a fit.

    Attributes:
        problem: The problem.
        vector: Its vector (p,).
        residual: The residual there.
        jacobian: Jacobian of the residual.
        free: Indices of the parameters that are not at a bound.
        held: Whether electrical inputs are held between samples.
        at_once: Most simulations in one batch.
    """

    problem: Problem
    vector: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    free: np.ndarray
    held: bool
    at_once: int

    def series(self, residual: np.ndarray) -> list[np.ndarray]:
        """Return the measured rows of each channel and recording of a residual, or of columns of them."""
        weight = np.asarray(self.problem.data.weight)
        measured = weight.reshape(-1, weight.shape[-1]) > 0
        columns = residual.reshape(*measured.shape, *residual.shape[1:])
        return [columns[k][rows] for k, rows in enumerate(measured)]


def simulate_errors(
    end: FitEnd, recordings: Sequence[Recording], noises: Sequence[InputNoise], seed: int
) -> Float[np.ndarray, "d m"] | None:
    """Simulate random draws of the errors of the inputs that remain, at the end of a fit.

    Args:
        end: The end of the fit.
        recordings: Its training recordings.
        noises: Noise of the inputs.
        seed: Seed of the draws.

    Returns:
        The change of the residual by each draw (d, m), without rows where the inputs are exact; ``None`` where hardly
        any draw can be simulated.
    """
    uncertain = [n for n in noises if n.kind is not NoiseKind.none and n.used_share < 1.0]
    uncertain = [n for n in uncertain if n.count or n.given]
    if not uncertain:
        return np.zeros((0, len(end.residual)))
    random = np.random.default_rng(seed)
    draws = [{n.channel: _draw(n, recordings, random) for n in uncertain} for _ in range(DRAWS)]
    changed, valid = _residuals(end, recordings, draws)
    return None if 2 * np.sum(valid) < DRAWS else changed[valid] - end.residual


def input_covariance(end: FitEnd, errors: np.ndarray | None) -> Float[np.ndarray, "p p"]:
    """Compute the covariance of the estimates by the errors of the inputs that remain.

    Args:
        end: The end of the fit.
        errors: The result of ``simulate_errors``.

    Returns:
        The covariance (p, p) in internal units, with infinite variances where ``errors`` is ``None``.
    """
    size = len(end.vector)
    if errors is None:
        return np.diag(np.full(size, np.inf))
    changes = np.array([_estimate_change(end, error) for error in errors]).reshape(-1, size)
    return changes.T @ changes / max(len(changes), 1)


def decide_kinds(
    end: FitEnd, recordings: Sequence[Recording], noises: Sequence[InputNoise], errors: np.ndarray | None
) -> tuple[tuple[InputNoise, ...], np.ndarray]:
    """Decide from the fitted channels what the noise of inputs is where nothing else shows it.

    Args:
        end: End of a fit with the means of the plateaus.
        recordings: Its recordings.
        noises: Noise of the inputs.
        errors: The result of ``simulate_errors`` for them.

    Returns:
        The noise of the inputs, and the change of the estimates (k, p), internal units, by the scatter of each input
        that remains undecided.
    """
    open_places = [k for k, noise in enumerate(noises) if noise.kind is NoiseKind.undecided]
    if not open_places:
        return tuple(noises), np.zeros((0, len(end.vector)))
    scatter = [[p.deviations for p in noises[k].plateaus] for k in open_places]
    changes = [{noises[k].channel: s} for k, s in zip(open_places, scatter, strict=True)]
    changed, valid = _residuals(end, recordings, changes)
    columns = (changed - end.residual).T
    decided, remaining = list(noises), []
    shares = _shares(end, columns, np.zeros((0, len(columns))) if errors is None else errors) if np.all(valid) else []
    channels = f"The fitted {', '.join(end.problem.channels)} follow{'s' * (len(end.problem.channels) == 1)}"
    for place, (share, error), column in zip(open_places, shares, columns.T, strict=False):
        decided[place] = with_share(noises[place], share, error, channels)
        if decided[place].kind is NoiseKind.undecided:
            remaining.append(_estimate_change(end, column))
    if not np.all(valid):
        reason = "With the recorded input the simulation fails"
        decided = [dataclasses.replace(n, reason=reason) if n.kind is NoiseKind.undecided else n for n in decided]
    return tuple(decided), np.array(remaining).reshape(-1, len(end.vector))


def _shares(end: FitEnd, columns: np.ndarray, errors: np.ndarray) -> list[tuple[float, float]]:
    """Shares of the scatter of inputs that the fitted channels follow, each with the half width of its interval.

    Parameters, shares, and the errors of the plateaus' means are estimated together, by least squares with a variance
    of 1 for the factor of each draw over the root of their number.
    """
    weights = [1.0 / difference_noise(series) for series in end.series(end.residual)]
    drawn = errors.T / math.sqrt(max(len(errors), 1))
    matrix = np.column_stack([end.jacobian[:, end.free], columns, drawn])
    parts = [w * part for w, part in zip(weights, end.series(matrix), strict=True)]
    residuals = [w * part for w, part in zip(weights, end.series(end.residual), strict=True)]
    determined = matrix.shape[1] - drawn.shape[1]
    size = np.linalg.norm(np.concatenate(parts), axis=0)
    size[determined:] = 1.0
    if np.any(size[:determined] == 0.0):
        return [(math.nan, math.inf)] * columns.shape[1]
    parts = [part / size for part in parts]
    prior = np.diag(np.where(np.arange(len(size)) < determined, 0.0, 1.0))
    inverse = np.linalg.pinv(np.sum([p.T @ p for p in parts], axis=0) + prior, rcond=_FLAT**2, hermitian=True)
    score = np.sum([p.T @ r for p, r in zip(parts, residuals, strict=True)], axis=0)
    solution = -inverse @ score
    rest = [r + p @ solution for p, r in zip(parts, residuals, strict=True)]
    middle = np.sum([score_covariance(p, r) for p, r in zip(parts, rest, strict=True)], axis=0) + prior
    deviation = np.sqrt(np.diag(inverse @ middle @ inverse))
    quantile = student_quantile(sum(map(len, rest)), determined)
    places = range(len(end.free), determined)
    return [(float(solution[i] / size[i]), float(quantile * deviation[i] / size[i])) for i in places]


def _estimate_change(end: FitEnd, change: np.ndarray) -> np.ndarray:
    """Change of the estimates (p,), internal units, by a change of the residual (m,); 0 for those at a bound."""
    jacobian = end.jacobian[:, end.free]
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    result = np.zeros(len(end.vector))
    result[end.free] = -np.linalg.lstsq(jacobian / size, change, rcond=_FLAT)[0] / size
    return result * np.array([u.scale for u in end.problem.unknowns])


def _draw(noise: InputNoise, recordings: Sequence[Recording], random: np.random.Generator) -> list[np.ndarray]:
    """Draw the error of an input in each recording (n,), SI: that of each plateau's mean, and that of single rows."""
    share = noise.used_share
    draws = []
    for recording, plateaus in zip(recordings, noise.plateaus, strict=True):
        error = math.sqrt(1.0 - share) * noise.deviation * random.standard_normal(len(recording))
        error[plateaus.rows] *= math.sqrt(share)
        for first, end in plateaus.parts:
            error[first:end] += random.normal(0.0, noise.mean_deviation * math.sqrt((1.0 - share) / (end - first)))
        draws.append(error)
    return draws


def _residuals(
    end: FitEnd, recordings: Sequence[Recording], changes: Sequence[dict[str, list[np.ndarray]]]
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (d, m) with each change of the inputs, and whether each simulation ended; all of one program."""
    batch = min(_AT_ONCE, end.at_once)
    parts = []
    for k in range(0, len(changes), batch):
        part = [_input_changes(end, recordings, change) for change in changes[k : k + batch]]
        part += [part[-1]] * (batch - len(part))
        stacked = jax.device_put([np.stack(leaves) for leaves in zip(*part, strict=True)])
        parts.append(_changed_residuals(end.problem, jnp.asarray(end.vector), *stacked))
    residuals, valid = (np.concatenate([np.asarray(part[i]) for part in parts])[: len(changes)] for i in (0, 1))
    return residuals, valid


def _input_changes(
    end: FitEnd, recordings: Sequence[Recording], change: dict[str, list[np.ndarray]]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Changes of the problem's ``before``, ``after`` and ``sample_signals`` by changes of channels (n,)."""
    inputs, plant = end.problem.data.inputs, end.problem.plant
    before, after, samples = (np.zeros(v.shape) for v in (inputs.before, inputs.after, inputs.sample_signals))
    grids, places = np.asarray(inputs.time), np.asarray(inputs.sample_indices)
    for name, rows in change.items():
        i = plant.signals.index(name)
        for k, (recording, values) in enumerate(zip(recordings, rows, strict=True)):
            if end.held:
                row = np.searchsorted(places[k, : len(values)], np.arange(before.shape[1]), side="right") - 1
                before[k, :, i] = after[k, :, i] = values[np.minimum(row, len(values) - 2)]
            else:
                on_grid = np.interp(grids[k], recording.time, values)
                before[k, :, i], after[k, :, i] = on_grid[:-1], on_grid[1:]
            samples[k, : len(values), i] = values
    return before, after, samples


@functools.partial(stored, compiler_options=SEARCH_OPTIONS)
def _changed_residuals(
    problem: Problem,
    vector: Float[Array, " p"],
    before: Float[Array, "d r steps signals"],
    after: Float[Array, "d r steps signals"],
    samples: Float[Array, "d r samples signals"],
) -> tuple[Float[Array, "d size"], Bool[Array, " d"]]:
    """Residuals with changed inputs, and whether all simulations ended."""

    def single(before: jax.Array, after: jax.Array, samples: jax.Array) -> tuple[jax.Array, jax.Array]:
        old = problem.data.inputs
        leaves = (old.before + before, old.after + after, old.sample_signals + samples)
        changed = eqx.tree_at(
            lambda p: (p.data.inputs.before, p.data.inputs.after, p.data.inputs.sample_signals), problem, leaves
        )
        model, status = changed.predict(vector)
        weight = problem.data.weight
        residual = jnp.where(weight > 0, (problem.data.measured - model) * weight, 0.0)
        return residual.ravel(), jnp.all(status == SimulationStatus.done)

    return jax.vmap(single)(before, after, samples)
