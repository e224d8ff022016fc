"""Shared parts of the experiments; the import sets up JAX as the command line does, before equinox is imported."""

import sys
from pathlib import Path

from smajax.numerics.process import prepare_jax

prepare_jax(accelerator=Path(sys.argv[0]).stem == "sweep_throughput")  # the others have small batches
