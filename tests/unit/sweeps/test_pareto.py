"""Violations of constraints, with bounds that are finite, one-sided or absent."""

import numpy as np
import pytest

from smajax.sweeps.pareto import constraint_violation, feasible_mask

INF = np.inf


@pytest.mark.parametrize(
    ("bounds", "expected"),
    [
        ((-INF, INF), [0.0, 0.0, 0.0, 1e6]),
        ((1.0, INF), [0.0, 3.0, 0.0, 1e6]),
        ((-INF, 1.0), [1.0, 0.0, 1e6, 1e6]),
        ((0.0, 0.0), [2.0, 2.0, 1e6, 1e6]),
        ((1.0, 4.0), [0.0, 0.75, 1e6, 1e6]),
    ],
)
def test_violations_agree_with_the_feasible_designs(bounds, expected):
    values = np.array([2.0, -2.0, INF, np.nan])
    violation = constraint_violation({"stroke": values}, {"stroke": bounds})
    np.testing.assert_allclose(violation, expected)
    columns = {"stroke": values, "code": np.array(["done"] * 4)}
    np.testing.assert_array_equal(feasible_mask(columns, {"stroke": bounds}), violation == 0.0)


def test_no_constraint_is_no_violation():
    assert float(constraint_violation({"stroke": 1.0}, {})) == 0.0
    assert float(constraint_violation({"stroke": 1.0}, {"stroke": (-INF, INF)})) == 0.0
