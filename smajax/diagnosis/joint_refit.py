"""Joint refit: a fit to training and selection split together, by which the holdout is predicted.

On a wire of cells and grains that leaves more than noise, it also frees the shapes of the grains' distribution. These
and the other parameters of the structure then have a weak prior (``JointPrior``), since a model that no rig matches
determines them by its misfit; all other parameters are those of the data alone.
"""

import dataclasses
import functools
import math

import numpy as np

from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import SELECT, TRAIN
from smajax.diagnosis.onset_times import with_better_onsets
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.structure import ASK_FROM
from smajax.numerics.ensemble import share_among_cores

# Largest number of evaluations of a search, which starts near its optimum, at a fit of the training split. Chosen by
# trial.
_MAX_EVALUATIONS = 12
# Relative falls of the cost at which a search ends near the noise and where more is left: there the exact optimum does
# not matter, and a diagnosis that explains nothing would spend most of its time. Chosen by trial.
_FTOL = 1e-6
_FTOL_FAR = 1e-3
# Share of the largest norm of a Jacobian column below which a parameter is held: such a column is rounding.
_MIN_INFLUENCE = 1e-9
# Share of the cost without shapes that parameters at one standard deviation of their prior cost. Samples of a misfit
# are not independent, so that each says less than one of noise. Chosen by trial on single rough rigs.
_PRIOR_SHARE = 0.1


def refit_jointly(problem: DiagnosisProblem, refit: Refit, *, shapes: bool = True) -> Refit:
    """Fit the parameters of a refit to training and selection split together, starting at its point.

    One split may determine a parameter that the other does not. A fit of the training split alone may then lie far from
    the joint optimum: where more than noise remains, a second search starts at the rig's own values.

    Args:
        problem: The diagnosis problem.
        refit: A refit of the training split.
        shapes: Whether the shapes of a structure's grains are fitted where more than noise remains.

    Returns:
        The joint refit with the smaller cost, with residual and Jacobian of the training split; ``refit`` itself if
        each recording has own parameters.
    """
    if problem.own_count:
        return refit
    joint = _refit_from(problem, refit)
    errors = _reduced_chi2(problem, joint)
    if max(errors) < ASK_FROM:
        return joint
    other = _refit_from(problem, dataclasses.replace(refit, base=problem.nominal))
    if sum(_reduced_chi2(problem, other)) < sum(errors):
        joint = other
    return _minimise(problem, joint, shapes=True) if shapes and problem.joint_prior is not None else joint


def _refit_from(problem: DiagnosisProblem, refit: Refit) -> Refit:
    """The joint refit from one start."""
    # Onset times first: where one recording does not determine an onset, a search of all parameters would let the
    # others compensate for it.
    joint = refit
    for turn in range(2):
        better = with_better_onsets(problem, joint, (TRAIN, SELECT))
        if turn == 0 or better is not None:
            joint = _minimise(problem, joint if better is None else dataclasses.replace(joint, effect_set=better))
    return joint


def _reduced_chi2(problem: DiagnosisProblem, refit: Refit) -> list[float]:
    """Reduced chi-squared of both splits; infinite where a simulation fails."""
    chi2 = [problem.reduced_chi2(problem.predict(refit.effect_set, refit.base, k), k) for k in (TRAIN, SELECT)]
    return [value if math.isfinite(value) else math.inf for value in chi2]


class _JointResidual:
    """Residual and Jacobian of both splits as functions of one vector: base vector, then scaled effect parameters."""

    def __init__(self, problem: DiagnosisProblem, refit: Refit):
        self.problem, self.refit = problem, refit
        self.free = problem.free_effect_parameters(refit.effect_set)
        self.scales = np.array([problem.effect_parameters.scale(name) for name in self.free])
        # SciPy calls for the residual and for its derivative one after the other.
        self.evaluate = functools.lru_cache(maxsize=2)(self._evaluate)

    def start(self) -> np.ndarray:
        """Return the vector at the refit."""
        effects = [self.refit.values[name] / scale for name, scale in zip(self.free, self.scales, strict=True)]
        return np.append(self.refit.base, effects)

    def effect_set(self, point: np.ndarray) -> EffectSet:
        """Return the effects with the values in a vector."""
        values = (point[self.problem.size :] * self.scales).tolist()
        return self.refit.effect_set.with_values(dict(zip(self.free, values, strict=True)))

    def _evaluate(self, packed: bytes) -> tuple[np.ndarray, np.ndarray, tuple[np.ndarray, np.ndarray]]:
        """Residual and Jacobian of the scored samples of both splits, and both of the whole training split."""
        problem, point = self.problem, np.frombuffer(packed)
        effect_set = self.effect_set(point)
        pairs = share_among_cores(
            lambda k: problem.evaluate(effect_set, point[: problem.size], k, self.free), (TRAIN, SELECT)
        )
        residual = np.concatenate([problem.counted_samples(r, k) for k, (r, _) in enumerate(pairs)])
        jacobian = np.concatenate(
            [np.column_stack([problem.counted_samples(c, k) for c in j.T]) for k, (_, j) in enumerate(pairs)]
        )
        # SciPy refuses a step to where the residual is NaN, but not to where its derivative is.
        if not math.isfinite(float(np.sum(jacobian**2))):
            residual = np.full(len(residual), np.nan)
        return residual, jacobian, pairs[0]


def _minimise(problem: DiagnosisProblem, refit: Refit, *, shapes: bool = False) -> Refit:
    """The joint refit by one search, with onset times as continuous parameters.

    With ``shapes`` it also frees what only joint refits do, with the prior of the problem.
    """
    from scipy.optimize import least_squares  # slow to import: while programs are compiled (slotted_programs)

    function = _JointResidual(problem, refit)
    lower, upper = problem.vector_bounds(function.free, jointly=shapes)
    start = function.start().clip(lower, upper)
    residual, jacobian, _ = function.evaluate(start.tobytes())
    if not np.all(np.isfinite(residual)):
        return refit
    influence = np.linalg.norm(jacobian, axis=0)
    free = (lower < upper) & (influence > _MIN_INFLUENCE * np.max(influence))
    weights = _prior_weights(problem, residual, len(start)) if shapes else np.zeros(len(start))
    centre = np.append(problem.nominal, np.zeros(len(start) - problem.size))

    def pack(x: np.ndarray) -> bytes:
        point = start.copy()
        point[free] = x
        return point.tobytes()

    # SciPy's own step length overflows where a singular value is next to 0.
    with np.errstate(over="ignore"):
        result = least_squares(
            lambda x: np.append(function.evaluate(pack(x))[0], weights[free] * (x - centre[free])),
            start[free],
            lambda x: np.vstack(  # pyright: ignore[reportArgumentType]
                [function.evaluate(pack(x))[1][:, free], np.diag(weights[free])]
            ),
            (lower[free], upper[free]),
            x_scale="jac",
            ftol=_FTOL if problem.reduced_chi2(refit.residual, TRAIN) < ASK_FROM else _FTOL_FAR,
            max_nfev=_MAX_EVALUATIONS,
        )
    packed = pack(result.x)
    point = np.frombuffer(packed)
    return Refit(function.effect_set(point), point[: problem.size], *function.evaluate(packed)[2], refit.status)


def _prior_weights(problem: DiagnosisProblem, residual: np.ndarray, size: int) -> np.ndarray:
    """Factors on the distances from the rig's own values that make them residuals of the prior."""
    weights = np.zeros(size)
    if problem.joint_prior is not None:
        weights[: problem.size] = math.sqrt(_PRIOR_SHARE * float(residual @ residual)) / problem.joint_prior.deviations
    return weights
