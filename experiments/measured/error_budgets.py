"""Error budgets of recordings by others: naive forecast, base model, with cells and grains, with effects.

    python experiments/measured/error_budgets.py [NAME ...] [--merge FILE ...] [--quick] [--json FILE] [--out DIR]

NAME is one of the recordings below, by default all. Parts, rigs and naive forecasts are those of the experiment of each
recording (``isobaric.py``, ``superelastic.py``, ``cyclic.py``, ``guarneros.py``, ``bu_softlimb.py``); all models are
fitted to the training and the selection part together, and predict the held-out part.

- ``flexinol``, ``nitihf``: isobaric cycles; ``superelastic``: stress-strain loops; ``asmada``: cycles under one load.
  Their temperature is prescribed, so the wire has one temperature and no cells. Effects are searched for on a wire of
  one grain and on one of five, and the selection part decides which of the two counts. As in a diagnosis, at most three
  effects are selected, on fewer rows and without the free shapes and the growing sets of the experiments' own searches.
- ``guarneros``: a heated wire against a force sensor, with cells, grains, and both; then with both and the effects that
  such a rig has in any case (``guarneros.EFFECTS``).
- ``softlimb``: four wires in a soft arm, each in silicone. The arm's model has one temperature along the wire, and its
  own grains (``experiments.common.arm_effects``).

``--merge`` puts the files of runs of one recording each into one table. The picture shows the held-out errors over that
of the naive forecast.
"""

from __future__ import annotations

import dataclasses
import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.arm_fit import ArmFitter
from experiments.common.arm_log import read_logs, repeat_first_pulse
from experiments.common.arm_model import rms as arm_rms
from experiments.common.base import DATA, Row, arguments, finish, refuse, say
from experiments.common.budgets import CELLS, GRAINS, Budget, Entry, Subject, path_budget
from experiments.common.charts import Bars, draw_bars
from experiments.common.effect_fit import EffectFit, EffectFitter
from experiments.common.forecasts import last_cycle
from experiments.common.greedy_search import rms
from experiments.measured import bu_softlimb, cyclic, guarneros, isobaric, superelastic

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.diagnosis.structure import SPREADS
from smajax.files.rig_file import parse_rig
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording

STARTS = 4  # start points of a base fit on a path
SCORED = 4  # distance of the scored rows of the held-out loop: all splits of a search have grids of one length
CYCLIC_ROWS = 9  # distance of the rows of the hundred cycles, fitted and scored
SPREAD_DEVIATION = 0.3  # prior of the spreads of the grains: any share of a band
DRAWN = 4  # start points of a fit to guarneros that are drawn, in addition to ``guarneros.STARTS``
Made = tuple[list[Budget], list[Row]]


def isobaric_subject(folder: str, level: int) -> Subject:
    """Return the isobaric cycles of a folder, with one level held out and the next one selecting."""
    levels = isobaric.read_levels(DATA / folder)
    parts, whole, rig = isobaric.split_levels(levels, level)[1:]
    nearest, naive = isobaric.repeat_nearest_level(levels, level)
    target = isobaric.PEERS[folder, level][1]
    name = f"{folder}, {level} MPa"
    return Subject(name, rig, parts, whole, "strain", "%", 100.0, (f"{nearest} MPa repeated", 100 * naive), target)


def superelastic_subject(every: int) -> Subject:
    """Return the stress-strain loops, with that of 40 degC held out."""
    folder = DATA / "tamu-muscle-superelastic"
    temperatures = (*superelastic.FITTED, superelastic.HELD)
    loops = {t: superelastic.read_loop(folder / f"pseudoelastic_{t}C.xlsx") for t in temperatures}
    train, select = superelastic.train_part(loops, every), superelastic.select_part(loops, every)
    rows = np.arange(0, len(loops[superelastic.HELD].load), SCORED)
    held_out = loops[superelastic.HELD].recording(f"{superelastic.HELD} degC", superelastic.load_zero(loops), rows)
    return Subject(
        "tamu-muscle-superelastic, 40 degC",
        parse_rig(superelastic.RIG),
        (train, select, DataSplit((held_out,))),
        superelastic.fitted_part(loops, every),
        "stress",
        "MPa",
        1e-6,
        ("between the fitted loops", rms(superelastic.interpolate_loops(loops)) / 1e6),
        superelastic.TARGET,
        tuple(superelastic.EXCLUDED),
    )


