"""The ``smajax`` command: parses, calls, prints. What is heavy to load is loaded inside the commands that need it."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from smajax import __version__
from smajax.errors import InputError

if TYPE_CHECKING:
    from smajax.console import Progress
    from smajax.jobs.record import Outcome


class Commands(TyperGroup):
    """The commands, with every error turned into its sentence and exit code."""

    def invoke(self, ctx: Any) -> Any:
        """Runs the chosen command."""
        try:
            return super().invoke(ctx)
        except (Exception, KeyboardInterrupt) as error:
            if type(error).__module__.partition(".")[0] in ("typer", "click"):  # usage errors and exits, which typer handles
                raise
            from smajax.console import exit_code

            raise typer.Exit(exit_code(error)) from None


app = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Fit, question and steer shape-memory-alloy actuators: differentiable models, identified from recordings by their gradients.",
)


class FitCommand(TyperCommand):
    """Takes all files after ``--holdout`` as holdouts, up to the next option: none of them is fitted by oversight."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Writes the option before each of its files."""
        spread: list[str] = []
        holding = False
        for word in args:
            if word == "--holdout":
                holding = True
                continue
            if word.startswith("-") and word != "-":
                holding = False
            spread += ["--holdout", word] if holding else [word]
        if args[-1:] == ["--holdout"]:
            spread.append("--holdout")
        return super().parse_args(ctx, spread)


class Kind(StrEnum):
    """The kinds of rig that there are templates for, and the machines, which come as they are."""

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


class Datasets(StrEnum):
    """What can be done with data sets."""

    list = "list"
    get = "get"


