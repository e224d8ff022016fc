"""Actuator files: metrics, names and units, messages about mistakes, and derivatives of every metric."""

import dataclasses
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.actuators.base import AbstractActuator
from smajax.actuators.flexural import FlexuralActuator
from smajax.actuators.registry import ACTUATORS
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.recordings.datasets import data_path

KINDS = sorted(ACTUATORS)
# Metrics that a sweep needs of every subject.
ASKED = {"stroke", "force", "bandwidth", "peak_temperature", "energy_per_cycle", "efficiency", "time_to_cool"}


def text_of(kind: str, changes: dict[str, str] | None = None) -> str:
    text = data_path("actuators", kind, "rig.toml").read_text("utf-8")
    for old, new in (changes or {}).items():
        assert old in text
        text = text.replace(old, new, 1)
    return text


def shipped_actuator(kind: str) -> AbstractActuator:
    actuator = actuator_file.read_actuator(data_path("actuators", kind, "rig.toml"))
    if kind == "soft-bending":  # does work on a cable
        actuator = parameters.replace(actuator, {"cable.force": 0.3})
    return dataclasses.replace(actuator, cells=6) if isinstance(actuator, FlexuralActuator) else actuator


@eqx.filter_jit
def figures(actuator: AbstractActuator) -> dict[str, jax.Array]:
    return actuator.metrics()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_shipped_actuators_round_trip_and_have_metrics(kind: str, tmp_path: Path):
    actuator = actuator_file.read_actuator(data_path("actuators", kind, "rig.toml"))
    actuator_file.write(tmp_path / "actuator.toml", actuator)
    reread = actuator_file.read_actuator(tmp_path / "actuator.toml")
    assert eqx.tree_equal(actuator, reread)
    metrics = figures(shipped_actuator(kind))
    assert set(metrics) == set(actuator.units) >= ASKED
    assert all(value.shape == () and np.isfinite(value) for value in metrics.values())
    optional = {"body.spacing"} if kind == "flexural" else set()
    for name, declaration in parameters.all_declarations(actuator).items():
        assert name in optional or declaration.lower <= float(parameters.get(actuator, name)) <= declaration.upper


def of_names(kind: str, names: list[str]):
    """Return all metrics as a function of some parameters, scaled to 1."""
    actuator = shipped_actuator(kind)
    nominal = jnp.stack([parameters.get(actuator, name) for name in names])

    def metrics_of(factors: jax.Array) -> jax.Array:
        values = factors * nominal
        metrics = parameters.replace(actuator, {name: values[i] for i, name in enumerate(names)}).metrics()
        return jnp.stack([metrics[name] for name in actuator.units])

    return metrics_of


