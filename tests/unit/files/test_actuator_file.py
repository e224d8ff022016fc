"""Actuators from their files: metrics, names and units, sentences about mistakes, and derivatives of every metric."""

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
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.recordings.datasets import data_path

KINDS = sorted(actuator_file.ACTUATORS)
# What a sweep may ask of whatever it sweeps.
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


@pytest.mark.parametrize("kind", KINDS)
def test_a_shipped_actuator_reads_back_and_gives_its_metrics(kind: str, tmp_path: Path):
    actuator = actuator_file.read_actuator(data_path("actuators", kind, "rig.toml"))
    actuator_file.write(tmp_path / "actuator.toml", actuator)
    again = actuator_file.read_actuator(tmp_path / "actuator.toml")
    assert eqx.tree_equal(actuator, again)
    told = figures(shipped_actuator(kind))
    assert set(told) == set(actuator.units) >= ASKED
    assert all(value.shape == () and np.isfinite(value) for value in told.values())
    unset = {"body.spacing"} if kind == "flexural" else set()
    for name, declaration in parameters.all_declarations(actuator).items():
        assert name in unset or declaration.lower <= float(parameters.get(actuator, name)) <= declaration.upper


def of_names(kind: str, names: list[str]):
    """All figures as a function of some parameters, scaled to 1."""
    actuator = shipped_actuator(kind)
    nominal = jnp.stack([parameters.get(actuator, name) for name in names])

    def told(factors: jax.Array) -> jax.Array:
        values = factors * nominal
        found = parameters.replace(actuator, {name: values[i] for i, name in enumerate(names)}).metrics()
        return jnp.stack([found[name] for name in actuator.units])

    return told


