"""Compiled programs over batches of designs: batch sizes, memory, and the devices that share a batch.

What each trick buys:

- A batch (``batch_size``) fills the vector units of a core while its states stay in the caches; on an accelerator it is
  as large as keeps the device busy between two steps. Batches are powers of two, and the last one is filled up with
  copies of its last design, so that one program serves all.
- ``xla_cpu_prefer_vector_width`` of 512 lets a batch use the widest vectors; a single simulation is slower with them.
- Batches run on one thread for each core (``parallel_batches``), or one at a time on an accelerator.
- ``spread_over_devices`` shares a batch among several devices.
- Designs that need different steps share programs (``step_levels``), and similar ones share batches (``batch_order`` of
  a problem).
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.errors import InputError
from smajax.numerics.process import count_cores
from smajax.recordings.recording import Floats
from smajax.sweeps.problem import AbstractSweepProblem

# Designs in a batch on an accelerator: with fewer it waits for the next step, with more its caches do not hold them.
# Chosen by experiments/speed/sweep_throughput.py.
ACCELERATOR_BATCH = 16384
# Bytes for the arrays of a batch on each core, and on an accelerator.
MEMORY = 2**28
ACCELERATOR_MEMORY = 2**33
# Bytes that one design may take.
_MAX_DESIGN_MEMORY = 2**31
# States next to the channels that derivatives keep, as a multiple of the channels; an estimate.
_STATES = 4


def _evaluate_batch(
    problem: AbstractSweepProblem, designs: jax.Array, steps: int
) -> tuple[dict[str, jax.Array], jax.Array]:
    """Metrics by name, each ``(m,)``, and codes, ``(m,)``, of designs ``(m, axes)``."""
    return jax.vmap(lambda design: problem.evaluate(design, steps))(designs)


_WIDE_VECTORS: Any = {"compiler_options": {"xla_cpu_prefer_vector_width": 512}}
evaluate_batch: Any = eqx.filter_jit(_evaluate_batch, **_WIDE_VECTORS)


@eqx.filter_jit
def differentiate_batch(problem: AbstractSweepProblem, designs: jax.Array, steps: int) -> tuple[dict, dict, jax.Array]:
    """Return metrics, ``(m,)`` each, derivatives with respect to the axes, ``(m, axes)`` each, and codes, ``(m,)``."""

    def evaluate_twice(design: jax.Array) -> tuple[dict, tuple[dict, jax.Array]]:
        metrics, code = problem.evaluate(design, steps, differentiable=True)
        return metrics, (metrics, code)

    derivatives, (metrics, codes) = jax.vmap(jax.jacfwd(evaluate_twice, has_aux=True))(designs)
    return metrics, derivatives, codes


def on_accelerator() -> bool:
    """Return whether an accelerator does the work; its batches may hold several chunks."""
    return jax.default_backend() != "cpu"


def parallel_batches() -> int:
    """Return how many batches run at once: one on each core, or one in all on an accelerator."""
    return 1 if on_accelerator() else count_cores()


def batch_size(problem: AbstractSweepProblem, steps: int, gradients: bool) -> int:
    """Return the designs of a batch, a power of two: as many as are fast, or as the memory holds."""
    if on_accelerator():
        fast, memory = ACCELERATOR_BATCH * jax.device_count(), ACCELERATOR_MEMORY * jax.device_count()
    else:
        fast, memory = problem.batch, MEMORY
    return max(1, min(fast, 2 ** int(math.log2(max(1.0, memory / _design_memory(problem, steps, gradients))))))


def check_memory(problem: AbstractSweepProblem, steps: int, gradients: bool) -> None:
    """Raise InputError, with the cure, if one design of so many steps takes more memory than is allowed."""
    memory = _design_memory(problem, steps, gradients)
    if memory > _MAX_DESIGN_MEMORY:
        raise InputError(
            f"{problem.size_message(steps)}, {memory / 2**30:.1f} GB a design, of {_MAX_DESIGN_MEMORY / 2**30:.0f} GB "
            f"allowed: {problem.size_hint}"
        )


def _design_memory(problem: AbstractSweepProblem, steps: int, gradients: bool) -> int:
    """Bytes of one design; derivatives keep all states next to the channels, and a tangent for each axis."""
    return 8 * problem.numbers(steps) * ((1 + len(problem.names)) * _STATES if gradients else 1)


def spread_over_devices(designs: Floats) -> jax.Array:
    """Return the designs on the device, or shared among several devices where their number divides the designs."""
    if jax.device_count() == 1 or len(designs) % jax.device_count():
        return jnp.asarray(designs)
    mesh = jax.make_mesh((jax.device_count(),), ("designs",), axis_types=(jax.sharding.AxisType.Auto,))
    return jax.device_put(designs, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("designs")))
