"""ASTM E3097 properties of thermal cycles: made ones with known corners, measured ones, and files that have none."""

import json
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import openpyxl
import pytest
import scipy.io
from scipy.signal import lfilter
from scipy.stats import binom
from typer.testing import CliRunner

from smajax.api.properties import START_VALUES, PropertiesStudy, thermal_cycle_properties
from smajax.app.cli import app
from smajax.errors import InputError
from smajax.files.parameter_sets import read_parameters
from smajax.files.rig_file import parse_rig, read_rig
from smajax.fitting.fit import fit
from smajax.plant.materials.registry import MATERIALS
from smajax.properties.cycle_rows import turning_points
from smajax.properties.recording_analysis import analyse_recordings
from smajax.properties.refused_cycles import merge_refusals
from smajax.properties.row_order import check_outliers, check_row_order
from smajax.properties.start_values import make_start_values
from smajax.properties.stress_levels import count_stresses
from smajax.properties.thermal_cycles import (
    PROPERTY_NAMES,
    TEMPERATURE_NAMES,
    Cycle,
    Value,
    analyse_cycles,
    mean_properties,
)
from smajax.recordings.read import read_recording
from tests.reference import brinson as brinson_reference
from tests.reference import lagoudas as lagoudas_reference
from tests.support import plants
from tests.unit.plant.test_lagoudas import VALUES as LAGOUDAS

TRUE = {"martensite_start": 70.0, "martensite_finish": 40.0, "austenite_start": 85.0, "austenite_finish": 110.0}


def strain_of(t: np.ndarray, low: float, high: float) -> np.ndarray:
    """Three straight lines: 3.5 % cold, 0.5 % hot, with slopes of the plateaus."""
    return 0.035 - 0.03 * np.clip((t - low) / (high - low), 0.0, 1.0) - 1e-5 * (t - 20.0)


def made(
    count: int = 3, noise: float = 1e-5, warm_noise: float = 0.0, seed: int = 0, rows: int = 160
) -> tuple[np.ndarray, np.ndarray]:
    """Cycles from hot to cold and back."""
    rng = np.random.default_rng(seed)
    cool, heat = np.linspace(150.0, 15.0, rows), np.linspace(15.0, 150.0, rows)
    strain = np.tile(np.r_[strain_of(cool, 40.0, 70.0), strain_of(heat, 85.0, 110.0)], count)
    temperature = np.tile(np.r_[cool, heat], count)
    return temperature + warm_noise * rng.standard_normal(len(temperature)), strain + noise * rng.standard_normal(
        len(strain)
    )


def write(path, temperature, strain, stress: float | None = None):
    columns, head = [temperature, 100 * strain], ["temperature [degC]", "strain [%]"]
    if stress is not None:
        columns, head = [*columns, np.full(len(strain), stress)], [*head, "stress [MPa]"]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=",".join(head), comments="", fmt="%.9g")
    return path


def test_corners_are_found():
    cycles, refused = analyse_cycles("made", *made())
    assert len(cycles) == 3 and not refused
    for cycle in cycles:
        for name, true in TRUE.items():
            assert cycle.values[name].value == pytest.approx(true, abs=0.2)
        assert cycle.values["transformation_strain"].value == pytest.approx(0.03 + 1e-5 * 25, abs=5e-5)
        assert cycle.values["actuation_strain"].value == pytest.approx(0.03 + 1e-5 * 135, abs=1e-4)
        assert cycle.values["span"].value == pytest.approx(70.0, abs=0.3)
        assert cycle.values["width"].value == pytest.approx(42.5, abs=0.3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "rows", "strain_noise", "warm_noise", "times"),
    [(1, 80, 4e-4, 0.0, 30), (1, 160, 1e-5, 3.0, 20), (2, 80, 4e-4, 0.0, 12), (3, 160, 1e-5, 3.0, 6), (8, 40, 4e-4, 0.0, 4), (1, 16, 1e-4, 0.0, 40)],
)  # fmt: skip
def test_intervals_hold_the_truth(count, rows, strain_noise, warm_noise, times):
    """So often that 95 % is credible: at 95 %, 0.1 % of such tests would hold fewer."""
    truth = TRUE | {
        "transformation_strain": 0.03 + 1e-5 * 25,
        "actuation_strain": 0.03 + 1e-5 * 135,
        "width": 42.5,
        "span": 70.0,
    }
    covered = {name: 0 for name in truth}
    for seed in range(times):
        temperature, strain = made(count, noise=strain_noise, warm_noise=warm_noise, seed=seed, rows=rows)
        cycles, refused = analyse_cycles("made", temperature, strain, smooth=9 if warm_noise else 1, seed=seed)
        assert not refused
        means = mean_properties(cycles)
        for name, true in truth.items():
            covered[name] += means[name].lower95 <= true <= means[name].upper95
    # Eight properties are looked at.
    assert min(covered.values()) >= binom.ppf(1e-3 / len(covered), times, 0.95), covered
    assert np.mean(list(covered.values())) >= 0.9 * times, covered


@pytest.mark.slow
@pytest.mark.parametrize(("warm_noise", "slow", "share"), [(0.4, 0.0, 0.9), (0.0, 0.9, 0.88)])
def test_intervals_know_noise_that_is_not_smoothed_and_noise_that_is_slow(warm_noise, slow, share):
    """Noise in the temperatures shows on the transformation only; neighbours that err together tell less than their number."""
    covered, times = [], 40
    for seed in range(times):
        temperature, strain = made(1, noise=0.0, warm_noise=warm_noise, seed=seed, rows=300)
        scatter = np.random.default_rng(seed + 100).standard_normal(len(strain))
        strain += lfilter([2e-4 * np.sqrt(1.0 - slow**2)], [1.0, -slow], scatter)
        (cycle,), _ = analyse_cycles("made", temperature, strain, seed=seed)
        covered.append([cycle.values[n].lower95 <= true <= cycle.values[n].upper95 for n, true in TRUE.items()])
    assert np.mean(covered) >= share, np.mean(covered, axis=0)


def rounded(noise: float, seed: int = 0, rows: int = 161, cosine: bool = True) -> tuple[np.ndarray, np.ndarray]:
    """A cycle that cools from 60 to 40 degC and heats from 70 to 90 degC through its transformation, by a cosine or a straight line."""
    cool = np.linspace(130.0, 10.0, rows)
    shares = [np.clip((finish - cool) / 20.0, 0.0, 1.0) for finish in (60.0, 90.0)]
    shares = [0.5 - 0.5 * np.cos(np.pi * share) for share in shares] if cosine else shares
    temperature = np.r_[cool, cool[::-1]]
    return temperature, 0.03 * np.r_[shares[0], shares[1][::-1]] + noise * np.random.default_rng(seed).standard_normal(
        2 * rows
    )


# Where a cosine's steepest tangent meets the plateaus: a cosine over 20 K is as steep as a line over 40 / pi.
STEEPEST = dict(
    zip(
        TEMPERATURE_NAMES,
        (50.0 + 20.0 / np.pi, 50.0 - 20.0 / np.pi, 80.0 - 20.0 / np.pi, 80.0 + 20.0 / np.pi),
        strict=True,
    )
)
STRAIGHT = dict(zip(TEMPERATURE_NAMES, (60.0, 40.0, 70.0, 90.0), strict=True))


