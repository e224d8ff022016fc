"""The trust-region search on functions with a known minimum, and with meaningless gradients."""

import math

import numpy as np
import pytest

from smajax.control.tuning.trust_region import SearchState, descend

START = np.array([0.2, 0.8, 0.5])


def search(slope, start=START, steps=60, least=1e-6):
    points = []

    def counted(point):
        points.append(point)
        return slope(point)

    return descend(counted, SearchState(start, math.inf, None, 0.1), least, steps), np.array(points)


def valley(point):
    """Rosenbrock's function in two of three coordinates; its minimum is 0 at (0.5, 0.25, 0.7)."""
    x, y, z = point - [0.0, 0.0, 0.7]
    turned = y - x**2
    return 100 * turned**2 + (x - 0.5) ** 2 + z**2, np.array([-400 * turned * x + 2 * (x - 0.5), 200 * turned, 2 * z])


def test_the_minimum_of_a_curved_valley_is_found():
    state, points = search(lambda point: (math.log1p(valley(point)[0]), valley(point)[1] / (1.0 + valley(point)[0])))
    assert state.cost < 1e-3 and state.cost == pytest.approx(math.log1p(valley(state.point)[0]), abs=1e-9)
    assert np.max(np.abs(np.diff(points[:2], axis=0))) <= 0.1 + 1e-12


@pytest.mark.parametrize("ends", [(-0.4, 0.3, 1.7), (0.1, 1.2, -0.2)])
def test_a_minimum_outside_of_the_box_ends_on_its_boundary(ends):
    stretched = np.array([1.0, 30.0, 0.2])
    state, points = search(
        lambda point: (float(stretched @ (point - ends) ** 2), 2 * stretched * (point - ends)), least=1e-9
    )
    np.testing.assert_allclose(state.point, np.clip(ends, 0.0, 1.0), atol=5e-3)
    assert points.min() >= 0.0 and points.max() <= 1.0


def test_the_search_stays_before_a_cliff():
    """Beyond 0.5 the cost is NaN, or the gradient is random and huge; the minimum lies just before."""
    for beyond in (lambda point: (math.nan, point), lambda point: (50.0, 1e40 * np.sin(1e6 * point))):
        state, _ = search(
            lambda point, beyond=beyond: (
                beyond(point) if point[0] > 0.5 else ((point[0] - 0.49) ** 2, np.array([2 * point[0] - 0.98]))
            ),
            np.array([0.1]),
        )
        assert state.point[0] == pytest.approx(0.49, abs=0.02) and state.cost < 4e-4


@pytest.mark.parametrize("size", [1e30, 1e126, 1e300])
def test_random_gradients_end_the_search_early(size):
    draws = np.random.default_rng(0)
    state, points = search(lambda point: (float(np.sum(point**2)), size * draws.standard_normal(3)), least=1e-3)
    assert len(points) < 30 and state.cost <= np.sum(START**2)


def test_a_start_without_a_finite_cost_is_returned():
    state, points = search(lambda point: (math.inf, np.zeros(3)))
    assert len(points) == 1 and np.array_equal(state.point, START) and not math.isfinite(state.cost)
