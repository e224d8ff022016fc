"""Population searches in common use, to compare the gradient with on the same compiled simulator.

Each takes a problem and returns a ``BaselineResult``. All search within the bounds from which the fit draws its starts,
all are compiled before their clock starts, and all count simulations in the same way: the cost of a point with ``r``
recordings is ``r`` simulations, a residual with its Jacobian in ``p`` parameters ``r (1 + p)``. A cost that is not
finite counts as a failure and is passed to a population as ``meter.UNUSABLE_COST``. pymoo and evosax are extras of the
package, imported where they are used.
"""

from smajax.fitting.baselines.differential_evolution import run_differential_evolution
from smajax.fitting.baselines.evosax_strategies import run_evosax
from smajax.fitting.baselines.genetic_algorithm import run_genetic_algorithm
from smajax.fitting.baselines.gradient import run_gradient_search
from smajax.fitting.baselines.meter import BaselineResult

__all__ = [
    "BaselineResult",
    "run_differential_evolution",
    "run_evosax",
    "run_genetic_algorithm",
    "run_gradient_search",
]
