"""Compiled programs over batches of designs: batch sizes, memory, and the devices that share a batch.

What makes a sweep fast:

- A batch (``batch_size``) fills the vector units of a core while its states stay in the caches; on an accelerator it is
  large enough to keep the device busy between two steps. Batch sizes are powers of two, and the last batch is padded
  with copies of its last design, so that all batches use the same program.
- ``xla_cpu_prefer_vector_width`` of 512 lets a batch use the widest vectors; a single simulation is slower with them.
- Batches run in one thread per core (``parallel_batches``), or one at a time on an accelerator.
- ``spread_over_devices`` distributes a batch over several devices.
- Designs that need different steps share programs (``step_levels``), and similar designs share batches (``batch_order``
  of a problem).
"""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.errors import InputError
from smajax.numerics.jax_setup import EMITTER_OPTIONS
from smajax.numerics.stored_programs import stored
from smajax.sweeps.problem import AbstractSweepProblem

# Number of designs in a batch on an accelerator: with fewer it is idle between steps, and more do not fit into its
# caches. Chosen by experiments/speed/sweep_throughput.py.
ACCELERATOR_BATCH = 16384
# Largest number of designs in a batch with derivatives on a CPU, whose tangents fill the caches of a core. Chosen by
# trial on the sweeps of `smajax init`.
GRADIENT_BATCH = 32
# Memory in bytes for the arrays of a batch on each core, and on an accelerator.
MEMORY = 2**28
ACCELERATOR_MEMORY = 2**33
# Largest memory of one design, in bytes.
_MAX_DESIGN_MEMORY = 2**31
# Memory of channels and states with derivatives, as a multiple of that of the channels; an estimate.
_STATE_FACTOR = 4


def _evaluate_batch(
    problem: AbstractSweepProblem, designs: Float[Array, "designs axes"], steps: int
) -> tuple[dict[str, Float[Array, " designs"]], Int[Array, " designs"]]:
    """Metrics by name, and result codes, of designs."""
    return jax.vmap(lambda design: problem.evaluate(design, steps))(designs)


def _differentiate_batch(
    problem: AbstractSweepProblem, designs: Float[Array, "designs axes"], steps: int
) -> tuple[dict[str, Float[Array, " designs"]], dict[str, Float[Array, "designs axes"]], Int[Array, " designs"]]:
    """Metrics by name, their derivatives with respect to the axes, and result codes, of designs."""

    def evaluate_twice(design: Float[Array, " axes"]) -> tuple[dict[str, Any], tuple[dict[str, Any], Int[Array, ""]]]:
        metrics, code = problem.evaluate(design, steps, differentiable=True)
        return metrics, (metrics, code)

    derivatives, (metrics, codes) = jax.vmap(jax.jacfwd(evaluate_twice, has_aux=True))(designs)
    return metrics, derivatives, codes


# The emitters change the rounding of a batch: with the same ones commands and library give the same digits.
evaluate_batch: Any = stored(_evaluate_batch, compiler_options={**EMITTER_OPTIONS, "xla_cpu_prefer_vector_width": 512})
differentiate_batch: Any = stored(_differentiate_batch, compiler_options=EMITTER_OPTIONS)


def on_accelerator() -> bool:
    """Return whether designs are simulated on an accelerator, whose batches may contain several chunks."""
    return jax.default_backend() != "cpu"


def batch_size(problem: AbstractSweepProblem, steps: int, gradients: bool) -> int:
    """Return the number of designs in a batch: a power of two that is fast and fits into the memory.

    Args:
        problem: Maps a design to its metrics.
        steps: Number of steps of each design.
        gradients: Whether derivatives are computed.
    """
    if on_accelerator():
        fast, memory = ACCELERATOR_BATCH * jax.device_count(), ACCELERATOR_MEMORY * jax.device_count()
    else:
        fast, memory = min(problem.batch, GRADIENT_BATCH) if gradients else problem.batch, MEMORY
    return max(1, min(fast, 2 ** int(math.log2(max(1.0, memory / _design_memory(problem, steps, gradients))))))


def check_memory(problem: AbstractSweepProblem, steps: int, gradients: bool) -> None:
    """Check the memory of one design.

    Args:
        problem: Maps a design to its metrics.
        steps: Number of steps of the design.
        gradients: Whether derivatives are computed.

    Raises:
        InputError: If the design needs more memory than is allowed.
    """
    memory = _design_memory(problem, steps, gradients)
    if memory > _MAX_DESIGN_MEMORY:
        raise InputError(
            f"{problem.size_message(steps)}, which need {memory / 2**30:.1f} GB per design, and at most "
            f"{_MAX_DESIGN_MEMORY / 2**30:.0f} GB are allowed: {problem.size_hint}"
        )


def _design_memory(problem: AbstractSweepProblem, steps: int, gradients: bool) -> int:
    """Memory of one design in bytes; derivatives store all states, and a tangent of each axis."""
    return 8 * problem.numbers(steps) * ((1 + len(problem.names)) * _STATE_FACTOR if gradients else 1)


def spread_over_devices(designs: Float[np.ndarray, "designs axes"]) -> Float[Array, "designs axes"]:
    """Put designs on the device, or distribute them over several devices if these divide their number evenly."""
    if jax.device_count() == 1 or len(designs) % jax.device_count():
        return jnp.asarray(designs)
    mesh = jax.make_mesh((jax.device_count(),), ("designs",), axis_types=(jax.sharding.AxisType.Auto,))
    return jax.device_put(designs, jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec("designs")))