RigFile = Annotated[Path, typer.Argument(metavar="RIG", help="The rig file (rig.toml).")]
Out = Annotated[Path, typer.Option("--out", metavar="DIR", help="The result folder; an earlier result there is replaced as a whole.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Show no progress and no summary.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result file to stdout, and nothing else there.")]
Seed = Annotated[int | None, typer.Option("--seed", min=0, max=2**32 - 1, help="Seed of what is drawn (default: the rig's).")]
Open = Annotated[bool, typer.Option("--open/--no-open", help="Open the report.")]
Start = Annotated[Path | None, typer.Option("--start", metavar="FIT.toml", help="Start from the parameters of an earlier fit.")]
DropBadRows = Annotated[bool, typer.Option("--drop-bad-rows", help="Leave out rows that cannot be read; they are counted in the result.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"smajax {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")] = False,
) -> None:
    pass


@app.command()
def simulate(
    rig: RigFile,
    recording: Annotated[Path, typer.Argument(metavar="INPUT.csv", help="A recording with the rig's inputs.")],
    out: Out,
    drop_bad_rows: DropBadRows = False,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Simulate a rig under the inputs of a recording."""
    from smajax.report.summary import simulation_text

    with _progress(quiet) as progress:
        from smajax.jobs.simulate import run_simulation

        outcome = run_simulation(rig, recording, out, drop_bad_rows=drop_bad_rows, progress=progress, argv=_argv())
    _finish(outcome, "run.json", simulation_text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


@app.command(cls=FitCommand)
def fit(
    rig: RigFile,
    train: Annotated[list[Path], typer.Argument(metavar="TRAIN.csv [MORE.csv ...]", help="The recordings to fit.")],
    out: Out,
    holdout: Annotated[list[Path] | None, typer.Option("--holdout", metavar="H.csv ...", help="Recordings to predict, not fitted.")] = None,
    start: Start = None,
    seed: Seed = None,
    starts: Annotated[int | None, typer.Option("--starts", min=1, max=10_000, help="Points to start from (default: the rig's).")] = None,
    profile: Annotated[list[str] | None, typer.Option("--profile", help="Parameter to profile; may be repeated.")] = None,
    drop_bad_rows: DropBadRows = False,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Fit a rig's free parameters to recordings, with intervals, and predict others."""
    from smajax.report.summary import text

    with _progress(quiet) as progress:
        from smajax.jobs.fit import FitJob, run_fit

        job = FitJob(rig, train, out, holdout or (), start, seed, starts, drop_bad_rows, profile or ())
        outcome = run_fit(job, progress, _argv())
    _finish(outcome, "fit.json", text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


@app.command()
def diagnose(
    rig: RigFile,
    train: Annotated[Path, typer.Argument(metavar="TRAIN.csv", help="The recording to fit.")],
    select: Annotated[Path, typer.Option("--select", metavar="S.csv", help="Another input: what is named must cut its error.")],
    holdout: Annotated[Path, typer.Option("--holdout", metavar="H.csv", help="A third input, looked at once, at the end.")],
    out: Out,
    start: Start = None,
    seed: Seed = None,
    drop_bad_rows: DropBadRows = False,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Say what a rig has that its file does not: trace the residual to an effect, add it, and compare before and after."""
    with _progress(quiet) as progress:
        from smajax.jobs.diagnose import DiagnoseJob, run_diagnose
        from smajax.report.diagnosis import text

        outcome = run_diagnose(DiagnoseJob(rig, train, select, holdout, out, seed, drop_bad_rows, start), progress, _argv())
    _finish(outcome, "diagnosis.json", text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


@app.command()
def compare(
    rig: RigFile,
    train: Annotated[Path, typer.Argument(metavar="TRAIN.csv", help="The recording to fit.")],
    holdout: Annotated[Path, typer.Option("--holdout", metavar="H.csv", help="A recording to predict, not fitted.")],
    out: Out,
    models: Annotated[str | None, typer.Option("--models", metavar="A,B,...", help="Models, with commas between (default: all).")] = None,
    seed: Seed = None,
    drop_bad_rows: DropBadRows = False,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Fit several models to one recording and say which predicts another one best: material laws, hysteresis operators, black boxes."""
    with _progress(quiet) as progress:
        from smajax.jobs.compare import MODELS, CompareJob, run_compare
        from smajax.report.comparison import text

        wanted = list(MODELS) if models is None else [word.strip() for word in models.split(",") if word.strip()]
        outcome = run_compare(CompareJob(rig, train, holdout, wanted, out, seed, drop_bad_rows), progress, _argv())
    _finish(outcome, "compare.json", text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


@app.command()
def tune(
    rig: RigFile,
    controller: Annotated[Path, typer.Argument(metavar="CONTROLLER.toml", help="The controller, its reference and its limits.")],
    out: Out,
    seed: Seed = None,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Tune a controller's gains by differentiating through its closed loop with the rig, and write them for a microcontroller."""
    with _progress(quiet) as progress:
        from smajax.jobs.tune import TuneJob, run_tune
        from smajax.report.tuning import text

        outcome = run_tune(TuneJob(rig, controller, out, seed), progress, _argv())
    _finish(outcome, "tune.json", text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


@app.command()
def sweep(
    sweep_file: Annotated[Path, typer.Argument(metavar="SWEEP.toml", help="The sweep; or sweep.parquet of an earlier one, to repeat it.")],
    out: Out,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="tcp://...", help="A Dask scheduler that shares the work; 'local' starts one here.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on from the chunks of a run that ended early; keep what has ended.")] = False,
    quiet: Quiet = False,
    as_json: Json = False,
    open_report: Open = False,
) -> None:
    """Simulate many designs of a rig at once: which are best, what they cost, what matters; refine the best by gradients."""
    with _progress(quiet, accelerator=True) as progress:
        from smajax.jobs.sweep import SweepJob, run_sweep
        from smajax.report.sweep import text

        outcome = run_sweep(SweepJob(sweep_file, out, scheduler, resume), progress, _argv())
    if outcome.code == 130:
        typer.echo(f"smajax: {outcome.reason}", err=True)
        raise typer.Exit(outcome.code)
    _finish(outcome, "sweep.json", text(outcome.document, str(out)), quiet=quiet, as_json=as_json, open_report=open_report)


class StartModel(StrEnum):
    """The laws that thermal cycles can start."""

    brinson = "brinson"
    lagoudas = "lagoudas"
    tanaka = "tanaka"
    liang_rogers = "liang-rogers"


class TangentLine(StrEnum):
    """Which line is laid along a transformation."""

    lines = "lines"
    steepest = "steepest"


@app.command()
def properties(
    recordings: Annotated[list[Path], typer.Argument(metavar="CYCLES.csv [MORE.csv ...]", help="Thermal cycles: temperature and strain.")],
    smooth: Annotated[
        int | None,
        typer.Option(
            "--smooth", min=1, metavar="ROWS", help="Smooth temperatures over so many rows, an odd number (default: as noise asks)."
        ),
    ] = None,
    tangent: Annotated[
        TangentLine,
        typer.Option(
            "--tangent", help="Along the transformation: one of three lines of least squares, or the tangent where it is steepest."
        ),
    ] = TangentLine.lines,
    write_set: Annotated[
        Path | None, typer.Option("--write-set", metavar="FILE.toml", help="Write a parameter set that starts a fit.")
    ] = None,
    model: Annotated[StartModel, typer.Option("--model", help="The law that the set is for.")] = StartModel.brinson,
    columns: Annotated[
        str,
        typer.Option("--columns", metavar="A,B,...", help=r"Headers of a file without: 'temperature \[degC],strain [%],-'; - is left out."),
    ] = "",
    delimiter: Annotated[
        str, typer.Option("--delimiter", metavar="CHARACTER", help="What separates columns; 'tab' and 'space' by name.")
    ] = ",",
    decimal: Annotated[str, typer.Option("--decimal", metavar="SIGN", help="The decimal sign of text files and cells: '.' or ','.")] = ".",
    quiet: Annotated[bool, typer.Option("--quiet", help="Show no progress.")] = False,
    as_json: Json = False,
) -> None:
    """Read the ASTM E3097 temperatures and strains off thermal cycles, by tangents, with intervals."""
    names = [name.strip() for name in columns.split(",")] if columns else None
    between = {"tab": "\t", "\\t": "\t", "space": " "}.get(delimiter, delimiter)
    with _progress(quiet) as progress:
        from smajax.jobs.properties import PropertiesJob, run_properties, text
        from smajax.report.document import to_json

        job = PropertiesJob(recordings, smooth, write_set, model.value, names, between, decimal, tangent.value)
        document = run_properties(job, progress.step)
    typer.echo(to_json(document).rstrip() if as_json else text(document))
    if write_set is not None and not as_json:
        typer.echo(f'\nWrote {write_set}: name it in a rig by [material] set = "{write_set.name}".')
    if write_set is not None:
        typer.echo(f"smajax: {write_set.name}: {document['guessed']}", err=True)


@app.command()
def demo(
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The result folder.")] = Path("smajax-demo"),
    open_report: Open = True,
    quiet: Quiet = False,
) -> None:
    """Find out what a shipped rig has that its file does not know: fit, trace, add, compare before and after, and open the report."""
    from smajax.datasets import shipped

    folder = shipped("recordings", "dead-weight-unexplained")
    with _progress(quiet) as progress:
        from smajax.jobs.diagnose import DiagnoseJob, run_diagnose
        from smajax.report.diagnosis import text

        train, select, holdout = (folder / f"{part}.csv" for part in ("train", "select", "holdout"))
        outcome = run_diagnose(DiagnoseJob(folder / "rig.toml", train, select, holdout, out), progress, _argv())
    after = f"Report:  {out / 'report.html'}\nNext:    smajax init dead-weight --out my-rig   (files to start from)"
    _finish(outcome, "diagnosis.json", f"{text(outcome.document, str(out))}\n{after}", quiet=quiet, open_report=open_report)


@app.command()
def init(
    kind: Annotated[Kind, typer.Argument(metavar="KIND", help=f"The kind of rig: {', '.join(Kind)}.")],
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder for the files; made if it is not there.")] = Path(),
) -> None:
    """Write a commented rig.toml and an example recording to start from; no file is ever overwritten."""
    from smajax.example import is_machine, write_example, write_machine

    if is_machine(kind.value):
        rig, sweep_file = write_machine(kind.value, out)
        typer.echo(f"Wrote {rig}, to be filled in with your own numbers, and {sweep_file}, a sweep of it.")
        typer.echo(f"Next: smajax check {rig}\n      smajax sweep {sweep_file} --out {out / 'swept'}")
        return

    rig, example, recording, more = write_example(kind.value, out)
    typer.echo(
        f"Wrote {rig}, to be filled in with your own wire, and {recording} with its rig {example}, to try things on.\n"
        f"Next: smajax check {rig} {recording}\n      smajax fit {example} {recording} --out {out / 'result'}"
    )
    for path in more:
        rest = f"tune {example} {path} --out {out / 'tuned'}" if path.name == "controller.toml" else f"sweep {path} --out {out / 'swept'}"
        typer.echo(f"      smajax {rest}")


@app.command()
def check(
    rig: RigFile,
    recordings: Annotated[list[Path] | None, typer.Argument(metavar="[RECORDING ...]", help="Recordings of this rig.")] = None,
    drop_bad_rows: DropBadRows = False,
) -> None:
    """Read and validate a rig and its recordings, and say what would be fitted; runs nothing."""
    from smajax.check import describe

    typer.echo(describe(rig, recordings or [], drop_bad_rows))


@app.command()
def report(folder: Annotated[Path, typer.Argument(metavar="DIR", help="A result folder.")]) -> None:
    """Make a result folder's report.html anew from its other files."""
    from smajax.report.rebuild import rebuild_report

    typer.echo(f"Wrote {rebuild_report(folder)}.")


@app.command()
def datasets(
    action: Annotated[Datasets, typer.Argument(metavar="[list | get]", help="List all, or get one.")] = Datasets.list,
    name: Annotated[str | None, typer.Argument(metavar="NAME", help="The data set to get.")] = None,
) -> None:
    """List the shipped and public recordings, or get one: public ones are fetched from their repository and checked."""
    from smajax import datasets as shelf

    if action is Datasets.list:
        if name is not None:
            raise InputError(f"'datasets list' takes no name: write 'smajax datasets get {name}' to get it")
        for dataset in shelf.datasets().values():
            files = f"; {len(dataset.files)} files" if len(dataset.files) > 1 else ""
            typer.echo(f"{dataset.name}: {dataset.what}\n    {dataset.source}; licence: {dataset.licence}{files}")
        return
    if name is None:
        raise InputError("'datasets get' needs a name: 'smajax datasets list' shows all")
    folder, missing = shelf.get(name)
    typer.echo(folder)
    if missing:
        note = shelf.find(name).note
        typer.echo(f"smajax: not there: {', '.join(missing)}" + (f" ({note})" if note else ""), err=True)


def _progress(quiet: bool, accelerator: bool = False) -> "Progress":
    """Progress of a long command; whatever compiles comes after it."""
    from smajax.console import Progress, prepare_jax

    progress = Progress(quiet)
    progress.phase("loading")
    prepare_jax(accelerator)
    return progress


def _argv() -> list[str]:
    return ["smajax", *sys.argv[1:]]


def _finish(outcome: "Outcome", result: str, text: str, *, quiet: bool, as_json: bool = False, open_report: bool = False) -> None:
    """Prints what a run is to print, opens its report, and leaves with its exit code."""
    if as_json:
        typer.echo((outcome.folder / result).read_text("utf-8"), nl=False)
    elif not quiet:
        typer.echo(text)
    if outcome.reason:
        typer.echo(f"smajax: {outcome.reason}; what there is was saved in {outcome.folder}", err=True)
    if outcome.note and not quiet:
        typer.echo(f"smajax: {outcome.note}", err=True)
    if open_report:
        from smajax.console import open_in_browser

        open_in_browser(outcome.folder / "report.html")
    if outcome.code:
        raise typer.Exit(outcome.code)


def main() -> None:
    """The entry point of the ``smajax`` command."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
