"""Compiler options of JAX for a process, and the choice of the CPU for single simulations.

Importing smajax sets none of these: the command line, the tests and the experiments call
``smajax.numerics.process.prepare_jax``, which sets the options. They serve the speed of compilation. What changes the
digits of a plant's programs, that a loop is one machine function, belongs to the programs
(``smajax.numerics.loop_kernels``). Outside of such loops the emitters change the rounding of input-output models and of
sweeps: the programs of a search and of a sweep have ``EMITTER_OPTIONS`` with any options of the process, so that
commands and library agree.
"""

import contextlib
import os
import platform
from typing import Any

import jax

# XLA's older emitters compile what is outside of loops faster. XLA aborts the process on an unknown option, and the XLA
# of jax 0.11 no longer has this one.
EMITTER_OPTIONS = {"xla_cpu_use_fusion_emitters": False} if jax.__version_info__ < (0, 11) else {}
EMITTER_FLAGS = tuple(f"--{name}={str(value).lower()}" for name, value in EMITTER_OPTIONS.items())
# Loops of single simulations operate on short vectors, which AVX-512 slows down; the wide batches of sweeps it does
# not. XLA takes this option from the process only, so sweeps, whose digits it changes,
# are without it. test_a_command_and_the_library_give_the_same_document of tests/integration holds that digits stay.
ISA_FLAGS = ("--xla_cpu_max_isa=AVX2",) if platform.machine().lower() in ("x86_64", "amd64") else ()


def set_compiler_options(batches: bool = False) -> None:
    """Add compiler options to the environment's ``XLA_FLAGS``; those that it already contains are left unchanged.

    If JAX has compiled something before, the options have no effect.

    Args:
        batches: Whether the process simulates batches of designs, for which AVX-512 is as fast.
    """
    flags = os.environ.get("XLA_FLAGS", "")
    added = [flag for flag in (*EMITTER_FLAGS, *(() if batches else ISA_FLAGS)) if flag.split("=")[0] not in flags]
    os.environ["XLA_FLAGS"] = " ".join([flags, *added]).strip()


def on_cpu() -> contextlib.AbstractContextManager[Any]:
    """Return a context in which compiled programs run on the CPU, even if JAX has an accelerator.

    A single simulation is a chain of small steps, which an accelerator runs more slowly. If ``JAX_PLATFORMS`` excludes
    the CPU, the context changes nothing.
    """
    try:
        return jax.default_device(jax.devices("cpu")[0])
    except RuntimeError:  # JAX_PLATFORMS excludes the CPU
        return contextlib.nullcontext()
