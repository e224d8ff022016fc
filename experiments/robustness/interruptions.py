"""Commands that are interrupted and killed at random moments: earlier results stay whole, and no half folder is left.

    python experiments/robustness/interruptions.py [--quick] [--json FILE] [--record] [--out DIR] [--commands A,B]

fit, diagnose, compare, tune and sweep run once undisturbed. Then each runs again into the folder of that result, and at
a random moment it gets SIGINT (Ctrl-C), SIGINT twice, or SIGKILL. Afterwards the folder has to be the earlier result,
byte for byte, or a complete new one; nothing else may be next to it but what the next run removes or resumes. Ctrl-C
has to end with the exit code 130 (or that of the complete result) and one sentence, a second one at once. Each sweep is
resumed at the end, and its table has to be that of the undisturbed one, byte for byte. With ``--out DIR`` a command
that is done is not done again.
"""

import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, Row, add_case, arguments, finish, read_cases, say, total_seconds

COMMANDS = {
    "fit": ["fit", "example.toml", "train.csv", "--holdout", "holdout.csv"],
    "sweep": ["sweep", "sweep.toml"],
    "compare": ["compare", "example.toml", "train.csv", "--holdout", "holdout.csv", "--models", "brinson,tanaka"],
    "tune": ["tune", "example.toml", "controller.toml"],
    "diagnose": ["diagnose", "example.toml", "train.csv", "--select", "select.csv", "--holdout", "holdout.csv"],
}
# Seconds within which a run ends after a second Ctrl-C: the signal is handled between two instructions of Python.
AT_ONCE = 5.0
# Rows of the recordings, so that a run takes some ten seconds.
ROWS = 240
# Seconds after which a run that does not end is a fault, on a busy machine.
LONGEST = 900.0
WAYS = ("ctrl-c", "kill", "ctrl-c twice", "kill")
ENDED = "ended before"


def start(folder: Path, words: list[str], out: str, *options: str) -> subprocess.Popen:
    """Start a command as a user does, in its own process group.

    Args:
        folder: Folder of its files.
        words: The command.
        out: Name of the result folder.
        *options: Further options.
    """
    call = [sys.executable, "-c", "import signal; signal.signal(signal.SIGINT, signal.default_int_handler);"
            " from smajax.__main__ import main; main()", *words, "--out", out, *options]  # fmt: skip
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(call, cwd=folder, env=environment, start_new_session=True, **pipes)


def content(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder with their bytes."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())} if folder.is_dir() else {}


def is_complete(files: dict[str, bytes]) -> bool:
    """Return whether the files are those of a complete result: all that run.json names, whose JSON can be read."""
    try:
        run = json.loads(files["run.json"])
        for name in files:
            if name.endswith(".json"):
                json.loads(files[name])
    except (KeyError, ValueError):
        return False
    return set(run["files"]) == set(files) and b"</html>" in files.get("report.html", b"</html>")


def interrupt(folder: Path, command: str, way: str, span: float) -> dict[str, object]:
    """Run a command and end it at a random moment; return what was found.

    Args:
        folder: Folder of its files, with the earlier result in ``out``.
        command: Name of the command.
        way: One of ``WAYS``.
        span: Seconds that the undisturbed command takes.
    """
    before, names = content(folder / "out"), set(os.listdir(folder))
    process = start(folder, COMMANDS[command], "out", *(("--resume",) if (folder / "out.partial").exists() else ()))
    moment = random.uniform(0.0, 1.0) * span
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=moment)
    alive = process.poll() is None
    sent = time.perf_counter()
    if alive and way == "kill":
        os.killpg(process.pid, signal.SIGKILL)
    elif alive:
        os.kill(process.pid, signal.SIGINT)
        if way == "ctrl-c twice":
            time.sleep(random.uniform(0.0, 0.3))
            if process.poll() is None:
                os.kill(process.pid, signal.SIGINT)
                sent = time.perf_counter()
    try:
        _, errors = process.communicate(timeout=LONGEST)
    except subprocess.TimeoutExpired:
        os.killpg(process.pid, signal.SIGKILL)
        _, errors = process.communicate()
        errors += "\nhangs"
    seconds = time.perf_counter() - sent
    after = content(folder / "out")
    others = set(os.listdir(folder)) - names - {"out.partial"}
    hidden = {name for name in others if name.startswith(".out.") and name.endswith(".part")}
    last = [line for line in errors.strip().splitlines() if line][-1:] or [""]
    # Python that is starting or ending leaves Ctrl-C to the system, whose code a shell shows as 130, too.
    codes = (0, -signal.SIGKILL) if way == "kill" else (0, 3, 130, -signal.SIGINT)
    code_is_good = process.returncode in codes
    is_starting = "smajax:" not in errors
    problems = {
        "result": after != before and not is_complete(after),
        "left": bool(others - hidden) or (bool(hidden) and way != "kill"),
        "code": not code_is_good or "hangs" in errors,
        "sentence": process.returncode == 130 and not last[0].startswith("smajax: "),
        "traceback": ("Traceback" in errors and not is_starting) or "fault in smajax" in errors,
        "slow": way == "ctrl-c twice" and alive and seconds > AT_ONCE,
    }
    for name in hidden:  # what the next run removes when it is an hour old
        shutil.rmtree(folder / name, ignore_errors=True)
    found = [name for name, is_problem in problems.items() if is_problem]
    say(f"{command} {way} at {moment:.1f} s: code {process.returncode}, {seconds:.1f} s, {found or 'good'}")
    if found:
        say(errors[-2000:])
    return {"way": way if alive else ENDED, "problems": found, "hidden": len(hidden), "seconds": seconds}


