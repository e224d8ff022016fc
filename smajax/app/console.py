"""Console: interruption, exit codes, error messages and the browser.

Exit codes: 0 done, 1 a fault in smajax, 2 bad input, 3 failed numerics or a lack of memory, disk or processes,
130 interrupted.
"""

import contextlib
import errno
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

from smajax.app.interrupt_watch import InterruptWatch
from smajax.app.loading import OUT_OF_TIME, raise_on_interrupt
from smajax.errors import Cancelled, InputError, NumericsError, printable_sentence
from smajax.progress import Progress, ProgressEvent

FAULT = 1
# What the messages of JAX's allocator contain.
_OUT_OF_MEMORY = ("RESOURCE_EXHAUSTED", "Out of memory")
_NOTHING_LOST = "earlier results are as they were"
# Errors of the system that no file of the user causes, with the cure.
_SHORTAGES = {
    errno.ENOSPC: "make room on the disk",
    getattr(errno, "EDQUOT", errno.ENOSPC): "make room on the disk, or in your quota of it",
    errno.EROFS: "name a folder elsewhere with --out",
    errno.EMFILE: "raise the limit of open files ('ulimit -n')",
    errno.ENFILE: "close other programs",
    errno.ENOMEM: "close other programs, or use a machine with more memory",
    errno.EAGAIN: "raise the limit of processes ('ulimit -u')",
}


# Signals that stop a command: Ctrl-C, and the signal that a scheduler sends when the time limit of a job is reached.
_STOPPING = (signal.SIGINT, signal.SIGTERM)


class CommandProgress:
    """Progress callback of a command: shows the events, and turns the first Ctrl-C or SIGTERM into a request to stop.

    In a phase that can stop, the first Ctrl-C does not raise an exception, since it could be lost during a compilation;
    the work stops after its step. Where the work has its result already, the first Ctrl-C is noted, and the result is
    written. The second one ends the process. In other phases Ctrl-C raises ``KeyboardInterrupt``, again at the next
    event if it was lost, as in a callback of the garbage collector.

    Attributes:
        interrupted: Whether Ctrl-C was pressed while the result was written, or too late to stop the work before.
    """

    def __init__(self, display: Progress, on_work: Callable[[], object] | None = None):
        """Begin without a phase.

        Args:
            display: Display of the events.
            on_work: Called once, at the beginning of the first phase that can stop; nothing is called by default.
        """
        self._display = display
        self._on_work: Callable[[], object] | None = on_work
        self._previous: dict[int, Any] = {}
        self._handling = self._requested = self._has_result = self._can_stop = self._raised = False
        self._watch = InterruptWatch(_STOPPING, self._end)
        self.interrupted: bool = False

    def __enter__(self) -> "CommandProgress":
        self._display.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        raise_on_interrupt()
        self._restore()
        self._display.close()

    def __call__(self, event: ProgressEvent) -> None:
        """Show an event.

        Raises:
            KeyboardInterrupt: If Ctrl-C was pressed in a phase that can stop, or before it when there was a result.
        """
        raise_on_interrupt()
        if self._raised:
            raise KeyboardInterrupt
        if event.step is None:
            self._has_result, self._can_stop = event.has_result, event.can_stop
            self.interrupted |= self._requested and event.has_result
            if event.can_stop or event.has_result:
                self._handle()
            else:
                self._restore()
                if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
                    self._handle()
            self._display.phase(event.text)
            if event.can_stop and self._on_work is not None:
                self._on_work()
                self._on_work = None
        else:
            self._display.step(event.text)
        if (self._requested or self.interrupted) and event.can_stop:
            raise KeyboardInterrupt

    def _handle(self) -> None:
        if not self._handling and threading.current_thread() is threading.main_thread():
            numbers: list[int] = list(_STOPPING)
            if OUT_OF_TIME is not None and signal.getsignal(OUT_OF_TIME) != signal.SIG_IGN:
                numbers.append(OUT_OF_TIME)
            self._previous = {number: signal.signal(number, self._on_interrupt) for number in numbers}
            self._handling = True
            self._watch.start()

    def _restore(self) -> None:
        if self._handling:
            self._watch.stop()
            for number, previous in self._previous.items():
                signal.signal(number, previous if previous is not None else signal.SIG_DFL)
        self._handling = self._requested = False

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if number == OUT_OF_TIME:  # the next one is no second Ctrl-C, and does not end the process after its results
            signal.signal(number, signal.SIG_IGN)
            self._previous.pop(number)
        if not (self._can_stop or self._has_result or self._raised):
            self._raised = True
            raise KeyboardInterrupt
        if self._raised or self.interrupted or (self._requested and not self._has_result):
            self._watch.end()
        if self._has_result:
            self.interrupted = True
            self._display.phase("writing the results; press Ctrl-C again to stop at once, without them")
            return
        self._requested = True
        self._display.phase(
            "stopping after this step, the best point so far is kept; press Ctrl-C again to stop at once"
        )

    def _end(self) -> None:
        """End the process at once."""
        self._display.close()
        _print_error("interrupted; nothing was written")
        os._exit(Cancelled.exit_code)


def exit_code(error: BaseException) -> int:
    """Print an error on stderr in one sentence, and return its exit code."""
    if isinstance(error, InputError | NumericsError):
        _print_error(str(error))
        return error.exit_code
    if isinstance(error, Cancelled):
        _print_error(str(error))
        return Cancelled.exit_code
    if isinstance(error, KeyboardInterrupt):
        _print_error("interrupted; nothing was written")
        return Cancelled.exit_code
    if isinstance(error, BrokenPipeError):  # the output was closed, as in `smajax datasets | head`
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return Cancelled.exit_code
    if shortage := _shortage(error):
        _print_error(shortage)
        return NumericsError.exit_code
    _print_error(
        f"{type(error).__name__}: this is a fault in smajax, not in your files; its traceback is in "
        f"{_save_traceback(error)}"
    )
    return FAULT


def _shortage(error: BaseException) -> str:
    """Return the sentence on an error that a lack of memory, disk or processes causes; empty for another error."""
    memory = (
        "there is not enough memory for this: cut the recordings into parts, or lower --starts, or chunk of a sweep"
    )
    if isinstance(error, MemoryError) or any(text in str(error) for text in _OUT_OF_MEMORY):
        return memory
    if "can't start new thread" in str(error):
        return f"the system starts no further threads: raise its limit of processes, or end others; {_NOTHING_LOST}"
    if not isinstance(error, OSError) or error.errno not in _SHORTAGES:
        return ""
    name = f"{error.filename}: " if error.filename else ""
    return f"{name}the system refuses ({error.strerror}): {_SHORTAGES[error.errno]}; {_NOTHING_LOST}"


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
        print(f"smajax: {printable_sentence(text)}", file=sys.stderr)


def _save_traceback(error: BaseException) -> str:
    """Write the traceback to a temporary file and return its path, or the traceback if that fails."""
    text = "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="smajax-", suffix=".txt", delete=False, encoding="utf-8") as file:
            file.write(text)
        return file.name
    except OSError:
        return f"these lines:\n{text}"
