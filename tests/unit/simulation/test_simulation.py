"""The simulation: convergence to the exact reference, derivatives, invariances, and error messages with a cure."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import NumericsError
from smajax.files.rig_file import parse_rig, read_rig
from smajax.plant.materials.brinson import Brinson
from smajax.recordings.datasets import data_path
from smajax.simulation import run as simulate
from smajax.simulation.inputs import discretise
from smajax.simulation.status import SimulationStatus
from tests.reference import rigs
from tests.reference.brinson import Material
from tests.reference.wire import Heat, Wire
from tests.support import plants

HEAT = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)


def material(plant) -> Material:
    return Material(**{k: float(getattr(plant.material, k)) for k in Material._fields})


def errors(plant, recording, exact, channel, steps, interpolation):
    """RMS differences to the exact channel for each step, all on the grid of the finest, so that one program serves all."""
    laid = [discretise(plant, recording, interpolation=interpolation, step=step) for step in steps]
    grid = max(len(inputs.time) for inputs in laid)
    results = [simulate.simulate_inputs(plant, inputs.pad(grid, len(recording))) for inputs in laid]
    return np.array([np.sqrt(np.mean((np.asarray(result.channels[channel]) - exact) ** 2)) for result in results])


def orders(computed, steps):
    return np.diff(np.log(computed)) / np.diff(np.log(steps))


@pytest.mark.slow
def test_dead_weight_converges_to_the_exact_reference_with_second_order():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 400, 0.08)
    exact = rigs.dead_weight(
        material(plant),
        HEAT,
        Wire(0.15e-3, 0.23, 0.0, 20.0),
        0.2,
        recording.time,
        recording.channels["current"],
        interpolation="linear",
    )
    steps = np.array([0.08, 0.04, 0.02])
    computed = errors(plant, recording, exact.position, "displacement", steps, "linear")
    assert np.all(orders(computed, steps) > 1.8), (computed, orders(computed, steps))
    assert computed[-1] < 1e-6


def test_rotary_converges_to_the_exact_reference():
    plant, recording = plants.light_rotary(), plants.inputs("light_rotary", 300, 0.08)
    signal = np.column_stack([recording.channels["current_1"], recording.channels["current_2"]])
    exact = rigs.rotary(material(plant), HEAT, Wire(0.2e-3, 0.5, 0.02, 20.0), 0.02, recording.time, signal)
    steps = np.array([0.08, 0.02, 0.005])
    computed = errors(plant, recording, exact.position, "angle", steps, "hold")
    # If a wire's driving variable reverses inside a step because that of the other does, the local order falls to one.
    assert np.all(orders(computed, steps) > 1.4), (computed, orders(computed, steps))
    assert np.degrees(computed[-1]) < 2e-3


def test_halved_steps_are_those_of_half_the_step_as_far_as_the_grid_goes():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 400, 0.08)
    inputs = discretise(plant, recording, interpolation="hold", step=0.08)
    halved, samples = inputs.halve()
    assert samples == 200 and all(
        a.shape == b.shape for a, b in zip(jax.tree.leaves(inputs), jax.tree.leaves(halved), strict=True)
    )
    finer = discretise(plant, recording, interpolation="hold", step=0.04)
    coarse, half, fine = (simulate.simulate_inputs(plant, i).channels["displacement"] for i in (inputs, halved, finer))
    assert np.max(np.abs(half - fine)[:samples]) < 1e-12 < 1e-3 * np.max(np.abs(coarse - fine)[:samples])


@pytest.mark.slow
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_merged_steps_heat_as_much(interpolation):
    """Merging three steps is as accurate as a recording of every third sample allows, and jumps of a held input heat as before."""
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 400, 0.02)
    inputs = discretise(plant, recording, interpolation=interpolation, step=0.02)
    merged = inputs.coarsen(3, held=interpolation == "hold")
    assert np.array_equal(merged.time[merged.sample_indices], recording.time[::3])
    assert np.array_equal(merged.sample_signals, inputs.sample_signals[::3])
    if interpolation == "hold":
        heat = [float(np.diff(i.time) @ np.asarray(i.before)[:, 0] ** 2) for i in (inputs, merged)]
        assert heat[1] == pytest.approx(heat[0], rel=1e-12)
    fine, coarse = (np.asarray(simulate.simulate_inputs(plant, i).channels["displacement"]) for i in (inputs, merged))
    assert np.max(np.abs(coarse - fine[::3])) < 0.01 * np.ptp(fine)


def test_pieces_of_a_sample_merge_into_one_step():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 400, 0.02)
    halves, whole = (discretise(plant, recording, interpolation="hold", step=step) for step in (0.01, 0.02))
    merged = halves.coarsen(1, held=True, pieces=2)
    assert all(
        np.allclose(a, b, rtol=1e-14, atol=0.0)
        for a, b in zip(jax.tree.leaves(merged), jax.tree.leaves(whole), strict=True)
    )


@pytest.mark.slow
def test_a_simulation_may_end_where_nothing_is_asked_for_any_more():
    plant, recording = plants.light_rotary(), plants.inputs("light_rotary", 100, 0.08)
    inputs = discretise(plant, recording, step=0.08)
    longer = inputs.pad(400, len(recording))

    @jax.jit
    def response(scale, inputs, until):
        member = parameters.replace(plant, {"heat.h0": 80.0 * scale})
        return simulate.simulate_channels(member, inputs, ["angle"], until)[0]["angle"]

    for differentiated in (response, jax.jit(jax.jacfwd(response))):
        whole, early = differentiated(1.0, inputs, None), differentiated(1.0, longer, jnp.max(longer.sample_indices))
        assert np.array_equal(whole, early) or np.max(np.abs(whole - early)) < 1e-12 * np.max(np.abs(whole))


@pytest.mark.slow
def test_smoothing_vanishes_on_the_wire_with_first_order():
    recording = plants.inputs("dead_weight", 400, 0.08)
    sharp = simulate.simulate(plants.dead_weight(), recording).channels["displacement"]
    amounts = np.array([1e-2, 1e-4])
    computed = []
    for smoothing in amounts:
        plant = eqx.tree_at(
            lambda p: p.material, plants.dead_weight(), Brinson(**plants.MATERIAL, smoothing=float(smoothing))
        )
        computed.append(
            float(jnp.sqrt(jnp.mean((simulate.simulate(plant, recording).channels["displacement"] - sharp) ** 2)))
        )
    assert np.all(np.abs(orders(computed, amounts) - 1.0) < 0.15), computed


@pytest.mark.slow
def test_bias_spring_testing_machine_and_paths_agree_with_the_reference():
    plant, recording = plants.bias_spring(), plants.inputs("bias_spring", 300, 0.05)
    exact = rigs.bias_spring(
        material(plant), HEAT, Wire(0.15e-3, 0.23, 0.0, 20.0), 300.0, 2.0, recording.time, recording.channels["voltage"],
        control="voltage", interpolation="hold",
    )  # fmt: skip
    result = simulate.simulate(plant, recording, step=0.01)
    assert np.max(np.abs(np.asarray(result.channels["displacement"]) - exact.position)) < 2e-7
    plant, recording = plants.testing_machine(), plants.inputs("testing_machine", 300, 0.05)
    exact = rigs.testing_machine(
        material(plant), Heat(60.0, 0.0, 0.05, 1.5, 2.2e6, 1.9e6, 0.0), Wire(0.4e-3, 0.1, 0.002, 20.0), recording.time,
        recording.channels["strain"], recording.channels["power"],
    )  # fmt: skip
    result = simulate.simulate(plant, recording, step=0.01)
    difference = np.asarray(result.channels["stress"]) - exact.stress[:, 0]
    assert np.sqrt(np.mean(difference**2)) < 2e-4 * np.ptp(exact.stress)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [k for k in plants.KINDS if k != "bias_spring"])
def test_every_parameter_has_its_derivative(kind):
    # Where a wire is just slack, at no prestrain or no thermal expansion, the response itself has a kink.
    plant = parameters.replace(plants.KINDS[kind](), {"material.thermal_expansion": 5e-6})
    if kind == "strain_path":
        plant = parameters.replace(plant, {"environment.ambient": 17.0})
    recording = plants.inputs(kind, 160, 0.15)
    inputs = discretise(plant, recording, step=0.08)
    channel = (
        plant.mechanism.coordinate
        if plant.mechanism.coordinate in recording.channels and kind not in ("testing_machine", "strain_path")
        else "stress"
    )
    names = [n for n in parameters.all_declarations(plant) if not n.startswith("initial.") and n not in parameters.TIES]
    if plant.mechanism.unknowns == 0 or not plant.drive.control:
        names = [n for n in names if n != "drive.gain" or plant.drive.control]
    values = np.array([float(parameters.get(plant, n)) for n in names])
    typical = {"K": 1.0, "degC": 1.0}
    scales = np.array(
        [
            typical.get(parameters.declaration(plant, n).unit, 0.0) or abs(v) or 1e-6
            for n, v in zip(names, values, strict=True)
        ]
    )

    weights = np.random.default_rng(0).standard_normal(len(recording))

    def response(scaled):
        member = parameters.replace(plant, {n: scaled[i] * scales[i] for i, n in enumerate(names)})
        return simulate.simulate_channels(member, inputs, [channel])[0][channel]

    @jax.jit
    def moved(point, direction):
        """The response, its derivative in a direction, and the gradient of its weighted sum in reverse mode."""
        value, push = jax.linearize(response, point)
        gradient = (
            jax.linear_transpose(push, point)(jnp.asarray(weights))[0]
            if kind in ("dead_weight", "light_rotary")
            else None
        )
        return value, push(direction), gradient

    point, still = values / scales, np.zeros(len(names))
    value, _, gradient = moved(point, still)
    jacobian = np.column_stack([moved(point, e)[1] for e in np.eye(len(names))])
    assert np.all(np.isfinite(jacobian))
    if gradient is not None:
        size = float(np.max(np.abs(jacobian)))
        assert np.asarray(gradient) == pytest.approx(weights @ jacobian, abs=1e-9 * size * len(recording))
    for i, name in enumerate(names):
        best = np.inf
        # The response has kinks in its parameters (a band's edge that a sample just misses): the median over samples and the best of
        # several steps is the best that a difference quotient can give.
        for h in (1e-4, 1e-5, 1e-6, 1e-7):
            e = h * np.eye(len(names))[i]
            numeric = np.asarray(moved(point + e, still)[0] - moved(point - e, still)[0]) / (2 * h)
            error = np.sqrt(np.mean((numeric - jacobian[:, i]) ** 2))
            best = min(best, error / max(np.sqrt(np.mean(jacobian[:, i] ** 2)), 1e-6 * float(np.max(np.abs(value)))))
        assert best < 2e-3, (name, best)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["dead_weight", "testing_machine", "light_rotary"])
def test_random_parameters_give_numbers_or_a_code(kind):
    plant = plants.KINDS[kind]()
    recording = plants.inputs(kind, 60, 0.2)
    count = 700
    draw = np.random.default_rng(5)
    values = {}
    for name, declared in parameters.all_declarations(plant).items():
        if name.startswith(("initial.", "sensor.")) or name in parameters.TIES:
            continue
        nominal = float(parameters.get(plant, name))
        width = 0.5 * abs(nominal) if nominal else {"K": 20.0, "ohm": 1.0}.get(declared.unit, 0.0)
        values[name] = np.clip(draw.uniform(nominal - width, nominal + width, count), declared.lower, declared.upper)
    inputs = discretise(plant, recording, step=0.1)
    channels, codes = simulate.simulate_batch(
        plant, {k: jnp.asarray(v) for k, v in values.items()}, inputs, plant.observable
    )
    finite = np.all([np.all(np.isfinite(np.asarray(v)), axis=1) for v in channels.values()], axis=0)
    assert np.all(finite | (np.asarray(codes) != SimulationStatus.done))
    assert np.mean(np.asarray(codes) == SimulationStatus.done) > 0.5


@pytest.mark.slow
def test_compiled_equals_eager_and_a_batch_equals_a_loop():
    plant, recording = plants.light_rotary(), plants.inputs("light_rotary", 301, 0.04)
    inputs = discretise(plant, recording, step=0.04)
    compiled = simulate.simulate(plant, recording, step=0.04)
    martensite = np.asarray(compiled.state.fractions.martensite)
    first = int(np.argmax(np.max(np.abs(np.diff(martensite, axis=0)), axis=1)))  # where a wire transforms
    assert abs(martensite[first + 1] - martensite[first]).max() > 0.02
    for row in (0, first):
        state, failed = plant.step(
            jax.tree.map(lambda leaf, row=row: leaf[row], compiled.state),
            inputs.before[row],
            inputs.after[row],
            jnp.diff(inputs.time)[row],
        )
        assert not failed
        assert np.asarray(compiled.state.temperature[row + 1]) == pytest.approx(
            np.asarray(state.temperature), rel=1e-12
        )
        assert martensite[row + 1] == pytest.approx(np.asarray(state.fractions.martensite), rel=1e-12)
        angle = plant.observe(state, inputs.sample_signals[row + 1])["angle"]
        assert float(compiled.channels["angle"][row + 1]) == pytest.approx(float(angle), abs=1e-12)
    h0 = jnp.asarray([80.0, 100.0, 130.0])
    batch, codes = simulate.simulate_batch(plant, {"heat.h0": h0}, inputs, ("angle",))
    for k, value in enumerate(h0):
        single = simulate.simulate(parameters.replace(plant, {"heat.h0": value}), recording, step=0.04)
        assert np.asarray(batch["angle"][k]) == pytest.approx(np.asarray(single.channels["angle"]), abs=1e-9)
    assert not np.any(np.asarray(codes))


def test_one_failing_member_leaves_the_others_alone():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 60, 0.1)
    inputs = discretise(plant, recording)
    channels, codes = simulate.simulate_batch(
        plant, {"drive.gain": jnp.asarray([1.0, 16.0, 0.9])}, inputs, ("displacement",)
    )
    assert codes[0] == codes[2] == SimulationStatus.done
    assert codes[1] == SimulationStatus.overheated
    assert np.all(np.isfinite(np.asarray(channels["displacement"])[[0, 2]]))


def test_a_recording_that_is_filled_up_stands_still_at_its_end():
    """A wire that would melt if its last current continued does not melt because a longer recording is in the same batch."""
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 60, 0.002)
    hot = {**recording.channels, "current": np.full(60, 5.0)}
    for rows, code in ((60, SimulationStatus.overheated), (8, SimulationStatus.done)):
        short = plants.recording({name: values[:rows] for name, values in hot.items()}, recording.time[:rows])
        alone = discretise(plant, short, step=0.002)
        computed = simulate.simulate_inputs(plant, alone.pad(128, 64))
        assert SimulationStatus(int(computed.status)) is code
        seen = np.asarray(computed.channels["temperature"])
        assert np.all(seen[rows:] == seen[rows - 1]) and computed.time[-1] == short.time[-1]


def test_swapping_the_wires_turns_the_angle_round():
    plant, recording = plants.light_rotary(), plants.inputs("light_rotary", 301, 0.04)
    swapped = plants.recording(
        {
            "current_1": recording.channels["current_2"],
            "current_2": recording.channels["current_1"],
            "angle": recording.channels["angle"],
        },
        recording.time,
    )
    response, mirrored = simulate.simulate(plant, recording, step=0.04), simulate.simulate(plant, swapped, step=0.04)
    assert np.asarray(response.channels["angle"]) == pytest.approx(-np.asarray(mirrored.channels["angle"]), abs=1e-9)
    assert np.asarray(response.channels["temperature_1"]) == pytest.approx(
        np.asarray(mirrored.channels["temperature_2"]), rel=1e-12
    )


@pytest.mark.slow
def test_two_wires_with_latent_heat_are_solved_at_every_step():
    """If a transformation begins within a step, there may be no Newton step that decreases the residual; draws where this failed."""
    text = (data_path("recordings", "rotary") / "rig.toml").read_text("utf-8")
    rig = parse_rig(
        text + '\n[effects.latent-heat]\nstrength = "40 MJ/m^3"\n[effects.wire-crosstalk]\nstrength = "0.08"\n'
    )
    for seed in (5, 13, 16, 19, 32, 50, 51, 55):
        rng = np.random.default_rng(seed)
        current, row = np.zeros((4000, 2)), 0
        while row < len(current):
            held, level, wire = rng.integers(50, 400), rng.uniform(0.3, 0.5), rng.integers(0, 2)
            current[row : row + held, wire] = level
            row += held
        plant = parameters.replace(
            rig.plant,
            {
                "effects.latent-heat.strength": rng.uniform(1e7, 1e8),
                "material.martensite_shift": rng.uniform(-4.0, 4.0),
                "material.austenite_shift": rng.uniform(-4.0, 4.0),
            },
        )
        recording = plants.recording(
            {"current_1": current[:, 0], "current_2": current[:, 1]}, 0.02 * np.arange(len(current))
        )
        result = simulate.simulate(plant, recording, interpolation="hold")
        assert np.ptp(np.asarray(result.channels["angle"])) > 0.1


NARROW = """
[rig]
kind = "antagonistic-rotary"
control = "current"
[material]
set = "rotary-table1"
[heat]
h0 = "377.375 W/m^2/K"
h2 = "0.050 W/m^2/K^3"
capacity = "2.046 MJ/m^3/K"
[wire]
diameter = "0.2 mm"
length = "500 mm"
prestrain = "2 %"
[pulley]
radius = "20 mm"
[environment]
ambient = "20 degC"
[effects.latent-heat]
strength = "156 MJ/m^3"
"""


@pytest.mark.slow
def test_two_wires_with_latent_heat_and_narrow_transformations_are_solved_at_every_step():
    """A band that a step crosses has a kink at either end, and Newton's steps that are judged by the next one alone go round between them.

    What the angle comes to does not depend on the steps: those ten times shorter were never stopped.
    """
    rig, swings = parse_rig(NARROW), []
    for current in (1.8, 2.0, 2.5, 3.0):
        for rows in (100, 1000):
            first = np.where(np.arange(rows) < 0.5 * rows, current, 0.0)
            recording = plants.recording({"current_1": first, "current_2": current - first}, np.arange(rows) / rows)
            result = simulate.simulate(rig.plant, recording, interpolation="hold", step=1.0 / rows)
            swings.append(float(np.ptp(np.asarray(result.channels["angle"]))))
    assert swings[::2] == pytest.approx(swings[1::2], rel=0.02)
    assert min(swings) > 0.5


@pytest.mark.slow
def test_a_step_as_far_beyond_a_kink_as_it_was_before_is_no_gain():
    """Cases from 100,000 designs: Newton's steps oscillated between two points of equal residual, and eight or nine never converged."""
    rig, swings = read_rig(data_path("recordings", "rotary") / "rig.toml"), []
    diameter, length, prestrain, radius = (
        0.0001535965451505035,
        0.5910847990773618,
        0.021063704323023555,
        0.011318499315530061,
    )
    amplitude = 1.337448635923257
    plant = parameters.replace(
        rig.plant,
        {"wire.diameter": diameter, "wire.length": length, "wire.prestrain": prestrain, "pulley.radius": radius},
    )
    for rows in (42, 840):
        time = np.arange(2 * rows + 1) / rows
        first = np.where(np.arange(len(time)) % rows < rows // 2, amplitude, 0.0)
        recording = plants.recording({"current_1": first, "current_2": amplitude - first}, time)
        result = simulate.simulate(plant, recording, interpolation="hold", step=1.0 / rows)
        swings.append(float(np.ptp(np.asarray(result.channels["angle"]))))
    assert swings[0] == pytest.approx(swings[1], rel=0.02) and swings[0] > 0.5


@pytest.mark.slow
def test_light_pulley_is_the_limit_of_small_inertia():
    recording = plants.inputs("rotary", 301, 0.02)
    computed = []
    for inertia in (1e-5, 1e-7):
        heavy = simulate.simulate(plants.rotary(inertia, 100 * inertia), recording, step=0.02).channels["angle"]
        light = plants.light_rotary(**{k: v for k, v in plants.ROTARY_PAPER.items() if not k.startswith("thermal")})
        computed.append(
            float(jnp.sqrt(jnp.mean((heavy - simulate.simulate(light, recording, step=0.02).channels["angle"]) ** 2)))
        )
    assert computed[1] < 0.3 * computed[0] or computed[1] < 1e-5, computed
    assert computed[1] < 1e-3


@pytest.mark.slow
def test_inertia_rings_as_the_reference_does():
    plant = plants.rotary(2e-4, 2e-4)
    recording = plants.inputs("rotary", 60, 0.05)
    signal = np.column_stack([recording.channels["current_1"], recording.channels["current_2"]])
    exact = rigs.rotary_inertia(
        material(plant), HEAT, Wire(0.2e-3, 0.5, 0.02, 20.0), 0.02, 2e-4, 2e-4, recording.time, signal, substeps=400
    )
    computed = errors(plant, recording, exact.position, "angle", (0.001, 0.0005), "hold")
    assert computed[1] < computed[0] / 2.5
    assert computed[1] < 2e-3 * np.ptp(exact.position)


@pytest.mark.slow
def test_a_wire_cannot_push():
    plant = plants.strain_path()
    strain = np.concatenate([np.linspace(0, 0.01, 300), np.linspace(0.01, -0.01, 500)])
    result = simulate.simulate(
        plant, plants.recording({"temperature": np.full(800, 20.0), "strain": strain, "stress": 0 * strain})
    )
    stress = np.asarray(result.channels["stress"])
    assert np.min(stress) == 0.0
    assert np.max(stress) > 1e7
    assert np.all(stress[-240:] == 0.0)


@pytest.mark.slow
def test_work_over_a_closed_cycle_is_dissipated():
    """Pulled and released at constant temperature above A_f, the wire returns to its start and the loop's area is positive."""
    strain = np.concatenate([np.linspace(0, 0.05, 400), np.linspace(0.05, 0, 400)])
    result = simulate.simulate(
        plants.strain_path(),
        plants.recording({"temperature": np.full(800, 95.0), "strain": strain, "stress": 0 * strain}),
    )
    stress = np.asarray(result.channels["stress"])
    work = float(np.sum(0.5 * (stress[1:] + stress[:-1]) * np.diff(strain)))
    assert stress[-1] == pytest.approx(0.0, abs=1e3)
    assert float(result.state.fractions.martensite[-1, 0]) < 1e-6
    assert work > 1e5


def test_heat_in_is_heat_stored_and_lost():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 300, 0.05)
    fine = plants.recording(
        {"current": np.repeat(recording.channels["current"], 10), "displacement": np.zeros(3000)},
        np.arange(3000) * 0.005,
    )
    result = simulate.simulate(plant, fine)
    t, temperature = np.asarray(result.time), np.asarray(result.channels["temperature"])
    volume = float(plant.wire.area * plant.wire.length)
    lost = np.asarray(plant.heat.convection(jnp.asarray(temperature))) * (temperature - 20.0) * 4 / 0.15e-3 * volume
    power = np.asarray(result.channels["power"])[:-1]
    stored = 2.046e6 * volume * (temperature[-1] - temperature[0])
    supplied = np.sum(power * np.diff(t))
    assert stored + np.sum(0.5 * (lost[1:] + lost[:-1]) * np.diff(t)) == pytest.approx(supplied, rel=2e-3)


