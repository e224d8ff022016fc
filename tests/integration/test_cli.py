"""Command line: files, output and exit codes, and fast help.

Most commands run in this process on a short recording, so that they share compiled programs.
"""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner, Result

from smajax.actuators.registry import ACTUATORS
from smajax.app import cli
from smajax.app.console import CommandProgress
from smajax.app.loading import interrupt_at_time_limits
from smajax.control.controller_file.read import read_controller
from smajax.errors import InputError
from smajax.files.parameter_sets import read_header, read_parameters, shipped_sets
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.progress import Progress, ProgressEvent
from smajax.recordings import datasets, read
from smajax.recordings.recording import Recording
from smajax.report.documents import FitDocument
from smajax.simulation.run import simulate
from smajax.sweeps.sweep_file import read_sweep
from tests.conftest import ROOT

LIMBS = ("elbow", "wrist", "glove-finger")
COILS = ("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip")
STEERED = ("dead-weight", "bias-spring", "antagonistic-rotary", *COILS, *LIMBS)
KINDS = (*STEERED, "testing-machine", "path")
FREE = ["heat.h0", "material.max_transformation_strain"]


def smajax(*words: object) -> Result:
    return CliRunner().invoke(cli.app, [str(word) for word in words])


def sentence(result: Result, code: int) -> str:
    """Return the single line on stderr of a refused command, which prints nothing on stdout."""
    lines = [line for line in result.stderr.splitlines() if not re.match("smajax: (loading|reading|compiling)", line)]
    assert result.exit_code == code, result.output
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("smajax: ")
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return lines[0]


@pytest.fixture(scope="module")
def bench(tmp_path_factory) -> Path:
    """A rig with two free parameters, and short recordings: simulations with other values, with noise."""
    folder = tmp_path_factory.mktemp("bench")
    text = datasets.data_path("recordings", "dead-weight", "rig.toml").read_text()
    text = re.sub(r"free = \[.*?\]", f"free = {json.dumps(FREE)}\nstarts = 1", text, flags=re.DOTALL)
    (folder / "rig.toml").write_text(f"# <script>alert(1)</script> & co\n{text}")
    rig = read_rig(folder / "rig.toml")
    time = np.arange(400) * 0.05
    noise = np.random.default_rng(3)
    truth = read_rig(folder / "rig.toml").to_toml({"heat.h0": 104.0, "material.max_transformation_strain": 0.0415})
    (folder / "truth.toml").write_text(truth)
    plant = read_rig(folder / "truth.toml").plant
    for name, period in (("train.csv", 9.0), ("holdout.csv", 6.0), ("more.csv", 5.0)):
        current = np.round(0.16 * (1 - np.cos(2 * np.pi * time / period)), 4)
        blank = Recording.from_arrays(name, time, {"current": current}, {"current": "A"})
        moved = np.asarray(simulate(plant, blank, interpolation=rig.interpolation).channels["displacement"])
        channels = {"current": current, "displacement": moved + noise.normal(0, 2e-5, len(time))}
        Recording.from_arrays(name, time, channels, {"time": "s", "current": "mA", "displacement": "mm"}).write(
            folder / name
        )
    return folder


@pytest.fixture(scope="module")
def fitted(bench) -> Result:
    files = (bench / "rig.toml", bench / "train.csv", "--holdout", bench / "holdout.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.progress._MIN_SECONDS_BETWEEN_LINES", 0.0)  # of all steps, however fast they are
        return smajax("fit", *files, "--out", bench / "out", "--profile", "heat.h0")


def test_help_imports_no_large_packages():
    probe = "import sys, smajax.app.cli; print([m for m in ('jax', 'equinox', 'numpy', 'scipy', 'pint', 'plotly', 'pandas', 'pydantic') if m in sys.modules])"
    result = subprocess.run([sys.executable, "-c", probe], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"


@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "{0}", "{1}"),
        ("fit", "{0}", "{1}"),
        ("diagnose", "{0}", "{1}", "--select", "{1}", "--holdout", "{1}"),
        ("demo",),
    ],
)
def test_equinox_is_imported_after_its_checks_are_disabled(words, tmp_path):
    """Its run-time checks call Python from compiled programs; such programs cannot be cached between runs."""
    probe = (
        "import sys, smajax.numerics.process\n"
        "def stop(accelerator):\n    print('equinox' in sys.modules)\n    sys.exit(7)\n"
        "smajax.numerics.process.prepare_jax = stop\nimport smajax.__main__\nsmajax.__main__.main()"
    )
    files = [ROOT / "data" / "recordings" / "dead-weight" / name for name in ("rig.toml", "train.csv")]
    arguments = [word.format(*files) for word in words]
    result = subprocess.run(
        [sys.executable, "-c", probe, *arguments, "--out", str(tmp_path / "out")],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert (result.returncode, result.stdout.strip()) == (7, "False"), result.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("fit", "none.toml", "{1}", "--out", "out"), "none.toml: there is no such file"),
        (("fit", "{0}", "none.csv", "--out", "out"), "none.csv: there is no such file"),
        (("fit", "{0}", "{1}", "--holdout", "none.csv", "--out", "out"), "none.csv: there is no such file"),
        (("simulate", "broken.toml", "{1}", "--out", "out"), "broken.toml: row 2, column"),
        (("diagnose", "{0}", "{1}", "--select", "{0}", "--out", "out"), "files ending in '.toml' are not read"),
        (("compare", "{0}", "{1}", "--out", "broken.toml"), "broken.toml"),
        (("tune", "{0}", "broken.toml", "--out", "out"), "broken.toml: row 2, column"),
        (("sweep", "none.toml", "--out", "out"), "none.toml: there is no such file"),
        (("check", "{0}", "none.csv"), "none.csv: there is no such file"),
        (("properties", "none.csv"), "none.csv: there is no such file"),
    ],
)
def test_a_wrong_path_or_invalid_toml_is_reported_before_jax_is_loaded(words, said, tmp_path):
    (tmp_path / "broken.toml").write_text("schema = 1\n[rig\n")
    probe = (
        "import sys, smajax.__main__\n"
        "class Refused:\n    def find_spec(self, name, path, target=None):\n"
        "        if name == 'jax':\n            sys.exit(7)\n"
        "sys.meta_path.insert(0, Refused())\nsmajax.__main__.main()"
    )
    files = [ROOT / "data" / "recordings" / "dead-weight" / name for name in ("rig.toml", "train.csv")]
    command = [sys.executable, "-c", probe, *(word.format(*files) for word in words)]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert result.returncode == 2 and said in result.stderr, (result.returncode, result.stderr)


