"""Small documents of every command, as the commands write them."""

from typing import Any

import numpy as np

from smajax.report.prediction import make_series

HASH = "ab" * 32


def recording(role: str, name: str = "") -> dict[str, Any]:
    """Return the entry of a recording."""
    return {"name": name or f"{role}.csv", "sha256": HASH, "rows": 600, "role": role, "notes": []}


def run(command: str, **more: Any) -> dict[str, Any]:
    """Return run.json of a command."""
    return {
        "schema": "smajax.run/1",
        "command": command,
        "argv": ["smajax", command],
        "rig": "rig.toml",
        "started": "2026-01-01T00:00:00+00:00",
        "exit_code": 0,
        "seed": 0,
        "versions": {"smajax": "0.2.0"},
        "machine": "a bench computer",
        "timings": {"read": 0.5},
        **more,
        "files": [],
    }


FIT: dict[str, Any] = {
    "schema": "smajax.fit/2",
    "rig": "rig.toml",
    "model": "brinson",
    "kind": "dead-weight",
    "inputs": ["current"],
    "observed": ["displacement"],
    "parameters": {
        name: {
            "estimate": value,
            "lower95": 0.9 * value,
            "upper95": 1.1 * value,
            "unit": unit,
            "free": True,
            "at_bound": False,
            "bounds": [0.0, None],
        }
        for name, value, unit in (
            ("heat.h0", 100.0, "W/m^2/K"),
            ("material.max_transformation_strain", 0.04, "1"),
        )
    },
    "fixed": {"wire.diameter": {"value": 1.5e-4, "unit": "m", "source": "rig.toml line 31"}},
    "rmse": {"displacement": {"train": 0.02, "holdout": None, "unit": "mm"}},
    "noise_floor": {"displacement": {"value": 0.0199, "unit": "mm", "from": "residual differences"}},
    "indistinct": [
        {"parameters": ["heat.h0", "material.max_transformation_strain"], "direction": [0.9, -0.4], "shrink": 0.004}
    ],
    "correlations": {
        "parameters": ["heat.h0", "material.max_transformation_strain"],
        "matrix": [[1.0, 0.5], [0.5, 1.0]],
    },
    "discretisation": {"displacement": {"value": 1e-4, "unit": "mm"}},
    "profiles": {"heat.h0": {"values": [90.0, 100.0], "rise": [4.0, 0.0], "lower95": 91.0, "upper95": None}},
    "solver": {
        "code": "converged",
        "text": "the cost falls by less than its tolerance",
        "steps": 14,
        "simulations": 112,
        "wall_s": 1.9,
        "compile_s": 0.9,
        "starts": 4,
        "starts_at_best": 4,
    },
    "recordings": [recording("train")],
    "warnings": [],
    "seed": 0,
    "smajax": "0.2.0",
}
_LATENT_HEAT = {
    "key": "latent-heat",
    "stage": "heat",
    "status": "testable",
    "smallest_detectable": 1e6,
    "unit": "J/m^3",
    "absorbed_by": ["material.max_transformation_strain"],
    "why": "",
}
_STATISTICS = {
    "rms": 0.02,
    "band_99": 0.1,
    "autocorrelation": [0.2, None],
    "cross_correlation": {"current": [0.1, 0.0]},
    "outside": {"itself": 0.5, "current": 0.0},
}
DIAGNOSIS: dict[str, Any] = {
    "schema": "smajax.diagnosis/2",
    "verdict": "named",
    "effects": ["latent-heat"],
    "equivalent": {"latent-heat": []},
    "unresolved_stage": None,
    "summary": "The rig has latent-heat.",
    "rmse": {
        "displacement": {
            "unit": "mm",
            **{f"{part}_{when}": 0.02 for part in ("train", "select", "holdout") for when in ("before", "after")},
            "holdout_cut_95": [0.1, 0.2],
        }
    },
    "evidence": [],
    "recordings": [recording(role) for role in ("train", "select", "holdout")],
    "left_out": [{"channel": "force", "why": "it is saturated"}],
    "noise_floor": {"displacement": {"value": 0.0199, "unit": "mm", "from": "rest"}},
    "base_fit_at_rest": True,
    "goodness_of_fit": {"before": 9.0, "after": 1.0, "critical": 1.1},
    "stages": {"drive": 0.0, "heat": 1.0, "material": 0.5, "mechanism": 0.1, "sensor": None},
    "ranking": [
        _LATENT_HEAT
        | {
            "strength": 8e7,
            "lower95": 7e7,
            "upper95": 9e7,
            "statistic": 900.0,
            "p_value": 1e-9,
            "refit_rmse_select": 0.02,
        }
    ],
    "rejected": [{"key": "backlash", "why": "is absorbed"}],
    "excluded": [{"key": "coating", "above": 1e-3, "unit": "1"}],
    "preflight": [_LATENT_HEAT],
    "residual": {"displacement": {"before": _STATISTICS, "after": _STATISTICS}},
    "free_form": None,
    "next_experiment": {"file": None, "separates": [], "sigma": None, "advice": "run another input"},
    "simulations": 100,
    "wall_s": 9.5,
    "seed": 0,
    "smajax": "0.2.0",
}
COMPARE: dict[str, Any] = {
    "schema": "smajax.compare/2",
    "rig": "rig.toml",
    "channel": "displacement",
    "not_compared": [],
    "unit": "mm",
    "summary": "brinson predicts the holdout best.",
    "models": [
        {
            "name": "brinson",
            "kind": "law",
            "why": "",
            "note": "",
            "at_bound": ["material.max_transformation_strain (0.05)"],
            "undetermined": [],
            "parameters": 1,
            "rmse_train": 0.02,
            "rmse_holdout": 0.02,
            "bic": -900.0,
            "fitted": {
                "material.max_transformation_strain": {
                    "value": 0.05,
                    "lower95": None,
                    "upper95": None,
                    "free": True,
                    "unit": "1",
                },
                "knots": {"value": [0.0, 1.0], "lower95": [None, 0.9], "upper95": [None, 1.1], "free": True},
            },
            "fit_percent_train": 99.0,
            "fit_percent_holdout": 99.0,
            "wall_s": 1.0,
        }
    ],
    "recordings": [recording("train"), recording("holdout")],
    "seed": 0,
    "smajax": "0.2.0",
}
_MARGINS = {"gain": 6.6, "phase": None, "sensitivity": 1.2}
TUNE: dict[str, Any] = {
    "schema": "smajax.tune/2",
    "rig": "rig.toml",
    "controller": "controller.toml",
    "channel": "displacement",
    "unit": "m",
    "feasible": True,
    "problems": [],
    "gains": {
        "kp": {
            "start": 30.0,
            "tuned": 90.0,
            "unit": "A/m",
            "usual_unit": "A/mm",
            "free": True,
            "bounds": [0.3, 3000.0],
        }
    },
    "metrics": {when: {"rmse": 1e-3, "settling": None} for when in ("start", "tuned")},
    "limits": {"temperature": 110.0},
    "margins": {"start": _MARGINS, "tuned": _MARGINS},
    "stable": {"start": True, "tuned": True},
    "robust": {},
    "start_kept": False,
    "objective": {"settle": False, "weights": {"tracking": 1.0, "effort": 0.01}},
    "rollouts": 100,
    "seed": 0,
    "smajax": "0.2.0",
    "left_out": {},
    "summary": "RMSE of displacement: 1 mm.",
}
SWEEP: dict[str, Any] = {
    "schema": "smajax.sweep/2",
    "sweep": "sweep.toml",
    "rig": "rig.toml",
    "sampling": "sobol",
    "designs": 3,
    "codes": {"done": 3},
    "feasible": 2,
    "parameters": {
        "material.max_transformation_strain": {"unit": "1", "from": 0.03, "to": 0.05, "scale": "even", "values": []}
    },
    "metrics": {
        "stroke": {"unit": "m", "lowest": 1e-3, "highest": 2e-3},
        "cycles": {"unit": "1", "lowest": 10.0, "highest": "inf"},
    },
    "objectives": {"stroke": "max"},
    "constraints": {"cycles": {"at_least": 20.0, "at_most": None}},
    "front": [
        {
            "design": 1,
            "parameters": {"material.max_transformation_strain": 0.05},
            "metrics": {"stroke": 2e-3, "cycles": "inf"},
        }
    ],
    "on_front": 1,
    "settling": {},
    "sensitivity": {},
    "sensitivity_notes": [],
    "refined": [],
    "problems": [],
    "seed": 0,
    "smajax": "0.2.0",
    "summary": "3 designs of rig.toml.",
}
_TEMPERATURE = {"value": 40.0, "lower95": 39.0, "upper95": 41.0, "unit": "degC"}
_PROPERTIES = {
    **{f"{phase}_{end}": _TEMPERATURE for phase in ("martensite", "austenite") for end in ("start", "finish")},
    **{f"{name}_strain": _TEMPERATURE | {"unit": "1"} for name in ("transformation", "actuation")},
    **{name: _TEMPERATURE | {"unit": "K"} for name in ("width", "span")},
}
PROPERTIES: dict[str, Any] = {
    "schema": "smajax.properties/1",
    "tangent": "lines",
    "definition": "three lines",
    "recordings": [
        {
            "name": "cycles.csv",
            "sha256": HASH,
            "stress_Pa": 1e8,
            "smoothed_rows": 1,
            "mean": _PROPERTIES,
            "cycles": [{"number": 1, "rows": [1, 600], "loops_left_out": [[5, 9]], "values": _PROPERTIES}],
            "in_no_cycle": [{"rows": [1, 4], "branch": "heating"}],
        }
    ],
    "refused": [],
    "smajax": "0.2.0",
}
SIMULATION: dict[str, Any] = run(
    "simulate",
    code="done",
    text="done",
    inputs=["current"],
    observed=["displacement"],
    channels={"displacement": {"lowest": 0.0, "highest": None, "unit": "mm"}},
    recordings=[recording("simulation")],
    warnings=[],
)
CONTROLLER: dict[str, Any] = {
    "schema": "smajax.controller/2",
    "kind": "pid",
    "period_s": 0.02,
    "output": [0.0, 0.5],
    "blind_s": 1.0,
    "derivative_on": "error",
    "gains": {"kp": {"value": 90.0, "unit": "A/m"}},
}
# The document of each command, and run.json without the entries of a simulation.
EXAMPLES: dict[str, dict[str, Any]] = {
    "fit": FIT,
    "diagnose": DIAGNOSIS,
    "compare": COMPARE,
    "tune": TUNE,
    "sweep": SWEEP,
    "properties": PROPERTIES,
    "simulate": SIMULATION,
}


