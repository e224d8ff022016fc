"""The exported C header in the loop: on the plant's NumPy text, with ten draws of the noise, and on an Arduino."""

import ctypes
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from smajax.control.analysis.case_check import CaseCheck, check_cases
from smajax.control.analysis.cases import make_cases
from smajax.control.analysis.closed_loop_checks import evaluate_gains, rollout_metrics, violated_limits
from smajax.control.analysis.reachable_range import reachable_range
from smajax.control.controller_file.read import ControllerFile, read_controller
from smajax.control.export.files import export_files
from smajax.control.export.fmu.plant_model import plant_model
from smajax.control.loop.gains import gain
from smajax.control.tuning.tuning_study import ControllerTuning
from smajax.files.rig_file import read_rig
from smajax.report.tune_document import tune_document
from tests.conftest import ROOT
from tests.unit.control.test_fmu import module
from tests.unit.control.test_tuning import FILE, RIG

# The derivative of the error shows how the loop starts.
GAINS = 'kp = "60 A/m"\nki = "40 A/m/s"\nkd = "0.5 A s/m"\nfilter_time = "100 ms"'
CONTENT = (
    FILE.replace('kp = "30 A/m"\nki = "10 A/m/s"', GAINS) + '[limits]\novershoot = "8 %"\n[sensor]\nnoise = "5 um"\n'
)
NOISE = 5e-6
SEEDS = 10
# Size of the measurement program with the controller, and cycles of a sample, on an ATmega328P (32 KiB, 16 MHz).
MOST_BYTES = 6_000
MOST_CYCLES = 8_000


class Printed(NamedTuple):
    """What the command writes and prints for gains without a search."""

    settings: ControllerFile
    check: CaseCheck
    document: dict[str, Any]
    folder: Path


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """Document, check and exported files of the gains of a controller file."""
    folder, rig = tmp_path_factory.mktemp("c_loop"), read_rig(RIG)
    (folder / "controller.toml").write_text(CONTENT)
    settings = read_controller(folder / "controller.toml", rig)
    own = {name: float(gain(settings.loop, name)) for name in settings.bounds}
    evaluation, check = evaluate_gains(settings, own), check_cases(settings, own, make_cases(settings, {}, True, 0))
    reachable = reachable_range(settings.system, settings.loop, settings.scenario, settings.limits)
    study = ControllerTuning(
        rig,
        settings,
        settings.weights,
        0,
        evaluation,
        evaluation,
        1,
        {},
        reachable,
        None,
        False,
        case_checks={"start": check, "tuned": check},
    )
    (folder / "controller.h").write_bytes(export_files(study).contents["controller.h"])
    return Printed(settings, check, tune_document(study), folder)


def c_controller(folder):
    """Functions ``begin`` and ``command`` of the exported header, with the start of its example."""
    (folder / "loop.c").write_text(
        '#include "controller.h"\nstatic smajax_state s;\n'
        "void begin(double value) { smajax_reset(&s, SMAJAX_START, value); }\n"
        "double command(double reference, double value) { return smajax_step(&s, reference, value); }\n"
    )
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-ffp-contract=off", "-shared", "-fPIC"]
    subprocess.run(["cc", *flags, "-o", "loop.so", "loop.c", "-lm"], cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "loop.so"))
    library.begin.argtypes, library.begin.restype = [ctypes.c_double], None
    library.command.argtypes, library.command.restype = [ctypes.c_double] * 2, ctypes.c_double
    return library.begin, library.command


