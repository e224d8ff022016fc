"""A limb on sheathed wires: against the exact reference, and against capstan equation, levers and heat balance."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.plant.convection import PolynomialConvection
from smajax.plant.plant import Plant
from smajax.recordings.datasets import data_path
from smajax.simulation import run as simulate
from smajax.simulation.inputs import discretise
from tests.reference import limb as reference
from tests.reference.brinson import Material
from tests.reference.wire import Heat, Wire
from tests.support import plants

STEP = 0.0125
GRID = 4 * 599 + 1  # of such steps
HEAT = PolynomialConvection(h0=100.6, capacity_austenite=2.046e6, capacity_martensite=2.046e6)


def air(plant: Plant) -> Plant:
    """The plant with a constant h, as the reference's sheath needs it."""
    return eqx.tree_at(lambda p: p.heat, plant, HEAT)


def exact(plant: Plant, recording, substeps: int) -> np.ndarray:
    """The reference's angle."""
    value = {n: float(parameters.get(plant, n)) for n in parameters.all_declarations(plant)}
    material = Material(*(value[f"material.{f}"] for f in Material._fields))
    heat = Heat(value["heat.h0"], 0.0, 0.0, 2.0, value["heat.capacity"], value["heat.capacity"], 0.0)
    wire = Wire(value["wire.diameter"], value["wire.length"], value["wire.prestrain"], value["environment.ambient"])
    of = {
        n.partition(".")[2]: v
        for n, v in value.items()
        if n.startswith(("limb.", "pulley.", "transmission.", "sheath."))
    }
    parts = reference.Limb(**({f: 0.0 for f in reference.Limb._fields} | of))
    return reference.limb(
        material, heat, wire, parts, recording.time, recording.channels["current"], substeps=substeps
    ).position


@pytest.fixture(scope="module")
def recording():
    return plants.inputs("limb", 600, 0.05)


def misses(plant: Plant, recording, steps: tuple[float, ...]) -> list[float]:
    """RMS difference to the reference over the range for each step, all on the grid of the shortest: one program serves all."""
    true, finer = (exact(plant, recording, substeps) for substeps in (50, 100))
    assert np.max(np.abs(true - finer)) < 2e-4 * np.ptp(true)
    laid = [discretise(plant, recording, step=step).pad(GRID, len(recording)) for step in steps]
    angles = [np.asarray(simulate.simulate_inputs(plant, inputs).channels["angle"]) for inputs in laid]
    return [float(np.sqrt(np.mean((a - finer) ** 2)) / np.ptp(finer)) for a in angles]


@pytest.mark.slow
def test_converges_to_the_reference(recording):
    assert misses(air(plants.limb(sheathed=False)), recording, (0.05,))[0] < 5e-3
    computed = misses(air(plants.limb()), recording, (0.05, STEP))
    # Friction reverses within a step: its error is of first order, all other errors of second order.
    assert computed[1] < computed[0] / 3.0, computed
    assert computed[1] < 1e-3, computed


def test_the_capstan_multiplies_and_divides_the_tension(recording):
    plant = plants.limb()
    slow = np.interp(recording.time, [0.0, 14.0, 30.0], [0.0, 0.65, 0.0])
    inputs = discretise(plant, plants.recording({"current": slow, "angle": 0 * slow}, recording.time)).pad(
        GRID, len(recording)
    )
    result = simulate.simulate_inputs(plant, inputs)
    angle, torque = np.asarray(result.channels["angle"]), np.asarray(result.channels["torque"])
    joint = torque / (2.0 * float(plant.wire.area) * 0.03 / 1.5)
    grip = np.log(np.asarray(result.channels["stress"]) / joint)
    rate = np.gradient(angle, recording.time)
    steady = 0.004 * np.abs(np.gradient(rate, recording.time)) < 1e-2 * torque  # where inertia is negligible
    assert np.sum(steady & (rate > 0.02)) > 20 and np.sum(steady & (rate < -0.02)) > 20
    assert grip[steady & (rate > 0.02)] == pytest.approx(0.175, abs=1.5e-3)
    assert grip[steady & (rate < -0.02)] == pytest.approx(-0.175, abs=1.5e-3)


def test_without_friction_and_conduction_there_is_no_sheath():
    text = data_path("templates", "elbow.toml").read_text("utf-8").replace(', "sheath.friction"]', "]")
    without = text.replace('friction = "0.07"', "").replace('conductance_ratio = "3"', "")
    assert parse_rig(text).plant.mechanism.sheath is not None
    bare = parse_rig(without.replace("[sheath]", '[sheath]\nfriction = "0"\nconductance_ratio = "0"')).plant
    assert bare.mechanism.sheath is None and eqx.tree_equal(bare, parse_rig(without).plant)
    # A free friction may start at zero.
    assert parse_rig(without.replace("free = [", 'free = ["sheath.friction", ')).plant.mechanism.sheath is not None