@pytest.mark.parametrize("module", ["typer", "jaxlib"])
def test_ctrl_c_while_packages_are_imported_is_one_sentence(module, tmp_path):
    probe = (
        "import signal, sys, smajax.__main__\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "class Interrupted:\n    def find_spec(self, name, path, target=None):\n"
        f"        if name == '{module}':\n            signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Interrupted())\nsmajax.__main__.main()"
    )
    files = [ROOT / "data" / "recordings" / "dead-weight" / name for name in ("rig.toml", "train.csv")]
    words = [sys.executable, "-c", probe, "fit", *map(str, files), "--out", str(tmp_path / "out"), "--quiet"]
    result = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    assert (result.returncode, result.stderr) == (130, "smajax: interrupted; nothing was written\n")


def test_help_names_every_command_and_its_options():
    top = smajax("--help")
    assert top.exit_code == 0
    for command in (
        "simulate",
        "fit",
        "diagnose",
        "tune",
        "compare",
        "properties",
        "demo",
        "init",
        "import",
        "check",
        "effects",
        "sets",
        "report",
        "datasets",
    ):
        assert command in top.stdout
        assert smajax(command, "--help").exit_code == 0
    options = smajax("fit", "--help").stdout
    for option in (
        "--holdout",
        "--out",
        "--start",
        "--seed",
        "--starts",
        "--drop-bad-rows",
        "--quiet",
        "--json",
        "--no-open",
        "--profile",
        "--auto",
    ):
        assert option in options
    assert smajax("--version").stdout == "smajax 0.2.0\n"


@pytest.mark.parametrize(
    "words",
    [["fit"], ["fly"], ["fit", "rig.toml", "a.csv"], ["fit", "--speed"], ["init", "tractor"], ["datasets", "steal"]],
)
def test_a_wrong_command_line_is_code_2(words):
    assert smajax(*words).exit_code == 2


def test_a_fit_leaves_a_whole_folder_and_a_summary(bench, fitted):
    assert fitted.exit_code == 0, fitted.output
    out = bench / "out"
    assert {path.name for path in out.iterdir()} == {
        "fit.json", "fit.toml", "prediction.csv", "report.html", "rig-fitted.toml", "rig.toml", "run.json"
    }  # fmt: skip
    document = json.loads((out / "fit.json").read_text())
    FitDocument.check(document)
    assert list(document["parameters"]) == FREE
    for name, truth in zip(FREE, (104.0, 0.0415), strict=True):
        entry = document["parameters"][name]
        assert entry["lower95"] < entry["estimate"] < entry["upper95"]
        assert abs(entry["estimate"] - truth) < 2 * (entry["upper95"] - entry["lower95"])
    rmse = document["rmse"]["displacement"]
    assert rmse["unit"] == "mm"
    assert rmse["train"] == pytest.approx(0.02, rel=0.15)
    assert rmse["holdout"] == pytest.approx(0.02, rel=0.15)
    assert document["noise_floor"]["displacement"]["value"] == pytest.approx(0.02, rel=0.2)
    assert [(r["name"], r["rows"], r["role"]) for r in document["recordings"]] == [
        ("train.csv", 400, "train"),
        ("holdout.csv", 400, "holdout"),
    ]
    assert document["recordings"][0]["sha256"] == read.read_recording(bench / "train.csv").sha256
    assert document["solver"]["code"] == "converged"
    profile = document["profiles"]["heat.h0"]
    assert profile["lower95"] < document["parameters"]["heat.h0"]["estimate"] < profile["upper95"]
    assert "Fitted 2 parameters of rig.toml (brinson) to train.csv (400 rows): converged" in fitted.stdout
    assert "smajax: fitting: step 1" in fitted.stderr
    run = json.loads((out / "run.json").read_text())
    assert run["versions"]["smajax"] == "0.2.0"
    assert run["timings"].keys() >= {"read", "fit", "profile"}
    assert (out / "rig.toml").read_text() == (bench / "rig.toml").read_text()


