"""Settings of the process that runs smajax: JAX's platform and cache, garbage collection, processor cores."""

import ctypes
import gc
import os
import tempfile
from pathlib import Path

from smajax.errors import InputError

# Objects allocated before the garbage collector runs (Python's default is 700 to 2000). Serialising a compiled program
# allocates many small objects, none of which is garbage. Chosen by trial.
_GARBAGE_THRESHOLD = 200_000
# Parameters of mallopt(3) of the GNU C library with their values: up to 512 MiB that are freed at the end of the heap
# are kept, and all threads share one heap, also for large arrays. Chosen by experiments/speed/allocator.py.
_KEEP_FREED_MEMORY = {-1: 512 * 2**20, -4: 0, -8: 1}  # M_TRIM_THRESHOLD, M_MMAP_MAX, M_ARENA_MAX
STORED_PROGRAMS = "SMAJAX_STORED_PROGRAMS"
"""Environment variable: whether traced programs are kept between processes, ``on`` or ``off``."""
COMPILATION = "smajax-compilation"
"""Name of the threads that compile in the background."""


def prepare_jax(accelerator: bool = False) -> None:
    """Set up JAX for a process of the command line: double precision, compiler options, platform and cache.

    Importing smajax only switches JAX to double precision, unless ``JAX_ENABLE_X64`` is set; here it is switched on in
    any case. The rest makes programs faster and changes no result; from Python call it before anything is compiled.
    Compiled programs are cached between runs in the user's cache folder or in ``JAX_COMPILATION_CACHE_DIR``, and so are
    traced ones, unless ``SMAJAX_STORED_PROGRAMS`` is ``off``. If no folder can be written, nothing is cached, and
    everything else works. A GPU is many times as slow for a few simulations at a time, and faster for thousands of
    designs in parallel. Equinox's run-time checks are switched off: they call Python from the compiled program, which
    then cannot be cached. smajax's simulations have status codes instead. Where equinox was imported before, its checks
    stay; where JAX has compiled something before, its compiler options stay.

    Args:
        accelerator: Whether JAX may use an accelerator, as for a sweep; otherwise it uses the CPU, unless
            ``JAX_PLATFORMS`` is set.
    """
    os.environ.setdefault("EQX_ON_ERROR", "off")
    gc.set_threshold(_GARBAGE_THRESHOLD, 20, 50)
    import jax

    from smajax.numerics.jax_setup import set_compiler_options

    set_compiler_options(batches=accelerator)
    jax.config.update("jax_enable_x64", True)
    if not accelerator and not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        folder = cache_folder("jax")
        if folder is None:
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    os.environ.setdefault(STORED_PROGRAMS, "on")


def require_gpu() -> None:
    """Refuse to go on without a GPU that JAX can use.

    Raises:
        InputError: If JAX's default device is not a GPU.
    """
    import jax

    try:
        found = jax.default_backend()
    except (RuntimeError, AssertionError):  # JAX_PLATFORMS names a platform that is not there
        found = "no device"
    if found != "gpu":
        raise InputError(
            f"--device gpu: JAX finds {found} instead of a GPU: install JAX for your GPU, as in "
            "pip install 'jax[cuda13]<0.11', unset JAX_PLATFORMS if it is set, or leave --device out"
        )


def keep_freed_memory() -> None:
    """Let the allocator keep what is freed for the next call of a program; GNU C library only, else nothing changes.

    For processes that run batch after batch: the system would clear all pages of their arrays for each. Compilations in
    several threads take longer with one heap, so that other processes do not call it.
    """
    try:
        library = ctypes.CDLL(None)
    except (OSError, TypeError):  # Windows
        return
    if not hasattr(library, "gnu_get_libc_version"):
        return
    for parameter, value in _KEEP_FREED_MEMORY.items():
        library.mallopt(parameter, value)


def count_cores() -> int:
    """Count the processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cache_folder(name: str) -> Path | None:
    """Create a folder in the user's cache.

    Args:
        name: Name of the folder.

    Returns:
        The folder; ``None`` if it cannot be written.
    """
    import pooch

    folder = Path(pooch.os_cache("smajax")) / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):
        return None
