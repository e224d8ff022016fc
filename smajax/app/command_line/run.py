"""Start and end of a long command: progress, the command line for its record, output and exit code."""

import sys
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from smajax.app.run_record import Outcome
    from smajax.progress import Progress


def start_run(quiet: bool, accelerator: bool = False) -> "Progress":
    """Show progress and configure JAX; call it before importing modules that use JAX.

    Args:
        quiet: Whether no progress is shown.
        accelerator: Whether JAX may use an accelerator.
    """
    from smajax.numerics.process import prepare_jax
    from smajax.progress import Progress

    progress = Progress(quiet)
    progress.phase("loading")
    prepare_jax(accelerator)
    return progress


def argv() -> list[str]:
    """Return the command line, for the record of the run."""
    return ["smajax", *sys.argv[1:]]


def finish_run(
    outcome: "Outcome", result: str, text: str, *, quiet: bool, as_json: bool = False, open_report: bool = False
) -> None:
    """Print the result of a run, open its report, and exit with its code.

    Args:
        outcome: The outcome of the job.
        result: Name of the file in the result folder that ``--json`` prints.
        text: The summary.
        quiet: Whether no summary is printed.
        as_json: Whether the result file is printed instead.
        open_report: Whether the report is opened in a browser.
    """
    if as_json:
        typer.echo((outcome.folder / result).read_text("utf-8"), nl=False)
    elif not quiet:
        typer.echo(text)
    if outcome.reason:
        typer.echo(f"smajax: {outcome.reason}; the results so far are saved in {outcome.folder}", err=True)
    if outcome.note and not quiet:
        typer.echo(f"smajax: {outcome.note}", err=True)
    if open_report:
        from smajax.app.console import open_in_browser

        open_in_browser(outcome.folder / "report.html")
    if outcome.code:
        raise typer.Exit(outcome.code)
