"""The command import and its page: from a file as it is to a rig that reads it, alone and with answers in a terminal."""

import json
import os
import pty
import re
import select
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

import smajax as sma
from docs.generate.blocks import blocks
from smajax.app import cli
from smajax.files.channel_settings import channel_settings
from smajax.files.recording_settings import recording_options
from smajax.recordings.read import read_recordings
from smajax.recordings.recording import Recording
from tests.conftest import ROOT
from tests.integration.test_cli import sentence, smajax

PAGE = (ROOT / "docs" / "how-to" / "import-a-file.md").read_text("utf-8")
OF_OTHERS = [block.text for block in blocks(PAGE) if "datasets get" in block.text]
LOG = "nr;millis;wire temp;load cell;pwm\n" + "".join(
    f"{k};{50 * k};{24 + k / 4:.2f};{800 - k};{120 * (k > 5)}\n".replace(".", ",") for k in range(40)
)
FORCE = "force [N] factor=-0.0087 offset=7.5"
# Raw files of other people, with what a user has to say about them.
RAW = {
    "dongsus-pwm-temperature/0331 test1.csv": ({}, {}),
    "guarneros-sma-force/AB0.csv": (
        {"Force sensor": "force [N] factor=-0.008694436 offset=7.486899"},
        {"sample_period": "19 ms"},
    ),
    "bu-softlimb/test_c1_only.csv": ({}, {}),
    "confluent-diamond/QoI_expt_load.csv": ({}, {}),
    "tamu-flexinol-isobaric/isobaric_150MPa.txt": (
        {},
        {"columns": ("temperature [degC]", "strain [1]", "stress [MPa]")},
    ),
    "tamu-muscle-superelastic/pseudoelastic_40C.xlsx": ({}, {}),
    "tamu-muscle-electric/Period_21.xlsx": ({}, {}),
    "tamu-react-raw/mts_3cycle.txt": ({}, {}),
}


def assert_same(first: Recording, second: Recording) -> None:
    assert first.has_clock == second.has_clock and set(first.channels) == set(second.channels)
    assert np.array_equal(first.time, second.time)
    assert all(np.array_equal(first.channels[name], second.channels[name]) for name in first.channels)


def assert_reads_back(path: Path, folder: Path, result: sma.RecordingImport) -> None:
    """The written recordings, and the original file by the written sections, have the same channels."""
    *written, sections = [path for path in result.save(folder) if not path.name.endswith("-rig.toml")]
    data = tomllib.loads(sections.read_text("utf-8"))
    channels, options = channel_settings(data.get("channels", {})), recording_options(data)
    clock = result.recordings[0].has_clock
    original = read_recordings(path, mapping=channels.columns, ignore=channels.ignore, options=options, clock=clock)
    assert len(original) == len(result.recordings) == len(written)
    for recording, again, file in zip(result.recordings, original, written, strict=True):
        assert_same(recording, again)
        assert_same(recording, sma.read_recording(file, clock=clock))