def test_the_parameter_file_and_the_fitted_rig_hold_the_estimates(bench, fitted):
    document = json.loads((bench / "out" / "fit.json").read_text())
    entries = read_parameters(bench / "out" / "fit.toml")
    plant = read_rig(bench / "out" / "rig-fitted.toml").plant
    assert list(entries) == FREE
    for name, entry in entries.items():
        parameter = document["parameters"][name]
        assert (entry.value, entry.interval95) == (parameter["estimate"], (parameter["lower95"], parameter["upper95"]))
        assert entry.free
        assert document["recordings"][0]["sha256"] in entry.source
    assert float(plant.heat.h0) == entries["heat.h0"].value
    assert read_header(bench / "out" / "fit.toml")["fit"]["recordings"] == ["train.csv"]


def test_the_prediction_has_the_fitted_plant_and_the_measurement(bench, fitted):
    rig = read_rig(bench / "out" / "rig-fitted.toml")
    rows = (bench / "out" / "prediction.csv").read_text().splitlines()
    assert rows[0].startswith("recording,role,time [s],current [mA],displacement [mm],displacement_model [mm]")
    table = np.array(
        [[float(cell) for cell in row.split(",")[2:6]] for row in rows if row.startswith("holdout.csv,holdout,")]
    )
    measured = rig.read(bench / "holdout.csv")
    np.testing.assert_array_equal(table[:, 0], measured.time)
    model = simulate(rig.plant, measured, interpolation=rig.interpolation).channels["displacement"]
    np.testing.assert_allclose(table[:, 2], 1e3 * measured.channels["displacement"], rtol=0, atol=1e-12)
    np.testing.assert_allclose(table[:, 3], 1e3 * np.asarray(model), rtol=1e-6, atol=1e-7)


def test_the_report_is_rebuilt_from_the_folder_alone(bench, fitted):
    page = bench / "out" / "report.html"
    before = page.read_text()
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; co" in before
    page.write_text("lost")
    assert smajax("report", bench / "out").exit_code == 0
    assert page.read_text() == before


def test_json_prints_the_result_file_and_nothing_else(bench, fitted):
    words = [
        "fit",
        bench / "rig.toml",
        bench / "train.csv",
        "--holdout",
        bench / "holdout.csv",
        "--out",
        bench / "json",
    ]
    result = smajax(*words, "--json", "--quiet", "--seed", "0")
    assert result.exit_code == 0
    assert result.stdout == (bench / "json" / "fit.json").read_text()
    assert result.stderr == ""
    first, second = (json.loads((bench / name / "fit.json").read_text()) for name in ("out", "json"))
    assert first["parameters"] == second["parameters"]


def test_a_fit_starts_from_an_earlier_one(bench, fitted):
    result = smajax(
        "fit",
        bench / "rig.toml",
        bench / "train.csv",
        "--start",
        bench / "out" / "fit.toml",
        "--out",
        bench / "again",
        "--quiet",
    )
    assert result.exit_code == 0, result.output
    first, second = (json.loads((bench / name / "fit.json").read_text()) for name in ("out", "again"))
    assert second["solver"]["steps"] < first["solver"]["steps"]
    for name in FREE:
        assert second["parameters"][name]["estimate"] == pytest.approx(first["parameters"][name]["estimate"], rel=1e-4)


def test_ctrl_c_keeps_the_best_point(bench, fitted, monkeypatch):
    monkeypatch.setattr(Progress, "step", lambda self, text: signal.raise_signal(signal.SIGINT))
    before = signal.getsignal(signal.SIGINT)  # a background process ignores it from the start
    result = smajax(
        "fit", bench / "rig.toml", bench / "train.csv", "--holdout", bench / "holdout.csv", "--out", bench / "stopped"
    )
    assert result.exit_code == 130, result.output
    document = json.loads((bench / "stopped" / "fit.json").read_text())
    FitDocument.check(document)
    assert document["solver"]["code"] == "interrupted"
    assert document["solver"]["steps"] == 1
    assert "the best point so far is kept" in result.stderr
    assert signal.getsignal(signal.SIGINT) is before


@pytest.mark.parametrize("command", ["fit", "simulate"])
def test_ctrl_c_while_the_results_are_written_keeps_them(bench, monkeypatch, command):
    shown = []

    def phase(self, text):
        shown.append(text)
        if text == "writing the report":
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Progress, "phase", phase)
    before, out = signal.getsignal(signal.SIGINT), bench / f"{command}-written"
    result = smajax(command, bench / "rig.toml", bench / "train.csv", "--out", out)
    assert result.exit_code == 130, result.output
    assert shown[-1] == "writing the results; press Ctrl-C again to stop at once, without them"
    complete = f"they are complete, in {out.resolve()}"
    assert result.stderr.endswith(f"smajax: interrupted when there were results already; {complete}\n")
    assert json.loads((out / "run.json").read_text())["exit_code"] == 0 and (out / "report.html").is_file()
    assert signal.getsignal(signal.SIGINT) is before


