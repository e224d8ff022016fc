"""Whether a diagnosis names the dominant effect in recordings of rough rigs, which no model matches.

    python experiments/diagnosis/rough_rigs.py [--quick] [--only KIND] [--seeds N] [--line SECTION.KEY=VALUE]
        [--case NAME] [--fits] [--json FILE] [--out DIR]

The truth is tests/reference/rough.py, which shares no code with smajax: wires of 44 cells between clamps, 12 grains in
each with transformation temperatures of their own, logistic branches, uneven convection, and a sensor with slow noise
and a jittering clock. On top of that there is one dominant effect, two, or none. Every case draws its rig, the values
of the rig's free parameters near those of the rig file, and three different inputs of 100 s for training, selection
and holdout; the size of an effect is drawn within 15 % of the one in experiments/common/rough_recordings.py.

The first table says what a fit of the one-cell model to training and selection recording leaves where nothing is
hidden, over the noise; ``--fits`` prints this alone. The second one has a line for each case, and then its totals are
counted for each kind of rig. "Without" is the held-out error over the noise of the same model fitted to the same rig
without the hidden effects, and "their share" is how much of the excess of the held-out mean square they cause: effects
with less than half of it do not dominate, and are counted apart.
Thresholds of a diagnosis are to be chosen on the odd seeds, and counted on the even ones.

``--line`` adds a setting to all rig files, such as ``--line wire.cells=9``; it may be repeated. With ``--out``, each
case is appended to DIR/cases.jsonl when it ends, and cases that are there are not run again, so that each choice of
lines needs a folder. ``--quick`` runs one case of each kind without a hidden effect.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import Row, arguments, finish, read_cases, refuse, say, table, total_seconds
from experiments.common.diagnosis_cases import INTERCHANGEABLE, Case, Facts, collect_facts, count_row
from experiments.common.rough_recordings import EFFECTS, KINDS, PAIRS, RoughRig, draw_rig, draw_strengths, record

import numpy as np

import smajax as sma
from smajax.diagnosis.structure import VARIANTS
from smajax.errors import NumericsError

SEEDS = 5  # of each effect, by default
SPLITS = {0: "counted on", 1: "chosen on"}  # by the parity of the seed
FIT = "one-cell fit"
UNITS = {"mm": 1e-3, "deg": math.pi / 180.0}
# Held-out error over the noise up to which a rig with nothing hidden should be predicted.
LARGEST_ERROR = {"dead weight": 6.0, "spring": 13.0}
# The same with an effect hidden, over that limit.
LARGEST_GROWTH = 1.3
# Least share of the excess of the held-out mean square that dominant effects cause.
DOMINANT = 0.5
LEAST_LEFT = 10.0  # times the noise: what makes a rig rough
Lines = dict[str, list[str]]


def rig_of(case: Case, lines: Lines) -> RoughRig:
    """Return the rig of a case; that of a fit is the one of the diagnosis with nothing hidden."""
    group, name, _, _, seed = case
    return draw_rig(
        group.removesuffix(f", {FIT}"), [seed, 7, *f"{group}, {name}".replace(f", {FIT}", "").encode()], lines
    )


def fit_over_noise(rig: RoughRig, hidden: dict[str, float]) -> tuple[float, float]:
    """Fit a rig's model to training and selection recording.

    Returns:
        Its error over the noise on these, and on the holdout.
    """
    recordings = record(rig, hidden)
    errors = sma.fit(tomllib.loads(rig.text), recordings[:2], holdout=recordings[2]).rmse[rig.channel]
    scale = UNITS[errors["unit"]] / rig.noise
    return errors["train"] * scale, errors["holdout"] * scale


def named(study: sma.DiagnosisStudy) -> tuple[list[str], list[str]]:
    """Return the keys that a diagnosis names as facts, and the further ones that it names as candidates, in order.

    The effects that stand for cells and grains are neither: every rough rig has them.
    """
    facts = [key for key in study.effects if key not in VARIANTS[study.structure]]
    equivalent = (key for effect in facts for key in study.equivalent.get(effect, ()))
    return facts, list(dict.fromkeys([*equivalent, *study.candidates]))


def run(lines: Lines, case: Case) -> Facts:
    """Record a case, and fit or diagnose it."""
    group, name, keys, hidden, seed = case
    facts = {"group": group, "case": name, "seed": seed, "keys": keys, "hidden": hidden}
    start = time.perf_counter()
    if group.endswith(FIT):
        train, holdout = fit_over_noise(rig_of(case, {}), {})
        say(f"{group} ({seed}): {train:.1f} of the noise, {holdout:.1f} held out")
        return facts | {"train": train, "holdout": holdout, "seconds": time.perf_counter() - start}
    rig = rig_of(case, lines)
    train, select, holdout = record(rig, hidden)
    start = time.perf_counter()
    facts |= diagnosed(rig, train, select, holdout, seed)
    facts["seconds"] = time.perf_counter() - start
    facts["without"] = fit_over_noise(rig, {})[1] if keys else facts["before"]
    say(
        f"{group}, {name} ({seed}): {facts['verdict']} {', '.join(facts['effects'])}; {facts['before']:.1f} -> "
        f"{facts['after']:.1f} of the noise, {facts['without']:.1f} without, {facts['seconds']:.0f} s"
    )
    return facts


def diagnosed(rig: RoughRig, train: Any, select: Any, holdout: Any, seed: int) -> Facts:
    """Return what a diagnosis says, as a user would call it; a failed one names nothing and predicts nothing."""
    try:
        study = sma.diagnose(tomllib.loads(rig.text), train, select=select, holdout=holdout, seed=seed)
    except NumericsError as error:
        say(str(error))
        empty = {"effects": [], "candidates": [], "structure": "neither"}
        return {"verdict": "failed", "before": math.inf, "after": math.inf} | empty
    effects, candidates = named(study)
    errors, scale = study.rmse[rig.channel], UNITS[study.rmse[rig.channel]["unit"]] / rig.noise
    before, after = (
        math.inf if errors[f"holdout_{w}"] is None else errors[f"holdout_{w}"] * scale for w in ("before", "after")
    )
    named_entries = {"effects": effects, "candidates": candidates, "structure": study.structure}
    return {"verdict": study.verdict, "before": before, "after": after} | named_entries


def cases(kinds: list[str], seeds: int, quick: bool, fits: bool) -> Iterator[Case]:
    """Yield all cases: with nothing hidden on twice as many seeds.

    Args:
        kinds: Kinds of rigs.
        seeds: Number of seeds of each effect.
        quick: Yield only the first case with nothing hidden of each kind.
        fits: Yield only the fits of the one-cell model.
    """
    for kind in kinds:
        for seed in range(1 if quick else 2 * seeds):
            yield f"{kind}, {FIT}", "nothing", (), {}, seed
    for seed in range(0 if fits else 1 if quick else 2 * seeds):
        for kind in kinds:
            yield kind, "nothing", (), {}, seed
            rng = np.random.default_rng([seed, 5, *kind.encode()])
            for keys in [(key,) for key in EFFECTS[kind]] + list(PAIRS) if seed < seeds and not quick else []:
                yield kind, " + ".join(keys), keys, draw_strengths(rng, kind, keys), seed


def is_right(case: Facts, name: str) -> bool:
    """Return whether a name is one of a hidden effect, or of one that recordings cannot distinguish from it."""
    return any(name == key or name in INTERCHANGEABLE.get(key, ()) for key in case["keys"])


def is_first(case: Facts) -> bool:
    """Return whether the first name, as a fact or else as a candidate, is right."""
    names = [*case["effects"], *case["candidates"]]
    return bool(names) and is_right(case, names[0])


def spurious(case: Facts) -> list[str]:
    """Return the names that are stated as facts, and are not right."""
    return [name for name in case["effects"] if not is_right(case, name)]


def share_caused(case: Facts) -> float:
    """Return the share of the base model's excess held-out mean square that the hidden effects cause."""
    before, without = (max(case[key] ** 2 - 1.0, 1e-9) for key in ("before", "without"))
    return 1.0 - without / before