@pytest.mark.parametrize("rows", [81, 121, 600])
@pytest.mark.parametrize("tilt", [1.0, -1.0])
def test_the_steepest_tangent_of_exact_kinetics(rows, tilt):
    """In tension and compression; of straight transformations it is the line of three."""
    for cosine, truth in ((True, STEEPEST), (False, STRAIGHT)):
        t, e = rounded(1e-8, rows=rows, cosine=cosine)
        (cycle,), refused = analyse_cycles("exact", t, tilt * e, tangent="steepest")
        assert not refused
        for name, true in truth.items():
            assert cycle.values[name].value == pytest.approx(true, abs=0.05 if cosine else 0.001), name
        (lines,), _ = analyse_cycles("exact", t, tilt * e)
        apart = [abs(lines.values[n].value - cycle.values[n].value) for n in TEMPERATURE_NAMES]
        assert min(apart) > 0.5 if cosine else max(apart) < 0.001
        assert cycle.values["transformation_strain"].value == pytest.approx(0.03 * tilt, abs=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("cosine", "noise", "rows"), [(True, 2e-4, 161), (True, 4e-4, 81), (False, 2e-4, 161)])
def test_intervals_hold_the_steepest_tangent(cosine, noise, rows):
    """As often as of the three lines, see above; they are a few times the scatter of what they tell of, no more."""
    truth = (STEEPEST if cosine else STRAIGHT) | {"width": 30.0}
    covered, away, half, times = {n: 0 for n in truth}, [], [], 30
    for seed in range(times):
        (cycle,), _ = analyse_cycles("made", *rounded(noise, seed, rows, cosine), seed=seed, tangent="steepest")
        for name, true in truth.items():
            covered[name] += cycle.values[name].lower95 <= true <= cycle.values[name].upper95
        away.append([cycle.values[n].value - truth[n] for n in TEMPERATURE_NAMES])
        half.append([cycle.values[n].upper95 - cycle.values[n].value for n in TEMPERATURE_NAMES])
    assert min(covered.values()) >= binom.ppf(1e-3 / len(covered), times, 0.95), covered
    assert np.mean(half) < 4.0 * np.sqrt(np.mean(np.square(away)))


def test_the_steepest_tangent_of_noisy_temperatures():
    cycles = []
    for seed in range(8):
        t, e = rounded(1e-5, seed)
        warm = t + 2.0 * np.random.default_rng(seed + 50).standard_normal(len(t))
        cycles += analyse_cycles("noisy", warm, e, smooth=9, seed=seed, tangent="steepest")[0]
    means = mean_properties(cycles)
    for name, true in STEEPEST.items():
        assert len(cycles) == 8 and means[name].value == pytest.approx(true, abs=2.0), name


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "warm_noise", "smooth"), [(30_001, 0.0, 1), (30_001, 0.4, 1), (30_001, 1.0, 99)])
def test_a_branch_of_very_many_rows_is_read_by_their_means(rows, warm_noise, smooth):
    """Its sharpness is that of all rows: a 95 % interval of 160 rows as noisy is ten times as wide."""
    truth, covered = TRUE | {"width": 42.5, "span": 70.0}, []
    for seed in range(4):
        (cycle,), refused = analyse_cycles(
            "long", *made(1, noise=4e-4, warm_noise=warm_noise, seed=seed, rows=rows), smooth=smooth, seed=seed
        )
        assert not refused
        covered += [cycle.values[n].lower95 <= true <= cycle.values[n].upper95 for n, true in truth.items()]
        assert all(
            abs(cycle.values[n].value - true) < 0.1 and cycle.values[n].upper95 - cycle.values[n].lower95 < 0.3
            for n, true in truth.items()
        )
    assert np.mean(covered) >= 0.8


def test_too_few_rows_to_say_where_it_is_steepest(tmp_path):
    path = write(tmp_path / "few.csv", *rounded(1e-6, rows=31), 50.0)
    assert CliRunner().invoke(app, ["properties", str(path)]).exit_code == 0
    done = CliRunner().invoke(app, ["properties", str(path), "--tangent", "steepest"])
    assert (
        done.exit_code == 2
        and "on cooling 3 rows lie on the transformation's middle part, fewer than the 6" in done.output
    )
    assert "--tangent lines" in done.output


def test_the_command_says_by_which_tangent(tmp_path):
    path = write(tmp_path / "a.csv", *rounded(1e-6), 50.0)
    starts = {}
    for tangent, definition in (
        ("lines", "the intersections of three straight lines, fitted by least squares"),
        ("steepest", "the tangent at the steepest point of the transformation with"),
    ):
        options = ["properties", str(path), "--tangent", tangent]
        assert definition in CliRunner().invoke(app, options).output
        document = json.loads(CliRunner().invoke(app, [*options, "--json"]).stdout)
        assert document["tangent"] == tangent and definition in document["definition"]
        starts[tangent] = document["recordings"][0]["mean"]["martensite_start"]
    assert "--tangent steepest" in CliRunner().invoke(app, ["properties", str(path)]).output
    assert starts["steepest"]["value"] < starts["lines"]["value"] - 0.5
    assert starts["steepest"]["value"] == pytest.approx(STEEPEST["martensite_start"], abs=0.05)


def test_the_interval_of_a_mean_knows_how_few_its_cycles_are():
    """Values of cycles that scatter among themselves, each thought exact, and some that agree by chance, each uncertain."""
    rng, covered = np.random.default_rng(0), 0
    for _ in range(400):
        exact = [Cycle(k, (0, 1), {"span": Value(v, v, v)}) for k, v in enumerate(rng.standard_normal(2))]
        covered += (
            abs(mean_properties(exact)["span"].value)
            <= mean_properties(exact)["span"].upper95 - mean_properties(exact)["span"].value
        )
    assert binom.ppf(1e-3, 400, 0.95) <= covered <= binom.ppf(1 - 1e-3, 400, 0.95)
    alike = mean_properties([Cycle(k, (0, 1), {"span": Value(1.0, 0.0, 2.0)}) for k in range(4)])["span"]
    assert alike.upper95 - alike.value == pytest.approx(0.5)


@pytest.mark.parametrize("rows", [12, 13, 16, 20, 24, 30])
def test_short_clean_cycles_are_read(rows):
    cycles, refused = analyse_cycles("short", *made(2, noise=1e-6, rows=rows))
    assert len(cycles) == 2 and not refused
    for name, true in TRUE.items():
        assert mean_properties(cycles)[name].value == pytest.approx(true, abs=0.1)


def write_start_values(paths: list[Path], target: Path, model: str = "brinson") -> PropertiesStudy:
    """Analyse recordings, and write the parameter set with the start values."""
    study = thermal_cycle_properties(paths, model=model)
    target.write_text(study.file_text(START_VALUES), "utf-8")
    return study


def test_few_rows_are_not_taken_for_noisy_ones(tmp_path):
    document = thermal_cycle_properties(write(tmp_path / "few.csv", *made(2, noise=1e-6, rows=16))).document
    assert document["recordings"][0]["smoothed_rows"] == 1 and len(document["recordings"][0]["cycles"]) == 2


