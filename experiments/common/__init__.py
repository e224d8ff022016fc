"""What the experiments share. Importing it sets up JAX as the command line does, before anything imports equinox."""

import sys
from pathlib import Path

from smajax.numerics.process import prepare_jax

prepare_jax(accelerator=Path(sys.argv[0]).stem == "sweep_throughput")  # all others simulate few at a time
