"""Seconds of a command in a process of its own, by what it does: importing, reading, tracing, compiling, running.

JAX reports the duration of each tracing, lowering and compilation, and each program taken from the cache
(``jax.monitoring``). Imports are timed around ``__import__``. The rest of the time is that of the phase that the
command shows.
"""

import compileall
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from experiments.common.base import ROOT

# Kinds of time in the order in which one counts where several overlap, such as an import while a program is traced.
KINDS = ("import", "compiling", "lowering", "tracing", "reading", "writing", "running")
# Runs a command, and writes the intervals of each kind, counts and peak memory to the file that its first argument
# names. JAX reports a duration at its end.
_WATCHER = """
import builtins, json, resource, sys, time
BEGAN = time.perf_counter()
target = sys.argv.pop(1)
EVENTS = {
    "/jax/core/compile/jaxpr_trace_duration": "tracing",
    "/jax/core/compile/jaxpr_to_mlir_module_duration": "lowering",
    "/jax/core/compile/backend_compile_duration": "compiling",
}
spans, counts, depth, plain_import = [], {"programs": 0, "hits": 0}, [0], builtins.__import__

def timed_import(name, *rest, **named):
    if depth[0]:
        return plain_import(name, *rest, **named)
    first = time.perf_counter()
    depth[0] += 1
    try:
        return plain_import(name, *rest, **named)
    finally:
        depth[0] -= 1
        spans.append(("import", first, time.perf_counter()))
        if "jax" in sys.modules and not counts.get("listens"):
            listen()

def listen():
    monitoring = getattr(sys.modules["jax"], "monitoring", None)
    if monitoring is None or not hasattr(monitoring, "register_event_duration_secs_listener"):
        return
    counts["listens"] = 1

    def on_duration(event, seconds, **_):
        if event in EVENTS:
            last = time.perf_counter()
            spans.append((EVENTS[event], last - seconds, last))
            counts["programs"] += EVENTS[event] == "compiling"

    def on_event(event, **_):
        counts["hits"] += event == "/jax/compilation_cache/cache_hits"

    monitoring.register_event_duration_secs_listener(on_duration)
    monitoring.register_event_listener(on_event)

builtins.__import__ = timed_import
phases = []
class Phases:
    def write(self, text):
        if text.startswith("smajax: "):
            phases.append((text[8:].split(":")[0].strip(), time.perf_counter()))
        return len(text)
    def flush(self): pass
    def isatty(self): return False
    def fileno(self): return 2
    encoding = "utf-8"
    errors = "replace"
sys.stderr = Phases()
code = 0
try:
    from smajax.__main__ import main
    main()
except SystemExit as end:
    code = end.code or 0
finally:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    report = {"code": code, "spans": spans, "phases": phases, "began": BEGAN, "ended": time.perf_counter(),
              "peak": 1024 * usage.ru_maxrss, **counts}
    with open(target, "w") as file:
        json.dump(report, file)
"""


@dataclass(frozen=True)
class ProcessTimes:
    """A command that has ended.

    Attributes:
        code: Exit code.
        wall: Seconds of the whole process.
        processor: Seconds of processor time of the whole process.
        seconds: Seconds by kind, of ``KINDS``.
        programs: Number of programs that were compiled or taken from the cache.
        cached: Number of those taken from the cache.
        peak: Largest resident set, bytes.
    """

    code: int
    wall: float
    processor: float
    seconds: Mapping[str, float]
    programs: int
    cached: int
    peak: int

    def text(self) -> str:
        """Return the times and counts in words."""
        parts = ", ".join(f"{kind} {self.seconds[kind]:.1f}" for kind in KINDS if self.seconds[kind] >= 0.05)
        counts = f"; {self.programs} programs, {self.cached} of them from the cache" if self.programs else ""
        return f"{self.wall:.2f} s: {parts}{counts}; {self.peak / 2**30:.2f} GiB"


def compile_package() -> None:
    """Compile the sources of smajax to bytecode as an installation does, so that no command that is timed does it."""
    compileall.compile_dir(str(ROOT / "smajax"), quiet=1)


def measure(words: Sequence[str], folder: Path, cache: Path) -> ProcessTimes:
    """Run a command of smajax in a process of its own.

    Args:
        words: The command and its arguments.
        folder: Working folder.
        cache: Folder of the compilation cache.
    """
    with tempfile.TemporaryDirectory() as scratch:
        target = Path(scratch) / "times.json"
        variables = {"JAX_COMPILATION_CACHE_DIR": str(cache), "PYTHONPATH": str(ROOT)}
        call = [sys.executable, "-c", _WATCHER, str(target), *words]
        before = os.times()
        subprocess.run(call, cwd=folder, env=os.environ | variables, stdout=subprocess.DEVNULL, check=False)
        after = os.times()
        report = json.loads(target.read_text("utf-8"))
    wall = after.elapsed - before.elapsed
    processor = after.children_user - before.children_user + after.children_system - before.children_system
    seconds = _by_kind(report)
    # Start and end of Python itself.
    seconds["import"] += wall - (report["ended"] - report["began"])
    return ProcessTimes(report["code"], wall, processor, seconds, report["programs"], report["hits"], report["peak"])


def median_of(runs: Sequence[ProcessTimes]) -> ProcessTimes:
    """Return the run with the median wall time, the slower one of two."""
    middle = statistics.median_high([run.wall for run in runs])
    return next(run for run in runs if run.wall == middle)


def _by_kind(report: Mapping) -> dict[str, float]:
    """Return the seconds by kind: each moment counts once, for the first of the kinds that it belongs to."""
    spans = [(kind, first, last) for kind, first, last in report["spans"]]
    ends = [*[first for _, first in report["phases"]], report["ended"]][1:]
    spans += [(_kind_of(words), first, last) for (words, first), last in zip(report["phases"], ends, strict=True)]
    times = sorted({t for _, first, last in spans for t in (first, last)} | {report["began"], report["ended"]})
    changes = sorted([(first, 1, kind) for kind, first, _ in spans] + [(last, -1, kind) for kind, _, last in spans])
    seconds, active, position = dict.fromkeys(KINDS, 0.0), dict.fromkeys(KINDS, 0), 0
    for first, last in itertools.pairwise(times):
        while position < len(changes) and changes[position][0] <= first:
            active[changes[position][2]] += changes[position][1]
            position += 1
        kind = next((kind for kind in KINDS if active[kind]), "running")
        seconds[kind] += last - first
    return seconds


def _kind_of(phase: str) -> str:
    """Return the kind of a phase that a command shows."""
    return "reading" if phase in ("loading", "reading") else "writing" if phase.startswith("writing") else "running"