@pytest.fixture
def log(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = Path("log.csv")
    path.write_text(LOG)
    return path


@pytest.mark.parametrize("name", RAW)
def test_raw_files_of_others_are_read_back(shared, tmp_path, name):
    channels, reading = RAW[name]
    path = shared / "data" / name
    assert_reads_back(path, tmp_path, sma.import_recording(path, channels=channels, **reading))


@pytest.mark.parametrize(
    "name",
    ["latin1.csv", "other-names.csv", "time-of-day.csv", "title-lines.csv", "utf16.csv", "sheet-per-stress.xlsx"],
)
def test_exports_of_instruments_need_no_word(shared, tmp_path, name):
    path = shared / "cases" / "instrument-exports" / name
    result = sma.import_recording(path)
    assert not result.questions and set(result.recordings[0].channels) == {"temperature", "stress", "strain"}
    assert_reads_back(path, tmp_path, result)


def test_the_command_states_its_doubts_and_writes_three_files(log):
    result = smajax("import", "log.csv")
    assert result.exit_code == 0, result.output
    assert "Doubts:\n1. load cell: the whole numbers 761 to 800 are counts of a converter" in result.stdout
    assert "Otherwise give for example --channel 'load cell = force [N] factor=0.01 offset=0'" in result.stdout
    assert 'duty = {column = "pwm", full_scale = 255.0}' in result.stdout
    assert "smajax explain free-parameters" in " ".join(result.stdout.split())
    assert max(map(len, result.stdout.splitlines())) <= 110
    names = ["log-recording.csv", "log-rig.toml", "log-sections.toml", "log.csv"]
    assert sorted(path.name for path in Path().iterdir()) == names
    assert result.stdout.endswith(
        "Next: smajax check log-rig.toml log.csv\n      smajax fit log-rig.toml log.csv --out log-fit\n"
    )
    header = Path("log-recording.csv").read_text().partition("\n")[0]
    assert header == "time [ms],temperature [degC],duty [1]"
    assert log.read_text() == LOG


def test_a_file_that_exists_is_not_overwritten(log):
    assert smajax("import", "log.csv", "--out", "a").exit_code == 0
    before = Path("a/log-recording.csv").read_bytes()
    result = smajax("import", "log.csv", "--out", "a", "--channel", f"load cell = {FORCE}")
    assert result.exit_code == 2
    assert "log-recording.csv: this file exists and is not overwritten: name another folder" in result.stderr
    assert Path("a/log-recording.csv").read_bytes() == before
    result = sma.import_recording("log.csv", channels={"load cell": FORCE})
    result.save("a", overwrite=True)
    assert b"force [N]" in Path("a/log-recording.csv").read_bytes()


def test_a_file_without_names_says_how_to_name_them(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("cycle.txt").write_text("".join(f"{30 + k} {0.04 - k / 1000} {100 + k % 2}\n" for k in range(30)))
    text = sentence(smajax("import", "cycle.txt"), 2)
    assert "no column is recognised as a channel ('column 1': it has no name, and its values are 30 to 59" in text
    columns = re.search(r"for example --columns '(.+?)'", text)
    assert columns is not None
    result = smajax("import", "cycle.txt", "--columns", "temperature [degC],strain [1],stress [MPa]")
    assert result.exit_code == 0, result.output
    assert 'columns = ["temperature [degC]", "strain [1]", "stress [MPa]"]' in result.stdout


def test_answers_decide_and_the_choice_of_a_question_stays(log):
    asked = []

    def ask(question):
        asked.append(question.key)
        return FORCE if question.key == "load cell" else None

    result = sma.import_recording(log, ask=ask)
    values = ["drive.supply", "wire.diameter", "wire.length", "spring.stiffness"]
    assert asked == ["load cell", "rig", *values] and not result.questions
    assert result.rig.fit.free[0] == "drive.supply"
    assert result.channels.columns["force"].factor == -0.0087
    assert_reads_back(log, Path("out"), result)


@pytest.mark.slow
def test_a_terminal_asks_until_an_answer_is_possible(log):
    command = [sys.executable, "-m", "smajax", "import", "log.csv", "--out", "a"]
    output = in_terminal(command, ["force", FORCE, "dead-wait", "dead-weight", "5 A", "5 V", "1 kg", "0.2 mm"])
    assert "Rig: bias-spring is suggested, since duty heats the wire, and the force changes" in output
    assert (
        "'dead-wait' is not a kind of rig" in output and "wire.diameter: '1 kg': the unit 'kg' does not fit" in output
    )
    rig = sma.read_rig("a/log-rig.toml")
    assert rig.kind == "dead-weight" and float(rig.plant.wire.diameter) == pytest.approx(0.2e-3)
    assert re.search(
        r"drive.supply: supply voltage .*, so that a fit finds it, from \S+ V on, unless you know it", output
    )
    assert "drive.supply: '5 A': the unit 'A' does not fit" in output
    assert float(rig.plant.drive.supply) == 5.0 and "drive.supply" not in rig.fit.free
    assert "1  leave it out  (Enter)" in output and "'force' has no unit" in output
    assert "Doubts" not in output and Path("a/log-sections.toml").is_file()
    assert "factor = -0.0087" in Path("a/log-sections.toml").read_text()
    output = in_terminal(command, ["", "none", "n"])
    assert "Replace a/log-recording.csv, a/log-sections.toml? [y/N]: n" in output
    assert "factor = -0.0087" in Path("a/log-sections.toml").read_text()
    in_terminal(command, ["", "none", "y"])
    assert "factor" not in Path("a/log-sections.toml").read_text()


def in_terminal(command: list[str], answers: list[str]) -> str:
    """Run a command in a terminal, answer its questions, the last ones by Enter, and return what it prints."""
    master, slave = pty.openpty()
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    process = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, env=environment, close_fds=True)
    os.close(slave)
    output = ""
    while select.select([master], [], [], 60)[0]:
        try:
            piece = os.read(master, 4096).decode()
        except OSError:  # the terminal is closed
            break
        output += piece
        if not piece:
            break
        if output.endswith(": "):
            os.write(master, ((answers.pop(0) if answers else "") + "\n").encode())
    process.wait(60)
    os.close(master)
    return output.replace("\r", "")


def with_command(folder: Path) -> dict[str, str]:
    """Return an environment in which ``smajax`` is a command, and make the folder ``bench``."""
    (folder / "smajax").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m smajax "$@"\n')
    (folder / "smajax").chmod(0o755)
    (folder / "bench").mkdir()
    return os.environ | {"PYTHONPATH": str(ROOT), "PATH": f"{folder}:{os.environ['PATH']}"}


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(OF_OTHERS)))
def test_raw_files_of_others_lead_to_a_fit_by_the_commands_of_the_page(shared, tmp_path, number):
    environment = with_command(tmp_path) | {"SMAJAX_DATA": str(shared / "data")}
    words = ["sh", "-e", "-c", OF_OTHERS[number]]
    done = subprocess.run(words, cwd=tmp_path / "bench", env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (document,) = (tmp_path / "bench").glob("*/fit/fit.json")
    fit = json.loads(document.read_text("utf-8"))
    assert fit["solver"]["code"] == "converged"
    estimates = [p for p in fit["parameters"].values() if p["free"]]
    assert estimates and all(p["lower95"] < p["estimate"] < p["upper95"] for p in estimates)
    # What the page says: the next two commands are those that the import prints.
    commands = [line for line in OF_OTHERS[number].splitlines() if re.match("smajax (check|fit)", line)]
    assert len(commands) == 2 and done.stdout.count("Next: smajax check ") == 1


def test_the_command_is_listed():
    assert "import" in {command.name for command in cli.app.registered_commands}
