"""The input-output models that can be fitted, one family in each file, with bounds that follow from the recordings.

``MODEL_SPECS`` maps the names of ``smajax compare`` to functions that make a ``ModelSpec`` for given series. The bounds
of the hysteresis operators are relative to the ranges of input and output, and include the models of copaci2020.
"""

import functools
from collections.abc import Callable, Mapping, Sequence

from smajax.fitting.io_models.problem import ModelSpec, Series
from smajax.fitting.io_models.specs.bouc_wen import bouc_wen_spec
from smajax.fitting.io_models.specs.hammerstein_wiener import hammerstein_wiener_spec
from smajax.fitting.io_models.specs.networks import heating_cooling_spec, narx_spec
from smajax.fitting.io_models.specs.prandtl_ishlinskii import prandtl_ishlinskii_spec
from smajax.fitting.io_models.specs.transfer_function import transfer_function_spec
from smajax.laws.transfer_function import STRUCTURES

MODEL_SPECS: Mapping[str, Callable[[Sequence[Series]], ModelSpec]] = {
    "bouc-wen": functools.partial(bouc_wen_spec, rest=True),
    "prandtl-ishlinskii": prandtl_ishlinskii_spec,
    "prandtl-ishlinskii-20": functools.partial(prandtl_ishlinskii_spec, count=20),
    "hammerstein-wiener": hammerstein_wiener_spec,
    "narx": narx_spec,
    "heating-cooling": heating_cooling_spec,
    **{f"transfer-function-{s}": functools.partial(transfer_function_spec, structure=s) for s in STRUCTURES},
}

__all__ = [
    "MODEL_SPECS",
    "bouc_wen_spec",
    "hammerstein_wiener_spec",
    "heating_cooling_spec",
    "narx_spec",
    "prandtl_ishlinskii_spec",
    "transfer_function_spec",
]
