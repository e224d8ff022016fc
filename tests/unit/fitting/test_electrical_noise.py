"""Noise of a recorded electrical input: its size, whether the wire gets it, and what a fit makes of it."""

import dataclasses
import math

import numpy as np
import pytest

from smajax import parameters
from smajax.errors import InputError
from smajax.files.fit_settings import read_input_noise
from smajax.files.rig_file import parse_rig, read_rig
from smajax.fitting.electrical_noise import NoiseKind, corrected_recordings, find_input_noise, with_share
from smajax.fitting.fit import fit
from smajax.fitting.plateaus import find_plateaus, pooled_noise
from smajax.recordings.recording import Recording
from smajax.report.fit_document import fit_document
from smajax.report.summary import text
from smajax.simulation.run import simulate
from tests.conftest import ROOT

RIG = """
schema = 1
[rig]
kind = "dead-weight"
control = "current"
[material]
set = "rotary-table1"
[heat]
h0 = "105 W/m^2/K"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[load]
mass = "0.2 kg"
[environment]
ambient = "20 degC"
[fit]
free = ["heat.h0", "material.austenite_shift"]
noise = { displacement = "0.02 mm" }
starts = 1
"""
TRUTH = {"heat.h0": 100.0, "material.austenite_shift": 0.0}
TIME = np.arange(400) / 10.0
LEVELS = np.repeat([0.0, 0.3, 0.22, 0.35, 0.0, 0.28, 0.33, 0.1], 50)
NOISE = 0.003


@pytest.fixture(scope="module")
def rig():
    return parse_rig(RIG, "noise.toml")


def recorded(rig, recorded_current, true_current, seed=0):
    """A recording of the truth under one current that has another one in its column."""
    plant = parameters.replace(rig.plant, TRUTH)
    made = Recording.from_arrays("made", TIME, {"current": true_current})
    exact = np.asarray(simulate(plant, made).channels["displacement"])
    noise = 2e-5 * np.random.default_rng(100 + seed).standard_normal(len(TIME))
    columns = {"current": recorded_current, "displacement": exact + noise}
    return Recording.from_arrays("made", TIME, columns, {"current": "mA", "displacement": "mm"})


def scatter(seed):
    return NOISE * np.random.default_rng(seed).standard_normal(len(TIME))


@pytest.fixture(scope="module")
def meter(rig):
    """Recordings with noise of the meter, and their fits with it and without."""
    made = [recorded(rig, LEVELS + scatter(k), LEVELS, k) for k in range(4)]
    fits = [fit(rig.plant, [r], rig.fit) for r in made]
    exact = [fit(rig.plant, [r], dataclasses.replace(rig.fit, input_noise=0.0)) for r in made]
    return made, fits, exact


def test_plateaus_of_a_noisy_command_are_found_and_nothing_else_is_one():
    rng, time = np.random.default_rng(0), np.arange(1500) / 25.0
    levels = np.repeat(rng.uniform(0.2, 0.4, 15), 100)
    for noise in (0.001, 0.003, 0.01):
        found = find_plateaus(levels + noise * rng.standard_normal(1500))
        assert (
            np.all(np.abs(found.means - levels)[found.rows] < 5.0 * noise / math.sqrt(100.0) + 1e-12) or noise > 0.005
        )
        assert pooled_noise([found])[0] == pytest.approx(noise, rel=0.06) and np.mean(found.rows) > 0.95
        for other in (0.2 + 0.1 * np.sin(time), 0.03 * np.abs(time % 20.0 - 10.0), rng.choice([0.0, 0.3], 1500)):
            assert len(find_plateaus(other + noise * rng.standard_normal(1500)).parts) == 0
    assert len(find_plateaus(levels).parts) == 0  # without noise there is nothing to correct


def test_ramps_between_plateaus_hide_none_of_them():
    """The ramps of one half of a recording break into short parts, which have slopes together."""
    random = np.random.default_rng(50)
    ramps = np.interp(np.arange(1500) / 150.0, np.arange(11), random.uniform(0.0, 0.55, 11))
    levels = np.repeat(random.uniform(0.1, 0.55, 10), 150)
    found = find_plateaus(np.concatenate([ramps, levels]) + 1e-3 * random.standard_normal(3000))
    long = [(first, end) for first, end in found.parts.tolist() if end - first > 100]
    assert long == [(1500 + 150 * k, 1650 + 150 * k) for k in range(10)]


