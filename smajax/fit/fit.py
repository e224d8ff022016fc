"""From recordings to a ``Fit``: parameters with intervals, what cannot be told apart, and the residual."""

import dataclasses
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from smajax import parameters, simulate
from smajax.errors import InputError, NumericsError
from smajax.fit import least_squares, uncertainty
from smajax.fit.least_squares import Stop
from smajax.fit.problem import Problem, Settings, build, difference_noise
from smajax.fit.searchable import Searchable, costs, residual
from smajax.plant.plant import Plant
from smajax.recording import Recording

_SCREENED = 48
# So many recordings are a batch of their own.
WIDE = 4


@dataclasses.dataclass(frozen=True)
class Estimate:
    """One parameter after a fit, in its internal unit; the interval is ``None`` where the data give none."""

    name: str
    estimate: float
    lower95: float | None
    upper95: float | None
    unit: str
    at_bound: bool
    bounds: tuple[float, float]


@dataclasses.dataclass(frozen=True)
class Response:
    """Measured and modelled channels of one recording (SI, shape ``(n,)``), the other modelled channels, and the result code."""

    recording: Recording
    role: str
    model: dict[str, np.ndarray]
    code: simulate.Code

    def residual(self, channel: str) -> np.ndarray:
        """Measured minus model; NaN where the channel was not measured."""
        return self.recording.channels[channel] - self.model[channel]

    def rmse(self, channel: str) -> float:
        """Root mean square of the residual, SI; NaN where nothing was measured."""
        residual = self.residual(channel)
        measured = residual[np.isfinite(residual)]
        return float(np.sqrt(np.mean(measured**2))) if len(measured) else math.nan


@dataclasses.dataclass(frozen=True)
class Fit:
    """The result of a fit. ``plants`` holds the fitted plant of each training recording, ``plant`` the one for any other recording."""

    problem: Problem
    plant: Plant
    plants: tuple[Plant, ...]
    estimates: tuple[Estimate, ...]
    covariance: np.ndarray
    indistinct: tuple[uncertainty.Indistinct, ...]
    responses: tuple[Response, ...]
    noise_floor: dict[str, float]
    cost: float
    starts_at_best: int
    starts: int
    stop: Stop
    steps: int
    simulations: int
    wall: float
    compile: float
    history: tuple[tuple[int, float, float], ...]
    seed: int
    vector: np.ndarray
    interpolation: str
    step: float | None
    discretisation: dict[str, float]

    @property
    def correlation(self) -> np.ndarray:
        """Correlations of the estimates, shape ``(p, p)``; NaN where a variance is not finite."""
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            return self.covariance / np.outer(deviation, deviation)

    def rmse(self, channel: str, role: str = "train") -> float | None:
        """Pooled RMSE of a channel over the recordings of a role, SI; ``None`` without any."""
        residuals = [r.residual(channel) for r in self.responses if r.role == role]
        measured = np.concatenate([r[np.isfinite(r)] for r in residuals]) if residuals else np.zeros(0)
        return float(np.sqrt(np.mean(measured**2))) if len(measured) else None


def draw_starts(problem: Searchable, starts: int, seed: int) -> tuple[np.ndarray, int]:
    """The nominal point and ``starts - 1`` drawn ones, shape ``(starts, p)``, and the number of simulations spent.

    Points drawn over the search box mostly never transform at all, where gradients say little. So many are drawn and simulated as one
    batch, and the best are kept.
    """
    if starts <= 1:
        return problem.nominal[None], 0
    lower, upper = problem.search_box()
    drawn = np.random.default_rng(seed).uniform(lower, upper, (max(_SCREENED, 4 * starts), len(lower)))
    found = np.asarray(costs(problem, jnp.asarray(drawn)))
    order = np.argsort(np.where(np.isfinite(found), found, np.inf))
    return np.vstack([problem.nominal, drawn[order[: starts - 1]]]), len(drawn) * problem.data.measured.shape[0]


