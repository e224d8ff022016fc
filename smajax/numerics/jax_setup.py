"""Double precision and compiler options, set for the process by importing this module.

All of smajax that computes imports this module. A loop over time steps runs many times as fast if all of it, however
large its arrays are, is compiled into one function. Such a function consists of short vectors, which AVX-512 slows
down, and XLA's older emitters compile it faster. Options that ``XLA_FLAGS`` names already stay as they are. Where JAX
has compiled something before, the options come too late, and everything is only slower.
"""

import contextlib
import os
import platform

import jax

XLA_FLAGS = (
    # XLA ends a process that names an option it does not know, and that of jax 0.11 no longer knows this one.
    *(["--xla_cpu_use_fusion_emitters=false"] if jax.__version_info__ < (0, 11) else []),
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
    *(["--xla_cpu_max_isa=AVX2"] if platform.machine().lower() in ("x86_64", "amd64") else []),
)

_environment_flags = os.environ.get("XLA_FLAGS", "")
os.environ["XLA_FLAGS"] = " ".join(
    [_environment_flags, *(flag for flag in XLA_FLAGS if flag.split("=")[0] not in _environment_flags)]
).strip()
jax.config.update("jax_enable_x64", True)


def on_cpu() -> contextlib.AbstractContextManager:
    """Make a context in which compiled programs run on the CPU, also where JAX has an accelerator.

    A single simulation is a chain of small steps, which an accelerator runs more slowly. Where ``JAX_PLATFORMS`` leaves
    the CPU out, the context changes nothing.
    """
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:  # JAX_PLATFORMS leaves the CPU out
        return contextlib.nullcontext()
