"""Progress of long work: events for a callback, and their display on stderr."""

import contextlib
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple, ParamSpec, Protocol, runtime_checkable

from smajax.errors import Cancelled, InputError, printable_sentence

# What a progress callback raises to stop the work; Ctrl-C raises the first.
_STOP_SIGNALS = (KeyboardInterrupt, StopIteration)
# Least time (s) between two lines of one phase where stderr is not a terminal; chosen by trial.
_MIN_SECONDS_BETWEEN_LINES = 2.0
# Width of the bar in characters.
_BAR_WIDTH = 24


class ProgressEvent(NamedTuple):
    """One report of long work to its callback.

    A callback that raises ``StopIteration`` stops the work: with the best result so far where ``can_stop`` is set, else
    with ``Cancelled``. One that raises ``KeyboardInterrupt`` does the same, but is not replaced by ``Cancelled``. What
    a callback returns is ignored, and so is a request to stop when the work has its result already.

    Attributes:
        text: What is being done, in words.
        step: Number of steps that are done in this phase; ``None`` at the beginning of a phase.
        total: Number of steps of the phase; ``None`` if it is not known.
        can_stop: Whether the work can stop here with the best result so far.
        has_result: Whether the work has its result already, so that a request to stop is ignored.
    """

    text: str
    step: int | None = None
    total: int | None = None
    can_stop: bool = False
    has_result: bool = False


ProgressCallback = Callable[[ProgressEvent], object]
_Arguments = ParamSpec("_Arguments")


class CallbackStop(Exception):
    """The progress callback asked to stop. A ``StopIteration`` of other code is a fault and is not taken for it."""


def stoppable(callback: Callable[_Arguments, object]) -> Callable[_Arguments, None]:
    """Return a callback that raises ``CallbackStop`` where the given one asks to stop; its result is ignored.

    Args:
        callback: The callback, which may raise ``StopIteration`` or ``KeyboardInterrupt``.
    """

    def report(*args: _Arguments.args, **kwargs: _Arguments.kwargs) -> None:
        try:
            callback(*args, **kwargs)
        except _STOP_SIGNALS as signal:
            raise CallbackStop from signal

    return report


@runtime_checkable
class PhasesAndSteps(Protocol):
    """What long work reports to: a ``Reporter`` or a ``Progress``."""

    def phase(self, text: str, *, can_stop: bool = False) -> None:
        """Report the beginning of a phase, and whether a ``KeyboardInterrupt`` of its steps ends it with a result."""
        ...

    def finish(self, text: str) -> None:
        """Report a phase in which a request to stop is ignored."""
        ...

    def step(self, text: str, step: int = 0) -> None:
        """Report a step within the phase: what has been reached, and the number of steps that are done."""
        ...


class Reporter:
    """Reports the phases and steps of long work to a callback, and takes its request to stop.

    Attributes:
        stopped: Whether the callback has asked to stop.
    """

    def __init__(self, callback: ProgressCallback | None = None):
        """Begin without a phase.

        Args:
            callback: Function that gets the events; ``None`` to report nothing.

        Raises:
            InputError: If the callback is no function.
        """
        if callback is not None and not callable(callback):
            raise InputError(
                f"progress is of type {type(callback).__name__}: give a function that takes a ProgressEvent, or None"
            )
        self._callback = callback
        self._last = ProgressEvent("")
        self.stopped = False

    def phase(self, text: str, *, can_stop: bool = False) -> None:
        """Report the beginning of a phase.

        Args:
            text: What is being done.
            can_stop: Whether the work can stop in this phase with the best result so far.

        Raises:
            KeyboardInterrupt: If the callback asks to stop where the work can, or raised it itself.
            Cancelled: If it asks to stop by ``StopIteration`` where there is no result.
        """
        self._report(ProgressEvent(text, can_stop=can_stop))

    def step(self, text: str, step: int = 0, total: int | None = None) -> None:
        """Report a step within the phase; see ``phase`` for the exceptions.

        Args:
            text: What has been reached.
            step: Number of steps that are done.
            total: Number of steps of the phase, if it is known.
        """
        self._report(ProgressEvent(text, step, total, self._last.can_stop))

    def finish(self, text: str) -> None:
        """Report a phase in which a request to stop is ignored, since there is a result already.

        Args:
            text: What is being done.
        """
        with contextlib.suppress(Cancelled, KeyboardInterrupt):
            self._report(ProgressEvent(text, has_result=True))

    def _report(self, event: ProgressEvent) -> None:
        self._last = event
        if self._callback is None:
            return
        try:
            self._callback(event)
        except _STOP_SIGNALS as error:
            if self.stopped and isinstance(error, StopIteration):
                return  # the work is ending with the best result so far
            self.stopped: bool = True
            if event.can_stop:
                raise KeyboardInterrupt from None
            if isinstance(error, KeyboardInterrupt):
                raise
            raise Cancelled(f"cancelled while {event.text}, before there was a result") from None


class Progress:
    """Progress display on stderr: a moving bar on a terminal, plain lines elsewhere, nothing if ``quiet``."""

    def __init__(self, quiet: bool = False):
        """Choose the display; nothing is shown before the first phase.

        Args:
            quiet: Show nothing.
        """
        self._bar: Any = None
        self._task: Any = None
        self._quiet = quiet
        self._last_line = 0.0
        if not quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            text, bar = TextColumn("{task.description}"), BarColumn(bar_width=_BAR_WIDTH)
            columns = (SpinnerColumn(), text, bar, TimeElapsedColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> "Progress":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Remove the bar from the terminal."""
        if self._bar:
            self._bar.stop()

    def phase(self, text: str, *, can_stop: bool = False) -> None:
        """Report the beginning of a phase of the work; ``text`` is shown as it is."""
        self._report(text, always=True)

    def finish(self, text: str) -> None:
        """Report a phase; there is no request to stop."""
        self.phase(text)

    def step(self, text: str, step: int = 0) -> None:
        """Report progress within a phase; without a terminal, at most one line every two seconds."""
        self._report(text, always=False)

    def _report(self, text: str, *, always: bool) -> None:
        if self._bar:
            self._bar.update(self._task, description=printable_sentence(text).replace("[", r"\["))
        elif not self._quiet and (always or time.monotonic() - self._last_line > _MIN_SECONDS_BETWEEN_LINES):
            self._last_line = time.monotonic()
            print(f"smajax: {printable_sentence(text)}", file=sys.stderr, flush=True)