@pytest.mark.parametrize("within", [10, 32])
def test_rows_shuffled_within_blocks_are_refused(within):
    temperature, strain = made()
    order = np.concatenate(
        [np.random.default_rng(0).permutation(block) for block in np.array_split(np.arange(960), 960 // within)]
    )
    with pytest.raises(InputError, match=r"row \d+ of the data deviates .* not in the order"):
        analyse_cycles("shuffled", temperature[order], strain[order])


@pytest.mark.parametrize("share", [0.02, 0.1, 0.2])
def test_a_few_shuffled_rows_are_refused(share):
    (temperature, strain), rng = made(), np.random.default_rng(0)
    rows, order = rng.choice(960, int(share * 960), replace=False), np.arange(960)
    order[np.sort(rows)] = rows
    with pytest.raises(InputError, match=r"row \d+ of the data: the temperature jumps by \d+ K .* not in the order"):
        analyse_cycles("shuffled", temperature[order], strain[order])


@pytest.mark.parametrize(("noise", "warm_noise"), [(1e-3, 0.0), (1e-5, 5.0), (1e-3, 5.0), (0.0, 0.0)])
def test_noise_is_not_taken_for_disorder(noise, warm_noise):
    for seed in range(10):
        check_row_order("ordered", *made(noise=noise, warm_noise=warm_noise, seed=seed))


def test_noise_alone_has_no_slip_of_a_reading():
    """Strains that only scatter: of some, single ones lie far off the median of their neighbours. A slip among them is found."""
    for seed in range(40):
        noise = np.random.default_rng(seed).standard_normal(40)
        check_outliers("noise", "a strain of", 0.01 + 1e-4 * noise)
        with pytest.raises(InputError, match="row 21 of the data: a strain of 0.02 is an outlier"):
            check_outliers("slip", "a strain of", np.where(np.arange(40) == 20, 0.02, 0.01 + 1e-4 * noise))


def test_a_noisy_thermocouple_is_smoothed():
    temperature, strain = made(8, warm_noise=4.0)
    means = mean_properties(analyse_cycles("noisy", temperature, strain, smooth=9)[0])
    for name, true in TRUE.items():
        assert means[name].value == pytest.approx(true, abs=3.0)


def test_turns_are_found_in_noise():
    temperature, _ = made(4, warm_noise=3.0)
    at = turning_points(temperature)
    assert len(at) == 9 and all(abs(a - b) < 8 for a, b in zip(at, range(0, 1281, 160), strict=True))


def _turned(first: int, last: int, count: int) -> np.ndarray:
    """Rows of which a block of the first cooling runs backwards, in every cycle."""
    rows = np.arange(count)
    for start in range(0, count, 320):
        rows[start + first : start + last] = rows[start + first : start + last][::-1]
    return rows


def _in_two_steps(*_):
    """A wire that cools by an R-phase, far before the rest."""
    cold = np.linspace(170.0, -20.0, 250)

    def share(finish, start, at):
        return 0.5 + 0.5 * np.cos(np.pi * np.clip((at - finish) / (start - finish), 0.0, 1.0))

    cooled = 0.02 * share(10.0, 25.0, cold) + 0.008 * share(60.0, 72.0, cold)
    return np.r_[cold, cold[::-1]], np.r_[cooled, 0.028 * share(92.0, 115.0, cold[::-1])]


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (lambda t, e: (np.random.default_rng(0).permutation(t), e), "not in the order in which they were recorded"),
        (lambda t, e: (np.full_like(t, 20.0), e), "heat and cool through the transformation"),
        (lambda t, e: (t[:100], e[:100]), "it has no complete cycle"),
        (
            lambda t, e: (t, 2e-3 * np.random.default_rng(1).standard_normal(len(e)) - 1e-5 * t),
            "no transformation is seen",
        ),
        (lambda t, e: (t, -1e-5 * t), "no transformation is seen"),
        (lambda t, e: (t[(t > 45.0)], e[(t > 45.0)]), "cool further"),
        (lambda t, e: (t[(t > 62.0)], e[(t > 62.0)]), "its end was not reached"),
        (lambda t, e: (t[::-1], e[::-1]), "the rows run backwards"),
        (lambda t, e: (t[_turned(40, 80, len(t))], e[_turned(40, 80, len(t))]), "rows 42 to 80 go back by"),
        (
            lambda t, e: (t, np.where(np.arange(len(e)) == 400, 0.5, e)),
            "row 401 of the data: a strain of 0.5 is an outlier among rows of about 0.0",
        ),
        (_in_two_steps, "bends where three straight lines do not, as in a transformation in two steps"),
        (
            lambda t, e: (np.where(np.arange(len(t)) == 50, t + 90.0, t), e),
            "row 51 of the data: a temperature (degC) of",
        ),
    ],
)
def test_what_cannot_be_read_is_said(change, sentence):
    temperature, strain = change(*made())
    try:
        cycles, refused = analyse_cycles("bad.csv", temperature, strain)
    except InputError as error:
        cycles, refused = [], [error]
    assert not cycles and sentence in str(refused[0]) and str(refused[0]).startswith("bad.csv")


def _little(strain: float, sign: float = 1.0, coldest: float = 10.0) -> tuple[np.ndarray, np.ndarray]:
    """A cycle with little transformation strain, in tension or compression (``sign``), in addition to an expansion of 1.1e-5/K."""
    cool = np.linspace(130.0, coldest, 241)
    share = [1.0 - np.clip((cool - 40.0) / 20.0, 0.0, 1.0), 1.0 - np.clip((cool - 70.0) / 20.0, 0.0, 1.0)]
    temperature = np.r_[cool, cool[::-1]]
    noise = 1e-7 * np.random.default_rng(0).standard_normal(len(temperature))
    return temperature, sign * strain * np.r_[share[0], share[1][::-1]] + 1.1e-5 * (temperature - 20.0) + noise


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("strain", [2e-4, 3e-4, 4.4e-4, 6e-4])
def test_expansion_is_not_taken_for_an_end_that_was_not_reached(strain, sign):
    """A specimen under 7 MPa: its plateaus are as steep as its transformation, but the strain bends where this begins and ends."""
    (cycle,), refused = analyse_cycles("7 MPa", *_little(strain, sign))
    assert not refused
    for name, true in zip(TEMPERATURE_NAMES, (60.0, 40.0, 70.0, 90.0), strict=True):
        value = cycle.values[name]
        assert (
            value.value == pytest.approx(true, abs=0.2)
            and value.lower95 < value.value < value.upper95 < value.lower95 + 0.5
        )
    assert cycle.values["transformation_strain"].value == pytest.approx(sign * strain - 20.0 * 1.1e-5, abs=1e-6)
    assert not analyse_cycles("7 MPa", *_little(strain, sign, coldest=45.0))[0]


@pytest.mark.slow
@pytest.mark.parametrize("law", MATERIALS)
def test_the_command(tmp_path, law):
    paths = [
        write(tmp_path / f"{s}.csv", t + s / 7.0, e, float(s)) for s, (t, e) in ((s, made(2)) for s in (50, 150, 300))
    ]
    done = CliRunner().invoke(
        app, ["properties", *map(str, paths), "--write-set", str(tmp_path / "set.toml"), "--model", law]
    )
    assert done.exit_code == 0 and "M_s" in done.output and "150.csv: 2 cycles at 150 MPa" in done.output
    rig = tmp_path / "rig.toml"
    rig.write_text(
        f'[rig]\nkind = "path"\n[material]\nset = "set.toml"\n[fit]\nmodel = "{law}"\nfree = []\nobserve = ["strain"]\n'
    )
    material = read_rig(rig).plant.material
    assert type(material) is MATERIALS[law] and float(material.modulus_austenite) == 67e9
    assert "Brinson (1993)" in read_parameters(tmp_path / "set.toml")["material.modulus_martensite"].source
    assert float(material.martensite_start) == pytest.approx(70.0, abs=0.5)
    assert float(material.clausius_clapeyron_martensite) == pytest.approx(7e6, rel=0.02)
    document = json.loads(CliRunner().invoke(app, ["properties", str(paths[0]), "--json"]).stdout)
    assert document["schema"] == "smajax.properties/1" and len(document["recordings"][0]["cycles"]) == 2


