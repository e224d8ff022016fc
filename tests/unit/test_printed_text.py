"""What is printed: control characters as escapes, long sentences shortened, and usage errors in one sentence."""

import errno
import os
import subprocess
import sys
import unicodedata

import pytest

from smajax.app.console import exit_code
from smajax.errors import printable, printable_sentence
from tests.conftest import ROOT


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("plain µm 温度 ü", "plain µm 温度 ü"),
        ("a\x1b[31mb\x07", "a\\x1b[31mb\\x07"),
        ("a\r\tb\x9b", "a\\r\\tb\\x9b"),
        ("a\u202eb\u2066c\u200fd", "a\\u202eb\\u2066c\\u200fd"),
        ("two\nlines\u2028", "two\nlines\\u2028"),
        (os.fsdecode(b"a\xff") if os.name == "posix" else "a\udcff", "a\\xff"),
        ("a\ud800", "a\\ud800"),
    ],
)
def test_what_a_terminal_acts_on_is_escaped(text, shown):
    assert printable(text) == shown
    assert printable_sentence(text) == shown.replace("\n", "\\n")


def test_every_character_is_shown_or_escaped():
    text = "".join(map(chr, range(0x110000)))
    shown = printable_sentence(text[:0x3000]) + printable(text[0x3000:])
    assert not {unicodedata.category(c) for c in shown} & {"Cc", "Cf", "Cs", "Zl", "Zp"} and shown.encode("utf-8")


def test_a_long_sentence_keeps_its_beginning_and_its_end():
    line = printable_sentence("wire.csv: column '" + "x" * 100_000 + "' is not known: rename it")
    assert len(line) < 5000 and line.startswith("wire.csv: column 'x") and line.endswith("' is not known: rename it")


def run(*words: str, encoding: str = "utf-8", cwd: object = None) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"PYTHONIOENCODING": encoding, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "smajax", *words]
    return subprocess.run(
        command, capture_output=True, text=True, encoding="utf-8", errors="replace", env=environment, cwd=cwd
    )


@pytest.mark.slow
def test_a_console_that_cannot_encode_a_text_gets_escapes(tmp_path):
    for folder, encoding, shown in (
        ("für", "utf-8", "für"),
        ("温度", "ascii", r"\u6e29\u5ea6"),
        ("ж", "cp1252", r"\u0436"),
    ):
        result = run("init", "dead-weight", "--out", folder, encoding=encoding, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
        assert f"Wrote {shown}/rig.toml" in result.stdout.replace(os.sep, "/")


@pytest.mark.parametrize(
    "words", [["fly"], ["fit"], ["fit", "--speed"], ["init", "tractor\x1b[31m"], ["fit", "a", "b", "--starts", "x"]]
)
def test_a_wrong_command_line_is_one_sentence(words):
    result = run(*words)
    assert (result.returncode, result.stdout) == (2, "")
    assert result.stderr.startswith("smajax: ") and result.stderr.count("\n") == 1 and "--help' shows" in result.stderr
    assert "\x1b" not in result.stderr


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps a folder in which a process is")
def test_absolute_paths_do_not_need_the_working_folder(tmp_path):
    gone, data = tmp_path / "gone", ROOT / "data" / "recordings" / "dead-weight"
    gone.mkdir()
    probe = (
        f"import os; os.chdir({str(gone)!r}); os.rmdir({str(gone)!r})\n"
        "import sys; sys.argv[1:] = sys.argv[1:]; from smajax.__main__ import main; main()"
    )
    words = ["simulate", str(data / "rig.toml"), str(data / "train.csv"), "--quiet", "--out", str(tmp_path / "out")]
    result = subprocess.run([sys.executable, "-c", probe, *words], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "out" / "run.json").is_file()


@pytest.mark.parametrize(
    ("error", "words", "code"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "make room on the disk", 3),
        (OSError(errno.EMFILE, "Too many open files", "a.csv"), "a.csv: the system refuses (Too many open files)", 3),
        (MemoryError(), "lower --starts, or chunk of a sweep", 3),
        (
            RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating 8 bytes"),
            "there is not enough memory for this",
            3,
        ),
        (RuntimeError("can't start new thread"), "the system starts no further threads", 3),
    ],
)
def test_a_lack_of_memory_disk_or_processes_is_a_sentence(error, words, code, capsys):
    assert exit_code(error) == code
    assert words in capsys.readouterr().err


def test_a_ctrl_c_while_python_ends_keeps_the_code_of_the_command():
    probe = (
        "import atexit, signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "atexit.register(signal.raise_signal, signal.SIGINT)\n"
        "sys.argv[1:] = ['fly']; from smajax.__main__ import main; main()"
    )
    result = subprocess.run([sys.executable, "-c", probe], capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 2 and result.stderr.count("\n") == 1, result.stderr


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no device that is full")
def test_a_full_disk_is_a_sentence():
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "smajax", "sets"]
        result = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, cwd=ROOT)
    assert (result.returncode, result.stderr.count("\n")) == (3, 1) and "make room on the disk" in result.stderr
