"""Candidates of a diagnosis: sets of effects, their fits, and searches that are still running."""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver

# Reduced chi-squared that a fit with the right effects may leave, where the threshold of ``chi2_threshold`` asks for
# less. Chosen by trial.
AT_NOISE = 1.25


@dataclasses.dataclass(frozen=True)
class EffectSet:
    """Effects that are added to the plant: their keys, and values of strengths and shapes by parameter name."""

    keys: tuple[str, ...] = ()
    values: tuple[tuple[str, float], ...] = ()

    def with_effect(self, key: str, values: dict[str, float]) -> "EffectSet":
        """Return the set with one effect more and the values of its parameters."""
        return EffectSet((*self.keys, key), (*self.values, *values.items()))

    def with_values(self, values: dict[str, float]) -> "EffectSet":
        """Return the set with other values of some parameters."""
        return EffectSet(self.keys, tuple({**dict(self.values), **values}.items()))

    def without(self, key: str) -> "EffectSet":
        """Return the set without one of its effects."""
        prefix = f"effects.{key}."
        return EffectSet(
            tuple(k for k in self.keys if k != key), tuple((n, v) for n, v in self.values if not n.startswith(prefix))
        )


@dataclasses.dataclass(frozen=True)
class NonparametricTerm:
    """A piecewise linear term of a stage.

    ``kind`` is a row of ``nonparametric.KINDS``. ``variable`` is a word of ``nonparametric.VARIABLES``, taken from
    ``low`` to ``high``. ``matrix``, shape ``(KNOTS, nodes)``, turns the values of the nodes, which fill slots, into
    those of the knots.
    """

    kind: int
    variable: str
    low: float
    high: float
    matrix: np.ndarray


@dataclasses.dataclass(frozen=True)
class Refit:
    """A set of effects fitted to the training split together with the base parameters.

    ``base``, shape ``(p,)``, are the base parameters; ``residual``, shape ``(m,)``, is divided by the noise;
    ``jacobian`` has the columns of the base parameters, then those of the free effect parameters. ``nodes`` are those
    of a nonparametric term, where there is one.
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
        """Strengths and shapes by parameter name."""
        return dict(self.effect_set.values)

    def values_of(self, key: str) -> dict[str, float]:
        """Return strength and shapes of one effect by parameter name."""
        return {name: value for name, value in self.values.items() if name.split(".")[1] == key}

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals over the noise; infinite if the simulation fails at the start point."""
        return math.inf if self.status is SolverStatus.failed else float(self.residual @ self.residual)


@dataclasses.dataclass(frozen=True)
class RefitSearch:
    """A search for a refit that can be continued.

    ``stride`` is the distance of the samples that it uses; with ``near_nominal`` the base parameters are held near the
    rig's own values. ``count_simulations`` is called with the number of simulations of each advance.
    """

    solver: MultiStartSolver
    effect_set: EffectSet
    term: NonparametricTerm | None
    stride: int
    near_nominal: bool
    rtol: float
    count_simulations: Callable[[int], None]

    @property
    def cost(self) -> float:
        """Sum of the squared residuals over the noise, scaled to all samples."""
        return self.stride * self.solver.cost

    def advance(self, steps: int) -> "RefitSearch":
        """Take at most so many further steps and return the search itself."""
        before = self.solver.simulations
        self.solver.advance(steps)
        self.count_simulations(self.solver.simulations - before)
        return self


class Candidate(NamedTuple):
    """One effect to be added to a fit.

    ``strength`` is the expected one in units of the typical strength, ``shape`` the values of its shape parameters, and
    ``gain`` the fall of chi-squared that its score predicts (0: unknown).
    """

    parent: Refit
    key: str
    strength: float
    shape: tuple
    gain: float = 0.0


@dataclasses.dataclass(frozen=True)
class CandidateFit:
    """A refit with its reduced chi-squared on the training split and on the selection split.

    ``rmse_select`` is the RMSE of the first observed channel on the selection split, SI.
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
        """Sum of both, by which candidate fits are compared."""
        return self.train_chi2 + self.select_chi2

    @property
    def at_noise(self) -> bool:
        """Whether its residuals are as small as those of a fit with the right effects."""
        return self.total_chi2 < 2.0 * AT_NOISE