def test_noise_on_ramps_between_plateaus_stays():
    values = np.clip(np.abs(np.arange(1500) / 25.0 % 20.0 - 10.0) * 0.1 - 0.2, 0.0, 0.4)
    noisy = values + 0.001 * np.random.default_rng(0).standard_normal(1500)
    found = find_plateaus(noisy)
    assert 0.5 < np.mean(found.rows) < 0.7
    assert np.array_equal(found.means[~found.rows], noisy[~found.rows])
    assert np.std((found.means - values)[found.rows]) < 0.0005  # half the noise


def test_noise_of_a_meter_is_recognised_by_the_fitted_channel(meter):
    _, fits, _ = meter
    for result in fits:
        (noise,) = result.input_noise
        assert noise.kind is NoiseKind.meter and not noise.given
        assert noise.deviation == pytest.approx(NOISE, rel=0.1)
        assert noise.count == 8 and noise.reason.startswith("The fitted displacement follows")


def test_noise_of_a_meter_shifts_no_estimate_beyond_its_interval(meter):
    """As exact, the noisy current puts most truths outside; the corrected fit has them inside, with wider intervals."""
    _, fits, exact = meter

    def outside(results):
        return sum(
            not (e.lower95 is not None and e.upper95 is not None and e.lower95 <= TRUTH[e.name] <= e.upper95)
            for r in results
            for e in r.estimates
        )

    assert outside(exact) >= 4 and outside(fits) <= 1
    widths = [[e.upper95 - e.lower95 for r in results for e in r.estimates] for results in (fits, exact)]
    assert np.all(np.array(widths[0]) > 1.1 * np.array(widths[1])) and sum(widths[0]) > 3.0 * sum(widths[1])
    bias = [np.mean([r.estimates[0].estimate for r in results]) - TRUTH["heat.h0"] for results in (fits, exact)]
    assert abs(bias[0]) < 0.3 * abs(bias[1])
    assert sum(r.cost for r in fits) < 0.3 * sum(r.cost for r in exact)


def test_ripple_that_the_wire_gets_is_kept(rig, meter):
    ripple = LEVELS + scatter(0)
    recording = recorded(rig, ripple, ripple)
    result = fit(rig.plant, [recording], rig.fit)
    exact = fit(rig.plant, [recording], dataclasses.replace(rig.fit, input_noise=0.0))
    assert result.input_noise[0].kind is NoiseKind.ripple
    for estimate, other in zip(result.estimates, exact.estimates, strict=True):
        assert estimate.estimate == pytest.approx(other.estimate, abs=0.05 * (other.upper95 - other.lower95))
        assert estimate.upper95 - estimate.lower95 == pytest.approx(other.upper95 - other.lower95, rel=0.01)


@pytest.mark.parametrize(
    ("given", "kind"), [(NOISE, NoiseKind.meter), (0.6 * NOISE, NoiseKind.both), (0.1 * NOISE, NoiseKind.ripple)]
)
def test_given_noise_of_the_meter_decides_the_rest(rig, meter, given, kind):
    """Scatter beyond the meter's noise is ripple."""
    settings = dataclasses.replace(rig.fit, input_noise=given)
    (noise,) = find_input_noise(rig.plant, meter[0][:1], settings)
    assert noise.kind is kind and noise.given and noise.deviation == given
    (corrected,) = corrected_recordings(meter[0][:1], [noise], training=True)
    left = np.std(corrected.channels["current"] - noise.plateaus[0].means) / np.std(noise.plateaus[0].deviations)
    assert left == pytest.approx({"meter": 0.0, "ripple": 1.0}.get(kind, 0.64), abs=0.1)


