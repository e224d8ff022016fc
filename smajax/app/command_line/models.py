"""The commands simulate, fit, diagnose and compare."""

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from smajax.app.command_line.early_checks import check_files
from smajax.app.command_line.options import (
    DEFAULT_MAX_STEPS,
    MAX_STEPS,
    Auto,
    Json,
    Open,
    Out,
    Quiet,
    RigFile,
    Seed,
    Split,
    Start,
    TrainFile,
)
from smajax.app.command_line.reading import NO_CHANGES, Reading, rig_with_reading, with_reading
from smajax.app.command_line.run import argv, finish_run, start_run
from smajax.app.memory_limit import MANY_PROGRAMS, WIDE_PROGRAMS
from smajax.arguments import MAX_STARTS


class FitCommand(TyperCommand):
    """The command fit, in which all files between ``--holdout`` and the next option are holdouts."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the arguments after repeating ``--holdout`` before each of its files."""
        spread: list[str] = []
        in_holdout = False
        for argument in args:
            word = argument
            if word.startswith("--holdout="):
                in_holdout, word = True, word.removeprefix("--holdout=")
            elif word == "--holdout":
                in_holdout = True
                continue
            if word.startswith("-") and word != "-":
                in_holdout = False
            spread += ["--holdout", word] if in_holdout else [word]
        if args[-1:] == ["--holdout"]:
            spread.append("--holdout")
        return super().parse_args(ctx, spread)


@with_reading
def simulate(
    rig: RigFile,
    recording: Annotated[Path, typer.Argument(metavar="INPUT.csv", help="A recording with the rig's inputs.")],
    out: Out,
    cycles: Annotated[
        int | None,
        typer.Option("--cycles", min=1, help="Equal cycles of the recording: show the metrics of the last one."),
    ] = None,
    reading: Reading = NO_CHANGES,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Simulate a rig under the inputs of a recording."""
    check_files(toml={"rig": rig}, recordings=[recording], out=out, reading=reading, observed=False)
    with start_run(quiet) as progress:
        from smajax.api.predict import predict

        study = predict(rig_with_reading(rig, reading), recording, cycles=cycles, progress=progress)
        study.save(out, argv=argv())
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)


@with_reading
def fit(
    rig: RigFile,
    train: Annotated[list[Path], typer.Argument(metavar="TRAIN.csv [MORE.csv ...]", help="The recordings to fit.")],
    out: Out,
    holdout: Annotated[
        list[Path] | None, typer.Option("--holdout", metavar="H.csv ...", help="Recordings to predict, not fitted.")
    ] = None,
    start: Start = None,
    seed: Seed = None,
    starts: Annotated[
        int | None, typer.Option("--starts", min=1, max=MAX_STARTS, help="Points to start from (default: the rig's).")
    ] = None,
    input_noise: Annotated[
        str | None,
        typer.Option(
            "--input-noise", metavar="QUANTITY", help="Noise of the input's meter: '1 mA', none, or estimated."
        ),
    ] = None,
    max_steps: Annotated[
        int, typer.Option("--max-steps", min=1, max=MAX_STEPS, help="Most steps of the search from each start.")
    ] = DEFAULT_MAX_STEPS,
    profile: Annotated[
        list[str] | None, typer.Option("--profile", help="Parameter to profile; may be repeated.")
    ] = None,
    auto: Auto = False,
    split: Split = False,
    reading: Reading = NO_CHANGES,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Fit a rig's free parameters to recordings, with intervals, and predict others."""
    check_files(toml={"rig": rig}, recordings=[*train, *(holdout or [])], out=out, reading=reading)
    with start_run(quiet, page="fit") as progress:
        from smajax.api.fit import fit as fit_rig

        study = fit_rig(
            rig_with_reading(rig, reading),
            train,
            holdout=holdout,
            start=start,
            seed=seed,
            starts=starts,
            input_noise=input_noise,
            max_steps=max_steps,
            profile=profile or (),
            auto=auto,
            split=split,
            progress=progress,
        )
        study.save(out, argv=argv())
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)


@with_reading
def diagnose(
    rig: RigFile,
    train: TrainFile,
    out: Out,
    select: Annotated[
        Path | None,
        typer.Option(
            "--select", metavar="S.csv", help="Another input: an effect is added if it lowers the error here."
        ),
    ] = None,
    holdout: Annotated[
        Path | None, typer.Option("--holdout", metavar="H.csv", help="A third input, used once, at the end.")
    ] = None,
    split: Split = False,
    start: Start = None,
    seed: Seed = None,
    laws: Annotated[
        bool, typer.Option("--laws", help="Compare the other material laws although effects explain the residual.")
    ] = False,
    reading: Reading = NO_CHANGES,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Find effects that a rig has and its model lacks: trace the residual to an effect, add it, compare."""
    check_files(toml={"rig": rig}, recordings=[train, select, holdout], out=out, reading=reading)
    with start_run(quiet, address_space=MANY_PROGRAMS, page="diagnose") as progress:
        from smajax.app.commands.diagnose import diagnose_into

        study = diagnose_into(
            out,
            rig_with_reading(rig, reading, drop_misplaced=True),
            train,
            select=select,
            holdout=holdout,
            start=start,
            seed=seed,
            laws=laws,
            split=split,
            progress=progress,
        )
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)


@with_reading
def compare(
    rig: RigFile,
    train: TrainFile,
    out: Out,
    holdout: Annotated[
        Path | None, typer.Option("--holdout", metavar="H.csv", help="A recording to predict, not fitted.")
    ] = None,
    split: Split = False,
    models: Annotated[
        str | None, typer.Option("--models", metavar="A,B,...", help="Models, with commas between (default: all).")
    ] = None,
    seed: Seed = None,
    reading: Reading = NO_CHANGES,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Rank material laws and input-output models, fitted to one recording, by their prediction of another."""
    names = None if models is None else [word.strip() for word in models.split(",") if word.strip()]
    check_files(toml={"rig": rig}, recordings=[train, holdout], out=out, reading=reading)
    with start_run(quiet, address_space=WIDE_PROGRAMS, page="compare") as progress:
        from smajax.api.compare import compare as compare_models

        study = compare_models(
            rig_with_reading(rig, reading),
            train,
            holdout=holdout,
            models=names,
            seed=seed,
            split=split,
            progress=progress,
        )
        study.save(out, argv=argv())
    finish_run(study, out, progress, quiet=quiet, as_json=as_json, open_report=open_report)
