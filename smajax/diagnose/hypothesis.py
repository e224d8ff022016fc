"""What may be missing: a hypothesis, how it is fitted and was, and a term of free form that may stand beside it."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np

from smajax.fit import least_squares
from smajax.fit.least_squares import Stop


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """Effects that are there: their keys, and starting values of their strengths and shapes by parameter name."""

    keys: tuple[str, ...] = ()
    values: tuple[tuple[str, float], ...] = ()

    def extended(self, key: str, values: dict[str, float]) -> "Hypothesis":
        """With one more effect."""
        return Hypothesis((*self.keys, key), (*self.values, *values.items()))

    def at(self, values: dict[str, float]) -> "Hypothesis":
        """With other values of some parameters."""
        return Hypothesis(self.keys, tuple({**dict(self.values), **values}.items()))

    def without(self, key: str) -> "Hypothesis":
        """With one effect less."""
        prefix = f"effects.{key}."
        return Hypothesis(tuple(k for k in self.keys if k != key), tuple((n, v) for n, v in self.values if not n.startswith(prefix)))


@dataclasses.dataclass(frozen=True)
class Form:
    """A free term: its kind (row of ``freeform.KINDS``), what it stands against from ``low`` to ``high``, and its nodes.

    ``matrix``, shape ``(freeform.KNOTS, nodes)``, makes the knots of what the slots hold.
    """

    kind: int
    against: str
    low: float
    high: float
    matrix: np.ndarray


@dataclasses.dataclass(frozen=True)
class Running:
    """A search that can go on: its hypothesis and its free term, if it has one, and what it was started with.

    ``stride`` says of how many samples it sees one; ``count`` is told how many simulations each advance took.
    """

    search: least_squares.Search
    hypothesis: Hypothesis
    form: Form | None
    stride: int
    near: bool
    rtol: float
    count: Callable[[int], None]

    @property
    def cost(self) -> float:
        """Sum of the squared residuals over the noise, as of all samples."""
        return self.stride * self.search.cost

    def advance(self, steps: int) -> "Running":
        """At most so many steps more."""
        before = self.search.simulations
        self.search.advance(steps)
        self.count(self.search.simulations - before)
        return self


@dataclasses.dataclass(frozen=True)
class Refit:
    """A hypothesis fitted: base vector ``(p,)``, effect parameters by name, residual and Jacobian (base, then moved parameters).

    ``nodes`` are those of a free term, where there is one.
    """

    hypothesis: Hypothesis
    base: np.ndarray
    residual: np.ndarray
    jacobian: np.ndarray
    stop: Stop
    nodes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0))

    def with_last(self, key: str) -> "Refit":
        """The same refit as if one of its effects had been added last; its Jacobian keeps its order."""
        keys = (*(k for k in self.hypothesis.keys if k != key), key)
        return dataclasses.replace(self, hypothesis=dataclasses.replace(self.hypothesis, keys=keys))

    @property
    def values(self) -> dict[str, float]:
        """Strengths and shapes by parameter name."""
        return dict(self.hypothesis.values)

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals over the noise; infinite if the simulation fails at the start point."""
        return math.inf if self.stop is Stop.failed else float(self.residual @ self.residual)
