"""The commands demo, init, check, effects, explain, sets, report and datasets."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from smajax.app.command_line.early_checks import check_files
from smajax.app.command_line.options import Auto, Open, Quiet
from smajax.app.command_line.reading import NO_CHANGES, Reading, with_reading
from smajax.app.command_line.run import finish_run, start_run
from smajax.app.memory_limit import MANY_PROGRAMS
from smajax.app.output import say, say_on_stderr
from smajax.errors import InputError


class Kind(StrEnum):
    """Kinds of rigs and actuators with a template."""

    dead_weight = "dead-weight"
    bias_spring = "bias-spring"
    antagonistic_rotary = "antagonistic-rotary"
    testing_machine = "testing-machine"
    path = "path"
    coil_dead_weight = "coil-dead-weight"
    coil_bias_spring = "coil-bias-spring"
    coil_antagonistic = "coil-antagonistic"
    hip = "hip"
    elbow = "elbow"
    wrist = "wrist"
    glove_finger = "glove-finger"
    flexural = "flexural"
    soft_bending = "soft-bending"
    knee = "knee"


class DatasetAction(StrEnum):
    """Actions on data sets."""

    list = "list"
    get = "get"


def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The result folder.")] = Path("smajax-demo"),
    open_report: Open = True,
    quiet: Quiet = False,
) -> None:
    """Find the effect that the model of a shipped rig lacks: fit, trace, add, compare; open the report."""
    from smajax.recordings.datasets import data_path

    folder = data_path("recordings", "dead-weight-unexplained")
    with start_run(quiet, address_space=MANY_PROGRAMS, page="diagnose") as progress:
        from smajax.app.commands.diagnose import diagnose_into

        train, select, holdout = (folder / f"{part}.csv" for part in ("train", "select", "holdout"))
        study = diagnose_into(out, folder / "rig.toml", train, select=select, holdout=holdout, progress=progress)
    report = f"Report:  {out / 'report.html'}"
    after = f"\n{report}\nNext:    smajax init dead-weight --out my-rig   (files to start from)"
    finish_run(study, out, progress, quiet=quiet, open_report=open_report, after=after)


def init(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help=f"The kind of rig: {', '.join(Kind)}.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="DIR", help="The folder for the files; made if it is not there.")
    ] = Path(),
) -> None:
    """Write a commented rig.toml, and an example with recordings to start from; no file is ever overwritten."""
    from smajax.files.templates import is_actuator_kind, write_actuator_example, write_example

    if is_actuator_kind(kind.value):
        rig, sweep_file = write_actuator_example(kind.value, out)
        say(f"Wrote {rig}, to fill in with your own numbers, and {sweep_file}, a sweep of it.")
        say(f"Next: smajax check {rig}\n      smajax sweep {sweep_file} --out {out / 'swept'}")
        return

    rig, example, (train, select, holdout), others, note = write_example(kind.value, out)
    say(
        f"Wrote {rig}, to fill in with your own wire, and an example: {example} with the recordings\n"
        f"{train} (to fit), {select} (to choose effects) and {holdout} (to predict).\n"
        f"Next: smajax check {rig} {train}\n"
        f"      smajax fit {example} {train} --holdout {holdout} --out {out / 'result'}\n"
        f"      smajax diagnose {example} {train} --select {select} --holdout {holdout} --out {out / 'found'}"
    )
    for path in others:
        if path.name == "controller.toml":
            say(f"      smajax tune {example} {path} --out {out / 'tuned'}")
        else:
            say(f"      smajax sweep {path} --out {out / 'swept'}")
    say("Why three recordings: smajax explain three-recordings")
    if note:
        say(f"Note: {note}.")


@with_reading
def check(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="The rig file (rig.toml), or a sweep file.")],
    recordings: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILE ...]", help="Recordings of this rig, its controllers and its sweeps."),
    ] = None,
    auto: Auto = False,
    reading: Reading = NO_CHANGES,
) -> None:
    """Read and validate a rig, its recordings, controllers and sweeps; say what would be fitted, and run nothing."""
    data = [path for path in recordings or [] if path.suffix.lower() != ".toml"]
    check_files(toml={"file": rig}, recordings=data, reading=reading)
    from smajax.numerics.process import prepare_jax

    prepare_jax()  # the program that looks for a transformation is cached for the fit
    from smajax.app.commands.check import describe

    say(describe(rig, recordings or [], reading, auto))


def effects(
    key: Annotated[str | None, typer.Argument(metavar="[KEY]", help="The effect to describe; all by default.")] = None,
) -> None:
    """List the effects that a rig can have: keys, units, usual strengths, sources; or describe one."""
    from smajax.app.commands.catalogues import effects_text

    say(effects_text(key))


def explain(
    topic: Annotated[
        list[str] | None, typer.Argument(metavar="[TOPIC]", help="A word of a message or the key of an effect.")
    ] = None,
) -> None:
    """Explain a word of a message, such as at-bound or equivalent, or an effect, such as backlash; or list them."""
    from smajax.app.commands.explain import explain_text

    say(explain_text(" ".join(topic) if topic else None))


def sets(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="The set whose values are listed; all sets by default.")
    ] = None,
) -> None:
    """List the shipped parameter sets, or the values of one: keys, units, sizes, sources."""
    from smajax.app.commands.catalogues import sets_text

    say(sets_text(name))


def report(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A result folder.")]) -> None:
    """Make a result folder's report.html again from its other files."""
    from smajax.report.rebuild import rebuild_report

    say(f"Wrote {rebuild_report(folder)}.")


def datasets(
    action: Annotated[
        DatasetAction, typer.Argument(metavar="[list | get]", help="List all, or get one.")
    ] = DatasetAction.list,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="The data set to get.")] = None,
) -> None:
    """List the shipped and public recordings, or get one: public ones are fetched from their repository and checked."""
    from smajax.recordings import datasets as catalogue

    if action is DatasetAction.list:
        if name is not None:
            raise InputError(f"'datasets list' takes no name: write 'smajax datasets get {name}' to get it")
        for dataset in catalogue.datasets().values():
            files = f"; {len(dataset.files)} files" if len(dataset.files) > 1 else ""
            head = f"{dataset.name}: {dataset.description}"
            say(f"{head}\n    {dataset.source}; licence: {dataset.licence}{files}")
        return
    if name is None:
        raise InputError("'datasets get' needs a name: 'smajax datasets list' shows all")
    folder, missing = catalogue.get(name)
    say(folder)
    say_on_stderr(f"it holds {', '.join(sorted(path.name for path in folder.iterdir()))}")
    if missing:
        note = catalogue.find(name).note
        say_on_stderr(f"not there: {', '.join(missing)}" + (f" ({note})" if note else ""))
