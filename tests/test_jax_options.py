"""What importing smajax does to JAX, in processes of their own."""

import os
import subprocess
import sys

import pytest

CODE = "import smajax.control, os, jax.numpy as jnp; print(os.environ['XLA_FLAGS']); print(jnp.ones(3).sum().dtype)"
OURS = "xla_cpu_small_while_loop_byte_threshold=1000000000"


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        (None, ["--xla_cpu_use_fusion_emitters=false", f"--xla_backend_extra_options={OURS}"]),
        ("--xla_cpu_use_fusion_emitters=true", ["--xla_cpu_use_fusion_emitters=true", f"--xla_backend_extra_options={OURS}"]),
    ],
)
def test_options_that_are_given_stay(given, expected):
    environment = {k: v for k, v in os.environ.items() if k != "XLA_FLAGS"} | ({} if given is None else {"XLA_FLAGS": given})
    done = subprocess.run([sys.executable, "-c", CODE], env=environment, capture_output=True, text=True, check=True)
    flags, kind = done.stdout.split("\n")[:2]
    assert kind == "float64" and set(expected) <= set(flags.split()) and flags.count("use_fusion_emitters") == 1
