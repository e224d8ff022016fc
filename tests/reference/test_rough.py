"""The simulator of rough rigs: smaller steps and cells, balance of energy, an independent solution of one cell, and its sensor."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.reference.hidden import Hidden
from tests.reference.make_data import shipped
from tests.reference.rough import (
    ANGLE_ENCODER,
    ENCODER,
    _constants,
    cell_lengths,
    draw_background,
    jittering_clock,
    read_sensor,
    simulate,
    slow_noise,
    smooth_background,
)
from tests.reference.rough_wire import transform

pytestmark = pytest.mark.slow  # the compiled loop of the rough rigs takes longer to compile than all tests take
WEIGHT = shipped("dead-weight")
SPRING = replace(shipped("bias-spring"), control="current", interpolation="linear")
PULLEY = shipped("rotary")
RIGS = {"weight": WEIGHT, "spring": SPRING, "pulley": PULLEY}
NOTHING = Hidden()
WARM, FULL = 0.24, 0.36  # A: within the transformations of the shipped wire, and above them


def levels(seconds: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and a current between cold, partly and fully transformed."""
    time = jittering_clock(np.random.default_rng(0), seconds)
    marks = seconds * np.array([0.0, 0.08, 0.35, 0.36, 0.5, 0.52, 0.7, 0.72, 1.0])
    return time, np.interp(time, marks, [0.0, FULL, FULL, 0.1, 0.1, 0.3, WARM, 0.1, 0.0])


