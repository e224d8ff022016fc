"""The exact reference against published vectors and figures (rotary paper), and against itself with smaller steps."""

import numpy as np
import pytest

from tests import plants
from tests.reference import rigs
from tests.reference.brinson import Material, brinson_original, forward_from_leg_start, reverse_from_leg_start
from tests.reference.wire import Heat, Wire

PAPER = Material(**{k: plants.ROTARY_PAPER[k] for k in Material._fields})
WIRE = Wire(0.2e-3, 0.5, 0.02, 20.0)
MODES = {"free": (100.614, 0.001), "low": (160.381, 0.041), "high": (377.375, 0.050)}


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


@pytest.mark.parametrize(
    ("start", "stress", "original"),
    [((0.0, 0.0), 50e6, 1.456), ((0.3, 0.0), 60e6, 1.819), ((0.2, 0.3), 40e6, 1.293), ((0.0, 0.5), 78e6, 1.500)],
)
def test_the_uncorrected_law_passes_one_and_the_corrected_does_not(start, stress, original):
    # Printed for the end of cooling, where twinning is complete.
    assert sum(brinson_original(PAPER, PAPER.martensite_finish, stress, *start)) == pytest.approx(original, abs=1e-3)
    assert sum(forward_from_leg_start(PAPER, PAPER.martensite_finish, stress, *start, True)) == pytest.approx(1.0, abs=1e-12)


def test_convection_time_constants_and_steady_temperatures():
    tau = {}
    for mode, (h0, h2) in MODES.items():
        h = h0 + h2 * 80.0**2
        tau[mode] = (h, 2.046e6 * 0.2e-3 / (4 * h))
    assert [tau[m][0] for m in MODES] == pytest.approx([107.0, 422.8, 697.4], abs=0.05)
    assert [tau[m][1] for m in MODES] == pytest.approx([0.956, 0.242, 0.147], abs=1e-3)
    for mode, current, expected in (("free", 0.5, 128.0), ("low", 1.0, 104.0), ("high", 1.5, 122.0), ("high", 2.0, 152.0)):
        h0, h2 = MODES[mode]
        time = np.linspace(0, 12, 241)
        run = rigs.dead_weight(
            PAPER, Heat(h0, 0.0, h2, 2.0, 2.046e6, 2.046e6, 0.0), WIRE, 0.0, time, np.full(241, current), interpolation="hold"
        )
        assert run.temperature[-1, 0] == pytest.approx(expected, abs=0.6)


def test_kinematic_angle_of_two_percent():
    assert np.degrees(0.02 * 0.5 / 0.02) == pytest.approx(28.65, abs=0.01)


@pytest.mark.parametrize(
    ("frequency", "current", "expected", "within"),
    [(0.1, 1.2, 51.7, 0.3), (1.0, 1.0, 51.5, 0.3), (2.0, 1.0, 5.8, 1.0), (5.0, 1.5, 43.1, 1.5)],
)
def test_peak_to_peak_angles_of_the_rotary_rig(frequency, current, expected, within):
    h0, h2 = MODES["high"]
    periods = 2 if frequency < 0.5 else 16
    time = np.arange(round(periods / frequency * 200 * max(frequency, 1.0)) + 1) / (200 * max(frequency, 1.0))
    first = np.where((time * frequency) % 1.0 < 0.5 - 1e-9, current, 0.0)
    run = rigs.rotary(
        PAPER, Heat(h0, 0.0, h2, 2.0, 2.046e6, 2.046e6, 0.0), WIRE, 0.02, time, np.column_stack([first, current - first]), substeps=4
    )
    last = np.degrees(run.position[time > (periods - 1.001) / frequency])
    assert np.ptp(last) == pytest.approx(expected, abs=within)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_dead_weight_is_converged(interpolation):
    recording = plants.inputs("dead_weight", 200, 0.05)
    heat = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)
    material = Material(**{k: plants.MATERIAL[k] for k in Material._fields})
    runs = [
        rigs.dead_weight(material, heat, Wire(0.15e-3, 0.23, 0.0, 20.0), 0.2, recording.time, recording.channels["current"],
                         interpolation=interpolation, substeps=n).position
        for n in (20, 40)
    ]  # fmt: skip
    assert np.max(np.abs(runs[0] - runs[1])) < 1e-7 * np.ptp(runs[1])


def test_rotary_is_converged():
    recording = plants.inputs("light_rotary", 150, 0.05)
    heat = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)
    signal = np.column_stack([recording.channels["current_1"], recording.channels["current_2"]])
    material = Material(**{k: plants.MATERIAL[k] for k in Material._fields})
    runs = [rigs.rotary(material, heat, WIRE, 0.02, recording.time, signal, substeps=n).position for n in (80, 160)]
    assert np.degrees(np.max(np.abs(runs[0] - runs[1]))) < 1e-4


def test_agrees_in_start_and_sign_with_recordings_made_elsewhere(shared):
    """Start states and signs of other exact recordings of the same two kinds of rig, with nominal values: only roughly alike."""
    from smajax.rig import read_rig

    for case, kind in (("case-01", "displacement"), ("case-08", "angle")):
        rig = read_rig(shared / "blind" / case / "rig.toml")
        recording = rig.read(shared / "blind" / case / "train.csv")
        material = Material(**{k: float(getattr(rig.plant.material, k)) for k in Material._fields})
        heat = Heat(100.6, 0.0, 0.001, 2.0, 2.046e6, 2.046e6, 0.0)
        wire = Wire(float(rig.plant.wire.diameter), float(rig.plant.wire.length), float(rig.plant.wire.prestrain), 20.0)
        part = slice(0, 1500)
        if kind == "displacement":
            mass = float(rig.plant.mechanism.load.mass)
            run = rigs.dead_weight(material, heat, wire, mass, recording.time[part], recording.channels["current"][part])
        else:
            signal = np.column_stack([recording.channels["current_1"], recording.channels["current_2"]])[part]
            run = rigs.rotary(material, heat, wire, 0.02, recording.time[part], signal, substeps=8)
        measured = recording.channels[kind][part]
        assert abs(run.position[0] - measured[0]) < 0.02 * np.ptp(measured)
        assert np.corrcoef(run.position, measured)[0, 1] > 0.5