def cyclic_subject(every: int) -> Subject:
    """Return the hundred cycles, the last forty of which are held out."""
    test = cyclic.read_test(DATA / "asmada-cyclic" / cyclic.FILE)
    parts = (
        cyclic.train_part(test, every),
        cyclic.select_part(test, every),
        test.part("cycles 61 to 100", (cyclic.FITTED + 1, cyclic.LAST), every),
    )
    naive = 100 * rms(cyclic.repeat_last_cycle(test))
    return Subject(
        "asmada-cyclic, cycles 61 to 100",
        parse_rig(cyclic.RIG),
        parts,
        cyclic.fitted_part(test, every),
        "strain",
        "%",
        100.0,
        (f"cycle {cyclic.FITTED} repeated", naive),
        cyclic.TARGETS[1],
        tuple(cyclic.EXCLUDED),
    )


def on_path(subject: Callable[[], Subject]) -> Callable[[bool], Made]:
    """Return a function that makes the budget of a recording on a path."""

    def make(quick: bool) -> Made:
        budget, rows = path_budget(subject(), 1 if quick else STARTS)
        return [budget], rows

    return make


def guarneros_text(cells: bool, grains: bool) -> str:
    """Return the rig of the logs with cells, with grains, or with both."""
    text = guarneros.RIG
    if cells:
        text = text.replace("[wire]\n", f"[wire]\ncells = {CELLS}\n")
    if grains:
        text = text.replace("[material]\n", f"[material]\ngrains = {GRAINS}\n")
        text = text.replace('free = ["drive', f'free = ["{SPREADS[0]}", "{SPREADS[1]}", "drive')
    return text


def fit_log(
    structure: tuple[bool, bool], effects: tuple[str, ...], logs: tuple[Recording, Recording], drawn: int
) -> tuple[EffectFitter, EffectFit]:
    """Fit a log by a wire with cells, grains, or both, and with some effects.

    Args:
        structure: Whether there are cells, and grains.
        effects: Keys of the effects.
        logs: The fitted and the forecast log.
        drawn: Number of start points that are drawn.
    """
    rig = parse_rig(guarneros_text(*structure), "guarneros.toml")
    deviation = guarneros.PRIOR_DEVIATION | dict.fromkeys(SPREADS, SPREAD_DEVIATION)
    kinds = {key: catalogue()[key] for key in effects}
    fitter = EffectFitter(rig, kinds, deviation, logs, guarneros.STEP)
    starts = [*guarneros.STARTS, *fitter.draw_starts(effects, drawn, seed=0)]
    return fitter, fitter.fit(logs[0], effects, starts, guarneros.STEPS)[0]


def guarneros_budgets(quick: bool) -> Made:
    """Return the budgets of temperature and force: the first log fitted, the second half of the second held out."""
    folder = DATA / "guarneros-sma-force"
    logs = (guarneros.read_log(folder / "AB0.csv")[0], guarneros.read_log(folder / "AB1.csv")[0])
    held = guarneros.halves(logs[1])[1]
    on_cells = tuple(key for key in guarneros.EFFECTS if key != "gradual-transformation")
    variants = {
        "base model": ((False, False), ()),
        "with cells": ((True, False), ()),
        "with grains": ((False, True), ()),
        "with cells and grains": ((True, True), ()),
        f"without them, with {', '.join(guarneros.EFFECTS)}": ((False, False), guarneros.EFFECTS),
        f"with cells, grains, {', '.join(on_cells)}": ((True, True), on_cells),
    }
    errors: dict[str, tuple[dict[str, float], dict[str, float]]] = {}
    rows = []
    for name, (structure, effects) in variants.items():
        say(f"guarneros-sma-force: {name}")
        fitter, fitted = fit_log(structure, effects, logs, 0 if quick else DRAWN)
        errors[name] = (
            guarneros.errors(fitter, logs[0], fitted, slice(None)),
            guarneros.errors(fitter, logs[1], fitted, held),
        )
        select = guarneros.selection_error(fitter, logs[1], fitted)
        what = f"guarneros-sma-force, {name}: error over noise on the selection part, cost"
        rows.append(Row(what, "-", f"{select:.3f}, {fitted.cost:.1f}", None, {"select": select, "cost": fitted.cost}))
    budgets = []
    for channel, unit in guarneros.CHANNELS.items():
        values = logs[1].channels[channel]
        earlier = (logs[0].time, logs[0].channels["duty"], logs[0].channels[channel])
        repeated = last_cycle(logs[1].time, logs[1].channels["duty"], values, earlier)
        entries = [Entry("naive, last cycle repeated", np.nan, rms((values - repeated)[held]))]
        entries += [Entry(name, fitted[channel], held_out[channel]) for name, (fitted, held_out) in errors.items()]
        budgets.append(
            Budget(
                "guarneros-sma-force, half of AB1",
                channel,
                unit,
                tuple(entries),
                list(variants)[-1],
                entries[0].held_out,
            )
        )
    return budgets, rows