def test_steady_temperature_and_time_constant_of_the_paper():
    plant = parameters.replace(plants.dead_weight(), {"heat.h0": 600.0, "heat.h2": 0.0, "wire.diameter": 0.2e-3})
    plant = parameters.replace(
        plant, {"material.resistivity_austenite": 9e-7, "material.resistivity_martensite": 9e-7, "load.mass": 0.0}
    )
    time = np.linspace(0, 2.999, 3000)
    result = simulate.simulate(plant, plants.recording({"current": np.ones(3000), "displacement": 0 * time}, time))
    temperature = np.asarray(result.channels["temperature"])
    assert temperature[100] == pytest.approx(53.7198, abs=2e-3)
    assert temperature[-1] == pytest.approx(95.9909, abs=1e-3)


def test_failure_says_what_to_do():
    plant = parameters.replace(plants.dead_weight(), {"drive.gain": 16.0})
    with pytest.raises(
        NumericsError, match=r"overheated: the wire exceeded .* check the input's unit.*drive.gain = 16"
    ):
        simulate.simulate(plant, plants.inputs("dead_weight", 100, 0.1))


def test_no_recompilation_for_other_values():
    plant, recording = plants.dead_weight(), plants.inputs("dead_weight", 50, 0.1)
    simulate.simulate(plant, recording, step=0.1)
    before = simulate.simulate_inputs._plain._cached._cache_size()
    for h0 in (80.0, 90.0, 110.0):
        simulate.simulate(parameters.replace(plant, {"heat.h0": h0}), recording, step=0.1)
    assert simulate.simulate_inputs._plain._cached._cache_size() == before