def case_table(facts: list[Facts]) -> str:
    """Return the table of the cases."""
    head = (
        "rig, seed, split, hidden, structure, facts, candidates, first right, spurious, before, after, without, "
        "their share, s"
    )
    lines = []
    for case in facts:
        numbers = [f"{case[key]:.1f}" for key in ("before", "after", "without")]
        right, share = ("yes" if is_first(case) else "no", f"{share_caused(case):.2f}") if case["keys"] else ("-", "-")
        names = [", ".join(case[key]) or "none" for key in ("effects", "candidates")]
        wrong, seconds = ", ".join(spurious(case)) or "none", f"{case['seconds']:.0f}"
        start = (case["group"], str(case["seed"]), SPLITS[case["seed"] % 2], case["case"], case["structure"])
        lines.append([*start, *names, right, wrong, *numbers, share, seconds])
    return table(head.split(", "), lines)


def fit_rows(facts: list[Facts], kinds: list[str]) -> list[Row]:
    """Return what the one-cell fit leaves where nothing is hidden."""
    rows = []
    for kind in kinds:
        group = [c for c in facts if c["group"] == f"{kind}, {FIT}"]
        errors = [c["train"] for c in group]
        counted = count_row(
            f"{kind}, nothing hidden: the one-cell fit leaves 10 times the noise",
            [e >= LEAST_LEFT for e in errors],
            0.90,
        )
        text = "; ".join(f"{c['train']:.1f} / {c['holdout']:.1f}" for c in group)
        rows += [counted, Row(f"{kind}: error over noise, fitted / held out, by seed", "-", text, None)]
    return rows