def softlimb_budgets(quick: bool) -> Made:
    """Return the budgets of temperature and bend of a soft arm, pooled over its four wires."""
    logs = read_logs(DATA / "bu-softlimb")
    fitter = ArmFitter(logs, bu_softlimb.EFFECTS)
    forecasts = [repeat_first_pulse(log) for log in logs]
    naive = arm_rms([g[0] for g in forecasts]), arm_rms([g[1] for g in forecasts])
    starts, hops, steps = (1, 0, 20) if quick else (bu_softlimb.STARTS, bu_softlimb.HOPS, bu_softlimb.STEPS)
    base_starts = min(starts, bu_softlimb.BASE_STARTS)
    left_out = {
        "base model": bu_softlimb.EFFECTS,
        "with grains": bu_softlimb.EFFECTS[1:],
        f"with grains, {', '.join(bu_softlimb.EFFECTS[1:])}": (),
    }
    errors = {}
    for name, without in left_out.items():
        say(f"bu-softlimb: {name}")
        fitted = fitter.fit("fitted", without, base_starts if without else starts, 0 if without else hops, steps)[0]
        errors[name] = fitter.errors("fitted", fitted), fitter.errors("held", fitted)
    budgets = []
    targets = bu_softlimb.TARGET_WITH_EFFECTS_K, bu_softlimb.TARGET_WITH_EFFECTS_DEG
    for i, (channel, unit) in enumerate((("temperature", "K"), ("bend", "deg"))):
        entries = [Entry("naive, pulse 1 repeated", np.nan, naive[i])]
        entries += [Entry(name, fitted[i], held[i]) for name, (fitted, held) in errors.items()]
        budgets.append(
            Budget("bu-softlimb, second pulses", channel, unit, tuple(entries), list(left_out)[-1], targets[i])
        )
    return budgets, []


RECORDINGS: dict[str, Callable[[bool], Made]] = {
    "flexinol": on_path(lambda: isobaric_subject("tamu-flexinol-isobaric", 150)),
    "nitihf": on_path(lambda: isobaric_subject("nasa-bigelow-nitihf", 200)),
    "superelastic": on_path(lambda: superelastic_subject(superelastic.THINNED)),
    "asmada": on_path(lambda: cyclic_subject(CYCLIC_ROWS)),
    "guarneros": guarneros_budgets,
    "softlimb": softlimb_budgets,
}


def read_budgets(paths: Sequence[Path]) -> Made:
    """Return the budgets and further rows of earlier runs, in the order of ``RECORDINGS``."""
    documents = [json.loads(path.read_text("utf-8")) for path in paths]
    if incomplete := [path for path, document in zip(paths, documents, strict=True) if "budgets" not in document]:
        refuse(f"{incomplete[0]} has no budgets: name files that this experiment wrote by --json")
    names = list(RECORDINGS)
    documents.sort(key=lambda document: names.index(document["words"].split()[0]) if document["words"] else 0)
    budgets = [
        Budget(**(values | {"entries": tuple(Entry(**entry) for entry in values["entries"])}))
        for document in documents
        for values in document["budgets"]
    ]
    return budgets, [
        Row(**row) for document in documents for row in document["rows"][len(document["rows"]) - document["details"] :]
    ]


def main() -> None:
    """Print the table."""
    more = {
        "names": {"nargs": "*", "metavar": "NAME", "help": f"recordings: {', '.join(RECORDINGS)}; by default all"},
        "--merge": {
            "nargs": "+",
            "type": Path,
            "default": [],
            "metavar": "FILE",
            "help": "print the table of earlier runs, which wrote these files by --json",
        },
    }
    args = arguments(__doc__, quick="fewest start points", more=more)
    if unknown := [name for name in args.names if name not in RECORDINGS]:
        refuse(f"{unknown[0]} is not a recording: name {', '.join(RECORDINGS)}")
    budgets, details = read_budgets(args.merge)
    for name in [] if args.merge else args.names or RECORDINGS:
        made, rows = RECORDINGS[name](args.quick)
        budgets += made
        details += rows
    if args.out:
        label = "held-out error over that of the naive forecast [1]"
        draw_bars([bars(budget) for budget in budgets], args.out, "error_budgets", label)
    rows = [row for budget in budgets for row in budget.rows()]
    words = "".join(f" {name}" for name in args.names)
    facts = {"budgets": [dataclasses.asdict(budget) for budget in budgets], "details": len(details)}
    finish([*rows, *details], args, words=words, resumed=bool(args.merge), **facts)


def bars(budget: Budget) -> Bars:
    """Return the held-out errors of a budget over that of the naive forecast."""
    naive = budget.entries[0].held_out
    names = [entry.model for entry in budget.entries]
    return Bars(f"{budget.recording}: {budget.channel}", names, [entry.held_out / naive for entry in budget.entries])


if __name__ == "__main__":
    main()
