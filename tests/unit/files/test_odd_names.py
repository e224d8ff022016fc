"""Names of files that cannot be shown, written or used are refused before any work."""

import os
import sys
from pathlib import Path

import pytest

from smajax.errors import InputError
from smajax.files.result_folder import check_output_folder
from smajax.files.rig_file import read_rig
from smajax.files.templates import write_example
from smajax.recordings.paths import check_output_file, check_output_path
from smajax.recordings.read import read_recording

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has none of these names")

ODD = {
    "not utf-8": (os.fsdecode(b"wi\xffre"), "bytes that are not UTF-8"),
    "line break": ("wi\nre", "a line break or another control character"),
    "escape": ("wi\x1b[31mre", "a line break or another control character"),
    "line separator": ("wi\u2028re", "a line break or another control character"),
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("kind", ODD)
def test_names_that_cannot_be_shown_are_refused(kind):
    name, words = ODD[kind]
    Path(f"{name}.csv").write_text("time [s],current [A]\n0,0.1\n1,0.2\n")
    Path(f"{name}.toml").write_text("schema = 1\n")
    for refuse in (
        lambda: read_recording(f"{name}.csv"),
        lambda: read_rig(f"{name}.toml"),
        lambda: check_output_folder(Path(name)),
        lambda: write_example("dead-weight", Path(name)),
    ):
        with pytest.raises(InputError, match=f"the name has {words}: rename it"):
            refuse()
    assert not Path(name).exists()


def test_other_names_are_used():
    for name in ("温度.csv", "a b.csv", "a\u202eb.csv", "-.csv", "%s.csv", "<b>.csv"):
        Path(name).write_text("time [s],current [A]\n0,0.1\n1,0.2\n")
        assert len(read_recording(name)) == 2
        assert check_output_folder(Path(f"out {name}")).name == f"out {name}"


@pytest.mark.parametrize("length", [225, 245, 255, 256, 300, 5000])
def test_a_name_that_is_too_long_for_the_files_of_a_run_is_refused_at_once(length):
    name = "x" * length
    for path in (Path(name), Path("a") / name / "b"):
        if length <= 225 or (path.name == "b" and length <= 255):
            check_output_folder(path).mkdir(parents=True)
        else:
            with pytest.raises(
                InputError, match=r"the path cannot be used \(File name too long\): name another one with --out"
            ):
                check_output_folder(path)


def test_a_name_that_the_check_accepts_has_room_for_the_temporary_files():
    longest = max(n for n in range(1, 256) if _is_accepted("y" * n))
    for part in (f".{'y' * longest}.12345678.part", f"{'y' * longest}.partial"):
        Path(part).mkdir()


def _is_accepted(name: str) -> bool:
    try:
        check_output_path(Path(name), "--out")
    except InputError:
        return False
    return True


def test_loops_of_symbolic_links_are_refused():
    Path("loop").symlink_to("loop")
    Path("a").symlink_to("b")
    Path("b").symlink_to("a")
    for path in ("loop", "a", "loop/x", "a/x/y"):
        with pytest.raises(InputError, match="the path cannot be used"):
            check_output_folder(Path(path))
    with pytest.raises(InputError, match="loop: there is no such file at the end of this symbolic link"):
        read_rig("loop")
    Path("wire.csv").symlink_to("wire.csv")
    with pytest.raises(InputError, match="wire.csv: there is no such file at the end of this symbolic link"):
        read_recording("wire.csv")


def test_a_file_for_a_result_is_checked_before_the_work():
    Path("folder").mkdir()
    for path, words in (("nowhere/x.toml", "nothing can be written"), ("folder", "this is a folder")):
        with pytest.raises(InputError, match=words):
            check_output_file(Path(path), "--write-set")
    check_output_file(Path("folder/x.toml"), "--write-set")