def fit(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str = "hold",
    step: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, float], None] = lambda step, cost: None,
) -> Fit:
    """Fits a plant's free parameters to recordings by bounded least squares from several starts.

    Raises ``InputError`` for recordings and settings that do not fit together, and ``NumericsError`` if the simulation fails at every
    start.
    """
    began = time.perf_counter()
    problem = build(plant, recordings, settings, interpolation=interpolation, step=step)
    starts, screened = draw_starts(problem, settings.starts, settings.seed)
    compiled = time.perf_counter()
    search = least_squares.Search(residual, problem, starts, *problem.box, size=problem.size, apart=len(recordings) >= WIDE)
    solved = search.advance(max_steps, progress).result()
    first = solved.history[0][1] if solved.history else 0.0
    later = (solved.wall - first) / max(len(solved.history) - 1, 1)
    if all(s is Stop.failed for s in solved.stops):
        _, codes = eqx.filter_jit(lambda p, v: p.predict(v))(problem, jnp.asarray(starts[0]))
        code = simulate.Code(int(jnp.max(codes)))
        raise NumericsError(f"{code.name} at the start values: {code.cure}; parameters: {simulate.describe(plant)}")
    # Next to a thermal runaway an end may be sound on the problem's steps, and not on those that the plant which was found asks for: then
    # the best of the others counts.
    order = [int(i) for i in np.argsort(solved.costs) if np.isfinite(solved.costs[i])]
    ends: dict[int, _End] = {}
    for best in order:
        ends[best] = _ended(problem, plant, recordings, settings, holdout, interpolation, step, solved.points[best], solved.jacobians[best])
        if all(r.code is simulate.Code.done for r in ends[best].responses if r.role == "train"):
            break
    else:
        best = order[0]
    vector, jacobian, plants, general, responses, discretisation = ends[best]
    at_best = int(np.sum(solved.costs <= solved.costs[best] * 1.001))
    estimates, covariance, groups = _uncertainty(problem, vector, solved.residuals[best], jacobian)
    floor = {c: max(difference_noise(r.residual(c)) for r in responses[: len(recordings)]) for c in settings.observe}
    return Fit(
        problem=problem,
        plant=general,
        plants=plants,
        estimates=tuple(estimates),
        covariance=covariance,
        indistinct=tuple(groups),
        responses=tuple(responses),
        noise_floor=floor,
        cost=float(solved.costs[best]),
        starts_at_best=at_best,
        starts=len(starts),
        stop=solved.stops[best],
        steps=solved.steps,
        simulations=solved.simulations + screened,
        wall=time.perf_counter() - began,
        compile=(compiled - began if screened else 0.0) + max(first - later, 0.0),
        history=tuple(solved.history),
        seed=settings.seed,
        vector=vector,
        interpolation=interpolation,
        step=step,
        discretisation=discretisation,
    )


class _End(NamedTuple):
    """Where a start ended: vector and Jacobian, the recordings' plants, a new one's, how all respond, and the discretisation error."""

    vector: np.ndarray
    jacobian: np.ndarray
    plants: tuple[Plant, ...]
    general: Plant
    responses: list[Response]
    discretisation: dict[str, float]


def _ended(
    problem: Problem,
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    holdout: Sequence[Recording],
    interpolation: str,
    step: float | None,
    point: np.ndarray,
    slopes: np.ndarray,
) -> _End:
    vector, jacobian = problem.put_in_order(point, slopes)
    shared, own = problem.values(jnp.asarray(vector))
    fitted = parameters.replace(problem.plant, shared)
    plants = tuple(parameters.replace(fitted, {n: v[k] for n, v in own.items()}) for k in range(len(recordings)))
    general = parameters.replace(fitted, {n: jnp.mean(v) for n, v in own.items() if not n.startswith("initial.")})
    for name in own:  # a new recording starts as the rig says
        if name.startswith("initial."):
            general = eqx.tree_at(
                lambda p, n=name: getattr(p.initial, n[8:]), general, getattr(plant.initial, name[8:]), is_leaf=lambda x: x is None
            )
    members = [*plants, *(general for _ in holdout)]
    roles = ["train"] * len(recordings) + ["holdout"] * len(holdout)
    return _End(vector, jacobian, plants, general, *respond(members, [*recordings, *holdout], roles, settings.observe, interpolation, step))


def respond(
    plants: Sequence[Plant],
    recordings: Sequence[Recording],
    roles: Sequence[str],
    channels: Sequence[str],
    interpolation: str,
    step: float | None,
) -> tuple[list[Response], dict[str, float]]:
    """Simulates each recording with its plant, and measures the discretisation error of the observed channels (RMS, SI).

    That error is the change when the first recording's first half is simulated with half the step. All are laid out on grids of one
    length, so that one compiled program does. Raises nothing: a failed simulation says so in its code.
    """
    laid = [simulate.lay_out(p, r, interpolation=interpolation, step=step) for p, r in zip(plants, recordings, strict=True)]
    grid, samples = max(len(i.time) for i in laid), max(len(i.rows) for i in laid)
    results = [simulate.simulate_inputs(p, i.padded(grid, samples)) for p, i in zip(plants, laid, strict=True)]
    responses = []
    for result, recording, role in zip(results, recordings, roles, strict=True):
        model = {c: np.asarray(v)[: len(recording)] for c, v in result.channels.items()}
        responses.append(Response(recording, role, model, simulate.Code(int(result.code))))
    first = recordings[0]
    count = len(first) // 2
    if not first.has_clock or count < 2:
        return responses, dict.fromkeys(channels, 0.0)
    half = dataclasses.replace(first, time=first.time[:count], channels={c: v[:count] for c, v in first.channels.items()})
    pieces = np.maximum(1, np.ceil(np.diff(half.time) / (step or simulate.default_step(plants[0])) - 1e-9))
    inputs = simulate.lay_out(plants[0], half, interpolation=interpolation, step=float(np.max(np.diff(half.time) / pieces)) / 2)
    if len(inputs.time) <= grid:
        inputs = inputs.padded(grid, samples)
    finer = simulate.simulate_inputs(plants[0], inputs).channels
    change = {c: np.asarray(finer[c])[:count] - responses[0].model[c][:count] for c in channels}
    return responses, {c: float(np.sqrt(np.mean(v**2))) for c, v in change.items()}


