"""The ``smajax`` command: commands in the order of ``--help``, and exit codes."""

import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from smajax import __version__
from smajax.app.command_line import designs, files, importing, models, properties
from smajax.app.loading import raise_on_interrupt
from smajax.app.output import say_on_stderr
from smajax.errors import Cancelled

# Packages whose exceptions are usage errors and exits, which typer handles.
_TYPER_MODULES = ("typer", "click")
# Exit code of click where its own output was closed, as in `smajax --help | head -1`.
_CLOSED_OUTPUT = 1


class Commands(TyperGroup):
    """Group of commands that reports every error as a sentence with an exit code."""

    def main(self, *args: Any, standalone_mode: bool = True, **extra: Any) -> Any:
        """Run the command line; a mistake in it is one sentence, where typer prints a box of several lines."""
        if not standalone_mode:
            return super().main(*args, standalone_mode=False, **extra)
        try:
            code = super().main(*args, standalone_mode=False, **extra)
        except typer.Abort:  # the end of the input at a question
            sys.exit(Cancelled.exit_code)
        except SystemExit as end:
            if end.code != _CLOSED_OUTPUT:
                raise
            sys.exit(Cancelled.exit_code)
        except OSError as error:  # in the output of --help or --version
            from smajax.app.console import exit_code

            sys.exit(exit_code(error))
        except Exception as error:
            if not hasattr(error, "format_message"):
                raise
            sys.exit(_report_usage_error(error))
        sys.exit(code or 0)

    def invoke(self, ctx: Any) -> Any:
        """Run the command and report its errors."""
        raise_on_interrupt()
        try:
            return super().invoke(ctx)
        except (Exception, KeyboardInterrupt) as error:
            if type(error).__module__.partition(".")[0] in _TYPER_MODULES:
                raise
            from smajax.app.console import exit_code

            raise typer.Exit(exit_code(error)) from None


def _report_usage_error(error: Any) -> int:
    """Print one of typer's errors in one sentence, and return its exit code."""
    message = error.format_message()
    context = getattr(error, "ctx", None)
    if not message.strip():  # the help, which is printed already
        return int(error.exit_code)
    command = context.command_path if context is not None else "smajax"
    words = " ".join(message.split()).rstrip(".").replace("Value error, ", "")
    say_on_stderr(f"{words[:1].lower()}{words[1:]}: '{command} --help' shows what it takes")
    return int(error.exit_code)


app: typer.Typer = typer.Typer(
    cls=Commands,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    help="Fit, diagnose and control shape-memory-alloy actuators: differentiable models, identified from recordings by "
    "their gradients.",
)


def _print_version(requested: bool) -> None:
    if requested:
        typer.echo(f"smajax {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    pass


app.command()(models.simulate)
app.command(cls=models.FitCommand)(models.fit)
app.command()(models.diagnose)
app.command()(models.compare)
app.command()(designs.tune)
app.command()(designs.sweep)
app.command()(properties.properties)
app.command()(files.demo)
app.command()(files.init)
app.command("import")(importing.import_file)
app.command()(files.check)
app.command()(files.effects)
app.command()(files.explain)
app.command()(files.sets)
app.command()(files.report)
app.command()(files.datasets)
