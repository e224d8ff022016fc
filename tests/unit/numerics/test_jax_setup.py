"""Settings of JAX by importing smajax, each in a separate process."""

import os
import subprocess
import sys

import pytest

CODE = "import smajax.plant, os, jax.numpy as jnp; print(os.environ['XLA_FLAGS']); print(jnp.ones(3).sum().dtype)"
OURS = "xla_cpu_small_while_loop_byte_threshold=1000000000"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, ["--xla_cpu_use_fusion_emitters=false", f"--xla_backend_extra_options={OURS}"]),
        (
            "--xla_cpu_use_fusion_emitters=true",
            ["--xla_cpu_use_fusion_emitters=true", f"--xla_backend_extra_options={OURS}"],
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
