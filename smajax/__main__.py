"""Run the command line: ``python -m smajax``, and the script ``smajax``."""

from smajax.app.loading import end_on_interrupt, end_process, exit_on_interrupt, interrupt_at_time_limits
from smajax.app.memory_limit import report_out_of_memory
from smajax.errors import Cancelled


def main() -> None:
    """Run the ``smajax`` command."""
    report_out_of_memory()
    exit_on_interrupt()
    interrupt_at_time_limits()
    from smajax.app.cli import app
    from smajax.app.output import escape_what_cannot_be_encoded

    escape_what_cannot_be_encoded()
    try:
        app()
        code: object = 0
    except KeyboardInterrupt:  # outside of a command, which has a sentence for it
        code = Cancelled.exit_code
    except SystemExit as end:
        code = end.code
    end_on_interrupt(code)
    end_process(code)


if __name__ == "__main__":
    main()
