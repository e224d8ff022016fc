"""The next experiment: the input that best distinguishes effects which explain the recordings equally well.

Candidates are steps, pulses and ramps of several levels and durations within the range of the recorded inputs. An input
is left out if it makes a wire hotter than the training and the selection input do, by the fitted plant without effects.
Each candidate costs one simulation with derivatives. The criterion is the distance between the two most similar effects
in standard deviations (``discrimination``), a T-optimal design to first order.

Source: atkinson1975.
"""

import dataclasses
import enum
import itertools
import math
from collections.abc import Mapping, Sequence

import jax
import numpy as np

from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import orthonormal_basis, project_out
from smajax.fitting.problem import Problem
from smajax.numerics.ensemble import share_among_cores
from smajax.recordings.recording import Recording

# Largest number of inputs that are evaluated. Chosen by trial; tests/unit/diagnosis holds that the proposed one
# distinguishes the effects.
_MAX_EVALUATED = 24
# Least distance in standard deviations with which an input is proposed, and its least ratio to that of the training
# input. Chosen by trial.
_MIN_DISCRIMINATION = 5.0
_MIN_IMPROVEMENT = 1.2
# Temperature by which a proposed input may exceed the highest one of the recordings, K. Chosen by trial.
_MAX_EXCESS_TEMPERATURE = 1.0
# Levels of the library's inputs between the lowest (0) and the highest (1) recorded value, so that heating is often
# partial. Chosen by trial.
_LEVELS = (0.0, 0.3, 0.5, 0.7, 0.85, 1.0)
# Numbers of pieces into which the library's inputs divide the recording, and the duration of a pulse as a share of its
# piece. Chosen by trial.
_PIECES = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
_PULSE_SHARE = 0.4


class InputShape(enum.StrEnum):
    """Form of an input of the library."""

    steps = "steps"
    pulses = "pulses"
    ramps = "ramps"


@dataclasses.dataclass(frozen=True)
class NextExperiment:
    """The experiment to run next.

    Attributes:
        recording: The input, as a recording without outputs; ``None`` if no input within the limits helps.
        separates: Keys of the effects to distinguish.
        sigma: Least distance between two of them in standard deviations, under the best input.
        training_sigma: The same under the training input.
        further_channels: Where no input helps: channels that might, "temperature", "voltage", or "motion" for a second
            sensor of the motion.
    """

    recording: Recording | None
    separates: tuple[str, ...]
    sigma: float
    training_sigma: float
    further_channels: tuple[str, ...] = ()


def propose_experiment(
    problem: DiagnosisProblem, refit: Refit, rivals: Mapping[str, Mapping[str, float]], seed: int
) -> NextExperiment | None:
    """Search a library of inputs for the one that best distinguishes effects.

    Args:
        problem: The diagnosis problem.
        refit: The last refit.
        rivals: The fitted strength and shapes of each effect, by key and parameter name.
        seed: Seed of the library's inputs.

    Returns:
        The proposal; ``None`` if there are fewer than two effects.
    """
    keys = [key for key in rivals if key in problem.effects]
    if len(keys) < 2:
        return None

    def separation(candidate: Problem) -> float:
        return discrimination(problem, refit, rivals, keys, candidate)

    training_sigma = separation(problem.problems[TRAIN])
    limit = max(_highest_temperature(problem, refit, problem.problems[k]) for k in (TRAIN, SELECT))
    options: list[tuple[Recording, Problem]] = []
    for recording in input_library(problem.splits[TRAIN].recordings[0], problem.base_problem.plant.signals, seed):
        candidate = problem.problem_for_inputs(recording)
        if candidate is None:
            continue
        if _highest_temperature(problem, refit, candidate) <= limit + _MAX_EXCESS_TEMPERATURE:
            options.append((recording, candidate))
        if len(options) == _MAX_EVALUATED:
            break
    separations = share_among_cores(lambda option: separation(option[1]), options)
    best = max(range(len(options)), key=lambda i: separations[i]) if options else -1
    if best < 0 or separations[best] < max(_MIN_DISCRIMINATION, _MIN_IMPROVEMENT * training_sigma):
        sigma = max([training_sigma, *separations])
        return NextExperiment(None, tuple(keys), sigma, training_sigma, _further_channels(problem, keys))
    return NextExperiment(options[best][0], tuple(keys), separations[best], training_sigma)


