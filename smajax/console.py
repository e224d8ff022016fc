"""What a command does around its work: progress, interruption, exit codes, the compilation cache, the browser.

Exit codes: 0 done, 1 a fault in smajax, 2 bad input, 3 the numbers failed, 130 interrupted.
"""

import contextlib
import gc
import os
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

from smajax.errors import InputError, NumericsError

FAULT, INTERRUPTED = 1, 130
_EVERY = 2.0
_OBJECTS = 200_000  # made before garbage is looked for


class Progress:
    """Says on stderr what a long run is doing: a moving bar on a terminal, plain lines elsewhere, nothing if ``quiet``."""

    def __init__(self, quiet: bool = False):
        self._bar: Any = None
        self._task: Any = None
        self._quiet = quiet
        self._said = 0.0
        if not quiet and sys.stderr.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn
            from rich.progress import Progress as Bar

            columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(bar_width=24), TimeElapsedColumn())
            self._bar = Bar(*columns, console=Console(stderr=True), transient=True)
            self._task = self._bar.add_task("", total=None)

    def __enter__(self) -> "Progress":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Takes the bar off the terminal."""
        if self._bar:
            self._bar.stop()

    def phase(self, text: str) -> None:
        """A new part of the work begins."""
        self._say(text, always=True)

    def step(self, text: str) -> None:
        """The same part goes on; off a terminal, a line every two seconds at most."""
        self._say(text, always=False)

    def _say(self, text: str, *, always: bool) -> None:
        if self._bar:
            self._bar.update(self._task, description=text.replace("[", r"\["))
        elif not self._quiet and (always or time.monotonic() - self._said > _EVERY):
            self._said = time.monotonic()
            print(f"smajax: {text}", file=sys.stderr, flush=True)


class Stopping:
    """Whether Ctrl-C was pressed."""

    requested = False


@contextlib.contextmanager
def stopping(progress: Progress) -> Iterator[Stopping]:
    """Within this, a first Ctrl-C only asks to stop, so that what was reached can be kept; a second one ends the process at once.

    It does not raise, since an exception in the middle of a compilation may be lost there.
    """
    asked = Stopping()
    if threading.current_thread() is not threading.main_thread():
        yield asked
        return

    def on_interrupt(number: int, frame: FrameType | None) -> None:
        if asked.requested:
            progress.close()
            _say("interrupted; nothing was written")
            os._exit(INTERRUPTED)
        asked.requested = True
        progress.phase("stopping after this step, the best point so far is kept; press Ctrl-C again to stop at once")

    before = signal.signal(signal.SIGINT, on_interrupt)
    try:
        yield asked
    finally:
        signal.signal(signal.SIGINT, before)


def exit_code(error: BaseException) -> int:
    """Says on stderr what went wrong, in one sentence, and gives the exit code for it."""
    if isinstance(error, InputError | NumericsError):
        _say(str(error))
        return error.exit_code
    if isinstance(error, KeyboardInterrupt):
        _say("interrupted; nothing was written")
        return INTERRUPTED
    if isinstance(error, MemoryError):
        _say("there is not enough memory for this: cut the recordings into parts, or lower --starts")
        return FAULT
    if isinstance(error, BrokenPipeError):  # the reader of our output has gone, as in `smajax datasets | head`
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return FAULT
    _say(f"{type(error).__name__}: this is a fault in smajax, not in your files; what happened is written down in {_write_down(error)}")
    return FAULT


def _say(text: str) -> None:
    with contextlib.suppress(OSError):
        print(f"smajax: {text}", file=sys.stderr)


def _write_down(error: BaseException) -> str:
    text = "".join(traceback.format_exception(error))
    try:
        with tempfile.NamedTemporaryFile("w", prefix="smajax-", suffix=".txt", delete=False, encoding="utf-8") as file:
            file.write(text)
        return file.name
    except OSError:
        return f"these lines:\n{text}"


def prepare_jax(accelerator: bool = False) -> None:
    """Have compiled programs kept between runs, in the user's cache folder or where ``JAX_COMPILATION_CACHE_DIR`` says.

    Unless ``accelerator``, or ``JAX_PLATFORMS`` says otherwise, they run on the processor: a few simulations at a time, step after step,
    are many times as slow on a GPU, which pays where thousands of designs go side by side.

    Equinox's run-time checks are switched off first: they bring calls from the compiled program into Python, with which it could not be
    kept, and smajax's simulations carry result codes instead. Where no folder can be written, nothing is kept, and all else works. Garbage
    is collected more seldom, since a program that is being written down is a great many small objects, none of which is garbage. Raises
    ``RuntimeError`` if Equinox has been loaded before, since the checks are then there to stay.
    """
    if "equinox" in sys.modules and os.environ.get("EQX_ON_ERROR") != "off":
        raise RuntimeError("prepare_jax has to be called before anything imports equinox")
    os.environ.setdefault("EQX_ON_ERROR", "off")
    gc.set_threshold(_OBJECTS, 20, 50)
    import jax

    from smajax import jax_options  # noqa: F401

    if not accelerator and not os.environ.get("JAX_PLATFORMS"):
        jax.config.update("jax_platforms", "cpu")
    if not os.environ.get("JAX_COMPILATION_CACHE_DIR"):
        folder = cache_folder("jax")
        if folder is None:
            return
        jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def cores() -> int:
    """The processor cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def cache_folder(name: str) -> Path | None:
    """A folder of that name in the user's cache; ``None`` if none can be written."""
    import pooch

    folder = Path(pooch.os_cache("smajax")) / name
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except (OSError, RuntimeError):
        return None


def open_in_browser(page: Path) -> bool:
    """Shows a page, where there is a screen to show it on; says whether it tried."""
    import webbrowser

    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        return False
    try:
        return webbrowser.open(page.as_uri())
    except (webbrowser.Error, OSError):
        return False
