"""Double precision and the compiler's options: importing this sets both for the whole process, and all of smajax that computes imports it.

A loop over steps runs many times as fast if all of it, however large its arrays are, is one function of machine code. Such a function is
full of short vectors, which AVX-512 slows down, and XLA's older emitters compile it faster. Options that ``XLA_FLAGS`` names already stay
as they are; where JAX has compiled something before, it is too late for these, and all is only slower.
"""

import os
import platform

import jax

# Known to jax < 0.11.
XLA_FLAGS = (
    "--xla_cpu_use_fusion_emitters=false",
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=1000000000",
    *(["--xla_cpu_max_isa=AVX2"] if platform.machine().lower() in ("x86_64", "amd64") else []),
)

_given = os.environ.get("XLA_FLAGS", "")
os.environ["XLA_FLAGS"] = " ".join([_given, *(flag for flag in XLA_FLAGS if flag.split("=")[0] not in _given)]).strip()
jax.config.update("jax_enable_x64", True)
