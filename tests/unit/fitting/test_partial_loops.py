"""Partial loops of a recording, and the warning about spreads of grains without them."""

import numpy as np
import pytest

from smajax.fitting.partial_loops import has_partial_loop, spread_warnings

UP, DOWN = np.linspace(0.0, 1.0, 50), np.linspace(1.0, 0.0, 50)
FULL = np.concatenate([UP, DOWN, UP, DOWN])
PARTIAL = np.concatenate([UP, np.linspace(1.0, 0.4, 30), np.linspace(0.4, 1.0, 30), DOWN])


@pytest.mark.parametrize(
    ("strain", "expected"),
    [
        (FULL, False),
        (PARTIAL, True),
        (-PARTIAL, True),
        (FULL + 0.02 * np.cos(np.arange(len(FULL))), False),  # noise makes no loops
        (np.concatenate([UP, np.full(20, 1.0), DOWN]), False),
        (np.zeros(10), False),
        (0.3 * UP, False),
    ],
)
def test_a_partial_loop_turns_round_inside_the_range(strain, expected):
    assert has_partial_loop(strain) is expected


def test_free_spreads_without_a_partial_loop_are_warned_of():
    free = ["heat.h0", "grains.austenite_spread", "grains.martensite_spread"]
    (sentence,) = spread_warnings([FULL], free)
    assert sentence.startswith("grains.austenite_spread and grains.martensite_spread: no training recording")
    assert "not distinguishable" in sentence
    assert spread_warnings([FULL, PARTIAL], free) == [] == spread_warnings([FULL], free[:1])
