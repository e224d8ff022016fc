"""Steps, memory and time of fits through the command line, up to 200,000 rows.

    python experiments/fitting/fit_memory.py [--quick] [--json FILE] [--out DIR]

Each fit is ``python -m smajax fit`` in a separate process with an empty cache, so that the peak includes compiling.
Recordings are simulated with other parameters than the start values, and have white noise:

- 3,000 rows over ten minutes, and 200,000 rows at 50 Hz, of the shipped dead-weight rig, within 2 GiB.
- 12, 25 and 50 recordings of 10,000 rows each, within 4 GiB and in a time that is linear in their number.
- A path with a time column whose rows are a microsecond or an hour apart, irregular or repeated: the estimates, the
  time and the memory of the same path without a clock.
- Fits of other sizes, which end after two steps: the peak next to ``smajax.fitting.memory.fit_memory``, whose constants
  were chosen so that no estimate is far below the peak.
- Diagnoses of 2,000 and 20,000 rows: the peak next to ``smajax.diagnosis.memory.diagnosis_memory``.
"""

import json
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say
from experiments.common.memory import Peak, measure_peak

import numpy as np

from smajax import parameters
from smajax.diagnosis.memory import diagnosis_memory
from smajax.files.rig_file import Rig, read_rig
from smajax.fitting.memory import FitMemory, fit_memory
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate

GIB = 2**30
LIMIT = 2 * GIB
# The same for fifty recordings, and the growth of the time with their number that counts as linear, as for sweeps.
LARGEST, EXPONENT = 4 * GIB, 1.05
# An estimate may be as much too low as the share of the free memory that a fit does not take.
LOWEST_ESTIMATE = 0.8
# Standard deviations of the noise, SI.
NOISE = {"displacement": 2e-5, "angle": 2e-3, "strain": 1e-5}
# Differences of the truth from the start values.
TRUTH = {"material.max_transformation_strain": 0.044, "material.martensite_shift": 3.0}
# Seconds for which a current stays.
SHORTEST, LONGEST = 4.0, 12.0


class Size(NamedTuple):
    """A fit whose peak is measured.

    Attributes:
        rig: Name of the rig.
        rows: Rows of each recording.
        period: Seconds from row to row.
        recordings: Number of recordings.
        starts: Number of starts.
        free: Number of free parameters; all of the rig where 0.
    """

    rig: str
    rows: int
    period: float
    recordings: int = 1
    starts: int = 1
    free: int = 0


SIZES = (
    Size("dead-weight", 100, 0.02),
    Size("dead-weight", 50_000, 0.02),
    Size("dead-weight", 200_000, 0.02),
    Size("dead-weight", 50_000, 0.02, starts=4),
    Size("dead-weight", 200_000, 0.02, starts=4),
    Size("dead-weight", 200_000, 0.02, starts=4, free=2),
    Size("dead-weight", 20_000, 0.2),
    Size("dead-weight", 20_000, 0.2, starts=4),
    Size("dead-weight", 50_000, 0.02, recordings=4, starts=2),
    Size("rotary", 100, 0.02),
    Size("rotary", 100_000, 0.02),
    Size("rotary", 100_000, 0.02, starts=4),
    Size("isobaric", 100_000, 1.0, starts=4),
)
QUICK_SIZES = (SIZES[0], SIZES[3])


def shipped_rig(name: str) -> Rig:
    """Return the rig of a folder of data/recordings, with inputs that are held between samples."""
    return replace(read_rig(ROOT / "data" / "recordings" / name / "rig.toml"), interpolation="hold")


