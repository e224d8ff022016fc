"""Experiments with raw logs of micro-controllers: blocks of rows, forecasts at horizons, and quick runs where ../shared is."""

import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from smajax.recordings.recording import Recording
from tests.conftest import ROOT
from tests.measured.test_measured import run_alone


@pytest.fixture(autouse=True)
def _experiments(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))


def test_a_block_has_the_readings_before_it_and_the_heat_after_it():
    from experiments.common.blocks import block_rows

    duty = np.zeros(12)
    duty[5] = 1.0  # a pulse of one row
    temperature = np.arange(12.0)
    recording = Recording.from_arrays("log", 0.1 * np.arange(12), {"duty": duty, "temperature": temperature})
    blocks = block_rows(recording, 3, ("duty",))
    np.testing.assert_allclose(blocks.time, [0.0, 0.3, 0.6, 0.9, 1.2])
    np.testing.assert_allclose(blocks.channels["duty"], [0.0, 1.0 / 3.0, 0.0, 0.0, 0.0])
    np.testing.assert_allclose(blocks.channels["temperature"], [0.0, 1.0, 4.0, 7.0, 10.0])
    rest = block_rows(recording.slice(0.0, 1.05), 3, ("duty",))  # 11 rows: the last two fill no block
    np.testing.assert_allclose(rest.time, [0.0, 0.3, 0.6, 0.9])


def test_a_block_without_rows_keeps_the_input_and_has_no_reading():
    from experiments.common.blocks import block_rows

    kept = np.array([0, 1, 2, 6, 7, 8])
    channels = {"duty": np.full(6, 0.5), "temperature": np.arange(6.0)}
    blocks = block_rows(Recording.from_arrays("log", 0.1 * kept, channels), 3, ("duty",))
    np.testing.assert_allclose(blocks.channels["duty"], 0.5)
    np.testing.assert_allclose(blocks.channels["temperature"], [0.0, 1.0, np.nan, 4.0])


def test_a_correction_uses_no_reading_after_its_origin():
    from experiments.common.forecasts import Correction

    measured, modelled = np.array([1.0, 2.0, 4.0, 4.0, 9.0]), np.zeros(5)
    latest = Correction(1.0, 0.0, np.inf).forecast(measured, modelled, 2, 1.0)
    np.testing.assert_allclose(latest, [np.nan, np.nan, 1.0, 2.0, 4.0])  # persistence, for a model of zero
    decaying = Correction(1.0, 0.0, 2.0).forecast(measured, modelled, 2, 1.0)
    np.testing.assert_allclose(decaying[2:], np.exp(-1.0) * measured[:3])
    offset = Correction(1.0, 1e9, 1e-3).forecast(measured, modelled, 1, 1.0)
    np.testing.assert_allclose(offset[1:], 1.0, rtol=1e-6)  # the mean that has not yet moved


def test_the_best_correction_is_chosen():
    from experiments.common.forecasts import choose_correction

    random = np.random.default_rng(0)
    modelled = np.sin(np.arange(2000) / 50.0)
    offset = modelled + 3.0 + 0.1 * random.standard_normal(2000)  # a constant error under white noise
    correction = choose_correction([(offset, modelled, slice(200, None))], 5, 1.0)
    assert correction.weight == 0.15 or correction.offset > 0
    assert correction.memory == np.inf or correction.offset > 0
    white = modelled + 0.1 * random.standard_normal(2000)
    chosen = choose_correction([(white, modelled, slice(None))], 20, 1.0)
    assert chosen.memory == 3.0 and chosen.offset == 0.0
    keeping = choose_correction([(white, modelled, slice(None))], 20, 1.0, keeps=True)
    assert keeping.memory == np.inf and keeping.offset == 0.0 and keeping.weight == 0.15


def test_the_last_cycle_is_repeated_from_its_heating_on():
    from experiments.common.forecasts import cycle_starts, last_cycle

    time = np.arange(0.0, 200.0)

    def cycles(*begins):
        duty = np.zeros(200)
        for begin in begins:
            duty[begin : begin + 20] = 0.1
        return duty

    assert cycle_starts(time, np.where(time == 90.0, 0.019, 0.0)).size == 0  # a single corrupt packet
    earlier, later = cycles(30), cycles(50, 120)
    first, second = cycle_starts(time, later)
    assert 45.0 <= first <= 55.0 and 115.0 <= second <= 125.0 and second - first == 70.0
    values = np.arange(200.0) ** 2
    repeated = last_cycle(time, later, values, (time, earlier, 1000.0 + time))
    np.testing.assert_allclose(repeated[60], 1000.0 + 40.0)  # 20 s earlier in the earlier recording
    np.testing.assert_allclose(repeated[130], 60.0**2)  # 70 s earlier in the same one


