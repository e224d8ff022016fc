"""Keys of traced programs: a text of everything that a traced program depends on, the same in every process.

A program depends on the code of smajax and of the libraries that it calls, on JAX's settings, on the shapes of the
arrays among its arguments, and on the arguments that are no arrays, such as the classes of a plant's stages. What has
no such text, and code of other packages, which may change without a new version, gives no key; such a program is traced
in every process. So it is after a source file of smajax was edited while the process runs, since Python may have
imported it before.
"""

import dataclasses
import enum
import functools
import hashlib
import os
import platform
import sys
import time
import types
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.core
import numpy as np

# Number of the format of stored programs and keys.
_FORMAT = 1
# Packages whose code changes with their version only, and smajax, whose files are part of the key.
_LIBRARIES = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax", "diffrax")
_KNOWN = frozenset({*_LIBRARIES, "smajax", "builtins", "functools", "operator", "enum", "collections"})
# Settings that say where programs are cached, not what they compute.
_CACHE_SETTINGS = ("jax_compilation_cache", "jax_persistent_cache", "jax_enable_compilation_cache")
# Environment variables that change programs.
_VARIABLES = ("XLA_FLAGS",)
# Whether equinox's checks are part of programs: equinox reads the variable when it is imported.
_CHECKS = getattr(sys.modules.get("equinox._config"), "EQX_ON_ERROR", os.environ.get("EQX_ON_ERROR", ""))
_SOURCES = Path(__file__).parents[1]
# In seconds since the epoch, as the times of files are.
_TIME_OF_IMPORT = time.time()


class NoKeyError(Exception):
    """A program depends on something that has no text which is the same in every process."""


def program_key(function: Any, options: Mapping[str, Any], arguments: Any) -> str:
    """Return the key of a program.

    Args:
        function: The function that is traced.
        options: Options of ``jax.jit``.
        arguments: Its arguments, a pytree.

    Returns:
        A hexadecimal number.

    Raises:
        NoKeyError: If a part has no key.
    """
    texts = [_environment(), _text(function), _text(dict(options)), _text(arguments, is_argument=True)]
    return hashlib.sha256("\n".join(texts).encode()).hexdigest()


def _environment() -> str:
    """The code, its versions, and JAX's settings."""
    settings = {name: str(value) for name, value in jax.config.values.items() if not name.startswith(_CACHE_SETTINGS)}
    versions = {name: sys.modules[name].__version__ for name in _LIBRARIES if name in sys.modules}
    variables = {name: os.environ.get(name, "") for name in _VARIABLES}
    where = (sys.version, platform.machine(), jax.default_backend(), _CHECKS)
    return repr((_FORMAT, _code_hash(), sorted(versions.items()), where, sorted(variables.items()), settings))


def is_code_edited() -> bool:
    """Return whether a source file of smajax was written after this module was imported."""
    return any(path.stat().st_mtime > _TIME_OF_IMPORT for path in _source_files())


def _source_files() -> list[Path]:
    return sorted(_SOURCES.rglob("*.py"))


@functools.cache
def _code_hash() -> str:
    """A hash of the source files of smajax."""
    files = _source_files()
    if not files or is_code_edited():
        raise NoKeyError("smajax has no source files, or other ones than those that were imported")
    total = hashlib.sha256()
    for path in files:
        total.update(str(path.relative_to(_SOURCES)).encode() + b"\0" + path.read_bytes() + b"\0")
    return total.hexdigest()


def _name(value: Any) -> str:
    """The module and name of a class or function."""
    _check_module(value.__module__)
    if isinstance(value, type) and "<locals>" in value.__qualname__:
        raise NoKeyError(f"{value.__qualname__} is a class of a function, which may make several of this name")
    return f"{value.__module__}:{value.__qualname__}"


def _check_module(module: str | None) -> None:
    if module is None or module.partition(".")[0] not in _KNOWN:
        raise NoKeyError(f"{module} has code without a version")


def _text(value: Any, is_argument: bool = False) -> str:
    """A text of a value; of arrays that are leaves of an argument only their shape and type."""
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, enum.Enum):
        return f"{_name(type(value))}.{value.name}"
    if isinstance(value, jax.core.Tracer):
        raise NoKeyError("a value that JAX traces has no text")
    if eqx.is_array(value):
        content = "" if is_argument else hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
        return f"array {value.shape} {value.dtype} {content}"
    if isinstance(value, jax.ShapeDtypeStruct | np.dtype):
        return str(value)
    if isinstance(value, type):
        return f"class {_name(value)}"
    if dataclasses.is_dataclass(value):
        return f"{_name(type(value))}({', '.join(_field_texts(value, is_argument))})"
    return _container_text(value, is_argument) or _function_text(value)


def _field_texts(value: Any, is_argument: bool) -> Iterator[str]:
    """Texts of the fields of a dataclass. Static fields of a module, and all fields of others, are no leaves."""
    for field in dataclasses.fields(value):
        is_leaf = is_argument and isinstance(value, eqx.Module) and not field.metadata.get("static", False)
        yield f"{field.name}={_text(getattr(value, field.name, None), is_leaf)}"


def _container_text(value: Any, is_argument: bool) -> str:
    """A text of a container; empty if it is none."""
    if isinstance(value, tuple | list):
        return f"{_name(type(value))}({', '.join(_text(item, is_argument) for item in value)})"
    if isinstance(value, Mapping):
        is_leaf = is_argument and isinstance(value, dict)
        return f"mapping({', '.join(f'{_text(key)}: {_text(item, is_leaf)}' for key, item in value.items())})"
    if isinstance(value, set | frozenset):
        return f"set({', '.join(sorted(_text(item) for item in value))})"
    return ""


def _function_text(value: Any) -> str:
    """A text of something that can be called, with the values that it has captured."""
    if isinstance(value, functools.partial):
        return f"partial({_text(value.func)}, {_text(value.args)}, {_text(value.keywords)})"
    if isinstance(value, types.MethodType):
        return f"method({_text(value.__func__)}, {_text(value.__self__)})"
    if isinstance(value, types.FunctionType):
        # functools.wraps gives a function the module and the name of the one that it wraps.
        _check_module(value.__globals__.get("__name__"))
        parts = ([cell.cell_contents for cell in value.__closure__ or ()], value.__defaults__, value.__kwdefaults__)
        return f"{_name(value)}:{_code_text(value.__code__)}({', '.join(_text(part) for part in parts)})"
    if isinstance(value, jax.custom_jvp):
        return f"custom_jvp({_text(value.__wrapped__)}, {_text(value.jvp)})"
    if isinstance(value, types.BuiltinFunctionType | np.ufunc) and getattr(value, "__module__", None):
        return _name(value)
    raise NoKeyError(f"{type(value).__module__}.{type(value).__qualname__} has no text")


def _code_text(code: types.CodeType) -> str:
    """The line of a function and its code, by which two lambdas in one line differ."""
    constants = [_code_text(c) if isinstance(c, types.CodeType) else repr(c) for c in code.co_consts]
    return repr((code.co_firstlineno, code.co_code, code.co_names, constants))
