"""Result folders: complete or not written at all after any interruption, and no other files are deleted."""

import json
import os
import random
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

from smajax.errors import InputError
from smajax.files import result_folder as results
from tests.conftest import ROOT

# Writes the same folder repeatedly, each time with one number in all its files, until it is killed.
WRITER = """
import sys
from pathlib import Path
from smajax.files.result_folder import write_folder
out = Path(sys.argv[1])
for turn in range(1_000_000):
    def fill(folder):
        for name in ("fit.json", "prediction.csv", "report.html"):
            with open(folder / name, "w") as file:
                for _ in range(40):
                    file.write(f"{turn}\\n" * 50)
    write_folder(out, {"turn": turn}, fill)
    print(turn, flush=True)
"""


def fill_with(**texts: str):
    def fill(folder: Path) -> None:
        for name, text in texts.items():
            (folder / name.replace("_", ".")).write_text(text)

    return fill


def contents(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != "run.json"}


def test_a_folder_is_written_with_its_list_of_files(tmp_path):
    results.write_folder(tmp_path / "deep" / "out", {"command": "fit"}, fill_with(fit_json="{}", report_html="page"))
    run = results.read_json(tmp_path / "deep" / "out", "run.json")
    assert run == {"schema": "smajax.run/1", "command": "fit", "files": ["fit.json", "report.html", "run.json"]}
    assert contents(tmp_path / "deep" / "out") == {"fit.json": "{}", "report.html": "page"}


@pytest.mark.parametrize("exchange", [True, False], ids=["exchanged", "renamed twice"])
def test_a_later_run_replaces_the_folder_as_a_whole(tmp_path, monkeypatch, exchange):
    if not exchange:
        monkeypatch.setattr(results, "_exchange", lambda one, other: False)
    out = tmp_path / "out"
    results.write_folder(out, {}, fill_with(fit_json="old", old_csv="1"))
    results.write_folder(out, {}, fill_with(fit_json="new"))
    assert contents(out) == {"fit.json": "new"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_failure_while_writing_leaves_the_old_folder_and_nothing_else(tmp_path):
    out = tmp_path / "out"
    results.write_folder(out, {}, fill_with(fit_json="old"))

    def fail(folder: Path) -> None:
        (folder / "fit.json").write_text("half")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        results.write_folder(out, {}, fail)
    assert contents(out) == {"fit.json": "old"}
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_files_are_flushed_as_windows_needs_it(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")
    modes = []

    def flush(descriptor: int) -> None:  # that of Windows refuses files that are open for reading only
        is_folder = stat.S_ISDIR(os.fstat(descriptor).st_mode)
        modes.append(is_folder or fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_RDWR)

    monkeypatch.setattr(os, "fsync", flush)
    results.write_folder(tmp_path / "out", {}, fill_with(a_txt="a"))
    results.replace_file(tmp_path / "out" / "a.txt", "b")
    assert len(modes) >= 3 and all(modes)


def test_numbers_that_json_does_not_have_are_refused(tmp_path):
    with pytest.raises(ValueError, match="JSON compliant"):
        results.write_folder(tmp_path / "out", {"wall_s": float("nan")}, fill_with(fit_json="{}"))
    assert not (tmp_path / "out").exists()


def test_a_killed_run_leaves_a_whole_folder(tmp_path):
    out = tmp_path / "out"
    chance = random.Random(0)
    turns = []
    for _ in range(12):
        with subprocess.Popen([sys.executable, "-c", WRITER, str(out)], cwd=ROOT, stdout=subprocess.PIPE) as run:
            assert run.stdout is not None
            assert run.stdout.readline()
            time.sleep(chance.uniform(0.0, 0.06))
            run.kill()
        record = json.loads((out / "run.json").read_text())
        assert sorted(path.name for path in out.iterdir()) == record["files"]
        for name in ("fit.json", "prediction.csv", "report.html"):
            assert (out / name).read_text() == f"{record['turn']}\n" * 2000
        turns.append(record["turn"])
    assert max(turns) > 0


def test_old_folders_of_killed_runs_are_removed(tmp_path):
    young, old, other = (
        tmp_path / name for name in (".out.0123abcd.part", ".out.4567cdef.part", ".outer.4567cdef.part")
    )
    for folder in (young, old, other):
        folder.mkdir()
        (folder / "fit.json").write_text("half")
    for folder in (old, other):
        os.utime(folder, (time.time() - 7200,) * 2)
    results.write_folder(tmp_path / "out", {}, fill_with(fit_json="{}"))
    assert young.exists()
    assert other.exists()
    assert not old.exists()


def test_an_empty_folder_is_filled_and_a_link_is_followed(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "real")
    results.write_folder(tmp_path / "link", {}, fill_with(fit_json="{}"))
    assert (tmp_path / "link").is_symlink()
    assert contents(tmp_path / "real") == {"fit.json": "{}"}


def foreign(folder: Path) -> Path:
    folder.mkdir()
    (folder / "thesis.txt").write_text("years of work")
    return folder


def added_to(folder: Path) -> Path:
    results.write_folder(folder, {}, fill_with(fit_json="{}"))
    (folder / "notes.md").write_text("mine")
    return folder


def forged(folder: Path) -> Path:
    folder.mkdir()
    (folder / "run.json").write_text('{"schema": "smajax.run/1"}')
    return folder


def a_file(path: Path) -> Path:
    path.write_text("text")
    return path


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (foreign, "this folder is not a result of smajax"),
        (added_to, "this folder holds 'notes.md', which smajax did not write"),
        (forged, "this folder is not a result of smajax"),
        (a_file, "this is a file"),
    ],
)
def test_other_folders_are_never_replaced(tmp_path, make, sentence):
    out = make(tmp_path / "out")
    before = out.read_text() if out.is_file() else sorted(path.name for path in out.iterdir())
    for ask in (
        lambda: results.check_output_folder(out),
        lambda: results.write_folder(out, {}, fill_with(fit_json="new")),
    ):
        with pytest.raises(InputError, match=sentence):
            ask()
    assert (out.read_text() if out.is_file() else sorted(path.name for path in out.iterdir())) == before


