"""Cases of the experiments on diagnosis: how they are run and recorded, and the rows that count their verdicts.

A case is a recording with hidden effects, made by the reference simulator. Its facts are what a diagnosis says of it,
next to what was hidden.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from experiments.common.base import Row, add_case, finish, read_cases, say, total_seconds

import numpy as np

from smajax.diagnosis.result import Diagnosis

# Group, name, keys of the hidden effects, the reference simulator's fields for them, and seed.
Case = tuple[str, str, tuple[str, ...], dict[str, float], int]
# What is recorded of a case, by name, as it is written to cases.jsonl.
Facts = dict[str, Any]
# Longest processor time of a case, s: a minute of one core.
LONGEST = 60.0
# Effects that one recording cannot distinguish: naming either counts as naming the other.
INTERCHANGEABLE = {"ratcheting": {"functional-fatigue"}, "functional-fatigue": {"ratcheting"}}


def collect_facts(
    cases: Iterable[Case], rig: Any, run: Callable[[Any, Case], Facts], folder: Path | None
) -> list[Facts]:
    """Run each case, or read its facts where the folder has them already.

    Args:
        cases: The cases, in order.
        rig: What ``run`` needs in addition to a case: a rig, or several by group.
        run: Makes the recordings of a case and diagnoses them.
        folder: Folder of ``cases.jsonl``; ``None`` runs all cases and writes nothing.

    Returns:
        The facts, in the order of the cases.
    """
    done = {(c["group"], c["case"], c["seed"]): c for c in read_cases(folder)}
    facts = []
    for case in cases:
        group, name, _, _, seed = case
        if (group, name, seed) not in done:
            start = time.process_time()
            facts_of_case = run(rig, case)
            done[group, name, seed] = facts_of_case | {"processor_seconds": time.process_time() - start}
            add_case(folder, done[group, name, seed])
        facts.append(done[group, name, seed])
    return facts


def report_cases(
    args: argparse.Namespace,
    default_seeds: int,
    rig: Any,
    cases: Callable[[range, bool], Iterator[Case]],
    run: Callable[[Any, Case], Facts],
    rows: Callable[[list[Facts]], list[Row]],
) -> None:
    """Run the cases of an experiment, print its table, and write its JSON file.

    Args:
        args: The command line, with ``seeds``.
        default_seeds: The number of seeds that the command line has by default.
        rig: What ``run`` needs in addition to a case.
        cases: Yields the cases of a range of seeds; its second argument asks for the quick ones only.
        run: Makes the recordings of a case and diagnoses them.
        rows: Makes the table from the facts.
    """
    resumed = bool(read_cases(args.out))
    facts = collect_facts(cases(range(1 if args.quick else args.seeds), args.quick), rig, run, args.out)
    options = "" if args.quick or args.seeds == default_seeds else f" --seeds {args.seeds}"
    finish(rows(facts), args, words=options, resumed=resumed, seconds=total_seconds(facts), cases=facts)


def verdict_facts(case: Case, diagnosis: Diagnosis) -> Facts:
    """Return a case and the verdict of its diagnosis."""
    group, name, keys, hidden, seed = case
    return {
        "group": group,
        "case": name,
        "seed": seed,
        "keys": keys,
        "hidden": hidden,
        "verdict": diagnosis.verdict,
        "effects": diagnosis.effects,
        "equivalent": diagnosis.equivalent,
    }


def scored_facts(label: str, case: Case, diagnosis: Diagnosis, noises: Mapping[str, float], seconds: float) -> Facts:
    """Return the verdict of a case with its held-out error over the noise, and report it on stderr.

    Args:
        label: The case in words, for the report.
        case: The case.
        diagnosis: What was found.
        noises: Standard deviation of the noise by channel, SI or K.
        seconds: Wall time of the diagnosis.

    Returns:
        The facts; an error is that of the channel whose error is largest over its noise.
    """
    before, after = (
        max(diagnosis.rmse[c][f"holdout_{when}"] / noises[c] for c in diagnosis.rmse) for when in ("before", "after")
    )
    say(
        f"{label} ({case[-1]}): {diagnosis.verdict} {', '.join(diagnosis.effects)}; {before:.2f} -> {after:.2f} of "
        f"the noise, {seconds:.0f} s"
    )
    return verdict_facts(case, diagnosis) | {
        "before_over_noise": before,
        "holdout_over_noise": after,
        "seconds": seconds,
    }


def error_text(case: Facts, precision: str = ".2f") -> str:
    """Return the held-out error over the noise before and after the diagnosis; a failed prediction has none.

    Args:
        case: The facts of a case.
        precision: Format of the errors.
    """
    errors = case["before_over_noise"], case["holdout_over_noise"]
    return " -> ".join(format(error, precision) if math.isfinite(error) else "failed" for error in errors)


def time_rows(group: str, facts: list[Facts]) -> list[Row]:
    """Return the row of the processor time of cases, which other programs on the machine hardly change.

    There is none where a case of an earlier run has no processor time.
    """
    seconds = [c["processor_seconds"] for c in facts if "processor_seconds" in c]
    if not seconds or len(seconds) < len(facts):
        return []
    text = f"{np.median(seconds):.0f}, {max(seconds):.0f}"
    what = f"{group}processor seconds a case, median and longest"
    return [Row(what, f"<= {LONGEST:g} s", text, max(seconds) <= LONGEST)]


def names_effect(case: Facts, key: str) -> bool:
    """Return whether a diagnosis names an effect, or a class that contains it."""
    return any(
        key == effect or key in case["equivalent"].get(effect, ()) or effect in INTERCHANGEABLE.get(key, ())
        for effect in case["effects"]
    )


def count_row(what: str, hits: list[bool], target: float) -> Row:
    """Return the row of how many cases are hits.

    Args:
        what: The statement that is counted.
        hits: Whether it holds, by case.
        target: The share of the cases for which it should hold.
    """
    is_met = float(np.mean(hits)) >= target if hits else None
    numbers = {"hits": sum(hits), "cases": len(hits)}
    return Row(what, f">= {100 * target:.0f} %", f"{sum(hits)} of {len(hits)}", is_met, numbers)


def verdict_rows(
    prefix: str, singles: list[Facts], nulls: list[Facts], pairs: list[Facts], outside: list[Facts]
) -> list[Row]:
    """Return the rows that count the verdicts.

    Args:
        prefix: Put before each row's name.
        singles: Cases with one hidden effect.
        nulls: Cases with none.
        pairs: Cases with two.
        outside: Cases with an effect that is not in the catalogue.
    """
    close = [c["holdout_over_noise"] <= 1.2 for c in singles]
    unresolved = [c["verdict"] in ("partial", "unresolved") for c in outside]
    return [
        count_row(
            f"{prefix}one effect: first, or in the class declared",
            [names_effect(c, c["keys"][0]) for c in singles],
            0.90,
        ),
        count_row(
            f"{prefix}one effect: exactly and first", [list(c["effects"][:1]) == list(c["keys"]) for c in singles], 0.80
        ),
        count_row(f"{prefix}one effect: no other named", [len(c["effects"]) <= 1 for c in singles], 0.90),
        count_row(f"{prefix}one effect: held-out error within 1.2 of the noise", close, 0.90),
        count_row(f"{prefix}nothing hidden: no effect named", [not c["effects"] for c in nulls], 0.98),
        count_row(
            f"{prefix}two effects: both named", [all(names_effect(c, k) for k in c["keys"]) for c in pairs], 0.80
        ),
        count_row(f"{prefix}in no catalogue: partial or unresolved", unresolved, 0.95),
    ]
