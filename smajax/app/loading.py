"""Before packages are imported: Ctrl-C ends the process at once, in one sentence.

An exception in the import of an extension module would come out as another one, or crash the process.
"""

import contextlib
import gc
import os
import signal
import sys
import threading
from types import FrameType

from smajax.errors import Cancelled
from smajax.numerics.process import COMPILATION

# Signal of Linux and macOS at the soft limit of processor time (``ulimit -St``), which is sent again each second.
OUT_OF_TIME: int | None = getattr(signal, "SIGXCPU", None)


def exit_on_interrupt() -> None:
    """Let Ctrl-C end the process, where it would raise ``KeyboardInterrupt``."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    if in_main_thread and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _exit)


def interrupt_at_time_limits() -> None:
    """Let the signals at the time limit of a process, which would kill it, do what Ctrl-C does."""
    for number in (signal.SIGTERM, OUT_OF_TIME):
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _interrupt)


def end_on_interrupt(code: object) -> None:
    """Let Ctrl-C end a process whose command has ended, with the code of the command and without a traceback.

    Args:
        code: Code of ``SystemExit``; ``None`` is 0.
    """
    in_main_thread = threading.current_thread() is threading.main_thread()
    if in_main_thread and callable(signal.getsignal(signal.SIGINT)):  # a background process ignores it
        signal.signal(signal.SIGINT, lambda *_: os._exit(_number_of(code)))


def end_process(code: object) -> None:
    """End the process; at once where a thread still compiles, since nobody waits for the program any more.

    Args:
        code: Code of ``SystemExit``; ``None`` is 0.
    """
    if any(thread.name == COMPILATION for thread in threading.enumerate()):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):  # closed
                stream.flush()
        os._exit(_number_of(code))
    gc.freeze()  # otherwise Python searches all objects for cycles before it ends, which takes long with those of JAX
    sys.exit(code)  # pyright: ignore[reportArgumentType]


def _number_of(code: object) -> int:
    return code if isinstance(code, int) else int(code is not None)


def raise_on_interrupt() -> None:
    """Let Ctrl-C raise ``KeyboardInterrupt`` after ``exit_on_interrupt``."""
    if signal.getsignal(signal.SIGINT) is _exit:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def _interrupt(number: int, frame: FrameType | None) -> None:
    # A second SIGTERM ends the process.
    signal.signal(number, signal.SIG_IGN if number == OUT_OF_TIME else signal.SIG_DFL)
    on_interrupt = signal.getsignal(signal.SIGINT)
    if callable(on_interrupt):
        on_interrupt(number, frame)
    else:  # a process of the background ignores SIGINT
        _exit(number, frame)


def _exit(number: int, frame: FrameType | None) -> None:
    line_end = b"\n" if os.isatty(2) else b""
    os.write(2, line_end + b"smajax: interrupted; nothing was written\n")
    os._exit(Cancelled.exit_code)