def test_the_end_of_a_schedulers_time_keeps_the_best_point(bench, fitted, monkeypatch):
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(Progress, "step", lambda self, text: signal.raise_signal(signal.SIGTERM))
    result = smajax("fit", bench / "rig.toml", bench / "train.csv", "--out", bench / "timed-out")
    assert result.exit_code == 130, result.output
    assert json.loads((bench / "timed-out" / "fit.json").read_text())["solver"]["code"] == "interrupted"
    assert signal.getsignal(signal.SIGTERM) is before


@pytest.mark.skipif(not hasattr(signal, "SIGXCPU"), reason="needs a limit of processor time")
def test_the_end_of_the_processor_time_keeps_the_best_point(bench, fitted, monkeypatch):
    """The signal comes each second, and is no second Ctrl-C."""

    def step(self, text):
        for _ in range(2):
            signal.raise_signal(signal.SIGXCPU)

    before = signal.getsignal(signal.SIGXCPU)
    monkeypatch.setattr(Progress, "step", step)
    try:
        result = smajax("fit", bench / "rig.toml", bench / "train.csv", "--out", bench / "out-of-time")
        signal.raise_signal(signal.SIGXCPU)
    finally:
        signal.signal(signal.SIGXCPU, before)
    assert result.exit_code == 130, result.output
    assert json.loads((bench / "out-of-time" / "fit.json").read_text())["solver"]["code"] == "interrupted"


