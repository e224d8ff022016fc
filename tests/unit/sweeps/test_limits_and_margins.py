"""Safe limits of the material, margins of constraints, catalogues, and axes of the input."""

import json
import math
import pathlib
import re
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

from smajax import parameters
from smajax.api.fit import fit
from smajax.api.predict import predict
from smajax.api.sweep import sweep
from smajax.app.cli import app
from smajax.errors import InputError
from smajax.files.material_limits import Limit, MaterialLimits, limits_from_document, read_catalogue, read_limits
from smajax.files.parameter_sets import find_set, shipped_sets
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.report.sweep import index_rows
from smajax.report.sweep_plots import parallel_picture, sensitivity_picture, trade_off_picture
from smajax.sweeps.excitation import Excitation, discretise_excitation
from smajax.sweeps.margins import Margins, margins_from_document
from smajax.sweeps.rig_problem import RigSweepProblem
from smajax.sweeps.sobol import SobolIndex, is_resolved, unresolved_indices
from smajax.sweeps.sweep_file import from_header, read_sweep

ROOT = pathlib.Path(__file__).parents[3]
BENCH = data_path("recordings", "dead-weight")
# A weight of 500 g on the shipped wire, whose rated pull of 172 MPa is at a diameter of 0.19 mm.
SWEEP = """
[sweep]
rig = "rig.toml"
designs = 64
[parameters]
wire.diameter = ["0.15 mm", "0.3 mm"]
wire.length = ["200 mm", "400 mm"]
input.amplitude = { from = "0.3 A", to = "1.5 A", scale = "log" }
[input]
wave = "square"
amplitude = "0.5 A"
frequency = "0.3 Hz"
cycles = 3
[objectives]
energy_per_cycle = "min"
[constraints]
stroke = { at_least = "5 mm" }
peak_temperature = { at_most = "110 degC" }
"""


@pytest.fixture
def folder(tmp_path):
    text = (BENCH / "rig.toml").read_text("utf-8").replace('mass = "0.2 kg"', 'mass = "0.5 kg"')
    assert "0.5 kg" in text
    (tmp_path / "rig.toml").write_text(text, "utf-8")
    (tmp_path / "sweep.toml").write_text(SWEEP, "utf-8")
    return tmp_path


def written(folder, text):
    (folder / "sweep.toml").write_text(text, "utf-8")
    return read_sweep(folder / "sweep.toml")