def test_a_forecast_is_compared_with_the_mean_that_nobody_knows():
    from experiments.common.forecasts import compare, naive_forecasts

    values = np.array([1.0, 2.0, 3.0, 4.0])
    naive = naive_forecasts(values, values[::-1], 1)
    np.testing.assert_allclose(naive["mean so far"], [np.nan, 1.0, 1.5, 2.0])
    np.testing.assert_allclose(naive["persistence"], [np.nan, 1.0, 2.0, 3.0])
    row = compare("a channel", values, values + 0.1, naive, "K")
    assert row.met and row.numbers["the part's own mean"] == pytest.approx(np.std(values))
    row = compare("a channel", values, values + 2.0, naive, "K")
    assert row.met is False and "is as good or better" in row.measured


@pytest.mark.slow
@pytest.mark.parametrize("name", ["measured/guarneros", "measured/dongsus"])
def test_a_missing_log_is_refused(name, tmp_path):
    words = [str(tmp_path / "nowhere.csv")] * (2 if name.endswith("guarneros") else 1)
    result = run_alone(name, *words)
    assert result.returncode == 2 and "nowhere.csv is not a file" in result.stderr


def test_rows_of_a_log_that_the_logger_cut_are_left_out_and_counted(tmp_path, capsys):
    from experiments.measured.guarneros import read_log

    header = ",SMA temperature,Ambiente temperature,Force sensor,Control input,Temperature derivative"
    rows = [f"{k},{25 + k % 7 / 10},24.3,{797 - k % 5},{k % 60},0.0" for k in range(13_000)]
    rows[4000], rows[7000] = rows[4000][:12], rows[7000].replace("24.3", "#$")
    path = tmp_path / "AB7.csv"
    path.write_text("\n".join([header, *rows]) + "\n")
    blocks, _ = read_log(path)
    assert len(blocks) == 13_000 // 53 + 1
    assert (
        "2 of 13000 rows with a blank or unreadable cell dropped on request: row 4002, 7002" in capsys.readouterr().err
    )


def rows_of(name: str, tmp_path: Path, *words: str) -> dict[str, dict]:
    """Return the rows of a quick run by name."""
    target = tmp_path / "rows.json"
    result = run_alone(name, *words, "--quick", "--json", str(target))
    assert result.returncode == 0, result.stderr
    return {row["what"]: row for row in json.loads(target.read_text("utf-8"))["rows"]}


@pytest.mark.slow
def test_a_raw_log_of_a_force_sensor_is_fitted_and_another_is_forecast(shared, tmp_path):
    folder = shared / "data" / "guarneros-sma-force"
    rows = rows_of("measured/guarneros", tmp_path, str(folder / "AB0.csv"), str(folder / "AB1.csv"))
    for channel, horizon in itertools.product(("temperature", "force"), (1, 5, 10, 20)):
        assert rows[f"AB1.csv, held out: {channel}, {horizon} s ahead"]["met"], (channel, horizon)
    simulated = rows["AB1.csv, held out: simulation without readings"]["numbers"]
    assert simulated["temperature"] < simulated["before"]["temperature"]


def test_an_effect_needs_a_fall_of_the_error_with_an_interval():
    from experiments.measured.dongsus import fall, fall_interval

    before = np.array([0.16, 0.09, 0.25, 0.16, 0.12, 0.2, 0.18])  # K^2, mean squared errors of blocks
    low, high = fall_interval(before, 0.25 * before)
    assert low < float(fall(before, 0.25 * before)) < high and low > 0.1
    after = 0.3 * before
    after[3] = 8.0 * before[3]  # one block gets much worse
    low, high = fall_interval(before, after)
    assert low < 0.0 < high


