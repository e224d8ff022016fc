"""Progress of a long run, reported on stderr."""

import sys
import time
from typing import Any

# Least time (s) between two lines of one phase where stderr is not a terminal; chosen by trial.
_MIN_SECONDS_BETWEEN_LINES = 2.0
# Width of the bar in characters.
_BAR_WIDTH = 24


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

    def phase(self, text: str) -> None:
        """Report the beginning of a phase of the work; ``text`` is shown as it is."""
        self._report(text, always=True)

    def step(self, text: str) -> None:
        """Report progress within a phase; without a terminal, at most one line every two seconds."""
        self._report(text, always=False)

    def _report(self, text: str, *, always: bool) -> None:
        if self._bar:
            self._bar.update(self._task, description=text.replace("[", r"\["))
        elif not self._quiet and (always or time.monotonic() - self._last_line > _MIN_SECONDS_BETWEEN_LINES):
            self._last_line = time.monotonic()
            print(f"smajax: {text}", file=sys.stderr, flush=True)