class TestLimits:
    def test_shipped_limits_have_sources_of_the_bibliography(self):
        keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text("utf-8"), re.MULTILINE))
        found = 0
        for name in shipped_sets():
            path = find_set(name)
            limits, catalogue = read_limits(path, name), read_catalogue(path, name)
            entries = [*limits.stress, limits.temperature, limits.strain] if limits else []
            for source in [entry.source for entry in entries] + ([catalogue.source] if catalogue else []):
                assert re.split(r"[:.]", source)[0] in keys, source
                found += 1
        assert found >= 8

    def test_the_stress_is_that_of_the_cycles_wanted(self):
        limits = MaterialLimits("own", (Limit(200e6, "a", 1e4), Limit(150e6, "b", 1e6)), Limit(120.0, "c"))
        assert limits.for_life(1e4)["stress"].value == 200e6 and limits.for_life(2e4)["stress"].value == 150e6
        assert limits.for_life(1.0)["temperature"].value == 120.0 and "strain" not in limits.for_life(1.0)
        with pytest.raises(
            InputError, match="parameter set own has no stress for 2,000,000 cycles, its largest number"
        ):
            limits.for_life(2e6)
        assert limits_from_document(json.loads(json.dumps(limits.to_document()))) == limits

    @pytest.mark.slow
    def test_they_hold_by_default_and_are_turned_off(self, folder):
        """The wire of least energy is one at 245 MPa without the limits, and one at most at the rated pull with them."""
        refined = SWEEP + "[refine]\nstarts = 1\n"
        (folder / "sweep.toml").write_text(refined, "utf-8")
        held = sweep(folder / "sweep.toml")
        (folder / "sweep.toml").write_text(refined.replace("[sweep]", '[sweep]\nlimits = "none"'), "utf-8")
        free = sweep(folder / "sweep.toml")
        assert held.refined[0]["metrics"]["peak_stress"] <= 172e6 < free.refined[0]["metrics"]["peak_stress"]
        assert held.refined[0]["metrics"]["strain_range"] <= 0.035
        assert "peak_stress" in free.designs and free.document["constraints"].keys() == {"stroke", "peak_temperature"}
        assert held.document["constraints"]["peak_temperature"]["at_most"] == 110.0

    def test_an_earlier_table_is_reproduced_without_limits(self, folder):
        header = read_sweep(folder / "sweep.toml").header()
        assert from_header(header).constraints["peak_stress"] == (-math.inf, 172e6)
        for key in ("limits", "catalogues", "margins"):
            del header[key]
        assert from_header(header).constraints.keys() == {"stroke", "peak_temperature"}

    @pytest.mark.parametrize(
        ("line", "message"),
        [
            ("life = 10_000_000", "sweep.life: parameter set flexinol has no stress for 10,000,000 cycles"),
            ('limits = "rotary-table1"', r'sweep.limits = "rotary-table1" has no section \[limits\]: add one'),
            ('limits = "flexinoll"', r"sweep.limits = 'flexinoll' is not known \(did you mean 'flexinol'\?\)"),
        ],
    )
    def test_a_bad_key_is_named(self, folder, line, message):
        with pytest.raises(InputError, match=message):
            written(folder, SWEEP.replace("[sweep]", f"[sweep]\n{line}"))

    def test_a_constraint_above_a_limit_is_refused(self, folder):
        text = SWEEP + 'peak_stress = { at_least = "200 MPa" }\n'
        with pytest.raises(InputError, match=r"constraints.peak_stress: its lower bound is above the limit"):
            written(folder, text)

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ('[[limits.stress]]\nvalue = "1 MPa"\nsource = "a"\n', "limits.stress 1.cycles is missing"),
            ('[limits.strain]\nvalue = "3 %"\nsource = "a"\ncycles = 5\n', "limits.strain.cycles has no place here"),
            ('[limits.temperature]\nvalue = "3 mm"\nsource = "a"\n', "limits.temperature.value"),
            ('[limits.temperature]\nvalue = "120 degC"\n', "limits.temperature.source"),
        ],
    )
    def test_a_bad_set_is_named(self, tmp_path, text, message):
        path = tmp_path / "own.toml"
        path.write_text('schema = "smajax.parameters/1"\n' + text, "utf-8")
        with pytest.raises(InputError, match=message):
            read_limits(path, "own.toml")