@pytest.mark.skipif(not hasattr(signal, "SIGXCPU"), reason="needs a limit of processor time")
def test_the_end_of_the_processor_time_while_packages_are_loaded(bench):
    """In a separate process with a limit of one second, most of which is used before the command begins."""
    program = (
        "import resource, time\n"
        "resource.setrlimit(resource.RLIMIT_CPU, (1, resource.RLIM_INFINITY))\n"
        "while time.process_time() < 0.7:\n    pass\n"
        "from smajax.__main__ import main\nmain()"
    )
    call = [sys.executable, "-c", program]
    words = ["fit", "rig.toml", "train.csv", "--out", "no-time", "--max-steps", "1"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    result = subprocess.run([*call, *words], cwd=bench, env=environment, capture_output=True, text=True)
    assert result.returncode == 130, result.stderr
    assert result.stderr.splitlines()[-1] == "smajax: interrupted; nothing was written"


@pytest.mark.parametrize("name", ["SIGTERM", "SIGXCPU"])
def test_a_signal_at_a_time_limit_does_what_ctrl_c_does(name):
    """A second SIGTERM ends the process; the processor time, which is sent again each second, does not."""
    number = getattr(signal, name, None)
    if number is None:
        pytest.skip("this system has no limit of processor time")
    before = {k: signal.getsignal(k) for k in (signal.SIGINT, number)}
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.signal(number, signal.SIG_DFL)
        interrupt_at_time_limits()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        assert signal.getsignal(number) == (signal.SIG_DFL if name == "SIGTERM" else signal.SIG_IGN)
    finally:
        for k, handler in before.items():
            signal.signal(k, handler)


def test_a_small_address_space_is_refused(bench):
    """In processes of their own; with the space that is said to be needed a simulation runs."""
    if not Path("/proc/self/limits").exists():
        pytest.skip("the limit is read from /proc")
    program = (
        "import resource; resource.setrlimit(resource.RLIMIT_AS, ({0}, {0})); from smajax.__main__ import main; main()"
    )
    for size, code in ((2**30, 3), (2 * 2**30, 0)):
        words = ["simulate", "rig.toml", "train.csv", "--out", f"space-{code}"]
        call = [sys.executable, "-c", program.format(size), *words]
        environment = os.environ | {"PYTHONPATH": str(ROOT)}
        result = subprocess.run(call, cwd=bench, env=environment, capture_output=True, text=True)
        assert result.returncode == code, result.stderr
        assert (bench / f"space-{code}").exists() is (code == 0)
        if code:
            assert result.stderr == (
                "smajax: there is not enough memory for this: the limit of this process is 1,024 MiB, and 2,048 MiB are "
                "needed: raise it ('ulimit -v')\n"
            )


@pytest.mark.parametrize(
    ("end", "code", "words"),
    [
        ("os.abort()", 3, "smajax: the memory ran out: the limit of this process is 4,096 MiB of address space"),
        ("os.kill(os.getpid(), signal.SIGKILL)", 3, "smajax: the memory ran out"),
        ("os.kill(os.getpid(), signal.SIGUSR1)", -10, ""),
        ("os.kill(os.getppid(), signal.SIGINT); time.sleep(30)", 130, "smajax: interrupted; nothing was written"),
        ("os.kill(os.getppid(), signal.SIGTERM); time.sleep(30)", 130, "smajax: interrupted; nothing was written"),
        ("sys.exit(7)", 7, ""),
    ],
)
def test_a_command_that_gets_no_memory_says_so(end, code, words):
    """Where the address space is limited, a process waits for the command and passes on its signals and exit code."""
    if not Path("/proc/self/limits").exists():
        pytest.skip("the limit is read from /proc")
    program = (
        "import os, resource, signal, sys, time\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2**32, 2**32))\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # a background process ignores it
        "import smajax.app.cli\n"
        "from smajax.__main__ import main\n"
        f"smajax.app.cli.app = lambda: exec({end!r})\n"
        "main()"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    result = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert result.returncode == code and result.stderr.startswith(words), result.stderr
    assert "Traceback" not in result.stderr and bool(result.stderr) is bool(words)


def test_a_ctrl_c_that_a_callback_loses_is_raised_again_and_a_second_one_ends_the_process(monkeypatch, capsys):
    codes = []
    monkeypatch.setattr("smajax.app.console.os._exit", codes.append)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        with CommandProgress(Progress(quiet=True)) as progress:
            progress(ProgressEvent("reading"))
            with pytest.raises(KeyboardInterrupt):  # as in a callback whose exceptions Python ignores
                signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                progress(ProgressEvent("drawing designs"))
            signal.raise_signal(signal.SIGINT)
        assert codes == [130] and capsys.readouterr().err == "smajax: interrupted; nothing was written\n"
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_ctrl_c_when_there_is_a_result_stops_the_next_search(monkeypatch):
    """As that which follows the checks of a tuning."""
    events = [ProgressEvent("tuning", can_stop=True), ProgressEvent("checking", has_result=True)]
    with CommandProgress(Progress(quiet=True)) as progress:
        for event in events:
            progress(event)
        signal.raise_signal(signal.SIGINT)
        assert progress.interrupted
        progress(ProgressEvent("exporting", has_result=True))
        with pytest.raises(KeyboardInterrupt):
            progress(ProgressEvent("tuning again", can_stop=True))


def test_what_builds_a_report_is_loaded_when_the_work_begins():
    """Only once. A new process loads the modules, since this one has loaded plotly already."""
    calls: list[str] = []
    with CommandProgress(Progress(quiet=True), lambda: calls.append("work")) as progress:
        progress(ProgressEvent("reading"))
        assert not calls
        for _ in range(2):
            progress(ProgressEvent("fitting", can_stop=True))
        assert calls == ["work"]
    program = (
        "import sys, threading\n"
        "from smajax.report.rebuild import load_page_builder\n"
        "assert 'plotly' not in sys.modules\n"
        "load_page_builder('fit')\n"
        "next(t for t in threading.enumerate() if t.name == 'smajax-report').join(60)\n"
        "print(*(name in sys.modules for name in ('smajax.report.run_pages', 'plotly.graph_objs._layout')))"
    )
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True)
    assert done.stdout == "True True\n", done.stderr


def test_a_simulation_is_a_recording_again(bench):
    result = smajax("simulate", bench / "rig.toml", bench / "more.csv", "--out", bench / "simulated")
    assert result.exit_code == 0, result.output
    assert "Simulated 400 rows of more.csv with rig.toml." in result.stdout
    rig = read_rig(bench / "rig.toml")
    recording, simulation = rig.read(bench / "more.csv"), rig.read(bench / "simulated" / "simulation.csv")
    assert simulation.units["current"] == "mA"
    np.testing.assert_array_equal(simulation.channels["current"], recording.channels["current"])
    channels = simulate(rig.plant, recording, interpolation=rig.interpolation).channels
    assert set(simulation.channels) == set(rig.plant.observable)
    for channel, values in channels.items():
        np.testing.assert_allclose(simulation.channels[channel], values, rtol=1e-12, atol=1e-12)
    page = (bench / "simulated" / "report.html").read_text()
    assert "The other channels" in page
    assert smajax("report", bench / "simulated").exit_code == 0
    assert (bench / "simulated" / "report.html").read_text() == page
    assert (
        json.loads(
            smajax("simulate", bench / "rig.toml", bench / "more.csv", "--out", bench / "simulated", "--json").stdout
        )["code"]
        == "done"
    )


def test_a_failed_simulation_is_code_3_and_saves_its_rows(bench, tmp_path):
    (tmp_path / "runaway.toml").write_text(
        re.sub(r'h2 = "[^"]*"', 'h2 = "-0.5 W/m^2/K^3"', (bench / "rig.toml").read_text())
    )
    result = smajax("simulate", tmp_path / "runaway.toml", bench / "more.csv", "--out", tmp_path / "out", "--quiet")
    reason = sentence(result, 3)
    assert re.search(r"more\.csv: (diverged|overheated|unsolved): .*h\(T\).* the results so far are saved in", reason)
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["exit_code"] == 3
    assert run["code"] in ("diverged", "overheated", "unsolved")
    assert (tmp_path / "out" / "report.html").is_file()


@pytest.mark.slow
def test_a_failed_fit_is_code_3_with_the_reason_in_the_result(bench, tmp_path):
    (tmp_path / "runaway.toml").write_text(
        re.sub(r'h2 = "[^"]*"', 'h2 = "-0.5 W/m^2/K^3"', (bench / "rig.toml").read_text())
    )
    result = smajax("fit", tmp_path / "runaway.toml", bench / "train.csv", "--out", tmp_path / "out", "--json")
    assert result.exit_code == 3
    document = json.loads(result.stdout)
    FitDocument.check(document)
    assert document["solver"]["code"] == "failed"
    assert "at the start values" in document["solver"]["text"]
    assert document["rmse"]["displacement"] == {"train": None, "holdout": None, "unit": "mm"}
    assert document["parameters"]["heat.h0"]["estimate"] == pytest.approx(100.6)
    assert (tmp_path / "out" / "report.html").is_file()
    assert smajax("report", tmp_path / "out").exit_code == 0


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["check", "{bench}/rik.toml"], r"rik\.toml: there is no such file.*did you mean 'rig\.toml'"),
        (["fit", "{bench}/rig.toml", "{bench}/none.csv", "--out", "{tmp}/out"], r"none\.csv"),
        (
            ["fit", "{bench}/rig.toml", "{bench}/train.csv", "--out", "{bench}"],
            "not a result of smajax: name another folder for --out",
        ),
        (
            ["fit", "{bench}/rig.toml", "{bench}/train.csv", "{bench}/train.csv", "--out", "{tmp}/out"],
            "this recording is given twice",
        ),
        (
            ["fit", "{bench}/rig.toml", "{bench}/train.csv", "--profile", "heat.h1", "--out", "{tmp}/out"],
            r"not free \(did you mean 'heat\.h0'\?\)",
        ),
        (
            ["fit", "{bench}/rig.toml", "{bench}/train.csv", "--start", "{bench}/rig.toml", "--out", "{tmp}/out"],
            "not a parameter file",
        ),
        (
            ["simulate", "{bench}/rig.toml", "{bench}/bad.csv", "--out", "{tmp}/out"],
            r"bad\.csv: row 3, column 'current \[A\]'",
        ),
        (["report", "{tmp}"], "this is not a result folder"),
        (["report", "{tmp}/none"], "there is no such folder"),
        (["datasets", "get"], "'datasets get' needs a name"),
        (["datasets", "get", "dead-wait"], "did you mean 'dead-weight'"),
        (["datasets", "list", "x"], "takes no name"),
    ],
)
def test_bad_input_is_one_sentence_and_code_2(bench, tmp_path, words, said):
    (bench / "bad.csv").write_text("time [s],current [A]\n0,0\n0.1,high\n")
    assert re.search(said, sentence(smajax(*(word.format(bench=bench, tmp=tmp_path) for word in words)), 2))
    assert not (tmp_path / "out").exists()


