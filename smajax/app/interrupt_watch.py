"""Detection of a second Ctrl-C during a call of another library, such as a compilation.

Python runs the handler of a signal after such a call only, once for all signals until then. It writes a byte to a file
for each signal at once, however; a thread reads and counts them.
"""

import contextlib
import signal
import socket
import threading
from collections.abc import Callable, Sequence

# Number of the signal that ends the process.
_SECOND = 2
# Bytes that are read at a time, one for each signal.
_BYTES = 16


class InterruptWatch:
    """Calls a function at the second Ctrl-C after ``start``, from a thread, and not more than once."""

    def __init__(self, signals: Sequence[int], function: Callable[[], object]):
        """Count no signals before ``start``.

        Args:
            signals: Numbers of the signals that count: that of Ctrl-C, and those that mean the same.
            function: Function that ends the process.
        """
        self._signals, self._function = signals, function
        self._once = threading.Lock()
        self._writer: socket.socket | None = None
        self._previous = -1

    def start(self) -> None:
        """Count from 0; to be called from the main thread. If there is no socket or thread left, nothing is watched."""
        with contextlib.suppress(OSError, RuntimeError):  # no socket, no thread
            reader, writer = socket.socketpair()
            writer.setblocking(False)
            threading.Thread(target=self._read, args=(reader,), daemon=True, name="smajax-interrupts").start()
            self._previous = signal.set_wakeup_fd(writer.fileno(), warn_on_full_buffer=False)
            self._writer = writer

    def stop(self) -> None:
        """Watch no longer; to be called from the main thread."""
        if self._writer is not None:
            signal.set_wakeup_fd(self._previous)
            self._writer.close()
            self._writer = None

    def end(self) -> None:
        """Call the function, unless it was called before."""
        if self._once.acquire(blocking=False):
            self._function()

    def _read(self, reader: socket.socket) -> None:
        count = 0
        with reader:
            while content := reader.recv(_BYTES):
                count += sum(content.count(number) for number in self._signals)
                if count >= _SECOND:
                    self.end()
                    return