def test_one_that_cannot_be_read_leaves_the_others(tmp_path):
    good, flat = write(tmp_path / "good.csv", *made(1)), write(tmp_path / "flat.csv", made(1)[0], -1e-5 * made(1)[0])
    done = CliRunner().invoke(app, ["properties", str(good), str(flat)])
    assert done.exit_code == 0 and "Not read: flat.csv" in done.output and "nan" not in done.output.lower()
    alone = CliRunner().invoke(app, ["properties", str(flat)])
    assert alone.exit_code == 2 and "flat.csv" in alone.output
    lacking = CliRunner().invoke(app, ["properties", str(good), "--write-set", str(tmp_path / "set.toml")])
    assert lacking.exit_code == 2 and "has no column stress" in lacking.output and not (tmp_path / "set.toml").exists()


def test_what_is_said_of_many_cycles_is_said_once(tmp_path):
    t, e = made(20)
    hidden = e.reshape(20, -1).copy()
    hidden[[0, 1, 2, 5, 7, 9, 11, 13, 15, 17]] = 0.0052 - 1e-5 * t.reshape(20, -1)[0]
    path = write(tmp_path / "some.csv", t, hidden.ravel())
    output = CliRunner().invoke(app, ["properties", str(path)]).output
    # From the sixth on a cycle begins with a row of one that transforms, which changes what is wrong with it.
    assert output.count("Not read") == 2 and output.count("no transformation is seen") == 1
    assert "some.csv, 3 cycles (1 to 3), the first of them (rows 1 to 320): on cooling the strain changes by" in output
    assert (
        "some.csv, 7 cycles (6, 8, 10, 12, 14, 16 and 1 more), the first of them (rows 1600 to 1920): on cooling"
        in output
    )
    assert len(json.loads(CliRunner().invoke(app, ["properties", str(path), "--json"]).stdout)["refused"]) == 10
    cold = t > 62.0
    done = CliRunner().invoke(app, ["properties", str(write(tmp_path / "all.csv", t[cold], e[cold]))])
    assert (
        done.exit_code == 2
        and done.output.count("its end was not reached") == 1
        and "all.csv, 20 cycles (1 to 20), the" in done.output
    )


def test_spaces_between_columns_are_noticed_and_cures_are_this_commands(tmp_path):
    (tmp_path / "a.csv").write_text("temperature [degC] strain [%]\n20 1.5\n30 1.4\n")
    done = CliRunner().invoke(app, ["properties", str(tmp_path / "a.csv")])
    assert done.exit_code == 2 and "the columns are separated by spaces: give --delimiter space" in done.output
    warm, strain = made(1)
    (tmp_path / "b.csv").write_text(
        "strain [%],temperature [degC]\n" + "".join(f"{t},{100 * e}\n" for t, e in zip(warm, strain, strict=True))
    )
    done = CliRunner().invoke(app, ["properties", str(tmp_path / "b.csv")])
    assert done.exit_code == 2 and "the strain of 150 % is above 50 %" in done.output and "rig" not in done.output


@pytest.mark.parametrize("warm_noise", [0.0, 1.0])
def test_loops_within_a_cycle_are_left_out_and_said_to_be(tmp_path, warm_noise):
    """On either branch it turns back half-way through the transformation, along a flat way, and comes again."""
    cool, heat = np.linspace(150.0, 15.0, 160), np.linspace(15.0, 150.0, 160)
    branches = {"cool": (cool, strain_of(cool, 40.0, 70.0)), "heat": (heat, strain_of(heat, 85.0, 110.0))}
    temperature, strain, starts = [], [], []
    for name, back in (("cool", 40.0), ("heat", -40.0), ("cool", 0.0), ("heat", 0.0)):
        t, e = branches[name]
        at = int(np.argmin(np.abs(t - (55.0 if name == "cool" else 97.0))))
        away = back * np.sin(np.linspace(0.0, np.pi, 40))
        loop = (t[at] + away, e[at] + 1e-5 * away) if back else (np.zeros(0), np.zeros(0))
        starts += [len(np.concatenate([*temperature, [0.0] * (at + 1)]))] if back else []
        temperature.append(np.r_[t[: at + 1], loop[0], t[at + 1 :]])
        strain.append(np.r_[e[: at + 1], loop[1], e[at + 1 :]])
    rng = np.random.default_rng(2)
    warm, extension = np.concatenate(temperature), np.concatenate(strain)
    noisy = warm + warm_noise * rng.standard_normal(len(warm)), extension + 1e-5 * rng.standard_normal(len(extension))
    smooth = 9 if warm_noise else 1
    cycles, refused = analyse_cycles("made", *noisy, smooth=smooth)
    assert len(cycles) == 2 and not refused
    assert [len(cycle.loops) for cycle in cycles] == [2, 0]
    for (first, last), start in zip(cycles[0].loops, starts, strict=True):
        assert abs(first - start) <= smooth + 1 and abs(last - start - 39) <= smooth + 2
    for cycle in cycles:
        for name, true in TRUE.items():
            assert cycle.values[name].value == pytest.approx(true, abs=1.5 if warm_noise else 0.4), name
    path, options = write(tmp_path / "loops.csv", *noisy), ["--smooth", str(smooth)]
    document = json.loads(CliRunner().invoke(app, ["properties", str(path), *options, "--json"]).stdout)
    first, last = document["recordings"][0]["cycles"][0]["loops_left_out"][0]
    assert (
        f"Left out of cycle 1: rows {first} to {last}, a loop within it."
        in CliRunner().invoke(app, ["properties", str(path), *options]).output
    )
    assert abs(first - cycles[0].loops[0][0]) <= 3 and abs(last - cycles[0].loops[0][1]) <= 3


@pytest.mark.parametrize(
    ("back", "rows", "warm_noise"), [(3.0, 60, 0.0), (8.0, 60, 0.0), (8.0, 60, 0.5), (15.0, 80, 2.0)]
)
def test_small_loops_are_left_out_too(back, rows, warm_noise):
    """On cooling it turns back a little at 50 degC, along a flat way: rows that would move the start by kelvins."""
    t, e = made(1)
    at = int(np.argmin(np.abs(t[:160] - 50.0)))
    away = back * (1.0 - np.abs(np.linspace(-1.0, 1.0, rows)))
    rng = np.random.default_rng(4)
    warm = np.r_[t[: at + 1], t[at] + away, t[at + 1 :]]
    warm = warm + warm_noise * rng.standard_normal(len(warm))
    strain = np.r_[e[: at + 1], np.full(rows, e[at]), e[at + 1 :]]
    (cycle,), refused = analyse_cycles("made", warm, strain, smooth=9 if warm_noise > 0.5 else 1)
    assert not refused and len(cycle.loops) == 1
    for name, true in TRUE.items():
        assert cycle.values[name].value == pytest.approx(true, abs=0.3 + 0.6 * warm_noise), name


