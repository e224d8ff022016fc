"""The surrogate of a rough cost, against the textbook's formulas written out, and on functions whose least point is known."""

import numpy as np
import pytest

from smajax.control import surrogate


def points_of(count, wide, seed=0):
    return np.random.default_rng(seed).uniform(size=(count, wide))


def test_the_likelihood_has_its_gradient():
    points, values = points_of(20, 3), np.random.default_rng(1).standard_normal(20)
    squares = (points[:, None] - points[None]) ** 2
    at = np.log([0.2, 0.4, 0.9, 1.3, 0.05])
    _, slope = surrogate.unlikelihood(at, squares, values)
    steps = 1e-6 * np.eye(len(at))
    central = [
        (surrogate.unlikelihood(at + h, squares, values)[0] - surrogate.unlikelihood(at - h, squares, values)[0]) / 2e-6 for h in steps
    ]
    np.testing.assert_allclose(slope, central, rtol=1e-6, atol=1e-7)


def test_mean_and_deviation_are_those_of_the_joint_distribution():
    """Conditioned by the blocks of the joint covariance of points seen and asked for, its matrices inverted outright."""
    points, asked = points_of(12, 2), points_of(5, 2, seed=3)
    values = np.sin(6.0 * points[:, 0]) + points[:, 1]
    lengths, variance, noise = np.array([0.3, 0.6]), 1.7, 0.02
    everywhere = np.vstack([points, asked])
    distance = np.array([[np.sqrt(5.0 * np.sum(((a - b) / lengths) ** 2)) for b in everywhere] for a in everywhere])
    joint = variance * (1.0 + distance + distance**2 / 3.0) * np.exp(-distance)
    seen = np.linalg.inv(joint[:12, :12] + noise * np.eye(12))
    mean, deviation = surrogate.Process.of(points, values, lengths, variance, noise).tell(asked)
    np.testing.assert_allclose(mean, joint[12:, :12] @ seen @ values, rtol=1e-6)
    left = joint[12:, 12:] - joint[12:, :12] @ seen @ joint[:12, 12:]
    np.testing.assert_allclose(deviation, np.sqrt(np.diag(left)), rtol=1e-5)


def test_what_is_believed_moves_no_mean():
    points = points_of(15, 2)
    process = surrogate.fitted(points, np.exp(np.sum((points - 0.4) ** 2, axis=1)))
    asked = points_of(6, 2, seed=5)
    later = process.believe(np.array([0.5, 0.5]))
    np.testing.assert_allclose(process.tell(asked)[0], later.tell(asked)[0], atol=1e-6)
    assert np.all(later.tell(asked)[1] <= process.tell(asked)[1] + 1e-9)


def found(function, wide, rounds, seed):
    rng = np.random.default_rng(seed)
    points = rng.uniform(size=(8, wide))
    costs, process = function(points), None
    for _ in range(rounds):
        process = surrogate.fitted(points, costs, process)
        more = surrogate.propose(process, 8, rng)
        assert more.shape == (8, wide) and more.min() >= 0.0 and more.max() <= 1.0
        points, costs = np.vstack([points, more]), np.append(costs, function(more))
    return points[np.argmin(costs)]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_narrow_valley_beside_a_wall_is_found(seed):
    """The cost of a loop: a valley, a wall beyond which all is bad, and one coordinate that hardly matters."""
    least = np.array([0.6, 0.8, 0.5])

    def cost(x):
        valley = 0.1 + 30.0 * (x[:, 0] - 0.6 + 0.3 * (x[:, 1] - 0.8)) ** 2 + 2.0 * (x[:, 1] - 0.8) ** 2 + 0.01 * (x[:, 2] - 0.5) ** 2
        return np.where(x[:, 0] + x[:, 1] > 1.55, 1e9, valley)

    assert cost(found(cost, 3, 10, seed)[None])[0] < 1.03 * cost(least[None])[0]


def test_roughness_is_taken_for_noise():
    """Ripples that no smooth surrogate can follow do not hide the valley beneath."""

    def cost(x):
        return (0.1 + np.sum((x - 0.3) ** 2, axis=1)) * (1.0 + 0.1 * np.sin(900.0 * x[:, 0]) * np.sin(700.0 * x[:, 1]))

    assert np.max(np.abs(found(cost, 2, 8, 0) - 0.3)) < 0.12
