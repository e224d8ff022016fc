"""Candidates of a diagnosis: sets of effects, their fits, and searches that can be continued."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver

# Reduced chi-squared up to which a fit with the right effects is at the noise, where ``chi2_threshold`` is smaller.
# Chosen by trial.
AT_NOISE = 1.25


@dataclasses.dataclass(frozen=True)
class EffectSet:
    """Effects that are added to the plant.

    Attributes:
        keys: Keys of the effects, in the order in which they were added.
        values: Strengths and shapes, SI, by parameter name.
    """

    keys: tuple[str, ...] = ()
    values: tuple[tuple[str, float], ...] = ()

    def with_effect(self, key: str, values: dict[str, float]) -> "EffectSet":
        """Return the set with one more effect.

        Args:
            key: Key of the effect.
            values: Its strength and shapes, SI, by parameter name.
        """
        return EffectSet((*self.keys, key), (*self.values, *values.items()))

    def with_values(self, values: dict[str, float]) -> "EffectSet":
        """Return the set with new values, SI, of some parameters, by name."""
        return EffectSet(self.keys, tuple({**dict(self.values), **values}.items()))

    def without(self, key: str) -> "EffectSet":
        """Return the set without one of its effects."""
        prefix = f"effects.{key}."
        return EffectSet(
            tuple(k for k in self.keys if k != key), tuple((n, v) for n, v in self.values if not n.startswith(prefix))
        )


@dataclasses.dataclass(frozen=True)
class NonparametricTerm:
    """A piecewise linear term of a stage, as a function of one variable.

    Attributes:
        kind: Row of ``nonparametric.KINDS``.
        variable: Word of ``nonparametric.VARIABLES``.
        low: Lower end of the variable's range, in its unit.
        high: Upper end of the variable's range.
        matrix: Maps the values of the nodes, which fill slots, to those of the knots, shape ``(KNOTS, nodes)``.
    """

    kind: int
    variable: str
    low: float
    high: float
    matrix: np.ndarray


@dataclasses.dataclass(frozen=True)
class Refit:
    """A set of effects fitted to the training split together with the base parameters.

    Attributes:
        effect_set: The effects with their fitted values.
        base: Base parameters, shape ``(p,)``.
        residual: Measurement minus model over the noise, shape ``(m,)``.
        jacobian: Derivatives of the residual with respect to the base parameters, then the free effect parameters,
            shape ``(m, columns)``.
        status: Status of the search at its end.
        nodes: Values of a nonparametric term's nodes; empty without one.
    """

    effect_set: EffectSet
    base: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    status: SolverStatus
    nodes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))

    def with_effect_last(self, key: str) -> "Refit":
        """Return the same refit as if one of its effects had been added last; its Jacobian keeps its order."""
        keys = (*(k for k in self.effect_set.keys if k != key), key)
        return dataclasses.replace(self, effect_set=dataclasses.replace(self.effect_set, keys=keys))

    @property
    def values(self) -> dict[str, float]:
        """Strengths and shapes, SI, by parameter name."""
        return dict(self.effect_set.values)

    def values_of(self, key: str) -> dict[str, float]:
        """Return strength and shapes of one effect, SI, by parameter name."""
        return {name: value for name, value in self.values.items() if name.split(".")[1] == key}

    @property
    def chi2(self) -> float:
        """Chi-squared, the sum of the squared residuals; infinite if the simulation fails at the start point."""
        return math.inf if self.status is SolverStatus.failed else float(self.residual @ self.residual)


@dataclasses.dataclass(frozen=True)
class RefitSearch:
    """A search for a refit that can be continued.

    Attributes:
        solver: The solver, at the search's current point.
        effect_set: The effects with their start values.
        free: Names of the effect parameters that it moves; others are held at their start values.
        term: A nonparametric term that is fitted as well, or ``None``.
        stride: Distance of the samples that the search uses.
        near_nominal: Whether the base parameters are held near the rig's own values.
        rtol: Relative fall of the cost at which the search ends.
        count_simulations: Called with the number of simulations of each advance.
    """

    solver: MultiStartSolver
    effect_set: EffectSet
    free: tuple[str, ...]
    term: NonparametricTerm | None
    stride: int
    near_nominal: bool
    rtol: float
    count_simulations: Callable[[int], None]

    @property
    def cost(self) -> float:
        """Chi-squared on the samples that the search uses, scaled to all samples."""
        return self.stride * self.solver.cost

    def advance(self, steps: int) -> "RefitSearch":
        """Take at most ``steps`` further steps, in place, and return the search itself."""
        before = self.solver.simulations
        self.solver.advance(steps)
        self.count_simulations(self.solver.simulations - before)
        return self


class Candidate(NamedTuple):
    """One effect to be added to a fit.

    Attributes:
        parent: The fit.
        key: Key of the effect.
        strength: Expected strength in units of the typical strength.
        shape: Names and values of its shape parameters.
        gain: Fall of chi-squared that its score predicts; 0 if unknown.
    """

    parent: Refit
    key: str
    strength: float
    shape: tuple[Any, ...]
    gain: float = 0.0


@dataclasses.dataclass(frozen=True)
class CandidateFit:
    """A refit with its errors on the training split and on the selection split.

    Attributes:
        refit: The refit.
        train_chi2: Reduced chi-squared on the training split.
        select_chi2: Reduced chi-squared on the selection split.
        rmse_select: RMSE of the first observed channel on the selection split, SI.
    """

    refit: Refit
    train_chi2: float
    select_chi2: float
    rmse_select: float

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of its effects, in the order in which they were added."""
        return self.refit.effect_set.keys

    @property
    def key(self) -> str:
        """Key of the effect that was added last; empty without effects."""
        return self.keys[-1] if self.keys else ""

    @property
    def total_chi2(self) -> float:
        """Sum of the two reduced chi-squared, by which candidate fits are compared; about 2 for noise."""
        return self.train_chi2 + self.select_chi2

    @property
    def at_noise(self) -> bool:
        """Whether the residuals of both splits are as small as those of a fit with the right effects."""
        return self.total_chi2 < 2.0 * AT_NOISE
