"""Double precision and compiler options, set for the process by importing this module.

All modules of smajax that compute import this one. A loop over time steps runs many times as fast if all of it, also
with large arrays, is compiled into one function. Such a function operates on short vectors, which AVX-512 slows down,
and XLA's older emitters compile it faster. Options that ``XLA_FLAGS`` already contains are left unchanged. If JAX has
compiled something before, the options have no effect: results are the same, but everything is slower.
"""

import contextlib
import os
import platform

import jax

XLA_FLAGS = (
    # XLA aborts the process on an unknown option, and the XLA of jax 0.11 no longer has this one.
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
    """Return a context in which compiled programs run on the CPU, even if JAX has an accelerator.

    A single simulation is a chain of small steps, which an accelerator runs more slowly. If ``JAX_PLATFORMS`` excludes
    the CPU, the context changes nothing.
    """
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:  # JAX_PLATFORMS excludes the CPU
        return contextlib.nullcontext()