@pytest.mark.parametrize("seed", range(5))
def test_a_noisy_thermometer_is_no_loop(seed):
    """10 K of noise, alone or going together over a few rows, on one long cycle."""
    t, e = made(1, rows=800)
    own = np.random.default_rng(seed).standard_normal(len(t))
    for noise in (10.0 * own, 3.0 * lfilter([1.0], [1.0, -0.7], own)):
        cycles, _ = analyse_cycles("noisy", t + noise, e, smooth=9)
        assert len(cycles) == 1 and not cycles[0].loops


def test_branches_that_are_in_no_cycle_are_said(tmp_path):
    """A file that begins cold: heated, cooled, heated and cooled."""
    t, e = made(3)
    path = write(tmp_path / "cold.csv", t[160:800], e[160:800])
    output = CliRunner().invoke(app, ["properties", str(path)]).output
    assert "cold.csv: 1 cycle" in output
    assert "Left out: rows 1 to 160, a heating without a cooling before it in the file." in output
    assert "Left out: rows 480 to 640, a cooling without a heating after it in the file." in output
    document = json.loads(CliRunner().invoke(app, ["properties", str(path), "--json"]).stdout)
    assert document["recordings"][0]["in_no_cycle"][1] == {"rows": [480, 640], "branch": "cooling"}
    whole = CliRunner().invoke(app, ["properties", str(write(tmp_path / "whole.csv", t, e))]).output
    assert "3 cycles" in whole and "Left out" not in whole


def test_decimal_commas_and_matlab_files_have_cures_of_this_command(tmp_path):
    warm, strain = made(1)
    rows = "".join(f"{t:.6g};{100 * e:.9g}\n".replace(".", ",") for t, e in zip(warm, strain, strict=True))
    (tmp_path / "german.csv").write_text("temperature [degC];strain [%]\n" + rows)
    run = lambda *words: CliRunner().invoke(app, ["properties", *map(str, words)])  # noqa: E731
    assert 'give --delimiter ";" --decimal ,' in run(tmp_path / "german.csv").output
    assert "has a decimal comma: give --decimal ," in run(tmp_path / "german.csv", "--delimiter", ";").output
    assert "A_f" in run(tmp_path / "german.csv", "--delimiter", ";", "--decimal", ",").output
    scipy.io.savemat(tmp_path / "a.mat", {"temperature": warm, "strain": strain})
    assert "save a struct next to it with units.temperature = 'degC'" in run(tmp_path / "a.mat").output
    scipy.io.savemat(tmp_path / "b.mat", {"warm": warm, "strain": strain})
    assert "save one vector per channel, named temperature, strain and stress" in run(tmp_path / "b.mat").output
    assert "with a struct units" in run(tmp_path / "a.mat", "--columns", "temperature [degC],strain").output
    scipy.io.savemat(
        tmp_path / "c.mat", {"temperature": warm, "strain": strain, "units": {"temperature": "degC", "strain": "1"}}
    )
    assert "A_f" in run(tmp_path / "c.mat").output


def test_a_file_given_twice_is_refused(tmp_path):
    path = write(tmp_path / "good.csv", *made(1))
    done = CliRunner().invoke(app, ["properties", str(path), str(tmp_path / "." / "good.csv")])
    assert done.exit_code == 2 and "good.csv: this file is given twice" in done.output


@pytest.mark.slow
def test_the_hundred_cycles_measured_by_others(shared):
    """Means by another tool, its values as that tool prints them."""
    columns = np.loadtxt(shared / "data" / "asmada-cyclic" / "Example Test Data.txt")
    cycles, refused = analyse_cycles("cycles", columns[:, 0], columns[:, 1], smooth=9)
    means = mean_properties(cycles)
    assert len(cycles) == 99 and not refused
    for name, value in zip(PROPERTY_NAMES, (122.90, 94.26, 113.09, 128.11, 0.0344, 0.03791, 12.02, 33.85), strict=True):
        scatter = np.std([c.values[name].value for c in cycles])
        assert abs(means[name].value - value) < 0.6 * scatter, name


def test_the_steepest_tangent_of_cycles_measured_by_others(shared):
    """Some of the hundred: it begins later and ends earlier, about the same middles."""
    columns = np.loadtxt(shared / "data" / "asmada-cyclic" / "Example Test Data.txt")[:4000]
    (lines, _), (steepest, refused) = (
        analyse_cycles("cycles", columns[:, 0], columns[:, 1], smooth=9, tangent=t) for t in ("lines", "steepest")
    )
    assert len(steepest) >= 13 and len(refused) <= 2
    of_lines, of_steepest = mean_properties(lines), mean_properties(steepest)
    assert 0.75 < of_steepest["span"].value / of_lines["span"].value < 1.0
    for name in ("width", "actuation_strain", "transformation_strain"):
        assert of_steepest[name].value == pytest.approx(of_lines[name].value, rel=0.05), name


@pytest.mark.parametrize(
    ("file", "rows", "columns", "text"),
    [
        ("nasa-bigelow-nitihf/200 MPa.txt", None, "temperature [degC],strain [%],stress [MPa]", "1 cycle at 200 MPa"),
        (
            "asmada-cyclic/Example Test Data.txt",
            2000,
            "temperature [degC],strain",
            "7 cycles, temperatures smoothed over 9 rows",
        ),
    ],
)
def test_the_command_reads_the_files_of_others(shared, tmp_path, file, rows, columns, text):
    """Whole, or their first rows: see the hundred cycles above."""
    lines = (shared / "data" / file).read_text("utf-8").splitlines(keepends=True)
    path = tmp_path / Path(file).name
    path.write_text("".join(lines[:rows]), "utf-8")
    run = lambda *options: CliRunner().invoke(app, ["properties", str(path), *options])  # noqa: E731
    for options in ((), ("--columns", columns)):
        done = run(*options)
        assert done.exit_code == 2 and 'give --delimiter "\\t"' in done.output and "rig" not in done.output
    done = run("--delimiter", "\\t")
    assert done.exit_code == 2 and "name the columns by --columns" in done.output and "rig" not in done.output
    done = run("--delimiter", "tab", "--columns", columns)
    assert done.exit_code == 0 and text in done.output and "A_f" in done.output


def test_spaces_between_columns_have_a_name(shared):
    files = sorted(str(p) for p in (shared / "data" / "tamu-flexinol-isobaric").glob("*_100MPa.txt"))
    done = CliRunner().invoke(
        app, ["properties", *files, "--delimiter", "space", "--columns", "temperature [degC],strain,stress [MPa]"]
    )
    assert files and done.exit_code == 0 and "A_f" in done.output, done.output


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--columns", "temperature [degC],strain [%]"), "row 1: the row has 3 cells, and 2 columns are named"),
        (("--columns", "temperature,strain [%],-"), "'temperature' has no unit"),
        (("--columns", "temperature [degC],elongation [%],-"), "rename it, or name the columns by --columns"),
        (("--columns", "temperature [degC],-,-"), "the channel strain is missing"),
        (
            ("--columns", "temperature [degC],strain [%],-", "--delimiter", ";"),
            'the columns are separated by ",": give --delimiter ","',
        ),
    ],
)
def test_columns_that_do_not_fit_are_refused(tmp_path, options, sentence):
    temperature, strain = made(1)
    np.savetxt(tmp_path / "bare.csv", np.column_stack([temperature, 100 * strain, strain]), delimiter=",", fmt="%.9g")
    done = CliRunner().invoke(app, ["properties", str(tmp_path / "bare.csv"), *options])
    assert done.exit_code == 2 and sentence in done.output and "[channels]" not in done.output
    good = CliRunner().invoke(
        app, ["properties", str(tmp_path / "bare.csv"), "--columns", "temperature [degC],strain [%],-"]
    )
    assert good.exit_code == 0 and "bare.csv: 1 cycle" in good.output


