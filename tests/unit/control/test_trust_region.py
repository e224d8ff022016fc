"""The search in a trust region, on functions whose least point is known, and where slopes tell nothing."""

import math

import numpy as np
import pytest

from smajax.control.tuning.trust_region import SearchState, descend

START = np.array([0.2, 0.8, 0.5])


def search(slope, start=START, steps=60, least=1e-6):
    asked = []

    def counted(point):
        asked.append(point)
        return slope(point)

    return descend(counted, SearchState(start, math.inf, None, 0.1), least, steps), np.array(asked)


def valley(point):
    """Rosenbrock's in two of three, its least point 0 at (0.5, 0.25, 0.7)."""
    x, y, z = point - [0.0, 0.0, 0.7]
    turned = y - x**2
    return 100 * turned**2 + (x - 0.5) ** 2 + z**2, np.array([-400 * turned * x + 2 * (x - 0.5), 200 * turned, 2 * z])


def test_the_bottom_of_a_valley_is_found():
    found, asked = search(lambda point: (math.log1p(valley(point)[0]), valley(point)[1] / (1.0 + valley(point)[0])))
    assert found.cost < 1e-3 and found.cost == pytest.approx(math.log1p(valley(found.point)[0]), abs=1e-9)
    assert np.max(np.abs(np.diff(asked[:2], axis=0))) <= 0.1 + 1e-12


@pytest.mark.parametrize("ends", [(-0.4, 0.3, 1.7), (0.1, 1.2, -0.2)])
def test_a_least_point_outside_ends_on_the_box(ends):
    stretched = np.array([1.0, 30.0, 0.2])
    found, asked = search(
        lambda point: (float(stretched @ (point - ends) ** 2), 2 * stretched * (point - ends)), least=1e-9
    )
    np.testing.assert_allclose(found.point, np.clip(ends, 0.0, 1.0), atol=5e-3)
    assert asked.min() >= 0.0 and asked.max() <= 1.0


def test_a_cliff_is_not_jumped_over():
    """Beyond a half there are no numbers, or slopes of any sign and size; the least point lies just before."""
    for beyond in (lambda point: (math.nan, point), lambda point: (50.0, 1e40 * np.sin(1e6 * point))):
        found, _ = search(
            lambda point, beyond=beyond: (
                beyond(point) if point[0] > 0.5 else ((point[0] - 0.49) ** 2, np.array([2 * point[0] - 0.98]))
            ),
            np.array([0.1]),
        )
        assert found.point[0] == pytest.approx(0.49, abs=0.02) and found.cost < 4e-4


@pytest.mark.parametrize("size", [1e30, 1e126, 1e300])
def test_slopes_that_tell_nothing_end_the_search_soon(size):
    draws = np.random.default_rng(0)
    found, asked = search(lambda point: (float(np.sum(point**2)), size * draws.standard_normal(3)), least=1e-3)
    assert len(asked) < 30 and found.cost <= np.sum(START**2)


def test_a_start_without_numbers_is_given_back():
    found, asked = search(lambda point: (math.inf, np.zeros(3)))
    assert len(asked) == 1 and np.array_equal(found.point, START) and not math.isfinite(found.cost)
