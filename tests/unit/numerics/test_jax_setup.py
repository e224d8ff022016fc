"""Settings of JAX: double precision by importing smajax, the others by ``prepare_jax``; each in its own process."""

import os
import subprocess
import sys

import jax
import pytest

from smajax.errors import InputError
from smajax.numerics.process import require_gpu
from tests.conftest import ROOT

CODE = (
    "from smajax.numerics.process import prepare_jax; prepare_jax(); import os, jax.numpy as jnp; "
    "print(os.environ['XLA_FLAGS']); print(jnp.ones(3).sum().dtype)"
)


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, ["--xla_cpu_use_fusion_emitters=false"]),
        ("--xla_cpu_use_fusion_emitters=true", ["--xla_cpu_use_fusion_emitters=true"]),
        (
            "--xla_dump_disable_metadata=true",
            ["--xla_dump_disable_metadata=true", "--xla_cpu_use_fusion_emitters=false"],
        ),
    ],
)
def test_options_that_are_given_stay(given, expected):
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | (
        {} if given is None else {"XLA_FLAGS": given}
    )
    done = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True)
    flags, kind = done.stdout.split("\n")[:2]
    assert kind == "float64" and set(expected) <= set(flags.split()) and flags.count("use_fusion_emitters") == 1


@pytest.mark.parametrize(
    ("words", "platforms", "expected"),
    [("", "", "cpu"), ("accelerator=True", "", "None"), ("", "cpu,cuda", "cpu,cuda")],
)
def test_only_what_goes_in_batches_is_left_to_an_accelerator(words, platforms, expected):
    """A few simulations at a time are slower on an accelerator."""
    code = f"from smajax.numerics.process import prepare_jax; prepare_jax({words}); import jax; print(jax.config.jax_platforms)"
    environment = os.environ | {"JAX_PLATFORMS": platforms}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() in (expected, expected.replace("None", ""))


def test_the_device_of_a_command_is_chosen_or_refused():
    code = "from smajax.app.command_line.run import start_run; start_run(True, 'cpu'); import jax; print(jax.default_backend())"
    assert python(code, JAX_PLATFORMS="cuda") == "cpu"
    if jax.default_backend() == "gpu":
        require_gpu()
    else:
        with pytest.raises(InputError, match=r"--device gpu: JAX finds cpu instead of a GPU: install JAX for your GPU"):
            require_gpu()


def test_the_best_designs_are_refined_on_the_processor():
    code = "import jax; jax.config.update('jax_num_cpu_devices', 2); jax.config.update('jax_default_device', jax.devices()[1]);"
    code += (
        "from smajax.numerics.jax_setup import on_cpu; import jax.numpy as jnp; double = jax.jit(lambda x: 2.0 * x)\n"
    )
    code += "with on_cpu(): print(double(jnp.ones(1)).devices())"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"JAX_PLATFORMS": "cpu"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == "{CpuDevice(id=0)}"


def python(code, **variables):
    """Run Python code in a process whose environment has no settings of JAX, and return its output."""
    ours = ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")
    environment = {k: v for k, v in os.environ.items() if k not in ours} | {"JAX_PLATFORMS": "cpu"} | variables
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.slow
def test_the_import_of_every_module_changes_no_setting_but_the_precision():
    code = """
import os, pkgutil, importlib, jax
variables, settings = dict(os.environ), dict(jax.config.values)
import smajax
for module in pkgutil.walk_packages(smajax.__path__, "smajax."):
    if not module.name.endswith(("__main__", "fmu.slave")):
        importlib.import_module(module.name)
print(dict(os.environ) == variables, {k for k in settings if jax.config.values[k] != settings[k]})
"""
    assert python(code) == "True {'jax_enable_x64'}"


SIMULATED = """
import equinox, jax
jax.numpy.ones(3).sum()
{prepare}
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.simulation.run import simulate
folder = data_path("recordings", "dead-weight")
rig = read_rig(folder / "rig.toml")
result = simulate(rig.plant, rig.read(folder / "train.csv").slice(0.0, 1.0), step=0.02)
print(int(result.status), result.channels["temperature"].dtype)
"""


@pytest.mark.slow
@pytest.mark.parametrize("prepare", ["", "from smajax.numerics.process import prepare_jax; prepare_jax()"])
def test_it_works_after_equinox_and_jax_were_imported_and_used(prepare, tmp_path):
    folder = {"JAX_COMPILATION_CACHE_DIR": str(tmp_path)} if prepare else {}
    assert python(SIMULATED.format(prepare=prepare), **folder) == "0 float64"


@pytest.mark.slow
def test_single_precision_is_refused_in_one_sentence():
    code = """
import jax
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
{switch}
try:
    read_rig(data_path("recordings", "dead-weight") / "rig.toml")
except InputError as error:
    print(error)
"""
    off = python(code.format(switch='jax.config.update("jax_enable_x64", False)'))
    for sentence in (off, python(code.format(switch=""), JAX_ENABLE_X64="0")):
        assert "JAX computes in single precision and smajax needs double precision: call " in sentence
        assert "jax_enable_x64" in sentence and "JAX_ENABLE_X64" in sentence and "\n" not in sentence
    assert python(code.format(switch="")) == python(code.format(switch=""), JAX_ENABLE_X64="1") == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    "call", ["sma.discretise(plant, recording)", "inputs.scale(2.0)", "sma.rollout(plant, loop, np.ones(4))"]
)
def test_double_precision_that_was_switched_off_later_is_refused_by_what_comes_next(call):
    """Inputs would be of single precision without a word, and a rollout would end in a TypeError of JAX."""
    code = f"""
import jax
import numpy as np
import smajax as sma
from smajax.recordings.datasets import data_path
folder = data_path("recordings", "dead-weight")
rig = sma.read_rig(folder / "rig.toml")
plant, recording = rig.plant, rig.read(folder / "train.csv").slice(0.0, 1.0)
inputs = sma.discretise(plant, recording)
loop = sma.ClosedLoop(sma.controllers.PID(kp=1.0, period=0.1), channel="displacement")
jax.config.update("jax_enable_x64", False)
try:
    {call}
except sma.InputError as error:
    print(error)
"""
    assert python(code).startswith("JAX computes in single precision and smajax needs double precision: call ")
