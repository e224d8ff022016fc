"""Cancellation: a progress callback stops a diagnosis by ``StopIteration`` or ``KeyboardInterrupt``."""

from collections.abc import Callable


class CallbackStop(Exception):
    """The progress callback asked to stop. A ``StopIteration`` of other code is a fault and is not taken for it."""


def stoppable(report_progress: Callable[[str], None]) -> Callable[[str], None]:
    """Return a callback that raises ``CallbackStop`` where the given one asks to stop.

    Args:
        report_progress: The callback, which may raise ``StopIteration`` or ``KeyboardInterrupt``.
    """

    def report(text: str) -> None:
        try:
            report_progress(text)
        except (StopIteration, KeyboardInterrupt) as stop:
            raise CallbackStop from stop

    return report
