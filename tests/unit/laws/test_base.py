"""Models that compute all rows at once refuse single steps."""

import jax.numpy as jnp
import pytest

from smajax.laws import BoucWen, TransferFunction


def test_a_model_without_steps_says_how_to_compute_it():
    one = jnp.asarray(1.0)
    model = TransferFunction(one, one, one, one, one, one, structure="one-pole")
    for call in (lambda: model.init(one), lambda: model.step((), one, one, one), lambda: model.output((), one)):
        with pytest.raises(TypeError, match="TransferFunction has no steps: compute all rows with"):
            call()
    with pytest.raises(TypeError, match="BoucWen has no steps"):
        BoucWen(one, one, one, one, one).step(one, one, one, one)