def test_the_working_directory_is_not_replaced(tmp_path, monkeypatch):
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    for out in (Path("."), Path("..")):
        with pytest.raises(InputError, match="this is the folder you are in"):
            results.check_output_folder(out)


def test_a_file_in_the_way_is_named_before_any_work(tmp_path):
    with pytest.raises(InputError, match="nothing can be written in"):
        results.check_output_folder(a_file(tmp_path / "file") / "out")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, "no run.json"),
        ("{", "this is not JSON"),
        ("[1]", "smajax did not write this file"),
        ('{"schema": "x"}', "smajax did not write this file"),
    ],
)
def test_folders_that_are_not_results_are_refused(tmp_path, text, sentence):
    if text is not None:
        (tmp_path / "run.json").write_text(text)
    with pytest.raises(InputError, match=sentence):
        results.read_json(tmp_path, "run.json")


def test_one_file_is_replaced_completely(tmp_path):
    out = tmp_path / "out"
    results.write_folder(out, {}, fill_with(report_html="old"))
    results.replace_file(out / "report.html", "new")
    assert (out / "report.html").read_text() == "new"
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_file_that_cannot_be_written_is_told_by_the_name_of_the_folder(tmp_path, monkeypatch):
    from smajax.recordings.recording import Recording

    recording = Recording.from_arrays("a.csv", [0.0, 1.0], {"current": [0.0, 0.1]}, {"current": "A"})

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("smajax.recordings.paths.os.replace", full)
    with pytest.raises(InputError) as refusal:
        results.write_folder(tmp_path / "out", {}, lambda folder: recording.write(folder / "simulation.csv"))
    text = (
        f"{tmp_path / 'out'}: the result cannot be written (No space left on device): make room, or name another --out"
    )
    assert str(refusal.value) == text
    assert not list(tmp_path.iterdir())
