"""The job of ``smajax tune``: gains of a controller for a rig, compared with those that it started from, checked, and written out."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from smajax import __version__, parameters
from smajax.console import Progress
from smajax.control import members
from smajax.control.c_header import c_header
from smajax.control.document import as_document
from smajax.control.driven import DrivenPlant
from smajax.control.gains import gain, gains, unit_of
from smajax.control.reach import Reach, cut, falls, reach
from smajax.control.slow_loop import Identified, identify, with_inverse
from smajax.control.tune import Tuned
from smajax.control.tuning import NOISES, SPREAD, Tuning, noises
from smajax.controller_file import ControllerFile, read_controller
from smajax.errors import InputError
from smajax.fmu.models import controller_model, plant_model
from smajax.fmu.pack import fmu
from smajax.jobs.behaviour import Behaviour, at_rest, behave, broken_limits, check, each_of, given_up, idle_error
from smajax.jobs.gain_search import harder, searched
from smajax.jobs.record import Clock, Outcome, rig_text, run_record
from smajax.report import prediction
from smajax.report.document import number, to_json
from smajax.report.tuning import SCHEMA, calmer, margin_words, sentences, shown, tuning_page
from smajax.results import check_out, read_json, write_folder
from smajax.rig import Rig, read_rig
from smajax.units import CHANNELS


class TuneJob(NamedTuple):
    """What to tune; ``seed`` replaces the controller file's where it is given."""

    rig: Path
    controller: Path
    out: Path
    seed: int | None = None


