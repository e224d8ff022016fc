"""What it buys that freed memory is kept for the next batch of closed loops, and that batches share the cores.

    python experiments/speed/allocator.py [--quick] [--json FILE] [--out DIR]

A population of gains of the shipped wire's controller is evaluated again and again, in processes of their own: batches
in one thread or in one per core, with the allocator as the system sets it and as ``smajax tune`` does
(``keep_freed_memory``). Times are per population, after one to warm up; all processes give the same numbers.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, arguments, finish, say

POPULATION = 48
# Largest ratio of the wall time on two cores, and of the time in the system, that counts as a gain.
GAIN = 0.7
# Evaluates populations; arguments: repeats, threads (0: one per core), whether freed memory is kept.
PROGRAM = """
import json, resource, sys, time
sys.path.insert(0, sys.argv[1])
repeats, workers, keeps = (int(word) for word in sys.argv[2:5])
from smajax.numerics import process
if keeps:
    process.keep_freed_memory()
process.prepare_jax()
from pathlib import Path
import jax.numpy as jnp, numpy as np
from smajax.control.controller_file.read import read_controller
from smajax.control.tuning.controller_problem import tuning_problem
from smajax.control.tuning.objective import make_objective
from smajax.control.tuning.problem import evaluate_points
from smajax.control.tuning.search import BATCH
from smajax.files.rig_file import read_rig
from smajax.numerics.ensemble import evaluate_members
data = Path(sys.argv[1]) / "data"
rig = read_rig(data / "recordings" / "dead-weight" / "rig.toml")
settings = read_controller(data / "controllers" / "dead-weight.toml", rig)
problem, objective = tuning_problem(settings, {}, 0), make_objective(settings.weights, settings.limits)
points = np.random.default_rng(0).uniform(size=(int(sys.argv[5]), len(problem.names)))
def evaluate():
    program = lambda batch: evaluate_points(problem, jnp.asarray(batch), objective)
    return evaluate_members(program, points, BATCH, workers=workers or None, new_program=True)
terms = evaluate()[0]
began, before = time.perf_counter(), resource.getrusage(resource.RUSAGE_SELF)
for _ in range(repeats):
    evaluate()
wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_SELF)
print(json.dumps({
    "wall": wall / repeats,
    "user": (after.ru_utime - before.ru_utime) / repeats,
    "system": (after.ru_stime - before.ru_stime) / repeats,
    "gibibytes": after.ru_maxrss / 2**20,
    "terms": terms.tolist(),
}))
"""


def measure(repeats: int, workers: int, keeps: bool) -> dict[str, Any]:
    """Return seconds of wall, user and system per population, peak memory in GiB, and the terms.

    Args:
        repeats: Number of populations.
        workers: Number of threads; 0 for one per core.
        keeps: Whether freed memory is kept.
    """
    words = [str(ROOT), str(repeats), str(workers), str(int(keeps)), str(POPULATION)]
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", PROGRAM, *words], capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    result = json.loads(done.stdout)
    say(f"{workers or 'all'} threads, freed memory {'kept' if keeps else 'returned'}: {result['wall']:.3f} s")
    return result


def main() -> None:
    """Print the table."""
    args = arguments(__doc__ or "")
    repeats = 5 if args.quick else 20
    kinds = {
        "one thread, freed memory returned": (1, False),
        "one thread, freed memory kept": (1, True),
        "a thread per core, freed memory returned": (0, False),
        "a thread per core, freed memory kept": (0, True),
    }
    measured = {name: measure(repeats, *kind) for name, kind in kinds.items()}
    first, last = (measured[name] for name in (next(iter(kinds)), list(kinds)[-1]))
    rows = [
        Row(
            f"{POPULATION} points: {name}",
            "-",
            f"{r['wall']:.3f} s; processor {r['user']:.3f} s, system {r['system']:.3f} s; {r['gibibytes']:.2f} GiB",
            None,
            {key: r[key] for key in ("wall", "user", "system", "gibibytes")},
        )
        for name, r in measured.items()
    ]
    same = all(r["terms"] == first["terms"] for r in measured.values())
    wall, system = last["wall"] / first["wall"], last["system"] / first["system"]
    rows += [
        Row("wall time of the last over the first", f"<= {GAIN:g}", f"{wall:.2f}", wall <= GAIN),
        Row("time in the system, the last over the first", f"<= {GAIN:g}", f"{system:.2f}", system <= GAIN),
        Row("equal numbers", "to the last digit", "yes" if same else "no", same),
    ]
    finish(rows, args)


if __name__ == "__main__":
    main()