class TestMargins:
    @pytest.mark.slow
    def test_of_a_range_against_single_simulations(self, folder):
        """The lowest stroke and the highest temperature are those of the rig at the ends of the range."""
        text = SWEEP + '[margins]\nvary = { "environment.ambient" = "3 K" }\n'
        found = written(folder, text.replace("designs = 64", "designs = 4"))
        assert found.constraints["lowest_stroke"][0] == pytest.approx(5e-3)
        assert found.constraints["highest_peak_temperature"] == (-np.inf, 110.0) and "stroke" not in found.constraints
        columns = sweep(folder / "sweep.toml").designs
        rig = read_rig(folder / "rig.toml")
        names = tuple(axis.name for axis in found.axes)
        design = jnp.array([columns[n][0] for n in names])
        values = []
        for ambient in (17.0, 20.0, 23.0):
            plant = parameters.replace(rig.plant, {"environment.ambient": ambient})
            source = found.subject.source
            problem = RigSweepProblem(names, plant, ("stroke", "peak_temperature"), source, 3, "linear", 0.0)
            values.append(problem.evaluate(design, int(problem.grouped_steps(found.designs())[0]))[0])
        strokes, peaks = ([float(v[n]) for v in values] for n in ("stroke", "peak_temperature"))
        assert columns["stroke"][0] == pytest.approx(strokes[1], rel=1e-6)
        assert columns["lowest_stroke"][0] == pytest.approx(min(strokes), rel=1e-6)
        assert columns["highest_peak_temperature"][0] == pytest.approx(max(peaks), rel=1e-6)

    def test_of_a_fit_for_a_linear_metric(self):
        """For a linear metric the margin is the half width of its 95 % interval, sqrt(g^T S g)."""
        rng = np.random.default_rng(0)
        axes, slope = rng.normal(size=(3, 3)), rng.normal(size=3)
        margins = Margins(("a", "b", "c"), (), tuple(map(tuple, axes)), ("lowest_m", "highest_m"))
        values = {"m": jnp.asarray(5.0 + margins.deviations @ slope)}
        half_width = np.sqrt(slope @ (axes.T @ axes) @ slope)
        result = margins.with_margins(values)
        assert float(result["lowest_m"]) == pytest.approx(5.0 - half_width)
        assert float(result["highest_m"]) == pytest.approx(5.0 + half_width)
        assert margins_from_document(json.loads(json.dumps(margins.to_document()))) == margins
        failed = {"m": values["m"].at[4].set(jnp.nan)}
        assert np.isnan(float(margins.with_margins(failed)["lowest_m"]))
        constant = {"m": jnp.full(7, 5.0)}
        slopes = jax.grad(lambda v: margins.with_margins({"m": v})["lowest_m"])(constant["m"])
        assert np.all(np.isfinite(np.asarray(slopes)))

    @pytest.mark.slow
    def test_of_a_fit_of_the_rig(self, folder):
        result = fit(BENCH / "rig.toml", BENCH / "train.csv")
        result.save(folder / "result")
        text = SWEEP.replace('"rig.toml"', '"result/rig-fitted.toml"').replace("designs = 64", "designs = 4")
        (folder / "sweep.toml").write_text(text + '[margins]\nfit = "result"\n', "utf-8")
        columns = sweep(folder / "sweep.toml").designs
        assert np.all(columns["lowest_stroke"] < columns["stroke"])
        header = read_sweep(folder / "sweep.toml").header()
        (folder / "result" / "fit.json").unlink()
        assert from_header(json.loads(json.dumps(header))).margins is not None
        result.save(folder / "result")
        (folder / "sweep.toml").write_text(SWEEP + '[margins]\nfit = "result"\n', "utf-8")
        with pytest.raises(InputError, match="outside of its interval in that fit: sweep the fitted rig"):
            read_sweep(folder / "sweep.toml")

    @pytest.mark.parametrize(
        ("lines", "message"),
        [
            ("", r"\[margins\] has neither vary nor fit"),
            ('vary = { "environment.ambiant" = "3 K" }', "environment.ambiant is not a parameter of this rig"),
            ('vary = { "environment.ambient" = "-3 K" }', "is not above 0: give the half width"),
            ('vary = { "environment.ambient" = "3 K" }\nconstraints = ["force"]', "there is no constraint on force"),
        ],
    )
    def test_a_bad_key_is_named(self, folder, lines, message):
        with pytest.raises(InputError, match=message):
            written(folder, f"{SWEEP}[margins]\n{lines}\n")