def total_rows(facts: list[Facts], kinds: list[str]) -> list[Row]:
    """Return the totals of each kind of rig on each half of the seeds."""
    rows = []
    for kind in kinds:
        for parity, split in SPLITS.items():
            group = [c for c in facts if c["group"] == kind and c["seed"] % 2 == parity]
            nulls, some = ([c for c in group if test(len(c["keys"]))] for test in (_is_0, bool))
            prefix = f"{kind} ({split}), "
            if nulls:
                rows += null_rows(prefix, kind, nulls)
            if some:
                rows += hidden_rows(prefix, kind, some)
            if group:
                rows.append(_at_most(f"{prefix}cases with a spurious name", [bool(spurious(c)) for c in group], 0.10))
    for kind in kinds:
        for name in dict.fromkeys(c["case"] for c in facts if c["group"] == kind and c["keys"]):
            shares = [share_caused(c) for c in facts if c["group"] == kind and c["case"] == name]
            text = ", ".join(f"{share:.2f}" for share in shares)
            is_met = float(np.median(shares)) >= DOMINANT
            rows.append(Row(f"{kind}, {name}: share of the excess", f">= {DOMINANT}", text, is_met))
    return rows


def null_rows(prefix: str, kind: str, nulls: list[Facts]) -> list[Row]:
    """Return the rows of the cases with nothing hidden."""
    rows = [count_row(f"{prefix}nothing hidden: no fact", [not c["effects"] for c in nulls], 1.0)]
    errors = [c["after"] for c in nulls]
    limit = LARGEST_ERROR.get(kind)
    text = f"{np.median(errors):.1f}, {max(errors):.1f}"
    is_met = None if limit is None else max(errors) <= limit
    target = "-" if limit is None else f"<= {limit:g}"
    return [*rows, Row(f"{prefix}nothing hidden: held-out error over noise, median and largest", target, text, is_met)]


