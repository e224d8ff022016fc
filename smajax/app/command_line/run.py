"""Start and end of a long command: progress, the command line for its record, output and exit code."""

import functools
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from smajax.app.loading import exit_on_interrupt
from smajax.app.memory_limit import FEW_PROGRAMS, check_address_space
from smajax.app.output import say, say_json, say_on_stderr
from smajax.errors import Cancelled

if TYPE_CHECKING:
    from smajax.api.study import Study
    from smajax.app.command_line.options import Device
    from smajax.app.console import CommandProgress


def start_run(
    quiet: bool,
    device: "Device | None" = None,
    address_space: int = FEW_PROGRAMS,
    page: str = "",
    keep_memory: bool = False,
) -> "CommandProgress":
    """Show progress and configure JAX; call it before importing modules that use JAX.

    Until the first event, Ctrl-C ends the process.

    Args:
        quiet: Whether no progress is shown.
        device: Device of a command that simulates thousands of designs at a time; others use the CPU.
        address_space: Bytes of address space that the command needs.
        page: Command whose report is built at the end; what builds it is loaded while the numbers run.
        keep_memory: Whether freed memory is kept, as for a command that runs batch after batch.

    Raises:
        NumericsError: If the process may not have the memory that JAX needs.
        InputError: If there is no device of this kind.
    """
    exit_on_interrupt()
    check_address_space(address_space)
    from smajax.app.console import CommandProgress
    from smajax.numerics.process import keep_freed_memory, prepare_jax, require_gpu
    from smajax.progress import Progress

    display = Progress(quiet)
    display.phase("loading")
    if keep_memory:
        keep_freed_memory()
    if device == "cpu":
        os.environ["JAX_PLATFORMS"] = "cpu"  # also of the processes that a sweep starts
    prepare_jax(accelerator=device is not None)
    if device == "gpu":
        require_gpu()
    return CommandProgress(display, functools.partial(_load_page_builder, page) if page else None)


def _load_page_builder(command: str) -> None:
    from smajax.report.rebuild import load_page_builder

    load_page_builder(command)


def argv() -> list[str]:
    """Return the command line, for the record of the run."""
    return ["smajax", *sys.argv[1:]]


def finish_run(
    study: "Study",
    out: Path,
    progress: "CommandProgress",
    *,
    quiet: bool,
    as_json: bool = False,
    open_report: bool = False,
    after: str = "",
) -> None:
    """Print the summary of a saved study, open its report, and exit with its code.

    Args:
        study: The study.
        out: Its result folder.
        progress: The progress of the command.
        quiet: Whether no summary is printed.
        as_json: Whether the result document is printed instead.
        open_report: Whether the report is opened in a browser.
        after: Lines that follow the summary.

    Raises:
        Cancelled: If Ctrl-C was pressed when there was a result already.
    """
    if as_json:
        say_json((out / study.document_name).read_text("utf-8"))
    elif not quiet:
        say(study.summary(str(out)) + after)
    if study.reason:
        say_on_stderr(f"{study.reason}; the results so far are saved in {out.resolve()}")
    if study.note and not quiet:
        say_on_stderr(f"{study.note}")
    if open_report:
        from smajax.app.console import open_in_browser

        open_in_browser(out.resolve() / "report.html")
    if progress.interrupted and study.exit_code != Cancelled.exit_code:
        raise Cancelled(f"interrupted when there were results already; they are complete, in {out.resolve()}")
    if not study.success:
        raise typer.Exit(study.exit_code)