def test_steps_of_a_converter_that_never_occur_are_named():
    from experiments.common.converter import step_row

    values = np.array([20.0, 20.25, 20.25, 21.0, 21.0, 21.0, 21.5, 21.5])
    row = step_row(0.2 * np.arange(8), values, 4, 0.25, "degC")
    assert row.numbers == {"stay_s": pytest.approx(0.6), "absent": [20.5, 20.75, 21.25]}
    assert row.measured == "the reading stays at 21 degC for 0.6 s there; steps that never occur: 20.5, 20.75, 21.25"
    still = step_row(0.2 * np.arange(3), np.full(3, 20.0), 2, 0.25, "degC")
    assert still.numbers["absent"] == [] and "for 0.4 s there; steps that never occur: none" in still.measured


def test_a_log_that_cools_after_its_heating_is_held_out_to_its_end(tmp_path):
    from experiments.measured.dongsus import Forecasts, read_parts

    time = np.arange(0.0, 120.0, 0.1)
    duty = np.where((time >= 10.0) & (time < 70.0), 10, 0)
    heated = np.clip(time - 10.0, 0.0, 60.0)
    temperature = 25.0 + 5.0 * (1.0 - np.exp(-heated / 20.0)) * np.exp(-np.clip(time - 70.0, 0.0, None) / 20.0)
    rows = (f"{t:.2f},{round(4 * c) / 4},{d}" for t, c, d in zip(time, temperature, duty, strict=True))
    (tmp_path / "log.csv").write_text("\n".join(["Time(sec),Temperature(C),PWM(%)", *rows]))
    parts = read_parts(tmp_path / "log.csv")
    assert parts.held[-1] and parts.whole.time[parts.first] == pytest.approx(40.0, abs=0.2)
    assert parts.blocks.max() == 9 and not np.any(parts.held & (parts.blocks >= 0))
    count = int(np.sum(parts.held))
    series = np.arange(count)[:, None] + np.zeros(len(parts.whole))
    ahead = Forecasts(series, ()).ahead(parts, 25)
    np.testing.assert_array_equal(ahead, np.arange(count - 24))  # each by the fit of the rows up to 25 before


@pytest.mark.slow
def test_a_forecast_uses_no_reading_after_its_origin(shared):
    import dataclasses

    from experiments.measured import dongsus

    parts = dongsus.read_parts(shared / "data" / "dongsus-pwm-temperature" / "0331 test1.csv")
    rig = dongsus.parse_rig(dongsus.RIG, "dongsus.toml")
    fitter = dongsus.EffectFitter(rig, {}, dongsus.PRIOR_DEVIATION, [parts.fitted], dongsus.STEP)
    base = fitter.fit(parts.fitted, (), dongsus.STARTS, dongsus.STEPS)[0]
    temperature = parts.whole.channels["temperature"].copy()
    temperature[parts.first + 3 :] += 5.0
    channels = {**parts.whole.channels, "temperature": temperature}
    changed = dataclasses.replace(parts, whole=dataclasses.replace(parts.whole, channels=channels))
    few = np.arange(len(parts.held)) < parts.first + 5
    series = []
    for each in (parts, changed):
        each = dataclasses.replace(each, held=parts.held & few)
        series.append(dongsus.forecast_all(fitter, each, base).series)
    np.testing.assert_array_equal(series[0][:4], series[1][:4])  # from rows before the fourth one
    assert np.abs(series[0][4] - series[1][4]).max() > 0.01


@pytest.mark.slow
def test_a_raw_log_with_repeated_stamps_is_fitted(shared, tmp_path):
    rows = rows_of("measured/dongsus", tmp_path, str(shared / "data" / "dongsus-pwm-temperature" / "0331 test1.csv"))
    assert "983 of 5491 rows in which time does not increase dropped" in rows["rows"]["measured"]
    assert rows["fitted half: simulation without readings"]["numbers"]["after"] < 0.5 * 0.246
    selected = rows["effect 1: error of blocks left out"]
    assert selected["numbers"]["fall"][0] > 0.0 and selected["measured"].endswith("accepted")
    for what in ("the rest, from each row on", "1 s ahead", "5 s ahead", "10 s ahead"):
        assert rows[f"held out: {what}"]["met"], what
    for what in ("the rest, from each row on", "5 s ahead", "10 s ahead"):
        assert rows[f"held out: {what}, naive forecasts"]["met"], what