def run_tune(job: TuneJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Reads, tunes, checks and writes the folder. Raises InputError for what cannot be read, NumericsError if no gains give numbers.

    Exit code 3 with the best feasible result if the start gains are unstable, the reference is beyond the stroke, or a limit is not met.
    """
    out, clock = check_out(job.out), Clock()
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(job.rig), rig_text(job.rig)
        given = read_controller(job.controller, rig)
        controller_text = job.controller.read_text("utf-8-sig")
        seed = given.seed if job.seed is None else job.seed
        try:
            drawn = _drawn(given, rig, seed)
        except InputError as error:
            raise InputError(f"{job.controller}: robust.fit: {error}") from None
    fed = None
    if given.feedforward is not None:
        progress.phase("fitting the feedforward to a slow loop")
        with clock.time("feedforward"):
            fed = identify(given.driven, given.loop, given.feedforward, given.limits.get("temperature", math.inf))
            given = replace(
                given, loop=eqx.tree_at(lambda one: one.controller, given.loop, with_inverse(given.loop.controller, fed.inverse))
            )
    progress.phase("trying the start gains")
    with clock.time("start"):
        far = reach(given.driven, given.loop, given.scenario, given.limits)
        if (channel := given.loop.channel) != rig.plant.mechanism.coordinate and falls(given.driven, given.loop):
            why = f"{channel} falls while the wire is heated, and no gain is negative"
            raise InputError(f"{job.controller}: controller.channel: {why}: steer {rig.plant.mechanism.coordinate}")
        beyond = _beyond(given, far)
        given = replace(given, scenario=cut(given.scenario, far)) if beyond else given
        own = {n: float(gain(given.loop, n)) for n in given.bounds}
        first = behave(given, own)
    progress.phase("tuning")
    with clock.time("tune"):
        few = {n: v[: given.robust.draws] for n, v in drawn.items()} if given.robust else {}
        draws = noises(given.loop, given.scenario, given.robust.draws if given.robust else NOISES, seed)
        sharp = bool(given.limits or given.settle or given.robust)  # what is limited, or spread already, is judged as it is
        tuning = Tuning.of(given.driven, given.loop, given.scenario, given.bounds, few, draws, 0.0 if sharp else SPREAD)
        found, last, weights = searched(given, tuning, far, seed, progress)
        asked, given = given.weights, replace(given, weights=weights)
    progress.phase("checking")
    with clock.time("check"):
        checks = {when: check(given, some, drawn) for when, some in (("start", own), ("tuned", found.gains))} if drawn else {}
    if checks and checks["tuned"].failing:
        with clock.time("tune"):
            found, checks["tuned"] = harder(given, tuning, found, checks, drawn, seed, progress)
    if checks and len(checks["start"].failing) < len(checks["tuned"].failing):  # what was tuned for some draws does worse on the others
        found, checks["tuned"], weights = found._replace(gains=own), checks["start"], asked
    if checks:
        last = behave(given, found.gains)
    units = (CHANNELS[given.driven.plant.drive.control].unit, CHANNELS[given.loop.channel].unit)
    progress.phase("exporting")
    with clock.time("export"):
        exports, left_out = _exports(given, rig, last, units)
    told = {when: one.document for when, one in checks.items()}
    document: dict[str, Any] = _document(given, rig, found, (first, last), told, beyond, far, seed) | {"left_out": left_out}
    if fed is not None:
        document["feedforward"] = _fed(given, fed)
    if isinstance(given.driven, DrivenPlant) and given.driven.carrier is not None:
        even = behave(replace(given, driven=given.driven.averaged()), found.gains)
        document["pulses"] = {"carrier": given.driven.carrier, "rmse_of_mean": number(even.numbers["rmse"])}
    if last.loop.believes and last.loop.meters is not None:
        document["believes"] = sorted(last.loop.meters.each)
    if weights is not asked:
        document["objective"]["asked"] = dict(asked)
    document["summary"] = sentences(document)
    reason = "; ".join(document["problems"])
    code = 3 if reason else 0
    run = run_record("tune", rig, argv, clock, seed, code) | {"controller": given.name}
    series = [_series(given, one, name) for name, one in (("start gains", first), ("tuned gains", last))]
    progress.phase("writing the report")

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "controller.toml").write_text(controller_text, "utf-8", newline="")
        (folder / "tune.json").write_text(to_json(document), "utf-8")
        (folder / "controller.json").write_text(to_json(as_document(last.loop, dict(given.units))), "utf-8")
        for name, content in exports.items():
            (folder / name).write_bytes(content)
        prediction.write(folder / "prediction.csv", series)
        page = tuning_page(document, prediction.read(folder / "prediction.csv"), run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, code, reason)


def _exports(given: ControllerFile, rig: Rig, last: Behaviour, units: tuple[str, str]) -> tuple[dict[str, bytes], dict[str, str]]:
    """C header and FMUs of plant and controller by the name of their file, and of those that could not be made, why."""
    loop = last.loop
    made: dict[str, bytes] = {}
    left_out: dict[str, str] = {}
    for name, content in (
        ("controller.h", lambda: c_header(loop, units, __version__).encode()),
        ("plant.fmu", lambda: fmu(plant_model(given.driven.plant, rig.name))),
        ("controller.fmu", lambda: fmu(controller_model(loop, units, given.units, given.name))),
    ):
        try:
            made[name] = content()
        except InputError as error:
            left_out[name] = str(error)
    return made, left_out


def _drawn(given: ControllerFile, rig: Rig, seed: int) -> dict[str, np.ndarray]:
    """Draws of what may be different, as many as are tuned for or checked on, whichever are more."""
    if given.robust is None:
        return {}
    count, rng = max(given.robust.draws, given.robust.check), np.random.default_rng([seed, 7])
    found: dict[str, np.ndarray] = {}
    if given.robust.fit is not None:
        known = list(parameters.declared(rig.plant))
        found = members.posterior(read_json(given.robust.fit, "fit.json"), known, count, rng)
    return found | members.spread(given.robust.vary, count, rng)


def _beyond(given: ControllerFile, far: Reach) -> str:
    """What to say of a reference that the rig cannot follow; nothing if it can."""
    wanted, channel = np.asarray(given.scenario.reference), given.loop.channel
    room = 0.02 * max(float(np.ptp(np.append(wanted, float(given.scenario.before)))), 1e-12)
    if far.least - room <= wanted.min() and wanted.max() <= far.largest + room:
        return ""
    ends = [shown(float(v), channel, channel) for v in (wanted.min(), wanted.max(), far.least, far.largest)]
    asked = f"asks for {ends[0]}" if ends[0] == ends[1] else f"goes from {ends[0]} to {ends[1]}"
    told = f"the reference {asked}, and with its largest command the rig reaches {ends[2]} to {ends[3]}"
    limited = given.loop.guard is not None or any(k in given.limits for k in ("temperature", "stress", "current"))
    told += " within the limits" if limited else ""
    stress, most = at_rest(given, "stress"), given.limits.get("stress", math.inf)
    if stress > most:
        ends = [shown(v, "peak_stress", channel) for v in (stress, most)]
        told += f": at rest the stress is {ends[0]} already, and its limit is {ends[1]}"
    return told + ("; tuned for the reference cut to that" if cut(given.scenario, far) is not given.scenario else "")


def _document(
    given: ControllerFile,
    rig: Rig,
    found: Tuned,
    both: tuple[Behaviour, Behaviour],
    checks: Mapping[str, Any],
    beyond: str,
    far: Reach,
    seed: int,
) -> dict[str, Any]:
    first, last = both
    unit, command = CHANNELS[given.loop.channel].unit, CHANNELS[given.driven.plant.drive.control].unit
    usual = "K" if unit == "degC" else prediction.usual_unit(given.loop.channel)
    table = {
        name: {
            "start": number(float(gain(first.loop, name))),
            "tuned": number(float(gain(last.loop, name))),
            "unit": given.units[name],
            "usual_unit": unit_of(name, last.loop, command, usual),
            "free": name in given.bounds,
            "bounds": [number(end) for end in given.bounds.get(name, (None, None))],
        }
        for name in gains(given.loop)
    }
    problems = [f"the start gains are unstable: {first.unstable}"] if first.unstable else []
    if not first.unstable and first.margins.unstable:
        problems.append(f"the start gains are unstable, linearised along their rollout, with {margin_words(*first.margins[:2])}")
    problems += [beyond] if beyond else []
    broken = broken_limits(given.limits, last.numbers)
    for name in broken:
        key = name if name in last.numbers else f"peak_{name}"
        ends = [shown(v, key, given.loop.channel) for v in (last.numbers[key], given.limits[name])]
        told = f"give {ends[0]}" if math.isfinite(last.numbers[key]) else f"never do ({name})"
        problems.append(f"the limit on {name} is not met: it is {ends[1]}, and the best gains found {told}")
    if last.unstable:
        problems.append(f"the best gains found are unstable: {last.unstable}")
    elif last.margins.unstable:
        told = f"{margin_words(*last.margins[:2])}: {calmer(given.settle)}"
        problems.append(f"the best gains found are unstable, linearised along their rollout, with {told}")
    if given_up(given, last, far):
        ends = [shown(v, "rmse", given.loop.channel) for v in (last.numbers["rmse"], idle_error(given))]
        told = f"the best gains found give the reference up: they leave an error of {ends[0]}, a rig that is left alone one of {ends[1]}"
        problems.append(f"{told}; try more starts, other start gains or wider limits")
    kinds = {
        "unstable": "are unstable",
        "unstable_linearised": "are unstable, linearised along their rollouts",
        "beyond_a_limit": "are beyond a limit",
    }
    few = {k: checks["tuned"][k] for k in kinds if checks and checks["tuned"][k]}
    if few:
        told = " and ".join(f"{count} {kinds[k]}" for k, count in few.items())
        problems.append(f"of {checks['tuned']['draws']} draws {told} with the best gains found: narrow what varies, or raise robust.draws")
    document: dict[str, Any] = {
        "schema": SCHEMA,
        "rig": rig.name,
        "controller": given.name,
        "channel": given.loop.channel,
        "unit": unit,
        "feasible": not (broken or last.unstable or last.margins.unstable or few),
        "problems": problems,
        "gains": table,
        "metrics": {
            when: {n: number(v) for n, v in one.numbers.items()} for when, one in (("start", first), ("tuned", last))
        },
        "limits": {n: number(v) for n, v in given.limits.items()},
        "margins": {
            when: {n: number(v) for n, v in one.margins._asdict().items()} for when, one in (("start", first), ("tuned", last))
        },
        "stable": {"start": not first.unstable, "tuned": not last.unstable},
        "robust": dict(checks),
        "start_kept": bool(checks) and all(one["start"] == one["tuned"] for one in table.values()),
        "objective": {"settle": given.settle, "weights": dict(given.weights)},
        "rollouts": found.rollouts,
        "seed": seed,
        "smajax": __version__,
    }  # fmt: skip
    return document


def _fed(given: ControllerFile, fed: Identified) -> dict[str, Any]:
    """What the feedforward was fitted to, and how well: of the operator, not of its inverse."""
    wanted = given.feedforward
    assert wanted is not None
    return {
        "operators": wanted.operators,
        "loop": "simulated" if wanted.measured is None else wanted.measured.name,
        "command": [number(end) for end in fed.ends],
        "command_unit": CHANNELS[given.driven.plant.drive.control].unit,
        "seconds": number(fed.seconds),
        "misfit": number(fed.misfit),
        "stroke": number(fed.stroke),
    }


def _series(given: ControllerFile, one: Behaviour, name: str) -> prediction.Series:
    control, channel = given.driven.plant.drive.control, given.loop.channel
    reference = np.asarray(given.scenario.reference)
    time = given.driven.period * np.arange(len(reference), dtype=np.float64)
    beside = [channel, *each_of(given, "temperature"), *each_of(given, "stress")]
    model = {c: one.channels[c] for c in dict.fromkeys(beside)}
    model |= {c: one.command[:, i] for i, c in enumerate(each_of(given, control))}
    return prediction.to_series(name, name.split()[0], time, {channel: reference}, model, {}, clock=True)
