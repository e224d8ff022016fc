"""Results of experiments: JSON documents with date, running time, command, machine and versions.

``--json FILE`` writes a document with all numbers; ``--record`` writes it to ``experiments/results``, without the
single cases, under the name of the run. The benchmark pages of the documentation are made from that folder.
"""

import datetime
import json
import os
import platform
import sys
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

import smajax

EXPERIMENTS = Path(__file__).resolve().parents[1]
RESULTS = EXPERIMENTS / "results"
PACKAGES = ("jax", "numpy", "scipy", "equinox", "diffrax")
# Keys of a recorded document; others, such as the single cases, stay in the file of --json.
KEYS = ("experiment", "words", "command", "quick", "date", "seconds", "machine", "versions", "rows")
_STARTED = time.perf_counter()


def experiment_name() -> str:
    """Return the path of the running experiment below experiments/, without suffix, as in ``papers/hip/hip_gains``."""
    path = Path(sys.argv[0]).resolve().with_suffix("")
    return path.relative_to(EXPERIMENTS).as_posix() if path.is_relative_to(EXPERIMENTS) else path.name


def document_of(
    rows: list[dict[str, Any]], words: str, quick: bool, resumed: bool, seconds: float | None = None
) -> dict[str, Any]:
    """Return the document of a run that ends now.

    Args:
        rows: The lines of the table.
        words: Options that change the result, as they are written on the command line, with a blank before each.
        quick: Whether it is a quick run.
        resumed: Whether a part of the numbers is of an earlier run.
        seconds: Running time of all parts of a resumed run; ``None`` where it is not known.
    """
    name, own = experiment_name(), time.perf_counter() - _STARTED
    taken = seconds if resumed else own
    return {
        "experiment": name,
        "words": words,
        "command": f"python experiments/{name}.py{words}{' --quick' if quick else ''}",
        "quick": quick,
        "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
        "seconds": None if taken is None else round(taken, 1),
        "machine": _machine(),
        "versions": {"smajax": smajax.__version__, "python": platform.python_version()}
        | {package: version(package) for package in PACKAGES},
        "rows": rows,
    }


def result_name(document: dict[str, Any]) -> str:
    """Return the name of a run: its experiment, its options, and the accelerator if there was one."""
    words = [word.lstrip("-") for word in document["words"].split()]
    parts = [*document["experiment"].split("/"), *words]
    parts += ["accelerator"] * bool(document["machine"]["accelerator"]) + ["quick"] * document["quick"]
    return "-".join(parts)


def record(document: dict[str, Any]) -> Path:
    """Write a document to the folder of results, and return its path."""
    RESULTS.mkdir(exist_ok=True)
    path = RESULTS / f"{result_name(document)}.json"
    write(path, {key: document[key] for key in KEYS})
    return path


def write(path: Path, document: dict[str, Any]) -> None:
    """Write a document, so that a run that is stopped leaves no half of one."""
    partial_file = path.with_name(f".{path.name}.part")
    partial_file.write_text(json.dumps(document, indent=1, default=_to_json) + "\n", encoding="utf-8")
    os.replace(partial_file, path)


def _machine() -> dict[str, Any]:
    """The processor, the number of cores that this process may use, and the accelerator if JAX has one."""
    import jax

    device = jax.devices()[0]
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "accelerator": None if device.platform == "cpu" else device.device_kind,
    }


def _processor() -> str:
    path = Path("/proc/cpuinfo")
    lines = path.read_text("utf-8").splitlines() if path.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return f"{names[0]} ({platform.machine()})" if names else platform.processor() or platform.machine()


def _to_json(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