def pulls(seconds: float = 12.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and currents of two wires of 0.2 mm that take turns."""
    time = jittering_clock(np.random.default_rng(1), seconds)
    first = time % 6.0 < 3.0
    return time, np.column_stack([0.45 * first, 0.42 * ~first])


def inputs(name: str) -> tuple[np.ndarray, np.ndarray]:
    return pulls() if name == "pulley" else levels()


def rough(name: str, seed: int = 0):
    return draw_background(np.random.default_rng(seed), 2 if name == "pulley" else 1)


@pytest.mark.parametrize("name", RIGS)
@pytest.mark.parametrize(
    "hidden", [NOTHING, Hidden(latent_heat=1.5e8), Hidden(friction=4e7)], ids=["nothing", "latent heat", "friction"]
)
def test_smaller_steps_change_less_than_the_noise(name, hidden):
    time, current = inputs(name)
    steps = (None, 10, 40) if hidden.latent_heat else (None, 10, 20)
    usual, fine, finest = (simulate(RIGS[name], rough(name), hidden, time, current, n).position for n in steps)
    noise = (ANGLE_ENCODER if name == "pulley" else ENCODER).noise
    errors = [float(np.sqrt(np.mean((run - finest) ** 2))) for run in (usual, fine)]
    assert errors[0] < 0.5 * noise
    assert errors[1] < 0.75 * errors[0] or hidden.latent_heat
    assert np.max(np.abs(usual - finest)) < 3.0 * noise


def test_without_an_effect_on_heat_or_force_steps_are_of_second_order():
    time, current = levels()
    runs = [simulate(WEIGHT, rough("weight"), NOTHING, time, current, n).temperature for n in (2, 4, 8, 32)]
    errors = [np.sqrt(np.mean((run - runs[-1]) ** 2)) for run in runs[:-1]]
    assert errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1]


@pytest.mark.parametrize("rig", [WEIGHT, SPRING], ids=["weight", "spring"])
def test_smaller_cells_change_less_than_the_noise(rig):
    time, current = levels()
    runs = []
    for cells in (44, 88):
        even = rough("weight")._replace(lengths=cell_lengths(cells), cooling=np.ones((1, cells)))
        runs.append(simulate(rig, even, NOTHING, time, current, 20).position)
    assert np.sqrt(np.mean((runs[0] - runs[1]) ** 2)) < 0.8 * ENCODER.noise


@pytest.mark.parametrize("name", RIGS)
def test_heat_is_neither_lost_nor_made(name):
    time, current = inputs(name)
    rig, background, hidden = RIGS[name], rough(name), Hidden(latent_heat=1.2e8, drift=0.1, crosstalk=0.05)
    run = simulate(rig, background, hidden, time, current)
    kept = run.heated - run.lost - run.clamped
    assert np.max(np.abs(kept - (run.stored - run.stored[0]))) < 1e-3 * run.heated[-1]
    # Convection once more, from the temperatures at the samples; heat that crosses over stays between the wires.
    section = 0.25 * math.pi * rig.wire.diameter**2
    volumes = background.lengths * rig.wire.length * section
    air = rig.wire.ambient + hidden.drift * time[:, None, None]
    h = rig.heat.h0 + rig.heat.h2 * run.temperature**2
    flows = 4.0 / rig.wire.diameter * background.cooling * h * (run.temperature - air)
    if name != "pulley":
        return  # a single wire's crosstalk is with itself, which is tested by the pulley's absence of it
    total = np.trapezoid(np.sum(flows * volumes, axis=(1, 2)), time)
    assert total == pytest.approx(run.lost[-1], rel=2e-3)


def test_a_closed_cycle_gives_off_the_heat_that_it_takes_up():
    time = np.arange(4001) / 50.0
    current = 0.24 + 0.1 * np.sin(2.0 * np.pi * time / 10.0)
    background = rough("weight")._replace(clamp_capacity=0.02)
    for rig in (WEIGHT, SPRING):
        run = simulate(rig, background, Hidden(latent_heat=1.5e8), time, current)
        first, last = -501, -1
        taken = run.heated[last] - run.heated[first]
        given = run.lost[last] - run.lost[first] + run.clamped[last] - run.clamped[first]
        assert np.max(np.ptp(run.martensite[first:, 0], axis=0)) > 0.5
        np.testing.assert_allclose(run.temperature[first], run.temperature[last], atol=0.05)
        assert given == pytest.approx(taken, rel=1e-3)


def test_minor_loops_of_grains_close():
    """What 20 equal loops between two temperatures change at their hot ends, for narrow and wide branches of the grains."""
    background = draw_background(np.random.default_rng(2), spread=(1.0, 1.0))
    totals = []
    for branch in (0.1, 0.6):
        constants = _constants(WEIGHT, background._replace(branch=branch))
        d, w, d1, w1 = np.ones(12), np.zeros(12), np.empty(12), np.empty(12)
        ends = []
        for _ in range(20):
            for start, end in ((57.5, 88.5), (88.5, 57.5)):
                path = np.linspace(start, end, 60)
                for before, after in zip(path[:-1], path[1:], strict=True):
                    xi = transform(constants, d, w, d1, w1, before, 111e6, after, 111e6)[1]
                    d[:], w[:] = d1, w1
                ends.append(xi)
        hot, cold = np.array(ends[::2]), np.array(ends[1::2])
        assert 0.15 < hot[-1] < cold[-1] < 0.95
        creeps = -np.diff(hot)
        assert np.all(creeps[1:] < creeps[:-1]) and 0.0 <= creeps[-1] < 0.01 * creeps[0] + 1e-4
        totals.append(np.sum(creeps))
    assert totals[0] < 0.5 * totals[1]


def one_cell(rig, time, current):
    """Contraction of one wire of one cell and one grain: rates of T, detwinned and twinned by SciPy, the stress from the balance."""
    m, heat, wire, of = rig.material, rig.heat, rig.wire, rig.mechanism
    section, turn = 0.25 * math.pi * wire.diameter**2, 2.0 * math.pi
    widths = [(m.austenite_finish - m.austenite_start) / turn]
    widths += [(m.detwinning_finish_stress - m.detwinning_start_stress) / turn]
    widths += [(m.martensite_start - m.martensite_finish) / turn]
    stiff = of.get("stiffness", 0.0) * wire.length / section
    s0 = (of["mass"] * 9.81 if "mass" in of else of["preload"]) / section
    total = s0 / m.modulus_martensite + m.max_transformation_strain

    def stress(t, d, w):
        e = m.modulus_austenite + (d + w) * (m.modulus_martensite - m.modulus_austenite)
        rest = m.max_transformation_strain * d + m.thermal_expansion_austenite * (t - wire.ambient)
        return (s0 + stiff * (total - rest)) / (1.0 + stiff / e), e, rest

    def occupied(x):
        return 1.0 / (1.0 + math.exp(-min(max(x, -500.0), 500.0)))

    def rates(at, y):
        t, d, w = y
        s, _, _ = stress(t, d, w)
        rho = m.resistivity_austenite + (d + w) * (m.resistivity_martensite - m.resistivity_austenite)
        lost = 4.0 / wire.diameter * (heat.h0 + heat.h2 * t * t) * (t - wire.ambient)
        warming = (rho * (np.interp(at, time, current) / section) ** 2 - lost) / heat.capacity_austenite
        small = 1e-6
        by_t, by_d, by_w = ((stress(*(v + small * (k == j) for k, v in enumerate(y)))[0] - s) / small for j in range(3))
        up = (
            occupied(
                (t - s / m.clausius_clapeyron_austenite - 0.5 * (m.austenite_start + m.austenite_finish)) / widths[0]
            )
            / widths[0]
        )
        shift = m.clausius_clapeyron_martensite if t > m.martensite_start else 0.0
        middle = 0.5 * (m.detwinning_start_stress + m.detwinning_finish_stress)
        down = occupied((s - shift * max(t - m.martensite_start, 0.0) - middle) / widths[1]) / widths[1]
        cold = occupied((0.5 * (m.martensite_start + m.martensite_finish) - t) / widths[2]) / widths[2]

        def moves(stressing):
            a, b = warming - stressing / m.clausius_clapeyron_austenite, stressing - shift * warming
            reverse, forward, twin = up * max(a, 0.0), down * max(b, 0.0), cold * max(-warming, 0.0)
            return -d * reverse + (1.0 - d) * forward, -w * (reverse + forward) + (1.0 - d - w) * twin

        # The rate of the stress is that which the rates of the fractions give: bisected, as their sum falls with it.
        low, high = -1e9, 1e9
        for _ in range(60 if stiff else 0):
            mid = 0.5 * (low + high)
            dd, dw = moves(mid)
            low, high = (mid, high) if by_t * warming + by_d * dd + by_w * dw > mid else (low, mid)
        dd, dw = moves(0.5 * (low + high) if stiff else 0.0)
        return [warming, dd, dw]

    solved = solve_ivp(
        rates, (0.0, time[-1]), [wire.ambient, 1.0, 0.0], t_eval=time, max_step=0.02, rtol=1e-7, atol=1e-9
    )
    strains = []
    for y in solved.y.T:
        s, e, rest = stress(*y)
        strains.append(s / e + rest)
    return wire.length * (total - np.array(strains))


@pytest.mark.parametrize("rig", [WEIGHT, SPRING], ids=["weight", "spring"])
def test_one_cell_of_one_grain_agrees_with_an_independent_solution(rig):
    time, current = np.arange(601) / 50.0, None
    current = np.interp(time, [0.0, 2.0, 4.0, 6.5, 8.0, 9.5, 12.0], [0.0, FULL, 0.34, 0.1, 0.3, 0.1, 0.0])
    expected = one_cell(rig, time, current)
    run = simulate(rig, smooth_background(), NOTHING, time, current, 20)
    assert np.ptp(expected) > 5e-3
    np.testing.assert_allclose(run.position, expected, atol=2e-6)


def test_equal_cells_and_grains_are_one():
    time, current = levels()
    one, many = (
        simulate(SPRING, smooth_background(1, n, g), NOTHING, time, current).position for n, g in ((1, 1), (44, 12))
    )
    np.testing.assert_allclose(many, one, atol=1e-9)


def test_a_wire_is_colder_and_more_martensitic_at_its_clamps():
    time, current = np.arange(501) / 50.0, np.full(501, FULL)
    run = simulate(WEIGHT, rough("weight"), NOTHING, time, current)
    middle, ends = run.temperature[-1, 0, 22], run.temperature[-1, 0, [0, -1]]
    assert np.all(ends < middle - 20.0)
    assert np.all(run.martensite[-1, 0, [0, -1]] > 0.5) and run.martensite[-1, 0, 22] < 0.01
    free = simulate(WEIGHT, rough("weight")._replace(contact=0.0), NOTHING, time, current)
    assert free.position[-1] > run.position[-1] + 1e-4


def test_two_wires_are_in_balance():
    time, current = pulls()
    background = rough("pulley")
    run = simulate(PULLEY, background, NOTHING, time, current)
    np.testing.assert_array_equal(run.stress[:, 0], run.stress[:, 1])
    assert np.ptp(run.position) > math.radians(20.0) and run.stress.max() > 1e7
    same = background._replace(cooling=background.cooling[[0, 0]])
    ahead = simulate(PULLEY, same, NOTHING, time, current).position
    mirrored = simulate(PULLEY, same, NOTHING, time, current[:, ::-1]).position
    np.testing.assert_allclose(mirrored, -ahead, atol=1e-6)


def test_friction_holds_the_stress_between_its_limits():
    time, current = levels()
    run = simulate(WEIGHT, rough("weight"), Hidden(friction=3e7), time, current)
    load = WEIGHT.mechanism["mass"] * 9.81 / (0.25 * math.pi * WEIGHT.wire.diameter**2)
    steps = np.diff(run.position)
    for sign in (1.0, -1.0):  # between two samples of motion
        moves = np.flatnonzero((sign * steps[:-1] > 1e-6) & (sign * steps[1:] > 1e-6)) + 1
        assert len(moves) > 25
        np.testing.assert_allclose(run.stress[moves, 0], load + sign * 3e7)
    assert np.all(np.abs(run.stress[:, 0] - load) <= 3e7 + 1.0)
    assert np.count_nonzero(np.diff(run.position) == 0.0) > 50


def test_effects_on_the_motion_and_on_the_driver():
    time, current = levels()
    background = rough("weight")
    plain = simulate(WEIGHT, background, NOTHING, time, current)
    drifting = simulate(WEIGHT, background, Hidden(encoder_drift=1e-5), time, current)
    np.testing.assert_allclose(drifting.reading - plain.reading, 1e-5 * time, atol=1e-12)
    assert np.max(
        plain.reading - simulate(WEIGHT, background, Hidden(play=2e-4), time, current).reading
    ) == pytest.approx(4e-4, rel=0.01)
    limited = simulate(WEIGHT, background, Hidden(saturation=0.1), time, current)
    assert limited.heated[-1] < 0.95 * plain.heated[-1]
    heavier = simulate(WEIGHT, background, Hidden(arm=0.3), time, current)
    slope = np.polyfit(heavier.position, heavier.stress[:, 0], 1)[0]
    assert slope == pytest.approx(0.3 * heavier.stress[0, 0] / (0.04 * WEIGHT.wire.length), rel=1e-3)


def test_what_a_rough_rig_does_not_know_is_refused():
    time, current = levels(1.0)
    with pytest.raises(ValueError, match="creep"):
        simulate(WEIGHT, smooth_background(), Hidden(creep=0.01), time, current)
    with pytest.raises(ValueError, match="voltage"):
        simulate(shipped("bias-spring"), smooth_background(), NOTHING, time, current)
    with pytest.raises(ValueError, match="capacity"):
        simulate(
            replace(WEIGHT, heat=WEIGHT.heat._replace(capacity_martensite=1e6)),
            smooth_background(),
            NOTHING,
            time,
            current,
        )


def test_a_seed_gives_the_same_rig_and_recording():
    runs = []
    for seed in (3, 3, 4):
        rng = np.random.default_rng(seed)
        time = jittering_clock(rng, 5.0)
        background = draw_background(rng)
        run = simulate(WEIGHT, background, NOTHING, time, np.full(len(time), 0.3))
        runs.append((background, read_sensor(rng, ENCODER, time, run.reading)))
    assert all(np.array_equal(a, b) for a, b in zip(runs[0][0], runs[1][0], strict=True))
    np.testing.assert_array_equal(runs[0][1], runs[1][1])
    assert not np.array_equal(runs[0][0].austenite, runs[2][0].austenite)
    assert not np.array_equal(runs[0][1], runs[2][1])


def test_a_background_is_what_it_says():
    background = draw_background(np.random.default_rng(5), 2)
    assert len(background.lengths) == 44 and np.sum(background.lengths) == pytest.approx(1.0)
    assert background.lengths[0] < 0.15 / 44 and background.lengths[22] > 1.5 / 44
    assert background.cooling.shape == (2, 44) and background.austenite.shape == background.martensite.shape == (12,)
    np.testing.assert_allclose(background.cooling @ background.lengths, 1.0)
    assert 0.003 < np.std(background.cooling) < 0.04
    assert not np.array_equal(background.austenite, background.martensite)


def test_the_sensor_has_a_quantum_white_and_slow_noise_and_its_clock_jitters():
    rng = np.random.default_rng(6)
    time = jittering_clock(rng, 2000.0)
    gaps = np.diff(time)
    assert gaps.min() > 0.0 and 1e-3 < gaps.std() < 2e-3
    shown = read_sensor(rng, ENCODER, time, np.zeros(len(time)))
    np.testing.assert_allclose(shown / 1e-5, np.round(shown / 1e-5), atol=1e-9)
    assert shown.std() == pytest.approx(ENCODER.noise, rel=0.03)
    slow = slow_noise(rng, time, 1.0)
    assert slow.std() == pytest.approx(1.0, rel=0.06)
    assert np.corrcoef(slow[:-20], slow[20:])[0, 1] == pytest.approx(math.exp(-1.0), abs=0.06)