class TestCatalogue:
    TEXT = SWEEP.replace('wire.diameter = ["0.15 mm", "0.3 mm"]', 'wire.diameter = { catalogue = "smartflex" }')

    def test_an_axis_of_stock_diameters(self, folder):
        axis = written(folder, self.TEXT).axes[0]
        assert axis.catalogue == "SmartFlex" and axis.values[0] == 25e-6 and axis.values[-1] == 0.5e-3
        assert {limit.parameter_set for limit in read_sweep(folder / "sweep.toml").limits} == {"smartflex"}
        narrow = written(folder, self.TEXT.replace('"smartflex" }', '"smartflex", from = "0.1 mm", to = "0.3 mm" }'))
        assert [round(1e6 * value) for value in narrow.axes[0].values] == [100, 150, 200, 300]

    @pytest.mark.parametrize(
        ("entry", "message"),
        [
            ('{ catalogue = "rotary-table1" }', r"parameter set rotary-table1 has no section \[catalogue\]"),
            ('{ catalogue = "smartflex", points = 3 }', "points has no place next to catalogue"),
            ('{ catalogue = "smartflex", from = "1 mm" }', "no diameter of SmartFlex is in this range"),
        ],
    )
    def test_a_bad_one_is_named(self, folder, entry, message):
        with pytest.raises(InputError, match=message):
            written(folder, self.TEXT.replace('{ catalogue = "smartflex" }', entry))

    @pytest.mark.slow
    def test_refinement_finds_the_best_diameter(self, folder):
        """The best result has no larger energy than the refinements with each diameter alone."""
        text = self.TEXT.replace("[sweep]", '[sweep]\nlimits = "flexinol"')
        (folder / "sweep.toml").write_text(
            text.replace('"smartflex" }', '"smartflex", from = "0.2 mm", to = "0.4 mm" }') + "[refine]\nstarts = 1\n",
            "utf-8",
        )
        best = sweep(folder / "sweep.toml").refined[0]
        for diameter in ("0.2 mm", "0.3 mm", "0.4 mm"):
            alone = text.replace('{ catalogue = "smartflex" }', f'{{ values = ["{diameter}"] }}')
            (folder / "sweep.toml").write_text(alone + "[refine]\nstarts = 1\n", "utf-8")
            energies = [e["metrics"]["energy_per_cycle"] for e in sweep(folder / "sweep.toml").refined if e["better"]]
            assert best["metrics"]["energy_per_cycle"] <= 1.001 * min(energies, default=math.inf)


class TestInputAxes:
    @pytest.mark.parametrize("wires", [1, 2])
    def test_a_varied_duty_gives_the_input_of_a_fixed_one(self, wires):
        """The levels at the middle of each step are those of the wave, and the switch-off is a grid point."""
        varied = Excitation("square", 2.0, 0.5, 0.3, 2, duties=(0.2, 0.45))
        for duty in (0.2, 0.31, 0.45):
            inputs = discretise_excitation(varied, wires, 40, {"duty": jnp.asarray(duty)})
            time, before = np.asarray(inputs.time), np.asarray(inputs.before)
            phase = 0.5 * (time[1:] + time[:-1]) * 0.5
            for wire in range(wires):
                expected = np.where((phase - wire / wires) % 1.0 < duty, 2.0, 0.0)
                np.testing.assert_array_equal(before[:, wire], expected)
            assert np.min(np.abs(time * 0.5 - duty)) < 1e-12
            assert np.all(np.diff(time) > 0.0) and np.max(np.diff(time)) < 1.2 * 2.0 / 40

    def test_shape_and_offset_of_a_design(self):
        mixed = Excitation("square", 2.0, 0.5, 0.3, 2, 0.1, shapes=("square", "sine"))
        for index, shape in enumerate(mixed.shapes):
            inputs = discretise_excitation(mixed, 1, 40, {"wave": jnp.asarray(float(index))})
            time, before = np.asarray(inputs.time), np.asarray(inputs.before)[:, 0]
            middle = 0.25 * (time[1:] + time[:-1]) % 1.0
            square = 0.1 + 2.0 * (middle < 0.3)
            sine = 0.1 + 1.0 - np.cos(2.0 * np.pi * 0.5 * time[:-1])
            np.testing.assert_allclose(before, square if shape == "square" else sine, atol=1e-12)

    def test_derivatives_against_finite_differences(self, folder):
        names = ("input.duty", "input.offset")
        source = Excitation("square", 0.7, 0.3, 0.3, 2, duties=(0.2, 0.45))
        plant = read_rig(folder / "rig.toml").plant
        problem = RigSweepProblem(names, plant, ("peak_temperature", "energy_per_cycle"), source, 2, "hold", 0.0)
        evaluate = jax.jit(lambda design: problem.evaluate(design, 128)[0])
        design, step = jnp.array([0.3, 0.05]), 1e-5
        slopes = jax.jit(jax.jacfwd(lambda d: evaluate(d)))(design)
        for k in range(2):
            shift = jnp.zeros(2).at[k].set(step)
            above, below = evaluate(design + shift), evaluate(design - shift)
            for metric in above:
                expected = (float(above[metric]) - float(below[metric])) / (2.0 * step)
                assert float(slopes[metric][k]) == pytest.approx(expected, rel=1e-3)

    def test_a_sweep_over_all_of_them(self, folder):
        lines = 'input.duty = ["0.1", "0.45"]\ninput.offset = ["0 A", "0.1 A"]\n'
        lines += 'input.wave = { values = ["square", "triangle"] }\n'
        text = SWEEP.replace("[input]\n", lines + "[input]\n").replace("designs = 64", "designs = 8")
        (folder / "sweep.toml").write_text(text, "utf-8")
        study = sweep(folder / "sweep.toml")
        assert set(study.designs["input.wave"]) == {0.0, 1.0}
        assert study.document["parameters"]["input.wave"]["labels"] == ["square", "triangle"]

    @pytest.mark.parametrize(
        ("line", "message"),
        [
            ('input.duty = ["0.2", "1.2"]', "input.duty"),
            ('input.wave = { values = ["box"] }', "'box' is not known: choose square, sine, triangle"),
            ('input.wave = ["square", "sine"]', "is not a list: write"),
            ('input.duty = ["0.2", "0.7"]\ninput.wave = { values = ["square", "sine"] }', "contains 0.5, where"),
            ('input.offset = ["0 A", "99 A"]', "input.offset"),
        ],
    )
    def test_a_bad_one_is_named(self, folder, line, message):
        with pytest.raises(InputError, match=message):
            written(folder, SWEEP.replace("[input]\n", f"{line}\n[input]\n"))

    def test_two_wires_need_a_duty_on_one_side_of_half(self, tmp_path):
        text = data_path("sweeps", "rotary.toml").read_text("utf-8")
        text = text.replace("../recordings/rotary/rig.toml", str(data_path("recordings", "rotary", "rig.toml")))
        text = text.replace("[parameters]", '[parameters]\ninput.duty = ["0.3", "0.6"]', 1)
        with pytest.raises(InputError, match="contains 0.5, where the second wire is switched on"):
            written(tmp_path, text)


