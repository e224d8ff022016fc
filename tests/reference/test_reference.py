"""Exact reference against published vectors and figures (rotary paper), closed forms, and smaller steps."""

import math

import numpy as np
import pytest

from tests.reference import fast_loop, rigs
from tests.reference.brinson import (
    Material,
    advance,
    brinson_original,
    chung_d,
    detwinning_drive,
    forward_from_leg_start,
    modulus,
    reverse_from_leg_start,
    stress_of,
)
from tests.reference.hidden import Hidden, displacement
from tests.reference.hidden_pair import angle
from tests.reference.make_data import CYCLES, FOLDER, RECIPES, make, splits, truth
from tests.reference.rig_file import quantity, read_channel, read_csv, read_rig, simulate
from tests.reference.wire import State, Wire, polynomial_heat

# Table 1 of the rotary paper, thermal strain left out; and a wire with wider bands and both expansions.
PAPER = Material(
    48.4, 43.9, 68.0, 73.8, 6.73e6, 6.32e6, 31.5e9, 20e9, 1.0e-6, 0.8e-6, 25e6, 78e6, 0.041, 0.0, 0.0,
)  # fmt: skip
MATERIAL = Material(
    50.0, 36.0, 64.0, 80.0, 6.73e6, 6.32e6, 31.5e9, 20e9, 1.0e-6, 0.8e-6, 25e6, 105e6, 0.041, 11e-6, 6.6e-6,
)  # fmt: skip
PAIR = Wire(0.2e-3, 0.5, 0.02, 20.0)
SINGLE = Wire(0.15e-3, 0.23, 0.0, 20.0)
CAPACITY = 2.046e6
AIR = polynomial_heat(100.6, CAPACITY, h2=0.001)
# Table 4, second order.
MODES = {"free": (100.614, 0.001), "low": (160.381, 0.041), "high": (377.375, 0.050)}
FAN = polynomial_heat(MODES["high"][0], CAPACITY, h2=MODES["high"][1])


