"""A limit of the address space (``ulimit -v``): too little is refused, and a command that gets no more says so.

JAX's compiler ends the process where it gets no memory, without an error that Python could report. Where the system
sets a limit, the command therefore runs in a child process, and this one reports how it ended. Linux only.
"""

import contextlib
import ctypes
import os
import signal
import sys
from pathlib import Path

from smajax.app.output import say_on_stderr
from smajax.errors import NumericsError

# Bytes of address space that a command needs at least: one with few programs, with many, and with wide batches. Found
# with an empty cache of compiled programs; test_a_small_address_space_is_refused in tests/integration/test_cli.py holds
# the first.
FEW_PROGRAMS, MANY_PROGRAMS, WIDE_PROGRAMS = 2 * 2**30, 3 * 2**30, 4 * 2**30
# Signals that end a process that gets no memory: by itself, by an access without a check, or by the system.
_OUT_OF_MEMORY = (signal.SIGABRT, signal.SIGSEGV, getattr(signal, "SIGBUS", None), getattr(signal, "SIGKILL", None))
# Signals that are passed on to the child.
_PASSED_ON = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
# Origin of a signal that the terminal sends, to the child as well (SI_KERNEL of Linux).
_FROM_TERMINAL = 0x80
# Option of prctl(2) that names the signal which a process gets when its parent ends (PR_SET_PDEATHSIG of Linux).
_AT_END_OF_PARENT = 1


def check_address_space(needed: int) -> None:
    """Check that the system does not limit the address space of this process below what a command needs.

    Args:
        needed: Bytes that the command needs.

    Raises:
        NumericsError: If it does.
    """
    limit = _address_space_limit()
    if limit is not None and limit < needed:
        raise NumericsError(
            f"there is not enough memory for this: the limit of this process is {limit // 2**20:,} MiB, and "
            f"{needed // 2**20:,} MiB are needed: raise it ('ulimit -v')"
        )


def report_out_of_memory() -> None:
    """Continue in a child process if the address space is limited; this process then ends with the child's exit code.

    A child that was ended for missing memory is reported in one sentence, with the exit code of a numerical failure.
    Where JAX is loaded already, its threads do not allow a child, and nothing is done.
    """
    limit = _address_space_limit()
    if limit is None or "jax" in sys.modules:
        return
    watched = (*_PASSED_ON, signal.SIGCHLD)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, the exit code is lost
    before = signal.pthread_sigmask(signal.SIG_BLOCK, watched)
    try:
        child = os.fork()
    except OSError:  # no process left: continue without a report
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return
    if child == 0:
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_AT_END_OF_PARENT, signal.SIGKILL)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        return
    number = _end_of(child, watched)
    if -number in _OUT_OF_MEMORY:
        say_on_stderr(
            f"the memory ran out: the limit of this process is {limit // 2**20:,} MiB of address space; results that "
            "were complete are kept: raise the limit ('ulimit -v')"
        )
        number = NumericsError.exit_code
    if number < 0:  # ended by another signal, and so does this process
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(-number, signal.SIG_DFL)
        os.kill(os.getpid(), -number)
    os._exit(number)


def _end_of(child: int, watched: tuple[signal.Signals, ...]) -> int:
    """Wait for the end of a child, and pass signals on to it; its exit code, or the negative number of a signal."""
    while True:
        received = signal.sigwaitinfo(watched)
        if received.si_signo != signal.SIGCHLD and received.si_code != _FROM_TERMINAL:
            with contextlib.suppress(ProcessLookupError):
                os.kill(child, received.si_signo)
        if os.waitid(os.P_PID, child, os.WEXITED | os.WNOHANG | os.WNOWAIT) is not None:
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _address_space_limit() -> int | None:
    """The limit in bytes; ``None`` without one, or on another system."""
    try:
        lines = Path("/proc/self/limits").read_text("utf-8").splitlines()
    except OSError:
        return None
    limit = next((line.split()[3] for line in lines if line.startswith("Max address space")), "unlimited")
    return int(limit) if limit.isdigit() else None
