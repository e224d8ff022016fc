"""Damaged files of each format: is every one read, or refused in one sentence?

    python experiments/robustness/damaged_files.py [--quick] [--json FILE] [--record] [--out DIR] [--kinds A,B]

Small valid files of each format of recordings and of each kind of TOML file are damaged by the seeded mutations of
``tests/fuzz``: bits, bytes, lengths, lines, words, tags, and bytes inside of what is compressed. Each file is read, in
a process of its own that may crash or hang, and every fourth recording is also imported. A fault is an error without
a sentence, a crash, a try of more than 10 s, one that needs more than 512 MiB, and columns of different lengths. With
``--out DIR`` a format that is done is not done again.
"""

import dataclasses
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, add_case, arguments, finish, read_cases, say, total_seconds

from tests.fuzz.attempts import FORMATS
from tests.fuzz.hunt import hunt
from tests.fuzz.settings import KINDS

# Seed of the first try; the tests of every run begin with 0, and those of an hour with a million.
FIRST = 20_000_000
TRIES, QUICK_TRIES = 100_000, 200


def row_of(case: dict) -> Row:
    """Return the line of a format.

    Args:
        case: What was found, as ``examine`` returns it.
    """
    faults = len(case["faults"])
    text = f"{case['tries']:,} tries: {case['read']:,} read, {case['refused']:,} refused in a sentence, {faults} faults"
    kind = f"{case['kind']}.toml" if case["kind"] in KINDS else case["kind"]
    return Row(kind, "no fault", f"{text}; the slowest took {case['slowest']:.1f} s", not faults, case)


def examine(kind: str, tries: int) -> dict:
    """Make tries with a format, and return what was found.

    Args:
        kind: A format of recordings, or a kind of TOML file.
        tries: Number of tries.
    """
    began = time.perf_counter()
    findings = hunt(kind, FIRST, tries=tries)
    seconds = time.perf_counter() - began
    outcomes = {name: findings.outcomes[name] for name in ("read", "refused")}
    return {
        "kind": kind,
        "seconds": seconds,
        **outcomes,
        **{k: v for k, v in dataclasses.asdict(findings).items() if k != "outcomes"},
    }


def main() -> None:
    """Print the table."""
    choice = {"help": "formats and kinds, with commas", "default": ",".join((*FORMATS, *KINDS)), "metavar": "A,B"}
    args = arguments(__doc__, more={"--kinds": choice})
    tries = QUICK_TRIES if args.quick else TRIES
    done = {case["kind"]: case for case in read_cases(args.out)}
    resumed = bool(done)
    for kind in args.kinds.split(","):
        if kind not in done:
            done[kind] = examine(kind, tries)
            add_case(args.out, done[kind])
            say(f"{row_of(done[kind]).what}: {row_of(done[kind]).measured}")
            for seed, fault in done[kind]["faults"].items():
                say(f"{kind} {seed}: {fault}")
    rows = [row_of(done[kind]) for kind in args.kinds.split(",")]
    total = sum(case["tries"] for case in done.values())
    faults = sum(len(case["faults"]) for case in done.values())
    rows.insert(0, Row("all formats", "no fault", f"{total:,} tries, {faults} faults", not faults))
    finish(rows, args, resumed=resumed, seconds=total_seconds(done.values()))


if __name__ == "__main__":
    main()