def levels(rng: np.random.Generator, rows: int, hold: int, low: float, high: float) -> np.ndarray:
    """Return random levels of ``hold`` rows each, every third one zero: partial and full loops."""
    chosen = rng.uniform(low, high, rows // hold + 1)
    chosen[::3] = 0.0
    return np.repeat(chosen, hold)[:rows]


def square_turns(frequency: float, current: float, periods: int, rows: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Times and currents of wires that take turns; ``rows`` a period."""
    count = np.arange(periods * rows + 1)
    first = np.where(count % rows < rows // 2, current, 0.0)
    return count / (rows * frequency), np.column_stack([first, current - first])


# Kinetics.


@pytest.mark.parametrize(
    ("temperature", "stress", "start", "expected"),
    [
        (60.0, 120e6, (0.1, 0.2), (0.423378572, 0.128138095)),
        (60.0, 98e6, (0.1, 0.2), (0.1, 0.2)),
        (46.0, 50e6, (0.2, 0.1), (0.564481642, 0.264895855)),
        (46.0, 10e6, (0.2, 0.1), (0.2, 0.486584962)),
        (40.0, 200e6, (0.2, 0.1), (1.0, 0.0)),
    ],
)
def test_forward_vectors(temperature, stress, start, expected):
    assert forward_from_leg_start(PAPER, temperature, stress, *start, True) == pytest.approx(expected, abs=1e-9)
    # The relative form, along a leg from outside of the bands: cooled without stress change, then loaded.
    hot = temperature + 60.0
    path = advance(PAPER, *start, hot, 0.0, temperature, 0.0)
    assert advance(PAPER, *path, temperature, 0.0, temperature, stress) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("temperature", "stress", "start", "expected"),
    [
        (72.0, 0.0, (0.5, 0.5), (0.109703234, 0.109703234)),
        (80.0, 60e6, (0.5, 0.3), (0.225031452, 0.135018871)),
        (75.0, 100e6, (0.5, 0.3), (0.5, 0.3)),
    ],
)
def test_reverse_vectors(temperature, stress, start, expected):
    assert reverse_from_leg_start(PAPER, temperature, stress, *start) == pytest.approx(expected, abs=1e-9)
    # The relative form in 50 steps at constant stress, from below the band.
    fractions, steps = start, np.linspace(temperature - 30.0, temperature, 51)
    for t0, t1 in zip(steps, steps[1:], strict=False):
        fractions = advance(PAPER, *fractions, t0, stress, t1, stress)
    assert fractions == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("start", "stress", "original"),
    [((0.0, 0.0), 50e6, 1.456), ((0.3, 0.0), 60e6, 1.819), ((0.2, 0.3), 40e6, 1.293), ((0.0, 0.5), 78e6, 1.500)],
)
def test_the_uncorrected_law_passes_one_and_the_corrected_does_not(start, stress, original):
    # At the end of cooling, where twinning is complete.
    assert sum(brinson_original(PAPER, PAPER.martensite_finish, stress, *start)) == pytest.approx(original, abs=1e-3)
    assert sum(forward_from_leg_start(PAPER, PAPER.martensite_finish, stress, *start, True)) == pytest.approx(
        1.0, abs=1e-12
    )


@pytest.mark.parametrize("point", [(46.0, 50e6, 0.2, 0.1), (44.5, 70e6, 0.0, 0.3), (48.0, 30e6, 0.4, 0.0)])
def test_printed_rates_are_those_of_the_corrected_law(point):
    """The rates of equation 5 in the paper are the derivative of the integrated law along a path in stress and temperature."""
    temperature, stress, x0, y0 = point
    per_second, width = (3e6, -0.7), PAPER.detwinning_finish_stress - PAPER.detwinning_start_stress
    a_m = math.pi / (PAPER.martensite_start - PAPER.martensite_finish)
    phase = math.pi * (stress - PAPER.detwinning_finish_stress) / -width
    x_rate = -0.5 * (1 - x0) * math.sin(phase) * math.pi / -width * per_second[0]
    d_rate = -0.5 * (1 - x0 - y0) * math.sin(a_m * (temperature - PAPER.martensite_finish)) * a_m * per_second[1]
    x = forward_from_leg_start(PAPER, temperature, stress, x0, y0, True)[0]
    y_rate = -x_rate / (1 - x0) * chung_d(PAPER, temperature, x0, y0, True) + (1 - x) / (1 - x0) * d_rate
    h = 1e-4
    ends = [
        np.array(
            forward_from_leg_start(
                PAPER, temperature + s * h * per_second[1], stress + s * h * per_second[0], x0, y0, True
            )
        )
        for s in (1, -1)
    ]
    assert (ends[0] - ends[1]) / (2 * h) == pytest.approx([x_rate, y_rate], rel=1e-6)


def test_constitutive_vector():
    fractions = forward_from_leg_start(PAPER, 60.0, 120e6, 0.1, 0.2, True)
    assert modulus(PAPER, sum(fractions)) == pytest.approx(25157.558e6, rel=2e-8)
    assert stress_of(PAPER, 60.0, 0.02, *fractions, 20.0) == pytest.approx(66.453151e6, rel=1e-7)


def test_fractions_stay_in_range_and_a_leg_may_be_cut_anywhere():
    rng = np.random.default_rng(0)
    x, y, t, s = 0.0, 1.0, 20.0, 0.0
    for _ in range(4000):
        t1, s1, part = rng.uniform(10.0, 120.0), rng.uniform(0.0, 300e6), rng.uniform()
        tm, sm = t + part * (t1 - t), s + part * (s1 - s)
        whole = advance(MATERIAL, x, y, t, s, t1, s1)
        cut = advance(MATERIAL, *advance(MATERIAL, x, y, t, s, tm, sm), tm, sm, t1, s1)
        assert cut == pytest.approx(whole, abs=1e-12)
        x, y, t, s = *whole, t1, s1
        assert min(x, y) >= 0.0 and x + y <= 1.0 + 1e-12


def test_a_restart_inside_the_band_is_continuous_and_completes():
    """There is no jump where a leg reverses, and the transformation is complete at the finish."""
    cold = (1.0, 0.0)
    half = advance(MATERIAL, *cold, 20.0, 0.0, 72.0, 0.0)
    assert 0.4 < sum(half) < 0.6
    back = advance(MATERIAL, *half, 72.0, 0.0, 68.0, 0.0)
    assert back == half
    assert sum(advance(MATERIAL, *back, 68.0, 0.0, 68.0 + 1e-9, 0.0)) == pytest.approx(sum(half), abs=1e-9)
    assert sum(advance(MATERIAL, *back, 68.0, 0.0, 80.0, 0.0)) == 0.0
    # Coldness drives detwinning above M_s, never below.
    assert (
        detwinning_drive(MATERIAL, 60.0, 100e6)
        < detwinning_drive(MATERIAL, 50.0, 100e6)
        == detwinning_drive(MATERIAL, 40.0, 100e6)
    )


# Heat.


def test_heat_vector():
    still = PAPER._replace(resistivity_austenite=9e-7, resistivity_martensite=9e-7)
    heat, wire = polynomial_heat(600.0, CAPACITY), PAIR._replace(prestrain=0.0)
    run = rigs.dead_weight(
        still, heat, wire, 0.0, np.array([0.0, 0.1, 5.0]), np.ones(3), interpolation="hold", substeps=400
    )
    assert run.temperature[:, 0] == pytest.approx([20.0, 53.7198, 95.9909], abs=5e-5)
    tau = CAPACITY * 0.2e-3 / (4 * 600.0)
    assert tau == pytest.approx(0.170500, abs=1e-6)


def test_convection_time_constants_and_steady_temperatures():
    h80 = {mode: h0 + h2 * 80.0**2 for mode, (h0, h2) in MODES.items()}
    assert [h80[m] for m in MODES] == pytest.approx([107.0, 422.8, 697.4], abs=0.05)
    assert [CAPACITY * 0.2e-3 / (4 * h80[m]) for m in MODES] == pytest.approx([0.956, 0.242, 0.147], abs=1e-3)
    for mode, current, expected in (
        ("free", 0.5, 128.0),
        ("low", 1.0, 104.0),
        ("high", 1.5, 122.0),
        ("high", 2.0, 152.0),
    ):
        heat = polynomial_heat(MODES[mode][0], CAPACITY, h2=MODES[mode][1])
        time = np.linspace(0, 12, 241)
        run = rigs.dead_weight(PAPER, heat, PAIR, 0.0, time, np.full(241, current), interpolation="hold")
        assert run.temperature[-1, 0] == pytest.approx(expected, abs=0.6)


@pytest.mark.parametrize(("control", "signal"), [("current", 0.3), ("power", 0.9), ("voltage", 3.0)])
def test_the_three_controls_agree(control, signal):
    time = np.arange(101) / 50
    run = rigs.dead_weight(
        MATERIAL, AIR, SINGLE, 0.2, time, np.full(101, signal), control=control, interpolation="hold"
    )
    signal_in = {"current": run.current, "power": run.current * run.voltage, "voltage": run.voltage}[control]
    assert signal_in == pytest.approx(signal, rel=1e-12)
    assert run.voltage == pytest.approx(run.current * run.resistance, rel=1e-12)


def test_latent_heat_and_phase_dependent_capacity_against_the_closed_form():
    """At constant stress (C + latent |dxi/dT|) dT/dt = heat; while the wire warms through its whole reverse band at constant power."""
    latent, power = 1.56e8, 0.9
    heat = polynomial_heat(0.0, CAPACITY)._replace(latent_heat=latent, capacity_austenite=2.4e6)
    time = np.linspace(0.0, 3.0, 151)
    run = rigs.dead_weight(
        MATERIAL, heat, SINGLE, 0.2, time, np.full(151, power), control="power", interpolation="hold", substeps=200
    )
    temperature, fraction = run.temperature[:, 0], (run.detwinned + run.twinned)[:, 0]
    assert fraction[0] == 1.0 and fraction[-1] == 0.0
    # Integrate the absorbed heat along the transformation with the integrated kinetics in small steps.
    grid = np.linspace(20.0, temperature[-1], 200_001)
    start = 64.0 + run.stress[0, 0] / 6.73e6
    xi = 0.5 * (1.0 + np.cos(np.pi * np.clip((grid - start) / 16.0, 0.0, 1.0)))
    capacity = 2.4e6 + 0.5 * (xi[1:] + xi[:-1]) * (CAPACITY - 2.4e6)
    absorbed = np.concatenate([[0.0], np.cumsum(capacity * np.diff(grid) - latent * np.diff(xi))])
    supplied = power / (np.pi / 4 * SINGLE.diameter**2 * SINGLE.length) * time
    assert np.interp(temperature, grid, absorbed) == pytest.approx(supplied, rel=2e-6, abs=1.0)


# Rigs against the paper and against one another.


def test_kinematic_angle_of_two_percent():
    # All strain moved from one wire to the other, no stress.
    assert np.degrees(PAIR.prestrain * PAIR.length / 0.02) == pytest.approx(28.65, abs=0.01)
    # Elastic strain takes the rest.
    time, currents = square_turns(0.1, 1.2, 2)
    run = rigs.rotary(PAPER, FAN, PAIR, 0.02, time, currents, substeps=10)
    assert np.degrees([run.position[-200:].max(), run.position[-200:].min()]) == pytest.approx(
        [25.85, -25.85], abs=0.03
    )
    assert run.stress[:, 0] == pytest.approx(run.stress[:, 1])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("frequency", "current", "expected", "within"),
    [
        (0.1, 1.2, 51.7, 0.06),
        (1.0, 1.0, 51.5, 0.06),
        (2.0, 1.0, 5.8, 0.06),
        (5.0, 1.2, 3.0, 0.07),
        (5.0, 1.5, 43.1, 0.07),
        (5.0, 2.0, 38.3, 0.06),
    ],
)
def test_peak_to_peak_angles_of_the_rotary_rig(frequency, current, expected, within):
    """Wires that take turns at high convection (systems of the rotary paper, no latent heat); the last two periods."""
    time, currents = square_turns(frequency, current, 2 if frequency < 0.5 else 25)
    run = rigs.rotary(PAPER, FAN, PAIR, 0.02, time, currents, substeps=20)
    last = np.degrees(run.position[-200 if frequency < 0.5 else -400 :])
    assert np.ptp(last) == pytest.approx(expected, abs=within)


@pytest.mark.slow
def test_heat_is_conserved_in_the_rotary_rig_with_latent_heat():
    heat = FAN._replace(latent_heat=1.56e8)
    time, currents = square_turns(1.0, 1.5, 2, rows=2000)
    run = rigs.rotary(PAPER, heat, PAIR, 0.02, time, currents, substeps=2)
    fraction = run.detwinned + run.twinned
    rho = 1e-6 - 0.2e-6 * fraction
    section, h = np.pi / 4 * 0.2e-3**2, MODES["high"][0] + MODES["high"][1] * run.temperature**2

    def net(signal):
        return rho * (signal / section) ** 2 - 4 / 0.2e-3 * h * (run.temperature - 20.0)

    # Held currents: the input of row k acts to the end of its step.
    before, after = net(currents)[:-1], (net(np.roll(currents, 1, axis=0)))[1:]
    absorbed = np.cumsum(0.5 * (before + after) * np.diff(time)[:, None], axis=0)
    content = CAPACITY * (run.temperature - 20.0) - 1.56e8 * (fraction - fraction[0])
    assert np.ptp(fraction) > 0.9
    assert content[1:] == pytest.approx(absorbed, abs=2e-5 * np.ptp(content))


def test_a_spring_without_stiffness_is_a_dead_weight():
    time, current = np.arange(1001) / 50, levels(np.random.default_rng(1), 1001, 75, 0.2, 0.34)
    weight = rigs.dead_weight(MATERIAL, AIR, SINGLE, 0.2, time, current, interpolation="hold")
    spring = rigs.bias_spring(MATERIAL, AIR, SINGLE, 0.0, 0.2 * 9.81, time, current, interpolation="hold")
    assert np.ptp(weight.position) > 9e-3
    assert spring.position == pytest.approx(weight.position, abs=1e-11)
    stiff = rigs.bias_spring(MATERIAL, AIR, SINGLE, 300.0, 2.0, time, current, interpolation="hold")
    section = np.pi / 4 * SINGLE.diameter**2
    assert stiff.stress[:, 0] * section == pytest.approx(2.0 + 300.0 * stiff.position, abs=1e-9)


def test_strain_and_stress_paths_are_inverse_and_a_loop_dissipates():
    temperature = np.full(241, 90.0)
    strain = 0.035 * np.sin(np.linspace(0, 2 * np.pi, 241)) ** 2
    strain_path = rigs.path(MATERIAL, temperature, strain=strain, reference=90.0)
    back = rigs.path(MATERIAL, temperature, stress=strain_path.stress[:, 0], reference=90.0)
    assert back.position == pytest.approx(strain, abs=1e-12)
    work = np.trapezoid(strain_path.stress[:, 0], strain)
    # Two superelastic loops, each of the area between its plateaus: at 50 % martensite they lie 2.6 C apart in stress.
    forward, reverse = 65e6 + 6.32e6 * (90.0 - 50.0), 6.73e6 * (90.0 - 72.0)
    assert work == pytest.approx(2 * 0.041 * (forward - reverse) * strain_path.detwinned.max(), rel=0.25)
    assert np.all(strain_path.stress >= 0.0)


def test_the_angle_of_a_slack_pulley_is_constant():
    """Wires with more prestrain than the pulley needs are slack: the angle is constant until one becomes taut."""
    wire = PAIR._replace(prestrain=0.02)
    loose = rigs.State(20.0, 0.0, 0.03 / 0.041, 1 - 0.03 / 0.041)
    time = np.arange(201) / 50
    currents = np.column_stack([np.where(time < 1.0, 0.3, 0.55), np.zeros(201)])
    run = rigs.rotary(PAPER, AIR, wire, 0.02, time, currents, start=(loose, loose), substeps=10)
    assert np.all(run.position[time < 1.0] == 0.0) and np.all(run.stress[time < 1.0] == 0.0)
    assert run.position[-1] > np.radians(10.0)
    # The pulley turns only when wire 1 is shorter than its path around the pulley.
    free = 500e-3 / 0.02 * (0.02 - run.strain[:, 0])
    assert run.position[-1] == pytest.approx(max(0.0, free.max()), abs=1e-9)


def test_inertia_and_damping_follow_the_light_pulley_as_they_vanish():
    time = np.arange(301) / 100
    currents = np.column_stack([np.linspace(0.0, 0.6, 301), np.zeros(301)])
    options = {"interpolation": "linear", "substeps": 400}
    light = np.degrees(rigs.rotary(MATERIAL, AIR, PAIR, 0.02, time, currents, **options).position)
    heavy = [
        np.degrees(rigs.rotary_inertia(MATERIAL, AIR, PAIR, 0.02, 1e-5, c, time, currents, **options).position)
        for c in (2e-3, 2e-4)
    ]
    error = [np.max(np.abs(h - light)) for h in heavy]
    assert np.ptp(light) > 20.0
    assert error[1] < 0.01 * np.ptp(light) and error[0] > 5.0 * error[1]


# Convergence, and the fast loop.


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_dead_weight_is_converged(interpolation):
    time, current = np.arange(1501) / 50, levels(np.random.default_rng(2), 1501, 60, 0.15, 0.33)
    runs = [
        rigs.dead_weight(MATERIAL, AIR, SINGLE, 0.2, time, current, interpolation=interpolation, substeps=n).position
        for n in (20, 40)
    ]
    assert np.ptp(runs[1]) > 9e-3
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-7 * np.ptp(runs[1])


def test_bias_spring_is_converged():
    time, voltage = np.arange(1501) / 50, levels(np.random.default_rng(3), 1501, 60, 1.5, 4.0)
    options = {"control": "voltage", "interpolation": "linear"}
    runs = [
        rigs.bias_spring(MATERIAL, AIR, SINGLE, 300.0, 2.0, time, voltage, **options, substeps=n).position
        for n in (20, 40)
    ]
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-7 * np.ptp(runs[1])


def test_testing_machine_is_converged():
    time, power = np.arange(1501) / 50, levels(np.random.default_rng(4), 1501, 100, 0.1, 0.8)
    strain = 0.02 * (1 - np.cos(2 * np.pi * time / 9.0))
    wire = Wire(0.2e-3, 0.1, 0.002, 20.0)
    runs = [rigs.testing_machine(MATERIAL, AIR, wire, time, strain, power, substeps=n).stress for n in (20, 40)]
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-6 * np.ptp(runs[1])


@pytest.mark.slow
def test_rotary_is_converged():
    time = np.arange(1501) / 50
    currents = np.column_stack([levels(np.random.default_rng(s), 1501, 80, 0.3, 0.55) for s in (5, 6)])
    runs = [np.degrees(rigs.rotary(PAPER, AIR, PAIR, 0.02, time, currents, substeps=n).position) for n in (100, 200)]
    assert np.ptp(runs[1]) > 40.0
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-5


def test_a_rotary_run_goes_on_from_any_row():
    """Restart from states and angle with slack wires, with wires that become taut, and during oscillation."""
    time = np.arange(301) / 50
    currents = np.zeros((301, 2))
    currents[:60, 0], currents[90:140, 1], currents[200:, 0] = 0.55, 0.6, 0.5
    whole = rigs.rotary(PAPER, AIR, PAIR, 0.02, time, currents, substeps=20)
    slack = whole.stress[:, 0] == 0.0
    assert 5 < np.sum(slack) < 60 and np.ptp(whole.position) > 0.3
    start, angle = None, 0.0
    for k in range(300):
        run = rigs.rotary(
            PAPER, AIR, PAIR, 0.02, time[k : k + 2], currents[k : k + 2], substeps=20, start=start, angle=angle
        )
        angle = float(run.position[-1])
        states = zip(*(a[-1] for a in (run.temperature, run.stress, run.detwinned, run.twinned)), strict=True)
        start = tuple(State(*map(float, s)) for s in states)
        assert angle == pytest.approx(whole.position[k + 1], abs=1e-9)
        assert run.temperature[-1] == pytest.approx(whole.temperature[k + 1], abs=1e-8)


@pytest.mark.slow
def test_the_fast_loop_converges_to_the_exact_rigs():
    time, current = np.arange(1001) / 50, levels(np.random.default_rng(7), 1001, 75, 0.2, 0.34)
    material = MATERIAL._replace(thermal_expansion_martensite=11e-6)
    design = fast_loop.Design(*material[:14], *AIR[:3], CAPACITY, *SINGLE[:2], 20.0, 0.2, 0.0, 1.0)
    exact = rigs.dead_weight(material, AIR, SINGLE, 0.2, time, current).position
    error = [np.sqrt(np.mean((fast_loop.dead_weight(design, time, current, substeps=n) - exact) ** 2)) for n in (1, 16)]
    assert error[0] < 1e-4 and error[1] < error[0] / 10
    time = np.arange(1001) / 50
    currents = np.column_stack([levels(np.random.default_rng(s), 1001, 80, 0.3, 0.55) for s in (5, 6)])
    pair = fast_loop.Design(*PAPER[:14], *AIR[:3], CAPACITY, *PAIR[:2], 20.0, 0.0, PAIR.prestrain, 0.02)
    exact = rigs.rotary(PAPER, AIR, PAIR, 0.02, time, currents).position
    error = [
        np.degrees(np.sqrt(np.mean((fast_loop.rotary(pair, time, currents, substeps=n) - exact) ** 2)))
        for n in (8, 128)
    ]
    assert error[0] < 0.1 and error[1] < 2e-3
    rows = np.array([design, design._replace(h0=120.0)])
    both = fast_loop.dead_weight_batch(rows, time, current)
    assert np.array_equal(both[1], fast_loop.dead_weight(design._replace(h0=120.0), time, current))
    rows = np.array([pair, pair._replace(h0=120.0)])
    assert np.array_equal(fast_loop.rotary_batch(rows, time, currents)[0], fast_loop.rotary(pair, time, currents))


# Recordings.


def test_quantities_of_the_rig_files_reader():
    assert (quantity("0.15 mm"), quantity("80 uohm cm"), quantity("10e-6 1/K")) == pytest.approx(
        (0.15e-3, 0.8e-6, 10e-6)
    )
    with pytest.raises(ValueError, match="not a quantity"):
        quantity("3 furlongs")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "split"), [*((name, "train") for name in RECIPES), *CYCLES.items()])
def test_shipped_recordings_are_what_their_recipe_makes(name, split):
    columns, exact = make(name, split)
    recipe = RECIPES[name].observed
    shipped = np.loadtxt(FOLDER / name / f"{split}.csv", delimiter=",", skiprows=1)
    # One unit in the last digit: the cosine of the platform may round differently.
    last = max(recipe.grid, 10.0**-recipe.digits)
    assert shipped == pytest.approx(np.column_stack(list(columns.values())), abs=1.01 * last)
    residual = shipped[:, list(columns).index(f"{recipe.name} [{recipe.unit}]")] - exact / recipe.si
    assert np.std(residual) == pytest.approx(math.hypot(recipe.noise, recipe.grid / math.sqrt(12.0)), rel=0.05)
    assert np.ptp(exact / recipe.si) > 100 * recipe.noise


@pytest.mark.slow
@pytest.mark.parametrize("name", RECIPES)
def test_nominal_values_do_not_explain_the_recordings(name):
    for split in splits(name):
        channels = read_csv(FOLDER / name / f"{split}.csv")
        rig, observed = read_rig(FOLDER / name / "rig.toml"), RECIPES[name].observed
        measured = channels[observed.name]
        miss = [
            np.std(read_channel(simulate(r, channels, substeps=5), observed.name) - measured)
            / observed.si
            / observed.noise
            for r in (rig, truth(rig, name))
        ]
        assert miss[0] > 5.0 and miss[1] < 1.1


@pytest.mark.parametrize(("case", "channel"), [("case-01", "displacement"), ("case-08", "angle")])
def test_agrees_in_start_and_sign_with_recordings_made_elsewhere(shared, case, channel):
    """Initial states, signs and stroke of other exact recordings of two kinds of rig agree roughly with nominal values."""
    folder = shared / "blind" / case
    channels = {name: values[:1500] for name, values in read_csv(folder / "train.csv").items()}
    run = simulate(read_rig(folder / "rig.toml"), channels, substeps=8)
    position, measured = read_channel(run, channel), channels[channel]
    assert position[0] == 0.0 and abs(measured[0]) < 0.02 * np.ptp(measured)
    assert np.ptp(position) == pytest.approx(np.ptp(measured), rel=0.1)
    assert np.corrcoef(position, measured)[0, 1] > 0.5


@pytest.mark.slow
def test_a_rig_without_hidden_effects_agrees_with_the_exact_one():
    rig = read_rig(FOLDER / "dead-weight" / "rig.toml")
    channels = read_csv(FOLDER / "dead-weight" / "train.csv")
    time, current = channels["time"][:1500], channels["current"][:1500]
    exact = read_channel(simulate(rig, {"time": time, "current": current}, substeps=20), "displacement")
    np.testing.assert_allclose(displacement(rig, Hidden(), time, current), exact, atol=2e-6)
    for name, size in {
        "friction": 1e7,
        "play": 1e-4,
        "lag": 0.1,
        "latent_heat": 5e7,
        "exponent": 0.1,
        "pace": 0.1,
        "cubic": 0.02,
    }.items():
        assert np.max(np.abs(displacement(rig, Hidden(**{name: size}), time, current) - exact)) > 2e-5, name


@pytest.mark.slow
def test_two_wires_without_hidden_effects_agree_with_the_exact_ones():
    rig = read_rig(FOLDER / "rotary" / "rig.toml")
    channels = read_csv(FOLDER / "rotary" / "train.csv")
    time, current = channels["time"][:1500], np.column_stack([channels["current_1"], channels["current_2"]])[:1500]
    exact = rigs.rotary(rig.material, rig.heat, rig.wire, rig.mechanism["radius"], time, current, substeps=40).position
    coarse, fine = (np.max(np.abs(angle(rig, Hidden(), time, current, substeps) - exact)) for substeps in (20, 80))
    assert coarse < 6e-4 and fine < 0.5 * coarse
    sizes = {
        "friction": 1e7,
        "play": 5e-3,
        "lag": 0.1,
        "latent_heat": 2e7,
        "crosstalk": 0.05,
        "creep": 1e-3,
        "draught": 0.1,
        "cubic": 0.1,
    }
    for name, size in sizes.items():
        moved = [angle(rig, Hidden(**{name: size}), time, current, substeps) for substeps in (20, 40)]
        effect, apart = np.max(np.abs(moved[1] - exact)), np.max(np.abs(moved[1] - moved[0]))
        assert effect > 3e-3 and apart < 0.1 * effect, name