def slopes_and_ends(metrics_of, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the derivatives at a point, and the values at it and at relative distances of 1e-4 on both sides."""
    basis = np.eye(len(point))
    points = point * (1.0 + 1e-4 * np.concatenate([basis, -basis, 0.0 * basis]))
    values, tangents = jax.jit(jax.vmap(lambda p, d: jax.jvp(metrics_of, (p,), (d,))))(points, np.tile(basis, (3, 1)))
    return np.array(tangents)[-len(point) :].T, np.array(values)


FREED = {
    "flexural": [
        "wire.diameter",
        "body.count",
        "body.curvature",
        "bending.yield_stress",
        "silicone.conductivity",
        "bench.position",
    ],
    "soft-bending": [
        *(
            "wires.diameter",
            "wires.count",
            "wires.memory_curvature",
            "wires.modulus_martensite",
            "bar.modulus",
            "bar.length",
        ),
        *("bar.conductivity", "heating.current", "cable.force"),
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", FREED)  # the knee's, which are integrated, in test_knee.py
def test_derivatives_of_every_metric(kind: str):
    metrics_of, count = of_names(kind, FREED[kind]), len(FREED[kind])
    slopes, ends = slopes_and_ends(metrics_of, np.ones(count))
    by_difference = (ends[:count] - ends[count:-count]).T / 2e-4
    size = np.abs(ends[0])[:, None]
    np.testing.assert_allclose(slopes / size, by_difference / size, rtol=2e-5, atol=1e-7)
    assert np.all(np.any(slopes != 0.0, axis=0))
    batched = dict(zip(shipped_actuator(kind).units, ends[0], strict=True))
    actuator = shipped_actuator(kind)
    single = figures(parameters.replace(actuator, {FREED[kind][0]: 1.0001 * parameters.get(actuator, FREED[kind][0])}))
    for name, value in batched.items():
        assert value == pytest.approx(float(single[name]), rel=1e-10)  # in a batch as alone


@pytest.mark.slow
def test_wires_at_a_spacing_cool_more_slowly_the_closer_they_are():
    """The spacing in the file is that of the cross-section; derivatives with respect to spacing and diameter."""
    actuator = shipped_actuator("flexural")
    close = dataclasses.replace(
        actuator_file.parse_actuator(text_of("flexural", {"count = 2": 'count = 4\nspacing = "0.8 mm"'})), cells=6
    )  # pyright: ignore[reportArgumentType]
    reread = actuator_file.parse_actuator(actuator_file.to_toml(close))
    assert float(parameters.get(reread, "body.spacing")) == pytest.approx(0.8e-3, rel=1e-12)
    even, names = parameters.replace(actuator, {"body.count": 4.0}), ("wire.diameter", "body.spacing")
    nominal = np.array([0.3e-3, 0.8e-3])

    def metrics_of(values: jax.Array) -> jax.Array:
        metrics = parameters.replace(close, dict(zip(names, values, strict=True))).metrics()
        return jnp.stack([metrics["time_to_cool"], metrics["temperature_after"]])

    slopes, ends = slopes_and_ends(metrics_of, nominal)
    np.testing.assert_allclose(slopes, ((ends[:2] - ends[2:4]) / (2e-4 * nominal[:, None])).T, rtol=1e-4)
    assert slopes[1, 0] > 0.0 > slopes[1, 1]
    assert float(ends[4, 1]) > float(figures(even)["temperature_after"]) + 1.0
    # A count that does not fit the grid gives NaN; evenly spaced wires do not.
    assert np.isnan(float(figures(parameters.replace(close, {"body.count": 3.0}))["time_to_cool"]))
    assert np.isfinite(float(figures(even)["time_to_cool"]))


def test_flexural_metrics_agree_with_those_of_the_parts():
    actuator = shipped_actuator("flexural")
    metrics = {name: float(value) for name, value in figures(actuator).items()}
    assert metrics["moment"] == pytest.approx(1.528e-3, rel=1e-3)
    assert metrics["blocking_force"] == pytest.approx(2 * metrics["moment"] / 55e-3, rel=1e-12)
    assert metrics["blocking_force_of_yielding"] == pytest.approx(
        metrics["plastic_share"] * metrics["blocking_force"], rel=1e-12
    )
    assert metrics["plastic_share"] == pytest.approx(1 - 0.638, abs=1e-3)
    assert metrics["yield_diameter"] == pytest.approx(230e-6, rel=1e-3)
    assert metrics["energy_per_cycle"] == pytest.approx(
        2.82 + 1.36, rel=3e-3
    )  # 123 mm of wire: warmed by 60 K, transformed
    assert metrics["resistance"] == pytest.approx(1.57, rel=5e-3)
    assert metrics["heating_time"] == pytest.approx(
        metrics["energy_per_cycle"] / (3.5**2 * metrics["resistance"]), rel=1e-12
    )
    assert 1.0 / metrics["bandwidth"] == pytest.approx(metrics["heating_time"] + metrics["time_to_cool"], rel=1e-12)
    assert metrics["force"] == metrics["blocking_force"] and metrics["peak_temperature"] == 80.0
    assert (
        metrics["efficiency"]
        < metrics["limit_efficiency"]
        == pytest.approx(metrics["plastic_work"] / metrics["energy_per_cycle"], rel=1e-12)
    )
    # Against a bench so soft that it takes all the stroke, or so stiff that it takes none, no work is done.
    work = [
        float(figures(parameters.replace(actuator, {"bench.diameter": d}))["work_per_cycle"])
        for d in (1e-5, 3e-4, 0.05)
    ]
    assert work[0] < 1e-3 * work[1] > work[2]
    thin = figures(parameters.replace(actuator, {"wire.diameter": 125e-6}))
    assert float(thin["blocking_force_of_yielding"]) == 0.0 == float(thin["plastic_work"])


def test_unused_metrics_are_not_computed():
    """Without the cooling metrics, the compiled program has no loop over time steps."""
    actuator = eqx.filter(shipped_actuator("flexural"), eqx.is_array)
    loops = {}
    for name in ("blocking_force", "time_to_cool"):
        lowered = jax.jit(lambda m, name=name: m.metrics()[name]).lower(actuator)
        loops[name] = "while" in (lowered.as_text() if name == "time_to_cool" else lowered.compile().as_text())
    assert loops == {"blocking_force": False, "time_to_cool": True}


CASES = {
    "no rig": ({"[rig]": "[rik]"}, "the section [rig] is missing: add [rig] with a line kind = \"flexural\""),
    "kind": ({'"flexural"': '"flexurel"'}, "rig.kind: 'flexurel' is not known (did you mean 'flexural'?): it is one of"),
    "section": ({"[silicone]": "[silicon]"}, "[silicon] is not a section of this actuator (did you mean 'silicone'?): correct it, or remove it"),
    "key": ({"diameter =": "diametre ="}, "wire.diametre is not known (did you mean 'diameter'?): the keys of [wire] are"),
    "missing": ({'curvature = "60 1/m"': ""}, 'body.curvature is missing: an actuator of kind flexural needs a line like curvature = "60 1/m" under [body]'),
    "unit": ({'"0.3 mm"': '"0.3 kg"'}, "wire.diameter: '0.3 kg': the unit 'kg' does not fit: a unit that converts to m is expected"),
    "bound": ({'"0.3 mm"': '"-0.3 mm"'}, "wire.diameter: '-0.3 mm' is not possible for the wire diameter: give a value from 0.001 mm to 20 mm"),
    "too thick": ({'"0.3 mm"': '"0.7 mm"'}, "wire.diameter leaves no silicone above or below the wire: keep it below 0.6 mm less twice the offset"),
    "half a wire": ({"count = 2": "count = 2.5"}, "body.count = 2.5 (actuator.toml line 10) is not a whole number, but is the number of wires side by side: give a whole number"),
    "past the bench": ({'position = "109.2 mm"': 'position = "310 mm"'}, "bench.position is beyond bench.length, where there is no cantilever to push: correct one of the two"),
    "stiffer by yielding": ({'"0.88 GPa"': '"68 GPa"'}, "bending.tangent_modulus is above bending.modulus, so that yielding stiffens the wire: correct one of the two"),
    "too close": ({"count = 2": 'count = 2\nspacing = "0.3 mm"'}, "body.spacing is not above wire.diameter, so that the wires overlap: give a larger one"),
    "too far": ({"count = 2": 'count = 3\nspacing = "11 mm"'}, "body.spacing sets the outer wires outside body.width: give a smaller one, or a wider strip"),
    "too many": ({"count = 2": "count = 80"}, "body.count wires do not fit side by side into body.width: take fewer or thinner wires, or a wider strip"),
    "schema": ({"schema = 1": "schema = 2"}, "schema = 2 is not known: this version reads schema = 1"),
}  # fmt: skip


KNEE_CASES = {
    "turns that do not fit": ({'"1 mm"': '"2 mm"', '"6 mm"': '"12 mm"'}, "wire.free_length = 80 mm is too short: 56 turns of a wire of 2 mm take 112 mm side by side: correct wire.turns, wire.diameter or wire.free_length"),
    "too many turns": ({"turns = 56": "turns = 200"}, "wire.free_length = 80 mm is too short: 200 turns of a wire of 1 mm take 200 mm side by side"),
    "coil narrower than its wire": ({'"6 mm"': '"0.9 mm"'}, "wire.coil_diameter = 0.9 mm (actuator.toml line 11) is not above wire.diameter = 1 mm (actuator.toml line 10): correct one of the two"),
    "stretched too far": ({'prestretch = "50 mm"': 'prestretch = "5 m"'}, "wire.prestretch = 5000 mm is too large: the equivalent tensile strain of the wire is"),
    "band backwards": ({'austenite_finish = "62 degC"': 'austenite_finish = "30 degC"'}, "material.austenite_finish = 30 degC (actuator.toml line 23) is not above material.austenite_start = 34 degC (actuator.toml line 22): correct one of the two"),
    "half a spring": ({"turns = 56": "turns = 56\nsprings = 1.5"}, "wire.springs = 1.5 (actuator.toml line 13) is not a whole number, but is the springs side by side"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "case"), [*(("flexural", case) for case in CASES), *(("knee", case) for case in KNEE_CASES)]
)
def test_malformed_actuator_files_are_refused(kind: str, case: str):
    changes, sentence = (CASES if kind == "flexural" else KNEE_CASES)[case]
    with pytest.raises(InputError) as error:
        actuator_file.parse_actuator(text_of(kind, changes))
    assert str(error.value).startswith(f"actuator.toml: {sentence}") and "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "values", "undefined"),
    [
        ("knee", {"wire.diameter": 1.5e-3}, {"stroke", "austenite_stiffness"}),
        ("flexural", {"bench.position": 0.31}, {"stroke", "work_per_cycle", "efficiency"}),
        ("flexural", {"bending.tangent_modulus": 68e9}, {"moment", "blocking_force", "plastic_work"}),
    ],
)
def test_impossible_parameters_give_nan(kind: str, values: dict[str, float], undefined: set[str]):
    metrics = figures(parameters.replace(shipped_actuator(kind), values))
    assert all(np.isnan(metrics[name]) for name in undefined)


def test_invalid_new_values_are_refused():
    actuator = actuator_file.read_actuator(data_path("actuators", "flexural", "rig.toml"))
    with pytest.raises(InputError, match="the actuator with new values: wire.diameter leaves no silicone"):
        actuator_file.to_toml(actuator, {"wire.diameter": 0.7e-3})
    with pytest.raises(InputError, match="there is no parameter 'wire.diametre' in this plant"):
        actuator_file.to_toml(actuator, {"wire.diametre": 0.7e-3})
    assert 'diameter = "0.25 mm"' in actuator_file.to_toml(actuator, {"wire.diameter": 0.25e-3})
