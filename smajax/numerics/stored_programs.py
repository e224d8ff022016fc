"""Traced programs that are kept between processes, next to JAX's cache of compiled programs.

JAX keeps compiled programs between processes, but a process has to trace Python code to find them, which takes longer
than all numbers of a fit. ``stored`` keeps what was traced, as StableHLO (``jax.export``), under a key of everything
that it depends on (``program_keys``): the next process neither traces nor compiles. ``experiments/speed/start_up.py``
shows what it buys. The programs are the same ones, so that no number changes.

``smajax.numerics.process.prepare_jax`` switches it on for the commands, unless the environment variable
``SMAJAX_STORED_PROGRAMS`` is ``off``. A process that replaces functions of smajax while it runs has to switch it off.
"""

import contextlib
import functools
import hashlib
import itertools
import json
import os
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.core
import jax.export

from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.numerics.output_trees import decode, encode
from smajax.numerics.process import STORED_PROGRAMS
from smajax.numerics.program_keys import NoKeyError, is_code_edited, program_key

# Folder in JAX's cache, ending of its files, and their largest number, which bounds the size of the folder; those that
# were not used for longest are deleted.
_FOLDER, _SUFFIX, _MOST_FILES = "traced", ".program", 256
# Bytes of the hash and of the length of the structure at the beginning of a file.
_HASH_BYTES, _LENGTH_BYTES = 32, 8


def stored(function: Callable[..., Any], **options: Any) -> "StoredFunction":
    """Compile a function as ``jit_with_kernels`` does, and keep what was traced between processes.

    Args:
        function: Function of pytrees, whose results are arrays in tuples, dictionaries, named tuples and modules.
        options: Options of ``jax.jit``, such as ``compiler_options``.

    Returns:
        The compiled function.
    """
    return StoredFunction(function, options)