def input_library(like: Recording, signals: Sequence[str], seed: int) -> list[Recording]:
    """Make steps, pulse trains and ramps on the clock of a recording, within the range of its inputs.

    Args:
        like: The recording.
        signals: Names of its driving channels.
        seed: Seed of the levels.

    Returns:
        Recordings of the driving channels, from few pieces to many.
    """
    rng, time = np.random.default_rng(seed), like.time
    span = time[-1] - time[0]
    recordings = []
    for shape, pieces in zip(itertools.cycle(InputShape), np.repeat(_PIECES, len(InputShape)), strict=False):
        channels = {}
        for name in signals:
            low, high = float(like.channels[name].min()), float(like.channels[name].max())
            levels = low + (high - low) * rng.choice(_LEVELS, pieces + 1)
            position = (time - time[0]) / span * pieces
            k = np.minimum(position.astype(int), pieces - 1)
            if shape is InputShape.steps:
                channels[name] = levels[k]
            elif shape is InputShape.pulses:
                channels[name] = np.where(position - k < _PULSE_SHARE, levels[k], low)
            else:
                channels[name] = levels[k] + (position - k) * (levels[k + 1] - levels[k])
        title = f"{shape} of several levels, {span / pieces:.3g} {'s' if like.has_clock else 'rows'} each"
        recordings.append(Recording.from_arrays(title, time if like.has_clock else None, channels, like.units))
    return recordings


def discrimination(
    problem: DiagnosisProblem,
    refit: Refit,
    rivals: Mapping[str, Mapping[str, float]],
    keys: Sequence[str],
    inputs: Problem,
) -> float:
    """Compute the least distance between two effects in standard deviations, under the inputs of a problem.

    With the projected sensitivities a and b, each times its fitted strength, the distance is
    min(|a|, |b|) sqrt(1 - cos(a, b)^2): the residual if the weaker effect is present and the other one is fitted in its
    place.

    Args:
        problem: The diagnosis problem.
        refit: The last refit.
        rivals: The fitted strength and shapes of each effect, by key and parameter name.
        keys: Keys of the effects.
        inputs: The training split's problem under other inputs.

    Returns:
        The least distance over all pairs; 0 if an effect has no influence, or the simulation fails.

    Source: atkinson1975, to first order.
    """
    without_rivals = refit.effect_set
    for key in keys:
        without_rivals = without_rivals.without(key)
    shapes = [item for key in keys for item in rivals[key].items() if not item[0].endswith(".strength")]
    effect_set = dataclasses.replace(without_rivals, values=(*without_rivals.values, *shapes))
    sensitivities, base_jacobian = [], np.zeros((0, problem.size))
    for batch in (keys[i : i + SLOTS] for i in range(0, len(keys), SLOTS)):
        strengths = [f"effects.{key}.strength" for key in batch]
        _, jacobian = problem.evaluate_on(inputs, effect_set, refit.base, strengths)
        base_jacobian = jacobian[:, : problem.size]
        sensitivities += [jacobian[:, problem.size + j] for j in range(len(batch))]
    basis = orthonormal_basis(base_jacobian)
    strength = {k: abs(rivals[k].get(f"effects.{k}.strength", 0.0)) / problem.effects[k].typical or 1.0 for k in keys}
    projected = {k: project_out(basis, c) * strength[k] for k, c in zip(keys, sensitivities, strict=True)}
    least = math.inf
    for a, b in itertools.combinations(keys, 2):
        norms = np.linalg.norm(projected[a]), np.linalg.norm(projected[b])
        if min(norms) == 0.0 or not all(map(np.isfinite, norms)):
            return 0.0
        cosine = float(projected[a] @ projected[b]) / (norms[0] * norms[1])
        least = min(least, float(min(norms)) * math.sqrt(max(0.0, 1.0 - cosine**2)))
    return least


def _highest_temperature(problem: DiagnosisProblem, refit: Refit, inputs: Problem) -> float:
    """Highest temperature under a problem's inputs, degC."""
    count = inputs.data.measured.shape[0]
    each = [jax.tree.map(lambda leaf, k=k: leaf[k], inputs.data.inputs) for k in range(count)]
    return max(float(np.max(np.asarray(problem.states(refit, single).temperature))) for single in each)


def _further_channels(problem: DiagnosisProblem, keys: Sequence[str]) -> tuple[str, ...]:
    """Channels that may distinguish effects that no input within the limits distinguishes."""
    stages = {problem.effects[key].stage for key in keys}
    thermal = stages & {"drive", "heat", "material"}
    channels = [c for c in ("temperature", "voltage") if c not in problem.channels and thermal]
    if stages & {"mechanism", "sensor"}:
        channels.append("motion")
    return tuple(channels)