@pytest.mark.slow
def test_a_vanishing_sheath_is_none(recording):
    plain = np.asarray(simulate.simulate(plants.limb(sheathed=False), recording, step=STEP).channels["angle"])
    inputs = discretise(plants.limb(), recording, step=STEP)
    friction = jnp.asarray([0.0, 1e-4, 1e-3, 0.07])
    values = {"sheath.friction": friction, "sheath.conductance_ratio": jnp.asarray([0.0, 0.0, 0.0, 3.0])}
    batch, codes = simulate.simulate_batch(plants.limb(), values, inputs, ("angle",))
    assert not np.any(np.asarray(codes))
    gap = np.sqrt(np.mean((np.asarray(batch["angle"]) - plain) ** 2, axis=1))
    assert gap[0] < 1e-8
    assert gap[2] == pytest.approx(10.0 * gap[1], rel=0.2)
    single = simulate.simulate(plants.limb(), recording, step=STEP).channels["angle"]
    assert np.asarray(batch["angle"][3]) == pytest.approx(np.asarray(single), abs=1e-9)


def test_wires_share_the_load_and_a_doubling_pulley_halves_the_arm(recording):
    angle = np.asarray(simulate.simulate(plants.limb(), recording, step=STEP).channels["angle"])
    loads = ("limb.mass", "limb.stiffness", "limb.preload", "pulley.inertia", "pulley.damping")
    half = {n: 0.5 * parameters.get(plants.limb(), n) for n in loads}
    single_wire = parameters.replace(plants.limb(), half | {"transmission.count": 1.0})
    assert np.asarray(simulate.simulate(single_wire, recording, step=STEP).channels["angle"]) == pytest.approx(
        angle, abs=1e-7
    )
    direct = parameters.replace(plants.limb(), {"transmission.ratio": 1.0, "pulley.radius": 0.02})
    assert np.asarray(simulate.simulate(direct, recording, step=STEP).channels["angle"]) == pytest.approx(
        angle, abs=1e-7
    )


def test_the_liner_takes_its_heat_and_gives_it_back(recording):
    """Wire -> liner -> air: the supplied heat is stored in wire and liner or lost to the air; the steady state is the bare wire's."""
    plant = parameters.replace(air(plants.limb()), {"material.resistivity_martensite": 1e-6})
    time = recording.time
    current = np.full(600, 0.3)
    result = simulate.simulate(plant, plants.recording({"current": current, "angle": 0 * time}, time), step=STEP)
    power = 0.3**2 * float(result.channels["resistance"][0])
    volume = float(plant.wire.area * plant.wire.length)
    steady = 4.0 / 0.2e-3 * 100.6
    over = np.asarray(result.channels["temperature"]) - 20.0
    seen = np.asarray(result.state.memory["sheath-liner"])[:, 0]
    liner = seen * 3.0 / 4.0  # T_p - T_ambient, from u
    inner, outer = 4.0 * steady, 4.0 / 3.0 * steady
    capacity = 1.5 * (inner + outer)
    given_off = np.sum(0.5 * (liner[1:] + liner[:-1]) * np.diff(time)) * outer
    assert 2.046e6 * over[-1] + capacity * liner[-1] + given_off == pytest.approx(power / volume * time[-1], rel=1e-3)
    assert over[-1] == pytest.approx(power / volume / steady, rel=2e-2)
    assert over[20] < 0.7 * over[-1] * (1 - np.exp(-1.0 * steady / 2.046e6))


def test_an_idle_arm_hangs_where_its_weight_and_spring_say(recording):
    """Cold wires at angle 0 carry the load; a wire cannot push: a limb without weight stays at the angle of the hot wire."""
    plant = plants.limb()
    start = plant.init(jnp.zeros(1))
    moment = 0.12 * 9.81 * 0.15 * np.sin(0.3) + 0.02
    assert float(start.stress[0]) == pytest.approx(moment * 1.5 / (2.0 * float(plant.wire.area) * 0.03), rel=1e-12)
    idle = parameters.replace(plant, {"limb.mass": 0.0, "limb.stiffness": 0.0, "limb.preload": 0.0})
    result = simulate.simulate(idle, recording, step=STEP)
    angle, stress = np.asarray(result.channels["angle"]), np.asarray(result.channels["stress"])
    assert np.min(stress) == 0.0 and angle[-1] > 0.5
    assert np.max(-np.diff(angle)) < 0.02 * np.ptp(angle)