@pytest.mark.parametrize(
    ("stress", "values"),
    [
        (50, (182.6, 166.2, 202.9, 215.2)),
        (100, (186.8, 168.9, 205.8, 218.5)),
        (200, (198.5, 175.1, 212.2, 225.8)),
        (300, (212.1, 182.0, 218.7, 236.6)),
        (400, (227.3, 188.8, 225.9, 255.1)),
    ],
)
def test_nitihf_measured_by_others(shared, stress, values):
    columns = np.loadtxt(shared / "data" / "nasa-bigelow-nitihf" / f"{stress} MPa.txt")
    cycles, _ = analyse_cycles(f"{stress}", columns[:, 0], columns[:, 1] / 100)
    actuation = cycles[0].values["actuation_strain"]
    assert (
        actuation.lower95 < actuation.value < actuation.upper95
        and actuation.upper95 - actuation.lower95 < 0.2 * actuation.value
    )
    for name, value in zip(TEMPERATURE_NAMES, values, strict=True):
        assert cycles[0].values[name].value == pytest.approx(value, abs=6.0), name


def test_a_document_names_its_file(tmp_path):
    document = thermal_cycle_properties(write(tmp_path / "a.csv", *made(1))).document
    assert document["recordings"][0]["name"] == "a.csv" and document["recordings"][0]["smoothed_rows"] == 1


def staircase(tmp_path, stresses: list[float], ramp: float = 0.0):
    """One file: a cycle under each stress (MPa), which may rise by ``ramp`` meanwhile; temperatures of 6 MPa/K."""
    parts = []
    for k, stress in enumerate(stresses):
        t, e = made(1, seed=k)
        parts.append(np.column_stack([t + stress / 6.0, 100 * e, stress + ramp * np.linspace(0.0, 1.0, len(t))]))
    path = tmp_path / "staircase.csv"
    np.savetxt(
        path,
        np.concatenate(parts),
        delimiter=",",
        header="temperature [degC],strain [%],stress [MPa]",
        comments="",
        fmt="%.9g",
    )
    return path


@pytest.mark.parametrize(
    ("rows", "sentence"),
    [
        ("4", "4 is even: give 5"),
        ("99999", "smoothed over 99999 rows the temperature changes by 0 K only: smooth over fewer"),
    ],
)
def test_smoothing_that_moves_or_hides_the_corners_is_refused(tmp_path, rows, sentence):
    done = CliRunner().invoke(app, ["properties", str(write(tmp_path / "a.csv", *made())), "--smooth", rows])
    assert done.exit_code == 2 and sentence in done.output


def test_cycles_of_one_file_are_read_stress_by_stress(tmp_path):
    path = staircase(tmp_path, [50.0, 50.0, 110.0])
    document = write_start_values([path], tmp_path / "set.toml").document
    assert [(level["stress_Pa"], len(level["cycles"])) for level in document["recordings"]] == [(50e6, 2), (110e6, 1)]
    for level in document["recordings"]:
        assert level["mean"]["martensite_start"]["value"] == pytest.approx(70.0 + level["stress_Pa"] / 6e6, abs=0.3)
    entries = read_parameters(tmp_path / "set.toml")
    assert entries["material.clausius_clapeyron_martensite"].value == pytest.approx(6e6, rel=0.02)
    assert entries["material.martensite_start"].value == pytest.approx(70.0, abs=0.5)


def test_a_stress_that_moves_within_a_cycle_is_refused(tmp_path):
    done = CliRunner().invoke(app, ["properties", str(staircase(tmp_path, [50.0], ramp=100.0))])
    assert (
        done.exit_code == 2
        and "cycle 1 (rows 1 to 320): its stress varies from 50 to 150 MPa: keep the stress constant" in done.output
    )


def test_compression_lowers_the_temperatures_at_no_stress_like_tension(tmp_path):
    starts = []
    for sign in (1.0, -1.0):
        t, e = made(1)
        write_start_values([write(tmp_path / "a.csv", t, sign * e, sign * 100.0)], tmp_path / "set.toml")
        starts.append(read_parameters(tmp_path / "set.toml")["material.martensite_start"].value)
    assert starts[1] == pytest.approx(starts[0], abs=1e-6) and starts[0] == pytest.approx(70.0 - 100.0 / 7.0, abs=0.3)


@pytest.mark.parametrize(
    ("row", "value", "sentence"),
    [(5, np.nan, "row 7, column 'strain [%]': 'nan' is not a finite number: correct it, or leave such rows out with --drop-bad-rows"), (slice(None), 0.01, "check the sensor")],
)  # fmt: skip
def test_cures_are_this_commands(tmp_path, row, value, sentence):
    """It has no rig."""
    temperature, strain = made(1)
    strain[row] = value
    done = CliRunner().invoke(app, ["properties", str(write(tmp_path / "a.csv", temperature, strain))])
    assert done.exit_code == 2 and sentence in done.output and "[fit]" not in done.output


def test_the_help_shows_a_header_with_its_unit():
    assert "[degC]" in CliRunner().invoke(app, ["properties", "--help"]).output


def test_a_slope_that_the_stresses_do_not_tell_is_said_to_be_usual(tmp_path):
    (t, e), entries = made(1), {}
    for name, shift in (("falls", -5.0), ("steep", 1.0)):
        paths = [write(tmp_path / f"{name}-{k}.csv", t + k * shift, e, 50.0 + 100.0 * k) for k in range(2)]
        write_start_values(paths, tmp_path / "set.toml")
        entries[name] = read_parameters(tmp_path / "set.toml")["material.clausius_clapeyron_martensite"]
    assert (
        entries["falls"].value == 7e6
        and "through 2 stresses the temperatures fall, by 0.05 K/MPa" in entries["falls"].source
    )
    assert (
        entries["steep"].value == 3e7 and "cut from 100 MPa/K to the nearest plausible one" in entries["steep"].source
    )


def test_the_command_says_what_it_guessed(tmp_path):
    (t, e), messages = made(1), {}
    for name, shift in (("rises", 15.0), ("falls", -5.0), ("steep", 1.0)):
        paths = [str(write(tmp_path / f"{name}-{k}.csv", t + k * shift, e, 50.0 + 100.0 * k)) for k in range(2)]
        for case, some in ((name, paths), ("one", paths[:1])):
            messages[case] = (
                CliRunner()
                .invoke(app, ["properties", *some, "--write-set", str(tmp_path / "set.toml"), "--json", "--quiet"])
                .stderr
            )
    assert all(
        message.startswith("smajax: set.toml: not determined by the cycles: ") and message.count("\n") == 1
        for message in messages.values()
    )
    assert all(
        "modulus_austenite = 67000 MPa" in message and "Brinson (1993)" in message for message in messages.values()
    )
    assert "clausius" not in messages["rises"]
    assert (
        "clausius_clapeyron_austenite = 7 MPa/K (C_A is a usual value: one stress does not determine it)"
        in messages["one"]
    )
    assert (
        "clausius_clapeyron_martensite = 30 MPa/K (C_M by a straight line through 2 stresses, cut from"
        in messages["steep"]
    )
    falling = "no shape-memory alloy's temperatures fall as the stress rises: check which stress belongs to which cycle"
    assert falling in messages["falls"] and falling not in messages["rises"] + messages["steep"] + messages["one"]