def test_a_constant_duty_gives_the_same_grid_as_one_that_varies():
    fixed, varied = Excitation("square", 1.0, 1.0, 0.3, 1), Excitation("square", 1.0, 1.0, 0.3, 1, duties=(0.3, 0.3))
    first = discretise_excitation(fixed, 1, 50, {})
    second = discretise_excitation(replace(varied, duty=0.3), 1, 50, {"duty": jnp.asarray(0.3)})
    np.testing.assert_allclose(np.asarray(first.time), np.asarray(second.time), atol=1e-15)


class TestRefinedDesigns:
    @pytest.mark.slow
    @pytest.mark.parametrize("shape", ["square", "triangle"])
    def test_the_command_shows_the_figures_again(self, folder, shape):
        """The rig is linear between samples, and a square input of a sweep is not: 7.69 mm instead of 8 before."""
        assert read_rig(folder / "rig.toml").interpolation == "linear"
        lines = 'input.duty = ["0.3", "0.45"]\n' if shape == "square" else ""
        text = SWEEP.replace('"square"', f'"{shape}"').replace("[input]\n", f"{lines}[input]\n")
        (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 1\n", "utf-8")
        study = sweep(folder / "sweep.toml", folder=folder / "out")
        entry = study.refined[0]
        words = entry["command"].split()
        assert words[:2] == ["smajax", "simulate"] and f"cd {folder / 'out'}" in study.summary(str(folder / "out"))
        paths = [str(folder / "out" / word) if word.endswith((".toml", ".csv")) else word for word in words[1:]]
        paths[-1] = str(folder / "shown")
        result = CliRunner().invoke(app, paths)
        assert result.exit_code == 0, result.output
        shown = json.loads((folder / "shown" / "run.json").read_text("utf-8"))["metrics"]
        # Linear inputs have more steps between rows in a simulation.
        tolerance = 1e-6 if shape == "square" else 2e-3
        for name in ("stroke", "peak_temperature", "peak_stress", "strain_range", "energy_per_cycle"):
            assert shown[name]["value"] == pytest.approx(entry["metrics"][name], rel=tolerance)
        assert "Last cycle:" in result.output and "strain_range" in result.output

    @pytest.mark.slow
    def test_the_answer_ends_with_what_to_buy(self, folder):
        text = TestCatalogue.TEXT.replace("designs = 64", "designs = 32")
        (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 1\n", "utf-8")
        study = sweep(folder / "sweep.toml")
        length = 1e3 * study.refined[0]["parameters"]["wire.length"]
        size = 1e3 * study.refined[0]["parameters"]["wire.diameter"]
        end = f"To buy: {length:.4g} mm of SmartFlex wire of {size:g} mm, and a length for the clamps."
        assert study.document["summary"].endswith(end)

    def test_cycles_of_a_recording_are_checked(self, folder):
        rig, recording = folder / "rig.toml", BENCH / "train.csv"
        assert "metrics" not in predict(rig, recording).document
        with pytest.raises(InputError, match=r"cycles = 5000: train.csv has \d+ rows, too few for so many"):
            predict(rig, recording, cycles=5000)
        with pytest.raises(InputError, match="cycles"):
            predict(rig, recording, cycles=0)


class TestReport:
    def test_what_rules_most_designs_out_is_said(self, folder):
        study = sweep(folder / "sweep.toml")
        columns = study.designs
        excludes = {
            "stroke": np.sum(columns["stroke"] < 5e-3),
            "peak_temperature": np.sum(columns["peak_temperature"] > 110.0),
            "peak_stress": np.sum(columns["peak_stress"] > 172e6),
            "strain_range": np.sum(columns["strain_range"] > 0.035),
        }
        entries = study.document["constraints"]
        assert {n: entry["excludes"] for n, entry in entries.items()} == excludes
        most = max(excludes, key=lambda n: excludes[n])
        words = (
            f"{most} rules out most, {excludes[most]} ({entries[most]['excludes_alone']} of them satisfy all others)"
        )
        assert words in study.document["summary"]
        alone = (columns["stroke"] < 5e-3) & (columns["peak_temperature"] <= 110.0) & (columns["peak_stress"] <= 172e6)
        assert entries["stroke"]["excludes_alone"] == np.sum(alone & (columns["strain_range"] <= 0.035))
        assert (
            "Limits of the material hold (flexinol): peak_stress at most 172 MPa for 1,000,000 cycles"
            in (study.document["summary"])
        )

    def test_axes_ignore_designs_far_from_useful(self):
        columns = {"a": np.array([1.0, 2.0, 3.0, 1e6]), "b": np.array([1.0, 2.0, 2.5, 4.0]), "design": np.arange(4)}
        feasible = np.array([True, True, True, False])
        axes = [("a", "1", "1"), ("b", "1", "1")]
        picture = trade_off_picture(columns, feasible, axes, np.array([0]), [])
        values = np.concatenate([np.asarray(trace.x, float) for trace in picture.figure.data])
        assert values.max() == 3.0 and "1 design lies far" in picture.caption
        lines = parallel_picture(columns, feasible, [(*axis, False) for axis in axes], np.array([0])).figure
        assert "3" in [mark.text for mark in lines.layout.annotations]
        assert "1e+06" not in [mark.text for mark in lines.layout.annotations]

    def test_indices_outside_of_0_to_1_are_explained_and_not_shown(self):
        index = SobolIndex(-0.2, (-0.5, 0.1), 1.3, (0.8, 1.6))
        words = unresolved_indices(
            {"wire.diameter": index, "wire.length": SobolIndex(0.1, (0.0, 0.2), 0.3, (0.2, 0.4))}
        )
        assert words == ["the first-order index of wire.diameter (-0.20)", "the total index of wire.diameter (1.30)"]
        assert is_resolved(-0.004) and is_resolved(1.0) and not is_resolved(None) and not is_resolved(1.01)
        entries = {"m": {"p": {k: list(v) if isinstance(v, tuple) else v for k, v in index._asdict().items()}}}
        rows = index_rows({"sensitivity": entries})
        assert rows == [("m", "p", "-", "0.00 .. 0.10", "-", "0.80 .. 1.00")]
        assert sensitivity_picture(entries).figure.data[0].z[0][0] is None