def example_series(command: str) -> Any:
    """Return the predictions that a command writes next to its document; of a sweep the columns of its table."""
    if command == "sweep":
        stroke = np.array([1e-3, 2e-3, 1.5e-3])
        columns = {
            "stroke": stroke,
            "cycles": np.array([10.0, np.inf, 30.0]),
            "material.max_transformation_strain": np.array([0.03, 0.05, 0.04]),
        }
        return columns | {"design": np.arange(3), "code": np.array(["done"] * 3)}
    names = {
        "fit": ("train.csv",),
        "diagnose": ("holdout.csv (before)", "holdout.csv (after)"),
        "compare": ("holdout.csv (brinson)",),
        "tune": ("start gains", "tuned gains"),
        "properties": ("cycles.csv",),
        "simulate": ("input.csv",),
    }[command]
    time = np.arange(50) * 0.02
    measured = {"displacement": 1e-3 * time} | ({"current": time} if command != "tune" else {})
    if command == "properties":
        measured = {"temperature": 80.0 * time, "strain": 0.04 * time}
    return [
        make_series(name, role, time, measured, {"displacement": 1.1e-3 * time}, {"time": "s"}, has_clock=True)
        for name in names
        for role in (("train", "holdout") if command == "compare" else ("holdout",))
    ]