def test_a_start_outside_of_its_bounds_is_refused(bench, fitted, tmp_path):
    text = (bench / "rig.toml").read_text() + '\nbounds = {"heat.h0" = ["90 W/m^2/K", "101 W/m^2/K"]}\n'
    (tmp_path / "narrow.toml").write_text(text)
    words = [
        "fit",
        tmp_path / "narrow.toml",
        bench / "train.csv",
        "--start",
        bench / "out" / "fit.toml",
        "--out",
        tmp_path / "out",
    ]
    assert "is outside of its bounds in narrow.toml" in sentence(smajax(*words), 2)


def test_all_files_after_holdout_are_holdouts(bench, monkeypatch, tmp_path):
    jobs = []

    def stop_here(rig, train, **options):
        jobs.append((train, options["holdout"]))
        raise InputError("enough")

    monkeypatch.setattr("smajax.api.fit.fit", stop_here)
    monkeypatch.setattr("smajax.app.command_line.models.check_files", lambda **_: None)  # there are no such files
    assert (
        smajax(
            "fit",
            "rig.toml",
            "a.csv",
            "b.csv",
            "--holdout",
            "c.csv",
            "d.csv",
            "--out",
            tmp_path / "o",
            "--holdout",
            "e.csv",
        ).exit_code
        == 2
    )
    assert [str(path) for path in jobs[0][0]] == ["a.csv", "b.csv"]
    assert [str(path) for path in jobs[0][1]] == ["c.csv", "d.csv", "e.csv"]
    smajax("fit", "rig.toml", "a.csv", "--holdout=b.csv", "c.csv", "--out", tmp_path / "o")
    assert [str(path) for path in jobs[1][0]] == ["a.csv"]
    assert [str(path) for path in jobs[1][1]] == ["b.csv", "c.csv"]


@pytest.mark.parametrize("kind", ACTUATORS)
def test_machines_start_and_are_checked_like_rigs(kind, tmp_path):
    result = smajax("init", kind, "--out", tmp_path)
    assert result.exit_code == 0, result.output
    rig = tmp_path / "rig.toml"
    assert {path.name for path in tmp_path.iterdir()} == {"rig.toml", "sweep.toml"}
    subject = read_sweep(tmp_path / "sweep.toml").subject
    checked = smajax("check", rig)
    assert checked.exit_code == 0, checked.output
    assert kind in checked.stdout and all(name in checked.stdout for name in [*subject.declarations, *subject.units])
    assert "exists and is not overwritten" in sentence(smajax("init", kind, "--out", tmp_path), 2)
    # Files that only rigs have.
    (tmp_path / "a.csv").write_text("time [s],current [A]\n0,0\n1,0\n")
    assert "the metrics of an actuator need no recording" in sentence(smajax("check", rig, tmp_path / "a.csv"), 2)
    refused = sentence(smajax("simulate", rig, tmp_path / "a.csv", "--out", tmp_path / "out"), 2)
    assert f'rig.kind = "{kind}" is an actuator' in refused and "smajax sweep" in refused