def _uncertainty(problem: Problem, vector: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> tuple[list, np.ndarray, list]:
    lower, upper = problem.box
    gradient = jacobian.T @ residual
    # Steps towards a bound that the data press against grow ever shorter: what is within a millionth of the range is there.
    margin = 1e-9 * (1.0 + np.abs(vector)) + 1e-6 * np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    held = ((vector <= lower + margin) & (gradient >= 0)) | ((vector >= upper - margin) & (gradient <= 0))
    count, free = int(np.sum(~held)), np.flatnonzero(~held)
    keep = np.asarray(problem.data.weight).reshape(-1, problem.data.weight.shape[-1]) > 0
    series = residual.reshape(keep.shape)
    columns = jacobian.reshape(*keep.shape, -1)[..., free]
    samples = int(np.sum(keep))
    scaled = uncertainty.covariance([columns[k][m] for k, m in enumerate(keep)], [series[k][m] for k, m in enumerate(keep)], count)
    covariance = np.full((len(vector), len(vector)), np.nan)
    scales = np.array([u.scale for u in problem.unknowns])
    covariance[np.ix_(free, free)] = scaled * np.outer(scales[free], scales[free])
    quantile = uncertainty.critical(samples, count)
    estimates = []
    for i, unknown in enumerate(problem.unknowns):
        value = float(vector[i] * unknown.scale)
        deviation = math.sqrt(covariance[i, i]) if np.isfinite(covariance[i, i]) else math.inf
        known = math.isfinite(deviation)
        interval = (value - quantile * deviation, value + quantile * deviation) if known else (None, None)
        estimates.append(Estimate(unknown.label, value, *interval, unknown.unit, bool(held[i]), (unknown.lower, unknown.upper)))
    names = [problem.unknowns[i].label for i in free]
    sizes = np.array([max(abs(vector[i]), 1e-3) for i in free])
    return estimates, covariance, uncertainty.indistinct(jacobian[:, free], names, sizes)


def profile(result: Fit, name: str, *, points: int = 9, width: float = 3.0) -> dict[str, Any]:
    """Profile likelihood of one parameter: the best cost with it held at ``points`` values over ``width`` standard errors either way.

    Returns ``values`` (internal unit), ``rise`` (of the cost, in units in which 3.84 bounds a 95 % interval, the noise's autocorrelation
    counted in), ``lower95`` and ``upper95`` (``None`` where the profile does not reach 3.84 within the range). Raises ``InputError``
    for a parameter that is not free or sits on its bound.
    """
    labels = [u.label for u in result.problem.unknowns]
    if name not in labels:
        raise InputError(f"'{name}' is not a free parameter of this fit; free are {', '.join(labels)}")
    i = labels.index(name)
    estimate, scale = result.estimates[i], result.problem.unknowns[i].scale
    deviation = math.sqrt(result.covariance[i, i]) if np.isfinite(result.covariance[i, i]) else math.nan
    if not math.isfinite(deviation):
        raise InputError(
            f"'{name}' has no finite standard error here (it sits on its bound, or the data do not show it): no profile can be drawn"
        )
    lower, upper = (np.tile(b, (points, 1)) for b in result.problem.box)
    values = np.clip(estimate.estimate + deviation * np.linspace(-width, width, points), lower[0, i] * scale, upper[0, i] * scale)
    lower[:, i] = upper[:, i] = values / scale
    starts = np.tile(result.vector, (points, 1))
    slope = result.covariance[:, i] / result.covariance[i, i]
    scales = np.array([u.scale for u in result.problem.unknowns])
    starts += np.outer(values - estimate.estimate, np.nan_to_num(slope)) / scales
    solved = least_squares.Search(residual, result.problem, starts, lower, upper, size=result.problem.size, rtol=1e-9).advance().result()
    rise = solved.costs - result.cost
    # Near the estimate the profile is a parabola; the noise's autocorrelation widens it as it widens the interval.
    curvature = np.sum(rise * (values - estimate.estimate) ** 2) / np.sum((values - estimate.estimate) ** 4)
    rise = rise / (curvature * deviation**2)
    return {
        "values": values,
        "rise": rise,
        "lower95": _crossing(values[: points // 2 + 1][::-1], rise[: points // 2 + 1][::-1]),
        "upper95": _crossing(values[points // 2 :], rise[points // 2 :]),
    }


def _crossing(values: np.ndarray, rise: np.ndarray, level: float = 3.841) -> float | None:
    above = np.flatnonzero(rise > level)
    if not len(above) or above[0] == 0:
        return None
    k = above[0]
    share = (level - rise[k - 1]) / (rise[k] - rise[k - 1])
    return float(values[k - 1] + share * (values[k] - values[k - 1]))
