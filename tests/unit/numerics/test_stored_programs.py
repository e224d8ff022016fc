"""Traced programs that are kept between processes."""

import dataclasses
import functools
import hashlib
import os
import shutil
import subprocess
import sys
import threading
import time
import types
from collections import OrderedDict

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics import output_trees, program_keys, stored_programs
from smajax.numerics.output_trees import UnknownStructureError, decode, encode
from smajax.numerics.program_keys import NoKeyError, program_key
from smajax.numerics.stored_programs import stored
from tests.conftest import ROOT


def scale(values: dict[str, jax.Array], factor: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
    return jnp.sum(values["a"] * factor), {"last": values["a"][-1] * factor}


def check_positive(value: jax.Array) -> jax.Array:
    return eqx.error_if(value, value < 0.0, "not positive", on_error="raise")


def raise_permission_error(*arguments: object) -> None:
    raise PermissionError


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of traced programs, into which functions of the tests may go as if they were smajax's."""
    monkeypatch.setenv("SMAJAX_STORED_PROGRAMS", "on")
    monkeypatch.setattr(program_keys, "_KNOWN", program_keys._KNOWN | {"tests"})
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    yield tmp_path / "traced"
    jax.config.update("jax_compilation_cache_dir", before)


ARGUMENTS = ({"a": jnp.arange(4.0)}, jnp.asarray(2.0))


def check_scaled(result: tuple[jax.Array, dict[str, jax.Array]]) -> None:
    assert float(result[0]) == 12.0 and float(result[1]["last"]) == 6.0


def test_a_program_that_a_thread_compiles_is_waited_for():
    traced = []

    def slow(value):
        traced.append(threading.current_thread())
        time.sleep(0.2)  # longer than the other thread needs to get here
        return 2.0 * value

    doubled, barrier, results = stored(slow), threading.Barrier(2), []

    def call():
        barrier.wait()
        results.append(float(doubled(jnp.asarray(3.0))))

    threads = [threading.Thread(target=call) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert results == [6.0, 6.0] and len(traced) == 1


def test_an_argument_that_belongs_to_the_device_needs_no_program_of_its_own(folder):
    program = stored(scale)
    check_scaled(program(*ARGUMENTS))
    (compiled,) = program._programs.values()
    first = compiled._compiled
    check_scaled(program(*jax.device_put(ARGUMENTS, jax.devices()[0])))
    assert compiled._compiled is first and first is not None


def test_a_program_is_read_again_instead_of_traced(folder, monkeypatch):
    check_scaled(stored(scale)(*ARGUMENTS))
    (path,) = folder.iterdir()
    monkeypatch.setattr(stored_programs.StoredFunction, "_traced", lambda *_: pytest.fail("traced again"))
    again = stored(scale)
    check_scaled(again(*ARGUMENTS))
    check_scaled(again(*ARGUMENTS))
    assert [*folder.iterdir()] == [path]


@pytest.mark.parametrize("damage", [lambda c: c[:-1], lambda c: c[:40] + b"?" + c[41:], lambda c: b""])
def test_a_damaged_file_is_written_again(folder, damage):
    stored(scale)(*ARGUMENTS)
    (path,) = folder.iterdir()
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    check_scaled(stored(scale)(*ARGUMENTS))
    assert len(path.read_bytes()) == len(whole)


def test_derivatives_and_batches_are_traced(folder):
    function = stored(scale)
    values, factor = ARGUMENTS
    assert float(jax.grad(lambda f: function(values, f)[0])(factor)) == 6.0
    assert jax.vmap(lambda f: function(values, f)[0])(jnp.ones(3)).tolist() == [6.0] * 3
    assert not folder.exists()


def test_a_folder_that_cannot_be_written_is_no_error(folder):
    folder.write_text("not a folder")
    check_scaled(stored(scale)(*ARGUMENTS))


def test_code_without_a_version_is_traced_in_every_process(folder, monkeypatch):
    monkeypatch.setattr(program_keys, "_KNOWN", program_keys._KNOWN - {"tests"})
    check_scaled(stored(scale)(*ARGUMENTS))
    assert not folder.exists()


def test_a_program_that_calls_python_is_traced_in_every_process(folder):
    checked = stored(check_positive)
    assert float(checked(jnp.asarray(1.0))) == 1.0
    with pytest.raises(RuntimeError, match="not positive"):
        jax.block_until_ready(checked(jnp.asarray(-1.0)))
    assert not folder.exists()


def test_other_settings_give_another_program(folder):
    function = stored(scale)
    function(*ARGUMENTS)
    with jax.default_matmul_precision("float32"):
        function(*ARGUMENTS)
    assert len([*folder.iterdir()]) == 2


def test_nothing_is_stored_after_a_source_file_was_edited(folder, monkeypatch):
    key_of(1.0)  # the hash of the files is known from now on
    monkeypatch.setattr(program_keys, "_TIME_OF_IMPORT", 0.0)
    check_scaled(stored(scale)(*ARGUMENTS))
    assert [*folder.parent.iterdir()] == []
    program_keys._code_hash.cache_clear()
    with pytest.raises(NoKeyError, match="source files"):
        key_of(1.0)


def test_a_result_of_a_class_that_is_not_imported_is_traced_again(folder, monkeypatch):
    monkeypatch.setattr(output_trees, "_PACKAGES", ("tests",))
    argument = jnp.ones(3)
    stored(make_table)(argument)
    traced = []
    trace = stored_programs.StoredFunction._traced
    monkeypatch.setattr(stored_programs.StoredFunction, "_traced", lambda *a: traced.append(1) or trace(*a))
    assert float(stored(make_table)(argument).numbers[0]) == 1.0 and not traced
    (path,) = folder.iterdir()
    content = path.read_bytes()[32:].replace(b":Table", b":Tabla")
    path.write_bytes(hashlib.sha256(content).digest() + content)
    assert float(stored(make_table)(argument).numbers[0]) == 1.0 and traced


def test_a_file_of_another_user_is_read(folder, monkeypatch):
    stored(scale)(*ARGUMENTS)
    monkeypatch.setattr(os, "utime", raise_permission_error)
    monkeypatch.setattr(stored_programs.StoredFunction, "_traced", lambda *_: pytest.fail("traced again"))
    check_scaled(stored(scale)(*ARGUMENTS))


def test_a_file_that_cannot_be_completed_leaves_nothing(folder, monkeypatch):
    monkeypatch.setattr(os, "replace", raise_permission_error)
    check_scaled(stored(scale)(*ARGUMENTS))
    assert [*folder.iterdir()] == []


def test_the_oldest_files_are_deleted(folder, monkeypatch):
    monkeypatch.setattr(stored_programs, "_MOST_FILES", 2)
    for count in range(1, 5):
        stored(scale)({"a": jnp.ones(count)}, jnp.asarray(1.0))
    assert len([*folder.iterdir()]) == 2


class Table(eqx.Module):
    numbers: jax.Array
    fixed: tuple[float, ...] = eqx.field(static=True)
    other: object = eqx.field(static=True, default=None)


def make_table(numbers: jax.Array) -> Table:
    return Table(numbers, (1.0,))


@dataclasses.dataclass(frozen=True)
class Options:
    weights: np.ndarray


def key_of(*arguments: object) -> str:
    return program_key(scale, {}, arguments)


def test_a_key_holds_all_but_the_numbers_in_arrays(folder):
    table = Table(jnp.ones(3), (1.0, 2.0))
    key = key_of(table)
    assert key == key_of(Table(jnp.zeros(3), (1.0, 2.0)))
    others = [
        Table(jnp.ones(4), (1.0, 2.0)),
        Table(jnp.ones(3, jnp.int32), (1.0, 2.0)),
        Table(jnp.ones(3), (1.0, 3.0)),
        Table(jnp.ones(3), (1.0, 2.0), Options(np.ones(2))),
        Table(jnp.ones(3), (1.0, 2.0), Options(np.zeros(2))),
    ]
    assert len({key, *map(key_of, others)}) == 6
    assert program_key(scale, {"inline": True}, (table,)) != key


def test_what_a_function_captures_is_part_of_its_key(folder):
    def function_with(captured: object):
        return lambda x: x * captured

    keys = {program_key(function_with(v), {}, ()) for v in (1.0, 2.0, np.ones(2), np.zeros(2), jnp.ones(2))}
    assert len(keys) == 4, "an array of numpy and one of JAX are the same constant"
    with pytest.raises(NoKeyError):
        program_key(function_with(object()), {}, ())


def test_functions_of_one_line_and_classes_of_one_name_are_distinguished(folder):
    first, second = (lambda x: x + 1.0), (lambda x: x + 2.0)
    assert program_key(first, {}, ()) != program_key(second, {}, ())

    class Local(Table):
        pass

    with pytest.raises(NoKeyError, match="Local"):
        key_of(Local(jnp.ones(1), (1.0,)))


def test_a_function_of_other_code_has_no_key_by_the_name_that_it_wraps(folder):
    wrapped = functools.wraps(scale)(types.FunctionType(check_positive.__code__, {"__name__": "__main__"}))
    assert wrapped.__module__ == scale.__module__
    with pytest.raises(NoKeyError, match="__main__"):
        program_key(wrapped, {}, ())


def test_a_captured_value_that_jax_traces_has_no_key(folder):
    argument = jnp.asarray(3.0)

    def outer(captured: jax.Array) -> jax.Array:
        return stored(lambda x: x * captured)(argument)

    assert float(jax.jit(outer)(jnp.asarray(2.0))) == 6.0


def test_settings_and_environment_are_part_of_a_key(folder, monkeypatch):
    key = key_of(1.0)
    with jax.default_matmul_precision("float32"):
        assert key_of(1.0) != key
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    assert key_of(1.0) != key


def test_structures_are_read_as_they_were_written():
    from smajax.fitting.levenberg_marquardt import LMState

    fields = {name: jnp.asarray(float(k)) for k, name in enumerate(LMState.__annotations__)}
    tree = {"b": (jnp.ones(2), None, [jnp.zeros(1), 3]), "a": LMState(**fields)}
    read = decode(encode(tree), iter(jax.tree.leaves(eqx.filter(tree, eqx.is_array))))
    assert bool(eqx.tree_equal(read, tree))
    for unknown in (object(), Options(np.ones(1)), {"a": {1, 2}}, OrderedDict(b=jnp.ones(1), a=jnp.zeros(1))):
        with pytest.raises(UnknownStructureError):
            encode(unknown)
    with pytest.raises(UnknownStructureError, match="no class"):
        decode({"kind": "class", "class": "os:system", "items": []}, iter(()))


SCRIPT = """
import sys
from smajax.numerics.process import prepare_jax
prepare_jax()
import smajax as sma
from smajax.numerics import stored_programs
traced, method = [], stored_programs.StoredFunction._traced
stored_programs.StoredFunction._traced = lambda *arguments: traced.append(1) or method(*arguments)
rig = sma.read_rig("wire/rig.toml")
found = sma.predict(rig, "wire/train.csv")
print(float(abs(found.channels["displacement"]).max()), len(traced))
"""


@pytest.mark.slow
def test_an_edited_law_gives_other_numbers_and_the_old_one_the_old_ones(tmp_path):
    """A copy of smajax, in which a phase that does not transform vanishes by 0.1 % in each step."""
    shutil.copytree(ROOT / "smajax", tmp_path / "smajax", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copytree(ROOT / "data", tmp_path / "data")
    shutil.copytree(ROOT / "data" / "recordings" / "dead-weight", tmp_path / "wire")

    def simulate() -> tuple[float, int]:
        environment = {**os.environ, "PYTHONPATH": str(tmp_path), "JAX_COMPILATION_CACHE_DIR": str(tmp_path / "cache")}
        del environment["SMAJAX_STORED_PROGRAMS"]
        call = [sys.executable, "-c", SCRIPT]
        done = subprocess.run(call, env=environment, cwd=tmp_path, stdout=subprocess.PIPE, text=True, check=True)
        number, traced = done.stdout.split()
        return float(number), int(traced)

    # Two programs: the length of a step, and the simulation.
    first, count = simulate()
    assert count == 2 and simulate() == (first, 0)
    law = tmp_path / "smajax" / "plant" / "materials" / "brinson.py"
    text = law.read_text("utf-8")
    edited = text.replace("cosine_remainder(b, self.smoothing), 1.0", "cosine_remainder(b, self.smoothing), 0.999")
    assert edited != text
    law.write_text(edited, "utf-8")
    number, count = simulate()
    assert count == 2 and abs(number / first - 1.0) > 1e-3
    law.write_text(text, "utf-8")
    assert simulate() == (first, 0)