def test_an_unexpected_error_is_one_sentence_with_the_path_of_its_traceback(bench, monkeypatch):
    def fail(*_: object) -> str:
        raise ZeroDivisionError("deep inside")

    monkeypatch.setattr("smajax.app.commands.check.describe", fail)
    message = sentence(smajax("check", bench / "rig.toml"), 1)
    written = Path(message.rpartition(" ")[2])
    assert "ZeroDivisionError: deep inside" in written.read_text()
    written.unlink()


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_init_writes_files_that_pass_the_check(kind, tmp_path):
    result = smajax("init", kind, "--out", tmp_path / "mine")
    assert result.exit_code == 0, result.output
    contents = {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()}
    steered = kind in STEERED
    more = {"controller.toml", "sweep.toml"} if steered else set()
    recordings = {"train.csv", "select.csv", "holdout.csv"}
    assert set(contents) == {"rig.toml", "example.toml"} | recordings | more
    assert len({contents[name] for name in recordings}) == 3
    if steered:
        assert read_sweep(tmp_path / "mine" / "sweep.toml").subject.name == "example.toml"
        read_controller(tmp_path / "mine" / "controller.toml", read_rig(tmp_path / "mine" / "example.toml"))
        assert "smajax tune" in result.output
    assert contents["rig.toml"].count(b"#") > 5
    note = "no latent heat of the transformation"
    assert (note in result.output) == (kind != "path")
    for rig in ("rig.toml", "example.toml"):
        checked = smajax("check", tmp_path / "mine" / rig, *(tmp_path / "mine" / name for name in sorted(recordings)))
        assert checked.exit_code == 0, checked.output
        assert kind in checked.stdout
        assert "free parameter" in checked.stdout
        assert (note in checked.stdout) == (kind != "path")
    (tmp_path / "mine" / "select.csv").unlink()
    assert "exists and is not overwritten" in sentence(smajax("init", kind, "--out", tmp_path / "mine"), 2)
    assert {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()} == {
        k: v for k, v in contents.items() if k != "select.csv"
    }


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_the_commands_that_init_prints_name_files_that_it_wrote(kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed = smajax("init", kind, "--out", "mine").stdout
    jobs: list[str] = []

    def stop(*_: object, **__: object):  # other tests run the commands
        jobs.append("started")
        raise typer.Exit(1)

    for module in ("models", "designs"):
        monkeypatch.setattr(f"smajax.app.command_line.{module}.start_run", stop)
    lines = re.findall(r"^(?:Next: |      )smajax (\S.*)$", printed, re.MULTILINE)
    assert [line.split()[0] for line in lines][:3] == ["check", "fit", "diagnose"] and len(lines) in (3, 5)
    for line in lines:
        words = line.split()
        files = [word for word in words[1:] if word.endswith((".toml", ".csv"))]
        assert files and all((tmp_path / file).is_file() for file in files)
        result = smajax(*words)
        assert "Usage" not in result.output
        assert result.exit_code == (0 if words[0] == "check" else 1), result.output
    assert len(jobs) == len(lines) - 1
    topic = re.search(r"smajax (explain \S+)$", printed.partition("Note:")[0].strip())
    assert topic and smajax(*topic[1].split()).exit_code == 0


def test_check_describes_the_fit(bench):
    text = smajax("check", bench / "rig.toml", bench / "train.csv").stdout
    assert re.search(r"heat\.h0 +100\.6 W/m\^2/K +0 W/m\^2/K \.\. .* rig\.toml line \d+", text)
    assert "Fitted and scored: displacement; needed in a recording: current." in text
    assert "train.csv: 400 rows, 19.95 s, sample time 0.05 s" in text
    assert "current [mA] (input), displacement [mm] (observed)" in text


@pytest.mark.slow
def test_check_reads_controllers_and_sweeps_and_lists_effects(tmp_path):
    assert smajax("init", "dead-weight", "--out", tmp_path).exit_code == 0
    rig, controller, sweep = (tmp_path / f"{name}.toml" for name in ("example", "controller", "sweep"))
    text = rig.read_text("utf-8").replace("[fit]", '[effects.latent-heat]\nstrength = "80 MJ/m^3"\n\n[fit]', 1)
    rig.write_text(text, "utf-8")
    whole = smajax("check", rig, tmp_path / "train.csv", controller, sweep)
    assert whole.exit_code == 0, whole.output
    assert "Effects in the model: latent-heat (80 MJ/m^3)." in whole.stdout
    assert "Effects that it could have" in whole.stdout and "backlash" in whole.stdout
    assert "controller.toml: PID of displacement, every 20 ms, for example.toml" in whole.stdout
    assert re.search(r"^ +kp +30 +A/m +0.3 .. 3000$", whole.stdout, re.MULTILINE)
    assert "sweep.toml: 1,024 designs of example.toml" in whole.stdout
    assert "peak_temperature at most 120 degC" in whole.stdout and "strain_range at most 3.5 %" in whole.stdout
    assert "Limits of the material (flexinol): peak_stress at most 172 MPa for 1,000,000 cycles" in whole.stdout
    assert "Objective: 1 tracking + 0.01 effort + 1 overshoot. Limits: temperature at most 110 degC." in whole.stdout
    alone = smajax("check", sweep)
    assert alone.exit_code == 0 and "wire.diameter     0.1 mm .. 0.3 mm" in alone.stdout
    ambient = '[margins]\nvary = { "environment.ambient" = "3 K" }\n'
    (tmp_path / "margins.toml").write_text(sweep.read_text("utf-8") + ambient, "utf-8")
    with_margins = smajax("check", tmp_path / "margins.toml")
    assert with_margins.exit_code == 0, with_margins.output
    assert "highest_peak_temperature at most 120 degC" in with_margins.stdout
    robust = controller.read_text("utf-8") + '[robust]\nfit = "nowhere"\n'
    (tmp_path / "robust.toml").write_text(robust, "utf-8")
    assert "robust.fit: " in sentence(smajax("check", rig, tmp_path / "robust.toml"), 2)
    controller.write_text(controller.read_text("utf-8").replace("kp = ", "kpp = ", 1), "utf-8")
    assert "kpp" in sentence(smajax("check", rig, controller), 2)
    sweep.write_text(sweep.read_text("utf-8").replace("wire.diameter", "wire.diametre", 1), "utf-8")
    assert "wire.diametre" in sentence(smajax("check", rig, sweep), 2)
    assert "write smajax check RIG" in sentence(smajax("check", controller), 2)


def test_effects_and_sets_are_listed_with_units_sizes_and_sources():
    effects = smajax("effects").stdout
    for key, effect in catalogue().items():
        assert re.search(rf"^{key} +{effect.stage} ", effects, re.MULTILINE), key
    assert re.search(r"^latent-heat +heat +150 MJ/m\^3 +Flexinol data sheet", effects, re.MULTILINE)
    single = smajax("effects", "backlash").stdout
    assert "effects.backlash.strength" in single and "Source of the typical strength" in single
    assert "did you mean 'backlash'" in sentence(smajax("effects", "backlsh"), 2)
    sets = smajax("sets").stdout
    assert all(f"\n{name}: " in f"\n{sets}" for name in shipped_sets())
    values = smajax("sets", "flexinol").stdout
    assert re.search(r"^heat.capacity +5.40123 MJ/m\^3/K +- +Dynalloy F1140", values, re.MULTILINE)
    stock = smajax("sets", "smartflex").stdout
    assert re.search(r"^stress +153 MPa for 1,000,000 cycles +saes_smartflex", stock, re.MULTILINE)
    assert re.search(r"^strain +3.5 % +saes_smartflex", stock, re.MULTILINE)
    assert "Stock diameters of SmartFlex: 0.025 mm, " in stock
    assert "did you mean 'flexinol'" in sentence(smajax("sets", "flexinoll"), 2)


def test_bad_rows_are_dropped_on_request_only_and_counted(bench, tmp_path):
    rows = (bench / "train.csv").read_text().splitlines()
    rows[5] = rows[5].replace(",", ",x", 1)
    (tmp_path / "train.csv").write_text("\n".join(rows) + "\n")
    assert "row 6" in sentence(smajax("check", bench / "rig.toml", tmp_path / "train.csv"), 2)
    result = smajax("check", bench / "rig.toml", tmp_path / "train.csv", "--drop-bad-rows")
    assert result.exit_code == 0
    assert "1 of 400 rows with a blank or unreadable cell dropped on request: row 6" in result.stdout


def test_recordings_with_one_name_get_distinct_names(bench, tmp_path):
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "train.csv").write_bytes((bench / "more.csv").read_bytes())
    text = smajax("check", bench / "rig.toml", bench / "train.csv", tmp_path / "two" / "train.csv").stdout
    assert f"{bench.name}/train.csv: 400 rows" in text
    assert "two/train.csv: 400 rows" in text


def test_the_data_sets_are_listed_and_found(shared, monkeypatch):
    text = smajax("datasets").stdout
    assert "dead-weight: A wire that lifts 200 g\n    ships with smajax" in text
    assert re.search(
        r"^asmada-cyclic: .*\n    matthewkuner/ASMADA at 7ca153ccc8; licence: GNU General Public License v3\n",
        text,
        re.MULTILINE,
    )
    monkeypatch.setenv("SMAJAX_DATA", str(shared / "data"))
    assert smajax("datasets", "get", "bu-softlimb").stdout.strip() == str(shared / "data" / "bu-softlimb")
    assert "it holds holdout.csv, rig.toml, select.csv, train.csv" in smajax("datasets", "get", "dead-weight").stderr


def test_a_missing_argument_is_one_sentence_with_its_choices():
    message = sentence(smajax("init"), 2)
    assert "\\" not in message and "Choose from: dead-weight, bias-spring, " in message