class StoredFunction:
    """A function whose traced programs are kept between processes; made by ``stored``."""

    def __init__(self, function: Callable[..., Any], options: dict[str, Any]) -> None:
        functools.update_wrapper(self, function)
        self._function, self._options = function, options
        self._plain = jit_with_kernels(function, **options)
        self._inner = jit_with_kernels(function)  # JAX takes compiler options of the outermost program only
        self._programs: dict[Any, _Program | None] = {}
        self._called: set[Any] = set()
        self._first_calls: dict[Any, threading.RLock] = {}
        self._lock = threading.RLock()

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the function; while a thread compiles a program, others that need it wait for it."""
        signature, arrays = _signature((args, kwargs))
        with self._first_call(signature):
            program = self._program_of(signature, (args, kwargs))
            return self._plain(*args, **kwargs) if program is None else program(arrays)

    def lower(self, *args: Any, **kwargs: Any) -> None:
        """Trace and lower the program for some arguments, so that it can be compiled in another thread."""
        signature, arrays = _signature((args, kwargs))
        program = self._program_of(signature, (args, kwargs))
        if program is None:
            self._plain.lower(*args, **kwargs)
        else:
            program.lower(arrays)

    @contextlib.contextmanager
    def _first_call(self, signature: Any) -> Iterator[None]:
        """Hold the lock of a program until it has been called once."""
        if signature is None or signature in self._called:
            yield
            return
        with self._lock:
            lock = self._first_calls.setdefault(signature, threading.RLock())
        with lock:
            yield
            self._called.add(signature)
            self._first_calls.pop(signature, None)

    def _program_of(self, signature: Any, arguments: Any) -> "_Program | None":
        """The stored program for arguments with a signature; ``None`` if there is none."""
        folder = _folder(jax.config.values)
        if folder is None or signature is None:
            return None
        with self._lock:
            if signature not in self._programs:
                self._programs[signature] = self._load_or_trace(folder, arguments)
            return self._programs[signature]

    def _load_or_trace(self, folder: Path, arguments: Any) -> "_Program | None":
        try:
            path = folder / (program_key(self._function, self._options, arguments) + _SUFFIX)
        except NoKeyError:
            return None
        with contextlib.suppress(OSError, ValueError):
            program = _Program(path.read_bytes(), self._options)
            with contextlib.suppress(OSError):  # the file of another user
                os.utime(path)
            return program
        content = self._traced(arguments)
        if content is None:
            return None
        with contextlib.suppress(OSError):  # a cache that cannot be written is no error
            if not is_code_edited():
                _write(path, content)
        return _Program(content, self._options)

    def _traced(self, arguments: Any) -> bytes | None:
        """The content of the file of a program; ``None`` if it cannot be stored."""
        dynamic, static = eqx.partition(arguments, eqx.is_array)
        leaves, structure = jax.tree.flatten(dynamic)
        results = []

        def flat(*arrays: Any) -> list[Any]:
            args, kwargs = eqx.combine(jax.tree.unflatten(structure, arrays), static)
            results[:] = [self._inner(*args, **kwargs)]
            return jax.tree.leaves(eqx.filter(results[0], eqx.is_array))

        # Without the weak types of JAX, which some arguments have in a first call only.
        shapes = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
        try:
            program = bytes(jax.export.export(jax.jit(flat))(*shapes).serialize())
            document = json.dumps(encode(results[0])).encode()
        except (NotImplementedError, ValueError):
            # jax.export refuses calls of Python, and encode refuses results of other classes. A ValueError of the
            # function itself is raised again when the caller traces it without storing.
            return None
        body = len(document).to_bytes(_LENGTH_BYTES, "big") + document + program
        return hashlib.sha256(body).digest() + body


class _Program:
    """A program with the structure of its results.

    Args:
        content: Content of its file.
        options: Options of ``jax.jit``.

    Raises:
        ValueError: If the content is damaged, or the class of a result is not imported.
    """

    def __init__(self, content: bytes, options: dict[str, Any]) -> None:
        digest, body = content[:_HASH_BYTES], content[_HASH_BYTES:]
        if hashlib.sha256(body).digest() != digest:
            raise ValueError("the file of a traced program is damaged")
        begin = _LENGTH_BYTES + int.from_bytes(body[:_LENGTH_BYTES], "big")
        self._structure = json.loads(body[_LENGTH_BYTES:begin])
        decode(self._structure, itertools.repeat(None))
        exported = jax.export.deserialize(bytearray(body[begin:]))
        # Results of an exported program belong to its device, so that arguments do so at times, for which JAX would
        # compile another program. It is compiled here, once.
        device = jax.sharding.SingleDeviceSharding(jax.local_devices()[0])
        self._call = jax.jit(exported.call, in_shardings=device, out_shardings=device, **options)
        self._lowered: Any = None
        self._compiled: Any = None

    def __call__(self, arrays: Sequence[Any]) -> Any:
        if self._compiled is None:
            self.lower(arrays)
            self._compiled = self._lowered.compile()
        return decode(self._structure, iter(self._compiled(*arrays)))

    def lower(self, arrays: Sequence[Any]) -> None:
        """Lower the program, so that only its compilation remains."""
        if self._lowered is None:
            self._lowered = self._call.lower(*arrays)


def _signature(arguments: Any) -> tuple[Any, list[Any]]:
    """What the program of some arguments depends on, and the arrays among them.

    ``None`` where the arguments are traced, so that they are part of another program, or have no hash.
    """
    leaves, structure = jax.tree.flatten(arguments)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in leaves):
        return None, []
    arrays = [leaf for leaf in leaves if eqx.is_array(leaf)]
    shapes = tuple((leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf for leaf in leaves)
    signature = structure, shapes, tuple(jax.config.values.values())
    try:
        hash(signature)
    except TypeError:
        return None, []
    return signature, arrays


def _folder(settings: Mapping[str, Any]) -> Path | None:
    """The folder of traced programs by JAX's settings; ``None`` if they are not kept."""
    cache = settings["jax_compilation_cache_dir"]
    if os.environ.get(STORED_PROGRAMS) != "on" or not cache or "://" in cache:
        return None
    is_single_cpu = jax.default_backend() == "cpu" and jax.local_device_count() == 1
    return Path(cache) / _FOLDER if is_single_cpu else None


def _write(path: Path, content: bytes) -> None:
    """Write a file at once, so that other processes see all of it or nothing, and delete old ones."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=path.parent, delete=False) as file:
        try:
            file.write(content)
            file.close()
            os.replace(file.name, path)
        except OSError:  # such as a full disk
            os.unlink(file.name)
            raise
    files = sorted(path.parent.iterdir(), key=lambda p: p.stat().st_mtime, reverse=True)
    for old in files[_MOST_FILES:]:
        old.unlink(missing_ok=True)
