"""Traced programs that are kept between processes."""

import dataclasses
import os
import shutil
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics import program_keys, stored_programs
from smajax.numerics.output_trees import UnknownStructureError, decode, encode
from smajax.numerics.program_keys import NoKeyError, program_key
from smajax.numerics.stored_programs import stored
from tests.conftest import ROOT


def scale(values: dict[str, jax.Array], factor: jax.Array) -> tuple[jax.Array, dict[str, jax.Array]]:
    return jnp.sum(values["a"] * factor), {"last": values["a"][-1] * factor}


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


def test_the_oldest_files_are_deleted(folder, monkeypatch):
    monkeypatch.setattr(stored_programs, "_MOST_FILES", 2)
    for count in range(1, 5):
        stored(scale)({"a": jnp.ones(count)}, jnp.asarray(1.0))
    assert len([*folder.iterdir()]) == 2


class Table(eqx.Module):
    numbers: jax.Array
    fixed: tuple[float, ...] = eqx.field(static=True)
    other: object = eqx.field(static=True, default=None)


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
    for unknown in (object(), Options(np.ones(1)), {"a": {1, 2}}):
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

    first, count = simulate()
    assert count == 1 and simulate() == (first, 0)
    law = tmp_path / "smajax" / "plant" / "materials" / "brinson.py"
    text = law.read_text("utf-8")
    edited = text.replace("cosine_remainder(b, self.smoothing), 1.0", "cosine_remainder(b, self.smoothing), 0.999")
    assert edited != text
    law.write_text(edited, "utf-8")
    number, count = simulate()
    assert count == 1 and abs(number / first - 1.0) > 1e-3
    law.write_text(text, "utf-8")
    assert simulate() == (first, 0)