def made_recording(rig: Rig, name: str, rows: int, period: float, seed: int = 0) -> Recording:
    """Return a recording of a rig: random currents, or cycles of temperature, and the response with noise.

    Args:
        rig: The rig.
        name: Name of the recording.
        rows: Number of rows.
        period: Seconds from row to row.
        seed: Seed of currents and noise.
    """
    random, time, channels = np.random.default_rng(seed), period * np.arange(rows), {}
    if rig.kind == "path":
        channels["temperature"] = 65.0 - 45.0 * np.cos(2.0 * np.pi * np.arange(rows) / 500.0)
        channels["stress"] = np.repeat(random.uniform(60e6, 200e6, -(-rows // 500)), 500)[:rows]
    else:
        for k, signal in enumerate(rig.plant.signals):
            lengths = np.ceil(random.uniform(SHORTEST, LONGEST, rows) / period).astype(int)
            levels = np.where(np.arange(rows) % 3 == k, random.uniform(0.2, 0.33, rows), 0.0)
            channels[signal] = np.repeat(levels, lengths)[:rows]
    observed = {c: np.zeros(rows) for c in rig.fit.observe}
    recording = Recording.from_arrays(name, time, channels | observed)
    plant = parameters.replace(rig.plant, TRUTH)
    response = simulate(plant, recording, interpolation=rig.interpolation).channels
    noisy = {c: np.asarray(response[c]) + NOISE[c] * random.standard_normal(rows) for c in observed}
    return Recording.from_arrays(name, time, channels | noisy)


def write_case(folder: Path, rig: Rig, recordings: list[Recording]) -> list[str]:
    """Write a rig and its recordings; return the arguments of ``smajax fit`` for them."""
    folder.mkdir()
    (folder / "rig.toml").write_text(rig.to_toml(), "utf-8")
    for recording in recordings:
        recording.write(folder / recording.name)
    return [str(folder / "rig.toml"), *(str(folder / r.name) for r in recordings), "--out", str(folder / "out")]


def run(command: str, files: list[str], *options: str) -> Peak:
    """Run a command of smajax; return its measured peak."""
    peak = measure_peak([sys.executable, "-m", "smajax", command, *files, *options], {"PYTHONPATH": str(ROOT)})
    if peak.code:
        raise RuntimeError(peak.output)
    return peak


def run_fit(folder: Path, rig: Rig, recordings: list[Recording], *options: str) -> tuple[Peak, dict[str, Any]]:
    """Fit through the command line; return the measured peak and the document of the fit."""
    peak = run("fit", write_case(folder, rig, recordings), *options)
    return peak, json.loads((folder / "out" / "fit.json").read_text("utf-8"))


def estimated(rig: Rig, recordings: list[Recording]) -> FitMemory:
    """Return the steps and the memory that ``smajax check`` says."""
    settings: Any = rig.fit
    return fit_memory(rig.plant, recordings, settings, interpolation=rig.interpolation)


def long_recording(folder: Path, rows: int, period: float) -> Row:
    """Fit a long recording of a dead-weight rig to its end."""
    rig = shipped_rig("dead-weight")
    recording = made_recording(rig, "made.csv", rows, period)
    peak, document = run_fit(folder, rig, [recording])
    memory = estimated(rig, [recording])
    error, unit = (document["rmse"]["displacement"][key] for key in ("train", "unit"))
    text = (
        f"{memory.steps:,} steps, peak {peak.memory / GIB:.2f} GiB ({memory.batch / GIB:.2f} estimated), "
        f"{peak.seconds:.0f} s, {document['solver']['code']}, RMSE {error:.3g} {unit}"
    )
    numbers = {"rows": rows, "steps": memory.steps, "peak": peak.memory, "seconds": peak.seconds, "rmse": error}
    met = peak.memory < LIMIT and document["solver"]["code"] == "converged"
    return Row(f"{rows:,} rows, {period:g} s apart", "converged within 2 GiB", text, met, numbers)


def many_recordings(folder: Path, counts: tuple[int, ...], rows: int) -> list[Row]:
    """Fit several numbers of recordings of a dead-weight rig to the end."""
    rig, peaks = shipped_rig("dead-weight"), []
    recordings = [made_recording(rig, f"{k}.csv", rows, 0.02, k) for k in range(counts[-1])]
    for count in counts:
        say(f"{count} recordings of {rows:,} rows ...")
        peak, document = run_fit(folder / f"several{count}", rig, recordings[:count])
        if document["solver"]["code"] != "converged":
            raise RuntimeError(f"the fit to {count} recordings ended with {document['solver']['code']}")
        peaks.append(peak)
    more, longer = np.diff(counts), np.diff([peak.seconds for peak in peaks])  # without compiling
    exponent = float(np.log(longer[-1] / longer[0]) / np.log(more[-1] / more[0]))
    memory = [f"{count}: {peak.memory / GIB:.2f} GiB" for count, peak in zip(counts, peaks, strict=True)]
    seconds = [f"{count}: {peak.seconds:.0f} s" for count, peak in zip(counts, peaks, strict=True)]
    what, numbers = f"recordings of {rows:,} rows each", [peak._asdict() | {"output": ""} for peak in peaks]
    met = peaks[-1].memory <= LARGEST
    return [
        Row(f"{what}: memory", f"<= {LARGEST / GIB:.0f} GiB", ", ".join(memory), met, {"peaks": numbers}),
        Row(f"{what}: time", "-", ", ".join(seconds), None),
        Row(
            f"{what}: growth of the time, compiling left out",
            f"exponent <= {EXPONENT}",
            f"{exponent:.2f}",
            exponent <= EXPONENT,
        ),
    ]


def clocks(folder: Path, rows: int, count: int = 4) -> list[Row]:
    """Fit one path without a clock, and with several; the first ``count`` of them all."""
    rig = shipped_rig("isobaric")
    timed = made_recording(rig, "path.csv", rows, 1.0)
    random = np.random.default_rng(1)
    times = {
        "no clock": None,
        "1 us apart": 1e-6 * np.arange(rows),
        "1 h apart": 3600.0 * np.arange(rows),
        "irregular, repeated": np.cumsum(random.choice([0.0, 1e-3, 1.0, 600.0], rows)),
    }
    results, lines = {}, []
    for name, time in list(times.items())[:count]:
        say(f"path, {name} ...")
        recording = Recording.from_arrays("path.csv", time, timed.channels)
        peak, document = run_fit(folder / name.replace(" ", "-"), rig, [recording])
        estimates = {key: entry["estimate"] for key, entry in document["parameters"].items()}
        results[name] = (peak, estimates)
        first, same = results["no clock"], estimates == results["no clock"][1]
        text = f"peak {peak.memory / GIB:.2f} GiB, {peak.seconds:.0f} s, {'same' if same else 'other'} estimates"
        met = same and peak.memory < 1.1 * first[0].memory
        numbers = {"rows": rows, "peak": peak.memory, "seconds": peak.seconds, "estimates": estimates}
        lines.append(
            Row(f"path of {rows:,} rows, {name}", "estimates and memory as without a clock", text, met, numbers)
        )
    return lines


def size_row(folder: Path, size: Size) -> Row:
    """Measure the peak of a fit of two steps, next to its estimate."""
    say(f"{size} ...")
    rig = shipped_rig(size.rig)
    free = rig.fit.free[: size.free or len(rig.fit.free)]
    rig = replace(rig, fit=replace(rig.fit, starts=size.starts, free=free))
    recordings = [made_recording(rig, f"{k}.csv", size.rows, size.period, k) for k in range(size.recordings)]
    peak, _ = run_fit(folder, rig, recordings, "--max-steps", "2")
    memory = estimated(rig, recordings)
    ratio = memory.batch / peak.memory
    text = f"{memory.steps:,} steps, peak {peak.memory / GIB:.3f} GiB, estimated {memory.batch / GIB:.3f} ({ratio:.2f})"
    numbers = size._asdict() | {"unknowns": len(free), "steps": memory.steps, "peak": peak.memory, "ratio": ratio}
    what = f"{size.rig}, {size.recordings} x {size.rows:,} rows, {size.starts} starts, {len(free)} free"
    return Row(what, f"estimate at least {LOWEST_ESTIMATE} of the peak", text, ratio > LOWEST_ESTIMATE, numbers)


def diagnosis_row(folder: Path, rows: int, period: float) -> Row:
    """Measure the peak of a diagnosis, next to its estimate."""
    say(f"diagnosis of {rows:,} rows ...")
    rig = shipped_rig("dead-weight")
    recordings = [made_recording(rig, f"{k}.csv", rows, period, k) for k in range(3)]
    rig_file, train, select, holdout, *out = write_case(folder, rig, recordings)
    peak = run("diagnose", [rig_file, train, "--select", select, "--holdout", holdout, *out])
    steps, size = diagnosis_memory(rig.plant, recordings, interpolation=rig.interpolation)
    ratio = size / peak.memory
    text = f"{steps:,} steps, peak {peak.memory / GIB:.3f} GiB, estimated {size / GIB:.3f} ({ratio:.2f})"
    numbers = {"rows": rows, "steps": steps, "peak": peak.memory, "seconds": peak.seconds, "ratio": ratio}
    target = f"estimate at least {LOWEST_ESTIMATE} of the peak"
    return Row(f"diagnosis, 3 x {rows:,} rows", target, text, ratio > LOWEST_ESTIMATE, numbers)


def main() -> None:
    """Run the experiment."""
    options = arguments(__doc__)
    with tempfile.TemporaryDirectory() as directory:
        folder = Path(directory)
        rows = [size_row(folder / f"size{k}", s) for k, s in enumerate(QUICK_SIZES if options.quick else SIZES)]
        rows += clocks(folder, 200, 2) if options.quick else clocks(folder, 3_000)
        for count, period in ((3_000, 0.2),) if options.quick else ((3_000, 0.2), (200_000, 0.02)):
            say(f"{count:,} rows ...")
            rows.append(long_recording(folder / f"long{count}", count, period))
        rows += many_recordings(folder, *(((2, 4, 8), 1_000) if options.quick else ((12, 25, 50), 10_000)))
        if not options.quick:
            rows += [diagnosis_row(folder / f"diagnosis{n}", n, p) for n, p in ((2_000, 0.05), (20_000, 0.02))]
    finish(rows, options)


if __name__ == "__main__":
    main()