def test_several_stresses_tell_how_strain_grows(tmp_path):
    """Cycles of the exact law at five stresses, and the set that is written."""
    law, rng, noise = lagoudas_reference.Law(**{**LAGOUDAS, "critical_stress": 0.0}), np.random.default_rng(0), 2e-5
    temperature = np.concatenate([np.linspace(150.0, 10.0, 90), np.linspace(10.0, 150.0, 90)[1:]])
    paths = []
    for stress in (20e6, 60e6, 120e6, 200e6, 300e6):
        state, strains = lagoudas_reference.State(0.0, 0.0), []
        for t in temperature:
            state = lagoudas_reference.advance(law, state, float(t), (stress, stress))
            strains.append(lagoudas_reference.strain(law, state, stress))
        paths.append(
            write(tmp_path / f"{stress:.0f}.csv", temperature, strains + noise * rng.standard_normal(179), stress / 1e6)
        )
    write_start_values(paths, tmp_path / "set.toml", model="lagoudas")
    text = '[rig]\nkind = "path"\n[material]\nset = "set.toml"\nmodulus_austenite = "60 GPa"\nmodulus_martensite = "30 GPa"\n'
    material = parse_rig(f'{text}[fit]\nmodel = "lagoudas"\nobserve = ["strain"]\n', folder=tmp_path).plant.material
    # What is read has the phases' elastic difference in it, up to 0.5 % at 300 MPa.
    for stress in (20e6, 100e6, 300e6):
        true = lagoudas_reference.current_strain(law, stress) + stress * (1 / 30e9 - 1 / 60e9)
        assert float(material.current_transformation_strain(jnp.asarray(stress))) == pytest.approx(true, rel=0.06)
    assert float(material.calibration_stress) == pytest.approx(140e6)


@pytest.mark.parametrize(
    ("stresses", "count"),
    [((100.01e6, 100.02e6, 200e6), 2), ((100e6, 150e6, 200e6), 3), ((5e6, 6e6, 9e6), 2), ((300e6, 305e6), 1), ((), 0)],
)
def test_stresses_that_scatter_count_once(stresses, count):
    assert count_stresses(stresses) == count


@pytest.mark.parametrize(("stresses", "strain", "model"), [([400.0], 0.03, "brinson"), ([400.0, 500.0], 0.03, "brinson"), ([30.0], 8e-4, "brinson"), ([10.0, 30.0, 60.0], 4e-4, "lagoudas")])  # fmt: skip
def test_high_stresses_and_small_strains_have_a_set_too(tmp_path, stresses, strain, model):
    t, e = made(1, noise=1e-6)
    for k, stress in enumerate(stresses):
        write(tmp_path / f"{k}.csv", t + stress / 8.0, (0.8 + 0.1 * k) * strain / 0.03 * e, stress)
    paths = [tmp_path / f"{k}.csv" for k in range(len(stresses))]
    write_start_values(paths, tmp_path / "set.toml", model=model)
    entry = read_parameters(tmp_path / "set.toml")["material.max_transformation_strain"]
    assert max(0.7 * strain, 1e-4) < entry.value < 2.5 * strain
    write(tmp_path / "little.csv", t, 5e-5 / 0.03 * e, 10.0)
    with pytest.raises(
        InputError, match="little.csv: the largest transformation strain is 0.005 %, below the lower bound of every law"
    ):
        write_start_values([tmp_path / "little.csv"], tmp_path / "set.toml", model=model)


def test_strains_that_do_not_grow_leave_their_growth_to_the_law(tmp_path):
    t, e = made(1)
    paths = [write(tmp_path / f"{k}.csv", t + 8.0 * k, e, 50.0 + 60.0 * k) for k in range(4)]
    write_start_values(paths, tmp_path / "set.toml", model="lagoudas")
    entries = read_parameters(tmp_path / "set.toml")
    assert not {"material.min_strain_share", "material.strain_saturation"} & set(entries)
    assert entries["material.max_transformation_strain"].value == pytest.approx(0.03, rel=0.02)


def brinson_cycles(folder: Path, stresses: list[float], noise: float = 1e-5) -> list[Path]:
    """Cycles of the exact law: those of a wire that detwins between 10 and 60 MPa."""
    law = brinson_reference.Material(
        martensite_start=60.0, martensite_finish=45.0, austenite_start=72.0, austenite_finish=84.0, clausius_clapeyron_austenite=8e6,
        clausius_clapeyron_martensite=7e6, modulus_austenite=67e9, modulus_martensite=26.3e9, resistivity_austenite=8e-7,
        resistivity_martensite=9e-7, detwinning_start_stress=1e7, detwinning_finish_stress=6e7, max_transformation_strain=0.04,
        thermal_expansion_austenite=0.0, thermal_expansion_martensite=0.0,
    )  # fmt: skip
    temperature, rng, paths = (
        np.r_[np.linspace(150.0, 10.0, 280), np.linspace(10.0, 150.0, 280)[1:]],
        np.random.default_rng(4),
        [],
    )
    for stress in stresses:
        detwinned = twinned = 0.0
        before, strains = 150.0, []
        for t in temperature:
            detwinned, twinned = brinson_reference.advance(
                law, detwinned, twinned, before, stress * 1e6, float(t), stress * 1e6
            )
            strains.append(brinson_reference.strain_of(law, float(t), stress * 1e6, detwinned, twinned, 20.0))
            before = float(t)
        paths.append(
            write(
                folder / f"{stress:g}.csv", temperature, strains + noise * rng.standard_normal(len(temperature)), stress
            )
        )
    return paths


@pytest.mark.slow
@pytest.mark.parametrize("stresses", [[40.0], [40.0, 90.0, 160.0]])
def test_a_brinson_fit_from_the_set_finds_stresses_that_detwin_a_wire_below_100_mpa(tmp_path, stresses):
    paths = brinson_cycles(tmp_path, stresses)
    write_start_values(paths, tmp_path / "set.toml", model="brinson")
    entries = read_parameters(tmp_path / "set.toml")
    for name in (
        "detwinning_start_stress",
        "detwinning_finish_stress",
        "martensite_start",
        "max_transformation_strain",
    ):
        entry = entries[f"material.{name}"]
        assert entry.lower <= entry.value <= entry.upper and "as Brinson's law would give them" in entry.source
    names = [
        "martensite_start",
        "austenite_start",
        "austenite_finish",
        "max_transformation_strain",
        "detwinning_finish_stress",
    ]
    free = ", ".join(f'"material.{n}"' for n in (*names, *(["martensite_finish"] if len(stresses) > 1 else [])))
    text = '[rig]\nkind = "path"\n[material]\nset = "set.toml"\n[environment]\nambient = "20 degC"\n'
    rig = parse_rig(
        f'{text}[fit]\nmodel = "brinson"\nfree = [{free}]\nobserve = ["strain"]\nstarts = 1\n', folder=tmp_path
    )
    result = fit(
        rig.plant,
        [read_recording(p, required=("temperature", "stress"), observed=("strain",), clock=False) for p in paths],
        rig.fit,
    )
    errors = [np.sqrt(np.mean(r.residual("strain") ** 2)) for r in result.responses]
    assert max(errors) < 0.002  # of 0.04: what is held at its start value is a little off
    values = {e.name: e.estimate for e in result.estimates}
    assert values["material.austenite_start"] < values["material.austenite_finish"]
    assert values.get("material.martensite_finish", -1e9) < values["material.martensite_start"]