def steps_of_loop(settings, library, noise):
    """Channels at the samples, and commands, of the C controller on the NumPy text of the plant's FMU."""
    plant, period = settings.system.plant, settings.system.period
    model = plant_model(plant, "wire")
    text, (begin, command) = module(model), library
    values = [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    substeps = settings.system.substeps
    state, rows, commands = list(text["start"](values, [np.float64(0.0)])), [], []
    place = plant.observable.index("displacement")
    last = np.float64(0.0)
    with np.errstate(invalid="ignore"):  # inf * 0 in the branch that np.where discards, as in JAX
        for k, reference in enumerate(np.asarray(settings.scenario.reference)):
            rest = text["outputs"](values, state, [last])
            measured = float(rest[place]) + noise[k]
            if k == 0:
                begin(measured)
            last = np.float64(command(float(reference), measured))
            rows.append([float(v) for v in text["outputs"](values, state, [last])])
            commands.append([float(last)])
            for _ in range(substeps):
                *state, failed = text["advance"](values, state, [last], np.float64(period / substeps))
                assert not failed
    table = np.array(rows)
    return {name: table[:, i] for i, name in enumerate(plant.observable)}, np.array(commands)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler here")
def test_the_c_header_gives_the_printed_metrics_for_ten_draws_of_the_noise(printed):
    """The rollout of the file, and ten cases of the check: each has the metrics that the command prints or keeps."""
    settings, check, document, folder = printed
    library = c_controller(folder)
    own = steps_of_loop(settings, library, NOISE * np.asarray(settings.scenario.draws))
    found = rollout_metrics(settings, *own)
    for name, value in document["metrics"]["tuned"].items():
        assert found[name] == pytest.approx(np.inf if value is None else value, rel=2e-3), name
    noisy = [k for k, case in enumerate(check.cases) if case.group == "noise"][:SEEDS]
    assert len(noisy) == SEEDS
    for k in noisy:
        metrics = rollout_metrics(settings, *steps_of_loop(settings, library, NOISE * check.cases[k].noise))
        assert violated_limits(settings.limits, metrics) == [n for n, rows in check.beyond.items() if k in rows]
        for name in ("rmse", "overshoot", "peak_temperature"):
            assert metrics[name] == pytest.approx(check.metrics[k][name], rel=1e-2), (name, k)
            assert metrics[name] <= document["case_check"]["worst"][name]["value"] * (1.0 + 1e-3)


@pytest.mark.slow
def test_a_start_at_another_reference_is_another_loop(printed):
    """The derivative of the error has a kick where the loop begins below its first reference; cases have all starts."""
    settings, check, _, folder = printed
    start = float(settings.scenario.initial_reference)
    assert f"#define SMAJAX_START ((smajax_real){start!r})" in (folder / "controller.h").read_text()
    starts = [case._replace(noise=0.0 * case.noise) for case in check.cases if case.group == "start"]
    metrics = check_cases(settings, {}, starts).metrics
    errors = {case.name: values["rmse"] for case, values in zip(starts, metrics, strict=True)}
    assert len(errors) == 3 and np.min(np.abs(np.diff(sorted(errors.values())))) > 1e-9


def avr_reason() -> str:
    """Why the Arduino cannot be simulated here; empty if it can."""
    missing = [tool for tool in ("avr-gcc", "avr-size", "simavr") if shutil.which(tool) is None]
    return f"not installed: {', '.join(missing)} (Debian: gcc-avr, avr-libc, simavr)" if missing else ""


@pytest.mark.slow
@pytest.mark.skipif(bool(avr_reason()), reason=avr_reason())
def test_the_header_runs_on_an_arduino(printed, tmp_path):
    """In single precision on a simulated ATmega328P: the commands are those in double precision, within a milliampere."""
    folder = printed.folder
    for name, source in (
        ("controller.h", folder / "controller.h"),
        ("main.c", ROOT / "tests" / "support" / "avr_main.c"),
    ):
        shutil.copy(source, tmp_path / name)
    flags = ["-std=c99", "-Wall", "-Wextra", "-Wdouble-promotion", "-Werror", "-Os", "-mmcu=atmega328p"]
    subprocess.run(["avr-gcc", *flags, "-o", "main.elf", "main.c"], cwd=tmp_path, check=True)
    size = subprocess.run(["avr-size", "main.elf"], cwd=tmp_path, check=True, capture_output=True, text=True).stdout
    text, data, bss = map(int, size.splitlines()[1].split()[:3])
    simulated = subprocess.run(
        ["simavr", "-m", "atmega328p", "-f", "16000000", "main.elf"],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    # The simulator colours the output of the serial port, and breaks its lines.
    output = re.sub(r"\x1b\[\d*m|\n", "", simulated.stdout + simulated.stderr)
    *microamperes, cycles = map(int, re.findall(r"-?\d+", output)[-101:])
    print(f"ATmega328P: {text + data} bytes of flash, {data + bss} bytes of RAM, {cycles} cycles a sample")
    begin, command = c_controller(folder)
    begin(0.0)
    expected = [command(3e-3, 4e-5 * k) for k in range(100)]
    np.testing.assert_allclose(np.array(microamperes) * 1e-6, expected, atol=1e-3)
    assert np.ptp(expected) > 0.05 and text + data < MOST_BYTES and 500 < cycles < MOST_CYCLES
