"""Double precision and the compiler's options: importing this sets both for the whole process, and all of smajax that computes imports it.

A loop over steps runs many times as fast if all of it, however large its arrays are, is one function of machine code. Such a function is
full of short vectors, which AVX-512 slows down, and XLA's older emitters compile it faster. Options that ``XLA_FLAGS`` names already stay
as they are; where JAX has compiled something before, it is too late for these, and all is only slower.
"""

import contextlib
import os
import platform

import jax

# XLA ends a process that names an option it does not know, and jax 0.11's does not know the first any more.
XLA_FLAGS = (
    *(["--xla_cpu_use_fusion_emitters=false"] if jax.__version_info__ < (0, 11) else []),
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
    *(["--xla_cpu_max_isa=AVX2"] if platform.machine().lower() in ("x86_64", "amd64") else []),
)

_given = os.environ.get("XLA_FLAGS", "")
os.environ["XLA_FLAGS"] = " ".join([_given, *(flag for flag in XLA_FLAGS if flag.split("=")[0] not in _given)]).strip()
jax.config.update("jax_enable_x64", True)


def on_processor() -> contextlib.AbstractContextManager:
    """What is compiled inside runs on the processor, also where JAX has an accelerator: one simulation is a chain of small steps."""
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:  # JAX_PLATFORMS leaves it out
        return contextlib.nullcontext()