def test_several_recordings_are_analysed_together():
    """The same groups as by the command, means, start values, and reasons with codes and fields in place of words."""
    t, e = made(2, noise=1e-6)
    stress = np.full(len(t), 200e6)
    flat = 0.0052 - 1e-5 * t
    good = plants.recording({"temperature": t, "strain": e, "stress": stress}, np.arange(len(t)) * 1.0, "good")
    bad = plants.recording({"temperature": t, "strain": flat}, np.arange(len(t)) * 1.0, "flat")
    analysis = analyse_recordings([good, bad])
    assert [len(group.cycles) for group in analysis.groups] == [2, 0]
    assert {r.error.code for r in analysis.refused} == {"no-transformation"}
    assert analysis.refused[0].error.fields == {"branch": "cooling"} and analysis.refused[0].number == 1
    (sentence,) = merge_refusals(analysis.refused)
    assert sentence.startswith("flat, 2 cycles (1 to 2), the first of them (rows 1 to 320): on cooling the strain")
    assert analysis.means == mean_properties(analysis.groups[0].cycles)
    assert analysis.start_values("brinson") == make_start_values(analysis.levels, "brinson")
    for recordings, reason in (
        ([bad], "flat, 2 cycles"),
        ([good, good], "this recording is given twice"),
        ([], "there is no recording"),
    ):
        with pytest.raises(InputError, match=reason):
            analyse_recordings(recordings)
    with pytest.raises(InputError, match="good has no channel strain"):
        analyse_recordings([plants.recording({"temperature": t}, np.arange(len(t)) * 1.0, "good")])


@pytest.mark.parametrize(
    ("text", "code", "cure"),
    [
        ("temperature [degC];strain [%]\n1;2\n", "delimiter", 'give --delimiter ";"'),
        ("temperature [degC],warm\n1,2\n", "unknown-column", "rename it, or name the columns by --columns"),
        ("temperature [degC],strain\n1,x\n", "bad-first-row", "give --units-row if the row has units, else correct it"),
        ("temperature [degC]\n1\n2\n", "channel-missing", "add a column 'strain [1]' or name the columns by --columns"),
    ],
)
def test_errors_of_a_reader_have_a_code_and_the_cure_of_the_front_end(tmp_path, text, code, cure):
    path = tmp_path / "a.csv"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_recording(path, required=("temperature",), observed=("strain",), clock=False)
    assert caught.value.code == code and caught.value.fields["cure"] in str(caught.value)
    output = CliRunner().invoke(app, ["properties", str(path)]).output
    assert cure in output and caught.value.fields["cure"] not in output


def as_workbook(path: Path) -> Path:
    """A workbook with a cycle on each of two sheets."""
    book = openpyxl.Workbook()
    for k, stress in enumerate((50, 100)):
        sheet = book.active if k == 0 else book.create_sheet()
        sheet.title = f"{stress} MPa"
        temperature, strain = made(1, seed=k)
        sheet.append(["temperature [degC]", "strain [%]", "stress [MPa]"])
        for row in zip(temperature + stress / 6.0, 100 * strain, strict=True):
            sheet.append([*map(float, row), stress])
    book.save(path)
    return path


def test_sheets_are_stresses(tmp_path):
    path = as_workbook(tmp_path / "cycles.xlsx")
    first = thermal_cycle_properties(path)
    assert "Reading: sheet '50 MPa' was read, and not 100 MPa" in first.summary()
    both = CliRunner().invoke(app, ["properties", str(path), "--sheet", "all"])
    assert both.exit_code == 0 and "at 50 MPa" in both.output and "at 100 MPa" in both.output


@pytest.mark.parametrize("options", [("--skip-rows", "2"), ("--skip-rows", "2", "--columns", "temperature,strain")])
def test_titles_units_and_other_names_are_read_by_options(tmp_path, options):
    temperature, strain = made(1)
    rows = "".join(f"{t:.9g},{100 * e:.9g}\n" for t, e in zip(temperature, strain, strict=True))
    names = "temperature,strain" if len(options) == 2 else "Temp,Eps"
    (tmp_path / "a.csv").write_bytes(f"Specimen: 3\nOperator: NN\n{names}\n°C,%\n{rows}".encode("cp1252"))
    title = CliRunner().invoke(app, ["properties", str(tmp_path / "a.csv")])
    assert title.exit_code == 2 and title.output.rstrip().endswith("give --skip-rows 2")
    done = CliRunner().invoke(app, ["properties", str(tmp_path / "a.csv"), *options])
    assert done.exit_code == 0 and "1 cycle" in done.output and "Reading: row 4 was read as units." in done.output


@pytest.mark.parametrize(
    ("head", "cells", "columns"),
    [
        ("Time,Temp,Stress,Strain", "{k},{t:.6g},100,{e:.6g}", "time [s],temperature [degC],stress [MPa],strain [%]"),
        ("Temp,Note,Eps,Load", "{t:.6g},ok,{e:.6g},{k}.5", "temperature [degC],-,strain [%],-"),
        ("T_wire;Dehnung", "{t:.6g};{e:.6g}", "temperature [degC],strain [%]"),
    ],
    ids=["names", "others", "semicolons"],
)
def test_the_advice_on_columns_is_that_of_the_file_and_works(tmp_path, head, cells, columns):
    path = tmp_path / "a.csv"
    temperature, strain = made(1)
    rows = (cells.format(k=k, t=t, e=100 * e) for k, (t, e) in enumerate(zip(temperature, strain, strict=True)))
    path.write_text("\n".join([head, *rows]) + "\n")
    options = ["--delimiter", ";"] if ";" in head else []
    refused = CliRunner().invoke(app, ["properties", str(path), *options])
    assert refused.exit_code == 2 and refused.output.rstrip().endswith(f"name the columns by --columns '{columns}'")
    done = CliRunner().invoke(app, ["properties", str(path), *options, "--columns", columns])
    assert done.exit_code == 0 and "a.csv: 1 cycle" in done.output


def test_the_advice_is_for_the_file_that_cannot_be_read_where_another_name_begins_like_it(tmp_path):
    temperature, strain = made(1)
    good, bad = tmp_path / "run.csv", tmp_path / "run.csv.mat"
    rows = (f"{t:.6g},{100 * e:.6g}" for t, e in zip(temperature, strain, strict=True))
    good.write_text("\n".join(["temperature [degC],strain [%]", *rows]) + "\n")
    scipy.io.savemat(bad, {"temperature": temperature, "units": {"temperature": "degC"}})
    refused = CliRunner().invoke(app, ["properties", str(good), str(bad)])
    assert refused.exit_code == 2 and "save a vector strain next to them" in refused.output
    assert "--columns" not in refused.output


def test_columns_that_cycles_do_not_need_are_named():
    temperature, strain = made(1)
    data = {"temperature [degC]": temperature, "strain": strain, "force [N]": strain, "ambient [degC]": strain}
    study = thermal_cycle_properties(data)
    note = "recorded and not used, since thermal cycles have temperature, strain, stress: force, ambient"
    assert f"Reading: {note}." in study.summary() and study.document["recordings"][0]["notes"] == [note]
