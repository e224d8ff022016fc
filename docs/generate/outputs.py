"""Output of commands, which is computed when the site is built: ``<!-- output of: smajax ... -->`` on a page.

The commands of a page run in one folder with the shipped data, in their order, so that a command finds what an earlier
one wrote.
"""

import functools
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Width of a terminal in columns.
WIDTH = 110
# Exit code of a command that refuses its input.
REFUSED = 2
# Variables with which a command would open a browser, or find other data than those that ship.
NOT_PASSED = ("DISPLAY", "WAYLAND_DISPLAY", "SMAJAX_DATA")


class CommandError(RuntimeError):
    """A command on a page failed."""


@functools.cache
def output_of(command: str, page: str) -> str:
    """Return the output of a command as a block of text.

    Args:
        command: The command line, which begins with smajax.
        page: The page, which determines the folder.

    Raises:
        CommandError: If it fails.
    """
    result = _result(command, page)
    if result.returncode:
        raise CommandError(f"'{command}' ended with {result.returncode}: {result.stderr.strip()}")
    return text_block(result.stdout)


def refusal_of(command: str, page: str) -> str:
    """Return the command and the sentence with which it refuses its input, as a block of text.

    Args:
        command: The command line, which begins with smajax.
        page: The page, which determines the folder.

    Raises:
        CommandError: If it succeeds, or fails for another reason.
    """
    result = _result(command, page)
    if result.returncode != REFUSED:
        raise CommandError(f"'{command}' ended with {result.returncode}, not {REFUSED}: {result.stderr.strip()}")
    return text_block(f"$ {command}\n{result.stderr}")


def _result(command: str, page: str) -> subprocess.CompletedProcess[str]:
    program, *words = shlex.split(command)
    if program != "smajax":
        raise CommandError(f"'{command}' does not begin with smajax")
    return result_of(["-m", "smajax", *words], page)


def text_block(text: str) -> str:
    """Return what a command prints as a block of a page.

    Args:
        text: What it prints.
    """
    lines = [part for line in text.strip("\n").rstrip().splitlines() for part in _wrapped(line)]
    return "\n".join(["```text", *lines, "```"])


def run_python(code: str, page: str) -> str:
    """Run Python code in the folder of a page, such as code that makes a file for its commands.

    Args:
        code: The code.
        page: The page, which determines the folder.

    Returns:
        What the code prints.

    Raises:
        CommandError: If it fails.
    """
    result = result_of(["-c", code], page)
    if result.returncode:
        raise CommandError(f"the code of {page} failed: {result.stderr.strip()}")
    return result.stdout


def write_file(name: str, text: str, page: str) -> None:
    """Write a file that a page shows into the folder of its commands.

    Args:
        name: Path of the file, relative to that folder.
        text: Its content.
        page: The page, which determines the folder.
    """
    (_folder(page) / name).write_text(text, "utf-8")


def read_file(name: str, page: str) -> str:
    """Return the content of a file that a command of a page has written.

    Args:
        name: Path of the file, relative to the folder of the page's commands.
        page: The page, which determines the folder.
    """
    return (_folder(page) / name).read_text("utf-8")


def result_of(
    arguments: list[str], page: str, variables: Mapping[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run Python in the folder of a page, without a display, and in a terminal of a known width.

    Args:
        arguments: Arguments of the interpreter.
        page: The page, which determines the folder.
        variables: Environment variables in addition to those of this process.
    """
    environment = {name: value for name, value in os.environ.items() if name not in NOT_PASSED}
    environment |= {"PYTHONPATH": str(ROOT), "COLUMNS": str(WIDTH), **(variables or {})}
    words = [sys.executable, *arguments]
    return subprocess.run(words, cwd=_folder(page), env=environment, capture_output=True, text=True, check=False)


def _wrapped(line: str) -> list[str]:
    """The line of a table and a command as they are, one of prose in several, as a terminal shows it."""
    is_prose = len(line) > WIDTH and "   " not in line.strip() and not line.lstrip().startswith("smajax ")
    return textwrap.wrap(line, WIDTH) if is_prose else [line]


@functools.cache
def _root() -> Path:
    return Path(tempfile.mkdtemp(prefix="smajax-docs-"))


@functools.cache
def _folder(page: str) -> Path:
    """A new folder with the shipped data."""
    folder = _root() / page.replace("/", "-")
    shutil.copytree(ROOT / "data", folder / "data")
    return folder


def prepare_folders() -> None:
    """Make the folder in which each page gets its own, before threads ask for one."""
    _root()


def clean_up() -> None:
    """Remove the folders of the commands."""
    if _root.cache_info().currsize:
        shutil.rmtree(_root(), ignore_errors=True)
        for function in (_root, _folder):
            function.cache_clear()
