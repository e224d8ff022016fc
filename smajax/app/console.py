"""Console: interruption, exit codes, error messages and the browser.

Exit codes: 0 done, 1 a fault in smajax, 2 bad input, 3 failed numerics, 130 interrupted.
"""

import contextlib
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import FrameType

from smajax.errors import InputError, NumericsError
from smajax.progress import Progress

FAULT = 1
INTERRUPTED = 130


class StopRequest:
    """A request to stop; ``requested`` is true after Ctrl-C was pressed."""

    requested = False


@contextlib.contextmanager
def stopping(progress: Progress) -> Iterator[StopRequest]:
    """Turn the first Ctrl-C into a request to stop with the best result so far; the second one ends the process.

    The first one does not raise an exception, since it could be lost during a compilation.

    Args:
        progress: Display that shows the request.

    Returns:
        A context with the request, to be tested between the steps of a calculation.
    """
    request = StopRequest()
    if threading.current_thread() is not threading.main_thread():
        yield request
        return

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        if request.requested:
            progress.close()
            _print_error("interrupted; nothing was written")
            os._exit(INTERRUPTED)
        request.requested = True
        progress.phase("stopping after this step, the best point so far is kept; press Ctrl-C again to stop at once")

    previous = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield request
    finally:
        signal.signal(signal.SIGINT, previous)


def exit_code(error: BaseException) -> int:
    """Print an error on stderr in one sentence, and return its exit code."""
    if isinstance(error, InputError | NumericsError):
        _print_error(str(error))
        return error.exit_code
    if isinstance(error, KeyboardInterrupt):
        _print_error("interrupted; nothing was written")
        return INTERRUPTED
    if isinstance(error, MemoryError):
        _print_error("there is not enough memory for this: cut the recordings into parts, or lower --starts")
        return FAULT
    if isinstance(error, BrokenPipeError):  # the output was closed, as in `smajax datasets | head`
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return FAULT
    _print_error(
        f"{type(error).__name__}: this is a fault in smajax, not in your files; its traceback is in "
        f"{_save_traceback(error)}"
    )
    return FAULT


def open_in_browser(page: Path) -> bool:
    """Open a page in the browser if there is a display, and return whether the browser accepted it."""
    import webbrowser

    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(page.as_uri())
    except (webbrowser.Error, OSError):
        return False


def _print_error(text: str) -> None:
    with contextlib.suppress(OSError):
        print(f"smajax: {text}", file=sys.stderr)


def _save_traceback(error: BaseException) -> str:
    """Write the traceback to a temporary file and return its path, or the traceback if that fails."""
    text = "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="smajax-", suffix=".txt", delete=False, encoding="utf-8") as file:
            file.write(text)
        return file.name
    except OSError:
        return f"these lines:\n{text}"