def interrupt_command(folder: Path, command: str, count: int) -> tuple[list[dict[str, object]], bool]:
    """Interrupt a command many times; return what was found, and whether its table is that of the undisturbed run.

    Args:
        folder: Folder of its files.
        command: Name of the command.
        count: How often a run is interrupted; those that end before do not count.
    """
    begin = time.perf_counter()
    start(folder, COMMANDS[command], "out").communicate()
    start_again = time.perf_counter()
    start(folder, COMMANDS[command], "again").communicate()  # with programs from the cache, as the runs below
    span = time.perf_counter() - start_again
    say(f"{command}: {start_again - begin:.1f} s, then {span:.1f} s")
    whole, again = content(folder / "out"), content(folder / "again")
    assert is_complete(whole) and is_complete(again), command
    shutil.rmtree(folder / "again")
    found: list[dict[str, object]] = []
    while sum(entry["way"] != ENDED for entry in found) < count:
        found.append(interrupt(folder, command, WAYS[len(found) % len(WAYS)], span))
    same = True
    if command == "sweep":
        resume = ["--resume"] if (folder / "out.partial").exists() else []
        start(folder, COMMANDS[command], "out", *resume).communicate()
        same = content(folder / "out").get("sweep.parquet") == whole["sweep.parquet"]
        same = same and not (folder / "out.partial").exists()
    return found, same


def write_files(folder: Path) -> None:
    """Write a small example of each command: short recordings, a short loop, few designs.

    Args:
        folder: Folder of the files.
    """
    call = [sys.executable, "-m", "smajax", "init", "dead-weight", "--out", str(folder)]
    subprocess.run(call, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
    for part in ("train", "select", "holdout"):
        path = folder / f"{part}.csv"
        path.write_text("".join(path.read_text("utf-8").splitlines(keepends=True)[:ROWS]), "utf-8")
    controller, sweep = (folder / name for name in ("controller.toml", "sweep.toml"))
    text = controller.read_text("utf-8").replace('"60 s"', '"6 s"').replace('"20 s"', '"2 s"')
    controller.write_text(re.sub("starts = 4 ", "starts = 1\ncheck = 1 ", text), "utf-8")
    text = sweep.read_text("utf-8").replace("designs = 1024 ", "designs = 4096\nchunk = 64 ")
    sweep.write_text(text.partition("[refine]")[0], "utf-8")


def examine(command: str, count: int) -> dict:
    """Interrupt a command in a folder of its own, and return what was found.

    Args:
        command: Name of the command.
        count: How often.
    """
    random.seed(command)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_files(folder)
        found, same = interrupt_command(folder, command, count)
    ways = Counter(str(entry["way"]) for entry in found)
    problems = Counter(problem for entry in found for problem in entry["problems"])  # type: ignore[attr-defined]
    return {"command": command, "ways": dict(ways), "problems": dict(problems), "same": same}


def rows_of(case: dict) -> list[Row]:
    """Return the lines of a command.

    Args:
        case: What was found, as ``examine`` returns it.
    """
    ways = case["ways"]
    count = sum(ways.values()) - ways.get(ENDED, 0)
    text = f"{case['problems'] or 'none'} ({', '.join(f'{number} {way}' for way, number in sorted(ways.items()))})"
    rows = [Row(f"{case['command']}: problems of {count} interruptions", "none", text, not case["problems"], ways)]
    if case["command"] == "sweep":
        text = "the same" if case["same"] else "others"
        rows.append(Row("sweep: the resumed table against the undisturbed one's", "the same bytes", text, case["same"]))
    return rows


def total_row(cases: list[dict]) -> Row:
    """Return the line of all commands together.

    Args:
        cases: What was found, as ``examine`` returns it.
    """
    ways = sum((Counter(case["ways"]) for case in cases), Counter())
    problems = sum((Counter(case["problems"]) for case in cases), Counter())
    count = ways.total() - ways[ENDED]
    text = f"{count} interruptions, {ways['kill']} of them kills; {problems.total()} problems"
    return Row("all commands", "no problem", text, not problems, dict(ways))


def main() -> None:
    """Print the table."""
    choice = {"help": "commands, with commas", "default": ",".join(COMMANDS), "metavar": "A,B"}
    args = arguments(__doc__, more={"--commands": choice})
    count = 4 if args.quick else 20
    done = {case["command"]: case for case in read_cases(args.out)}
    resumed = bool(done)
    for command in args.commands.split(","):
        if command not in done:
            began = time.perf_counter()
            done[command] = examine(command, count) | {"seconds": time.perf_counter() - began}
            add_case(args.out, done[command])
    cases = [done[command] for command in args.commands.split(",")]
    rows = [total_row(cases), *(row for case in cases for row in rows_of(case))]
    finish(rows, args, resumed=resumed, seconds=total_seconds(cases))


if __name__ == "__main__":
    main()