def slopes_and_ends(told, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives at a point, and the values 1e-4 of it above, below it, and there: one program."""
    basis = np.eye(len(at))
    points = at * (1.0 + 1e-4 * np.concatenate([basis, -basis, 0.0 * basis]))
    ends, pushed = jax.jit(jax.vmap(lambda p, d: jax.jvp(told, (p,), (d,))))(points, np.tile(basis, (3, 1)))
    return np.array(pushed)[-len(at) :].T, np.array(ends)


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


@pytest.mark.parametrize("kind", FREED)  # the knee's, which are integrated, in test_knee.py
def test_every_figure_has_its_derivatives(kind: str):
    told, count = of_names(kind, FREED[kind]), len(FREED[kind])
    slopes, ends = slopes_and_ends(told, np.ones(count))
    by_difference = (ends[:count] - ends[count:-count]).T / 2e-4
    size = np.abs(ends[0])[:, None]
    np.testing.assert_allclose(slopes / size, by_difference / size, rtol=2e-5, atol=1e-7)
    assert np.all(np.any(slopes != 0.0, axis=0))
    one = dict(zip(shipped_actuator(kind).units, ends[0], strict=True))
    actuator = shipped_actuator(kind)
    alone = figures(parameters.replace(actuator, {FREED[kind][0]: 1.0001 * parameters.get(actuator, FREED[kind][0])}))
    for name, value in one.items():
        assert value == pytest.approx(float(alone[name]), rel=1e-10)  # in a batch as alone


def test_wires_at_a_spacing_cool_more_slowly_the_closer_they_are():
    """The file's spacing is that of the section; derivatives in it and in the diameter beside it."""
    actuator = shipped_actuator("flexural")
    close = dataclasses.replace(
        actuator_file.parse_actuator(text_of("flexural", {"count = 2": 'count = 4\nspacing = "0.8 mm"'})), cells=6
    )  # pyright: ignore[reportArgumentType]
    again = actuator_file.parse_actuator(actuator_file.to_toml(close))
    assert float(parameters.get(again, "body.spacing")) == pytest.approx(0.8e-3, rel=1e-12)
    even, names = parameters.replace(actuator, {"body.count": 4.0}), ("wire.diameter", "body.spacing")
    nominal = np.array([0.3e-3, 0.8e-3])

    def told(values: jax.Array) -> jax.Array:
        found = parameters.replace(close, dict(zip(names, values, strict=True))).metrics()
        return jnp.stack([found["time_to_cool"], found["temperature_after"]])

    slopes, ends = slopes_and_ends(told, nominal)
    np.testing.assert_allclose(slopes, ((ends[:2] - ends[2:4]) / (2e-4 * nominal[:, None])).T, rtol=1e-4)
    assert slopes[1, 0] > 0.0 > slopes[1, 1]
    assert float(ends[4, 1]) > float(figures(even)["temperature_after"]) + 1.0
    # A count that the grid was not made for has no answer, where even wires have one.
    assert np.isnan(float(figures(parameters.replace(close, {"body.count": 3.0}))["time_to_cool"]))
    assert np.isfinite(float(figures(even)["time_to_cool"]))


def test_flexural_figures_are_those_of_its_parts():
    actuator = shipped_actuator("flexural")
    told = {name: float(value) for name, value in figures(actuator).items()}
    assert told["moment"] == pytest.approx(1.528e-3, rel=1e-3)
    assert told["blocking_force"] == pytest.approx(2 * told["moment"] / 55e-3, rel=1e-12)
    assert told["blocking_force_of_yielding"] == pytest.approx(
        told["plastic_share"] * told["blocking_force"], rel=1e-12
    )
    assert told["plastic_share"] == pytest.approx(1 - 0.638, abs=1e-3)
    assert told["yield_diameter"] == pytest.approx(230e-6, rel=1e-3)
    assert told["energy_per_cycle"] == pytest.approx(
        2.82 + 1.36, rel=3e-3
    )  # 123 mm of wire: warmed by 60 K, transformed
    assert told["resistance"] == pytest.approx(1.57, rel=5e-3)
    assert told["heating_time"] == pytest.approx(told["energy_per_cycle"] / (3.5**2 * told["resistance"]), rel=1e-12)
    assert 1.0 / told["bandwidth"] == pytest.approx(told["heating_time"] + told["time_to_cool"], rel=1e-12)
    assert told["force"] == told["blocking_force"] and told["peak_temperature"] == 80.0
    assert (
        told["efficiency"]
        < told["limit_efficiency"]
        == pytest.approx(told["plastic_work"] / told["energy_per_cycle"], rel=1e-12)
    )
    # Against a bench so soft that it takes all the stroke, or so stiff that it takes none, no work is done.
    work = [
        float(figures(parameters.replace(actuator, {"bench.diameter": d}))["work_per_cycle"])
        for d in (1e-5, 3e-4, 0.05)
    ]
    assert work[0] < 1e-3 * work[1] > work[2]
    thin = figures(parameters.replace(actuator, {"wire.diameter": 125e-6}))
    assert float(thin["blocking_force_of_yielding"]) == 0.0 == float(thin["plastic_work"])


def test_an_unused_figure_costs_nothing():
    """Without the cooling the compiled program has no loop over time steps."""
    actuator = eqx.filter(shipped_actuator("flexural"), eqx.is_array)
    loops = {}
    for name in ("blocking_force", "time_to_cool"):
        lowered = jax.jit(lambda m, name=name: m.metrics()[name]).lower(actuator)
        loops[name] = "while" in (lowered.as_text() if name == "time_to_cool" else lowered.compile().as_text())
    assert loops == {"blocking_force": False, "time_to_cool": True}


CASES = {
    "no rig": ({"[rig]": "[rik]"}, "the section [rig] is missing: add [rig] with a line kind = \"flexural\""),
    "kind": ({'"flexural"': '"flexurel"'}, "rig.kind: 'flexurel' is not known (did you mean 'flexural'?): it is one of"),
    "section": ({"[silicone]": "[silicon]"}, "[silicon] is not a section of this actuator (did you mean 'silicone'?): correct it, or take it out"),
    "key": ({"diameter =": "diametre ="}, "wire.diametre is not known (did you mean 'diameter'?): the keys of [wire] are"),
    "missing": ({'curvature = "60 1/m"': ""}, 'body.curvature is missing: an actuator of kind flexural needs a line like curvature = "60 1/m" under [body]'),
    "unit": ({'"0.3 mm"': '"0.3 kg"'}, "wire.diameter: '0.3 kg': the unit 'kg' does not fit: a unit that converts to m is expected"),
    "bound": ({'"0.3 mm"': '"-0.3 mm"'}, "wire.diameter: '-0.3 mm' is not possible for the wire diameter: give a value from 0.001 mm to 20 mm"),
    "too thick": ({'"0.3 mm"': '"0.7 mm"'}, "wire.diameter leaves no silicone above or below the wire: keep it below 0.6 mm less twice the offset"),
    "half a wire": ({"count = 2": "count = 2.5"}, "body.count = 2.5 (actuator.toml line 10) is not a whole number, and it is the number of wires side by side: give a whole one"),
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
    "stretched too far": ({'prestretch = "50 mm"': 'prestretch = "5 m"'}, "wire.prestretch = 5000 mm is too much: it strains this coil's wire like a tension of"),
    "band backwards": ({'austenite_finish = "62 degC"': 'austenite_finish = "30 degC"'}, "material.austenite_finish = 30 degC (actuator.toml line 23) is not above material.austenite_start = 34 degC (actuator.toml line 22): correct one of the two"),
    "half a spring": ({"turns = 56": "turns = 56\nsprings = 1.5"}, "wire.springs = 1.5 (actuator.toml line 13) is not a whole number, and it is the springs side by side"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "case"), [*(("flexural", case) for case in CASES), *(("knee", case) for case in KNEE_CASES)]
)
def test_a_malformed_actuator_gets_its_sentence(kind: str, case: str):
    changes, sentence = (CASES if kind == "flexural" else KNEE_CASES)[case]
    with pytest.raises(InputError) as error:
        actuator_file.parse_actuator(text_of(kind, changes))
    assert str(error.value).startswith(f"actuator.toml: {sentence}") and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("kind", "values", "lost"),
    [
        ("knee", {"wire.diameter": 1.5e-3}, {"stroke", "austenite_stiffness"}),
        ("flexural", {"bench.position": 0.31}, {"stroke", "work_per_cycle", "efficiency"}),
        ("flexural", {"bending.tangent_modulus": 68e9}, {"moment", "blocking_force", "plastic_work"}),
    ],
)
def test_what_cannot_be_has_no_figures(kind: str, values: dict[str, float], lost: set[str]):
    told = figures(parameters.replace(shipped_actuator(kind), values))
    assert all(np.isnan(told[name]) for name in lost)


def test_new_values_have_to_make_an_actuator():
    actuator = actuator_file.read_actuator(data_path("actuators", "flexural", "rig.toml"))
    with pytest.raises(InputError, match="the actuator with new values: wire.diameter leaves no silicone"):
        actuator_file.to_toml(actuator, {"wire.diameter": 0.7e-3})
    with pytest.raises(InputError, match="there is no parameter 'wire.diametre' in this plant"):
        actuator_file.to_toml(actuator, {"wire.diametre": 0.7e-3})
    assert 'diameter = "0.25 mm"' in actuator_file.to_toml(actuator, {"wire.diameter": 0.25e-3})