def hidden_rows(prefix: str, kind: str, some: list[Facts]) -> list[Row]:
    """Return the rows of the cases with one or two hidden effects; those that do not dominate are counted apart."""
    dominant = [c for c in some if share_caused(c) >= DOMINANT]
    singles, pairs = ([c for c in dominant if test(len(c["keys"]))] for test in (_is_1, _is_2))
    both = [all(any(is_right(c | {"keys": [k]}, e) for e in c["effects"]) for k in c["keys"]) for c in pairs]
    weak = [c for c in some if c not in dominant]
    rows = [
        count_row(f"{prefix}dominant effect first", [is_first(c) for c in singles], 0.95),
        count_row(f"{prefix}two effects: one of them first", [is_first(c) for c in pairs], 0.95),
        Row(f"{prefix}two effects: both are facts", "-", f"{sum(both)} of {len(both)}", None),
        Row(f"{prefix}not dominant: first", "-", f"{sum(map(is_first, weak))} of {len(weak)}", None),
    ]
    errors, limit = [c["after"] for c in some], LARGEST_GROWTH * LARGEST_ERROR.get(kind, math.inf)
    what = f"{prefix}something hidden: held-out error over noise"
    text = f"median {np.median(errors):.1f}, largest {max(errors):.1f}"
    if math.isinf(limit):
        return [*rows, Row(what, "-", text, None)]
    kept = [error <= limit for error in errors]
    return [*rows, Row(what, f"<= {limit:g}", f"{text}; {sum(kept)} of {len(kept)} within", all(kept))]


def _is_0(number: int) -> bool:
    return number == 0


def _is_1(number: int) -> bool:
    return number == 1


def _is_2(number: int) -> bool:
    return number == 2


def _at_most(what: str, hits: list[bool], target: float) -> Row:
    return Row(what, f"<= {100 * target:.0f} %", f"{sum(hits)} of {len(hits)}", float(np.mean(hits)) <= target)


def read_lines(settings: list[str]) -> Lines:
    """Return the lines of ``--line`` by section."""
    lines: Lines = {}
    for setting in settings:
        name, is_set, value = setting.partition("=")
        section, has_key, key = name.strip().partition(".")
        if not (is_set and has_key and value.strip()):
            refuse(f"--line {setting} is not of the form SECTION.KEY=VALUE: write for example wire.cells=9")
        lines.setdefault(section, []).append(f"{key} = {value.strip()}")
    return lines


def read_arguments() -> argparse.Namespace:
    """Read the command line."""
    more: dict[str, dict[str, Any]] = {
        "--only": {"choices": list(KINDS), "action": "append", "help": "a kind of rig; all by default"},
        "--seeds": {"type": int, "default": SEEDS, "help": "seeds of each effect; with nothing hidden, twice as many"},
        "--case": {
            "action": "append",
            "help": "hidden effects to run, such as latent-heat, or nothing; all by default",
        },
        "--line": {"action": "append", "default": [], "help": "a setting of all rig files, SECTION.KEY=VALUE"},
        "--fits": {"action": "store_true", "help": "only fit the one-cell model where nothing is hidden"},
    }
    return arguments(__doc__, quick="one case of each kind, with nothing hidden", more=more)


def option_words(args: argparse.Namespace) -> str:
    """Return the options that are not the usual ones, as they are written on the command line."""
    options = {"only": args.only, "case": args.case, "line": args.line}
    words = "".join(f" --{name} {value}" for name, values in options.items() for value in values or ())
    return words + f" --seeds {args.seeds}" * (args.seeds != SEEDS) + " --fits" * args.fits


def main() -> None:
    """Run all cases and print the tables."""
    args = read_arguments()
    kinds, lines = args.only or list(KINDS), read_lines(args.line)
    chosen = (c for c in cases(kinds, args.seeds, args.quick, args.fits) if not args.case or c[1] in args.case)
    resumed = bool(read_cases(args.out))
    facts = collect_facts(chosen, lines, run, args.out)
    rows = fit_rows(facts, kinds) if not args.case or "nothing" in args.case else []
    print(table(["what", "target", "measured"], [(r.what, r.target, r.measured) for r in rows]), end="\n\n")
    diagnoses = [c for c in facts if not c["group"].endswith(FIT)]
    if diagnoses:
        print(case_table(diagnoses), end="\n\n")
    words = option_words(args)
    rows += total_rows(diagnoses, kinds)
    finish(rows, args, words=words, resumed=resumed, seconds=total_seconds(facts), cases=facts, lines=lines)


if __name__ == "__main__":
    main()
