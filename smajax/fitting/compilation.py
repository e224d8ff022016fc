"""Code that serves the compiler only.

- ``SEARCH_OPTIONS``: the programs of a search, which are never part of another program, are compiled with the options
  of the commands, and round in the same way from Python. Nothing else here changes a result.
- ``vmap_unless_single``: a batch of one compiles and runs slower than no batch, so a single start, recording or point
  is computed without one.
- ``LARGE_PROGRAM_OPTIONS``: in a large program without a batch, LLVM's later optimisations take long and save no run
  time.
- Two programs (``primal_fn`` of ``smajax.fitting.multi_start.MultiStartSolver``): simulation and derivatives are
  compiled in parallel, and the derivatives are computed only for accepted steps.
- The starts of a search run one program without a batch, in a thread for each core, so that fits with any number of
  starts, profiles and refits share it, and a search that has ended costs nothing (``smajax.fitting.multi_start``).
- That program is compiled in the background while the recordings are checked (``smajax.fitting.preparation``).
- ``residual`` and ``costs`` in ``smajax.fitting.abstract_problem`` are one compiled program each for all searches.
"""

from collections.abc import Callable
from typing import Any

import jax

from smajax.numerics.jax_setup import EMITTER_OPTIONS

SEARCH_OPTIONS: dict[str, Any] = {**EMITTER_OPTIONS}
LARGE_PROGRAM_OPTIONS: dict[str, Any] = {**SEARCH_OPTIONS, "xla_backend_optimization_level": 1}


def vmap_unless_single(function: Callable[..., Any], size: int, *arguments: Any) -> Any:
    """Map a function over the leading axis of all leaves of its arguments, without a batch where it has length 1.

    Args:
        function: Function of ``arguments`` without their leading axis.
        size: Length of the leading axis.
        *arguments: Pytrees of arrays.

    Returns:
        The function's result, with a leading axis of ``size`` on all leaves.
    """
    if size == 1:
        result = function(*jax.tree.map(lambda leaf: leaf[0], arguments))
        return jax.tree.map(lambda leaf: leaf[None], result)
    return jax.vmap(function)(*arguments)