@pytest.mark.parametrize("partner", ["voltage", "resistance"])
@pytest.mark.parametrize("follows", [False, True])
def test_voltage_or_resistance_show_whether_the_wire_gets_the_scatter(rig, partner, follows):
    true = LEVELS + scatter(0) if follows else LEVELS
    shown = LEVELS + scatter(0)
    resistance = 3.0 + 0.2 * np.sin(TIME)
    voltage = resistance * true + 0.002 * np.random.default_rng(5).standard_normal(len(TIME))
    values = voltage if partner == "voltage" else voltage / np.where(np.abs(shown) > 0.05, shown, np.inf) + 1e-9
    recording = Recording.from_arrays("made", TIME, {"current": shown, "displacement": 0.0 * TIME, partner: values})
    (noise,) = find_input_noise(rig.plant, [recording], rig.fit)
    assert noise.kind is (NoiseKind.ripple if follows else NoiseKind.meter) and partner in noise.reason


def test_without_plateaus_the_input_stays_and_the_result_says_so(rig, meter):
    ramps = 0.1 + 0.2 * np.abs(np.sin(TIME / 6.0))
    recording = recorded(rig, ramps + 0.001 * np.random.default_rng(0).standard_normal(len(TIME)), ramps)
    result = fit(rig.plant, [recording], rig.fit)
    exact = fit(rig.plant, [recording], dataclasses.replace(rig.fit, input_noise=0.0))
    given = fit(rig.plant, [recording], dataclasses.replace(rig.fit, input_noise=0.001))
    (noise,) = result.input_noise
    assert noise.kind is NoiseKind.no_plateaus and noise.deviation == pytest.approx(0.001, rel=0.2)
    assert 'input_noise = "1 mA"' in noise.sentence() and "as exact" in noise.sentence()
    assert [e.estimate for e in result.estimates] == [e.estimate for e in exact.estimates]
    assert np.array_equal(result.covariance, exact.covariance)
    assert np.all(np.diag(given.covariance) > 1.5 * np.diag(exact.covariance))
    assert "as given" in given.input_noise[0].sentence()


def test_shares_between_none_and_all_are_both_and_wide_ones_undecided(rig, meter):
    noise = find_input_noise(rig.plant, meter[0][:1], rig.fit)[0]
    cases = {(0.0, 0.3): "meter", (0.9, 0.3): "ripple", (0.5, 0.2): "both", (0.4, 0.9): "undecided"}
    for (share, error), kind in {**cases, (-2.0, 0.1): "undecided", (math.nan, math.inf): "undecided"}.items():
        assert with_share(noise, share, error, "It follows").kind == kind


def test_document_and_summary_state_the_noise(rig, meter):
    document = fit_document(meter[1][0], rig, rig.fit)
    (entry,) = document["input_noise"]
    assert (entry["kind"], entry["from"], entry["unit"], entry["plateaus"]) == ("meter", "estimated", "mA", 8)
    assert entry["value"] == pytest.approx(3.0, rel=0.1) and "noise of the meter" in entry["text"]
    assert "noise of the meter" in " ".join(text(document).split())
    assert fit_document(meter[2][0], rig, rig.fit)["input_noise"] == []


def test_input_noise_of_a_rig_file_is_read_and_written(rig):
    for line, value in (('"2 mA"', 0.002), ('"none"', 0.0), ('"estimated"', None)):
        read = parse_rig(RIG + f"input_noise = {line}\n", "noise.toml")
        assert read.fit.input_noise == value
        assert parse_rig(read.to_toml(), "again.toml").fit.input_noise == value
    assert rig.fit.input_noise is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ("1 mV", r"fit.input_noise: .*'1 mV'.*\"1 mA\""),
        ("much", r"fit.input_noise: .*\"none\" or \"estimated\""),
        ("-1 mA", "is not positive"),
        ("0 mA", "is not positive"),
    ],
)
def test_wrong_input_noise_is_refused(rig, given, message):
    with pytest.raises(InputError, match=message):
        parse_rig(RIG + f'input_noise = "{given}"\n', "noise.toml")
    with pytest.raises(InputError, match="fit: input_noise"):
        read_input_noise(given, rig.plant.drive.control, "fit: input_noise")


def test_input_noise_of_a_rig_without_electrical_input_is_refused():
    isobaric = read_rig(ROOT / "data" / "recordings" / "isobaric" / "rig.toml")
    with pytest.raises(InputError, match="has no electrical input"):
        read_input_noise("1 mA", isobaric.plant.drive.control, "fit.input_noise")
    assert find_input_noise(isobaric.plant, [], isobaric.fit) == ()
