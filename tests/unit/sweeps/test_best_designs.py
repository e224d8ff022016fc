"""Best designs of a sweep: refined designs that are alike, and those at the end of an axis."""

import numpy as np
import pytest

from smajax.report.sweep import sweep_summary
from smajax.sweeps.best_designs import distinct_designs
from smajax.sweeps.evaluation import DesignEvaluator
from smajax.sweeps.refinement import RefinedDesign
from smajax.sweeps.space import Axis
from tests.unit.sweeps.test_sweeps import StubProblem

LENGTH = Axis("wire.length", "m", 0.1, 0.5)
WIRES = Axis("number", "1", 1.0, 9.0, whole=True)
DIAMETER = Axis("wire.diameter", "m", 1e-4, 3e-4, values=(1e-4, 3e-4))


def result(*design, better=True):
    return RefinedDesign(np.array(design), {"stroke": 1e-3}, {"stroke": 1e-3}, 10, better)


def test_refined_designs_that_a_person_would_build_alike_count_as_one():
    first, near, far = result(0.3, 3.0, 1e-4), result(0.303, 3.0, 1e-4), result(0.306, 3.0, 1e-4)
    other_count, other_wire = result(0.3, 4.0, 1e-4), result(0.3, 3.0, 3e-4)
    not_better = result(0.3, 3.0, 1e-4, better=False)
    distinct = distinct_designs((LENGTH, WIRES, DIAMETER), [first, near, far, other_count, other_wire, not_better])
    assert [d.design[0] for d in distinct] == [0.3, 0.306, 0.3, 0.3, 0.3]
    assert [d.simulations for d in distinct] == [20, 10, 10, 10, 10] and not distinct[-1].better


def summary(length, duty, better=True):
    parameters = {"wire.length": length, "input.duty": duty, "wire.diameter": 1e-4}
    return sweep_summary(
        {
            "designs": 9,
            "rig": "rig.toml",
            "codes": {"done": 9},
            "constraints": {},
            "objectives": {"stroke": "max"},
            "parameters": {
                "wire.length": {"unit": "m", "from": 0.1, "to": 0.4, "scale": "even", "values": []},
                "input.duty": {"unit": "1", "from": 0.05, "to": 0.5, "scale": "log", "values": []},
                "wire.diameter": {"unit": "m", "from": 1e-4, "to": 3e-4, "scale": "even", "values": [1e-4, 3e-4]},
            },
            "front": [],
            "refined": [{"better": better, "parameters": parameters, "metrics": {"stroke": 2e-3}, "simulations": 9}],
            "metrics": {"stroke": {"unit": "m"}},
            "problems": [],
        }
    )


def test_the_ends_of_axes_at_which_the_best_design_lies_are_named():
    ends = "the smallest wire.length (100 mm) and the largest input.duty (0.5) of the space"
    assert f" The best design has {ends}: a wider one may hold better designs." in summary(0.1, 0.5)
    assert "The best design has the largest wire.length (399.9 mm) of the space" in summary(0.3999, 0.2)
    assert "of the space" not in summary(0.3, 0.2) and "of the space" not in summary(0.1, 0.5, better=False)


def test_a_search_that_stops_at_an_end_by_rounding_ends_there():
    offset = Axis("input.offset", "A", 0.0, 0.5)
    evaluator = DesignEvaluator(
        StubProblem(("input.offset", "wire.length"), {}), (offset, LENGTH), np.array([0.1, 0.2]), 100
    )
    assert evaluator.design(np.array([7e-13, 1.0 - 7e-13])).tolist() == [0.0, 0.5]
    assert evaluator.design(np.array([-1e-3, 0.5])).tolist() == pytest.approx([0.0, 0.3])
