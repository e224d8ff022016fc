"""What serves the compiler only.

- ``vmap_unless_single``: a batch of one compiles and runs slower than no batch, so one start, one recording or one
  point is computed without.
- ``LARGE_PROGRAM_OPTIONS``: in a large program that is no batch, LLVM's later optimisations take long and make nothing
  faster.
- Two programs (``primal_fn`` of ``smajax.fitting.multi_start.MultiStartSolver``): simulation and derivatives compile
  side by side, and the derivatives are computed only for steps that are taken.
- ``residual`` and ``costs`` in ``smajax.fitting.abstract_problem`` are one program each, whoever searches.

None of this changes a result.
"""

from collections.abc import Callable
from typing import Any

import jax

LARGE_PROGRAM_OPTIONS = {"xla_backend_optimization_level": 1}


def vmap_unless_single(function: Callable, size: int, *arguments: Any) -> Any:
    """Map a function over the leading axis, of length ``size``, of all leaves of its arguments."""
    if size == 1:
        result = function(*jax.tree.map(lambda leaf: leaf[0], arguments))
        return jax.tree.map(lambda leaf: leaf[None], result)
    return jax.vmap(function)(*arguments)
