"""Every reader and every TOML file against seeded mutations: some hundred tries each, and an hour by ``pytest -m fuzz``."""

import os
import struct
import zlib

import pytest

from smajax.errors import InputError
from smajax.recordings.read import read_recordings
from tests.fuzz.attempts import FORMATS, mutated_file, try_recording
from tests.fuzz.hunt import hunt
from tests.fuzz.mutations import mutate
from tests.fuzz.samples import SAMPLES
from tests.fuzz.settings import KINDS, try_settings

# Tries in a run of all tests; a workbook or a bag takes some ten times as long as a text.
TRIES = {"xlsx": 80, "mat73": 80, "bag": 50, "db3": 40, "controller": 60, "rig": 150, "sweep": 100}
USUAL_TRIES = 300
# Seconds of all hunts together in ``pytest -m fuzz``.
HOUR = float(os.environ.get("SMAJAX_FUZZ_SECONDS", "3600"))
# Seed of the first try of a hunt; another one makes other tries.
FIRST = int(os.environ.get("SMAJAX_FUZZ_SEED", "1000000"))

# Seeds of tries that once ended in another error than a sentence, crashed, or hung.
FOUND = {
    "mat4": (1063, 1500, 2928),
    "mat5": (420, 4473),
    "mat73": (11, 21, 27, 33),
    "parquet": (3168,),
    "xlsx": (20046080,),
    "mcap": (74, 104, 144),
    "bag": (8, 16),
    "db3": (216, 688, 200127, 300176),
}


@pytest.mark.parametrize("kind", FORMATS)
def test_mutated_recordings_are_read_or_refused(kind, tmp_path):
    outcomes = [try_recording(kind, seed, tmp_path) for seed in range(TRIES.get(kind, USUAL_TRIES))]
    assert {"read", "refused"} == set(outcomes)


@pytest.mark.parametrize("kind", KINDS)
def test_mutated_settings_are_read_or_refused(kind, tmp_path):
    outcomes = [try_settings(kind, seed, tmp_path) for seed in range(TRIES.get(kind, USUAL_TRIES))]
    assert {"read", "refused"} == set(outcomes)


@pytest.mark.parametrize(("kind", "seed"), [(kind, seed) for kind, seeds in FOUND.items() for seed in seeds])
def test_tries_that_once_failed(kind, seed, tmp_path):
    assert try_recording(kind, seed, tmp_path) in ("read", "refused")


def test_a_try_is_the_same_in_every_process():
    assert mutated_file("mat5", 3) == mutated_file("mat5", 3)
    assert zlib.crc32(mutated_file("tdms", 5)[1]) != zlib.crc32(SAMPLES["tdms"][0].content)


def test_the_mutations_reach_what_is_compressed(tmp_path):
    """Most tries on compressed arrays are refused for their content, and not by the checksum of the compression."""
    sentences = []
    for seed in range(150):
        suffix, content, options = mutated_file("mat5", seed)
        if struct.unpack_from("<I", content.ljust(132, b"\0"), 128)[0] != 15:
            continue
        path = tmp_path / f"wire{suffix}"
        path.write_bytes(content)
        try:
            read_recordings(path, required=("current",), observed=("displacement",), **options)
        except InputError as error:
            sentences.append(str(error))
    assert sentences and sum("decompressing" in text for text in sentences) < len(sentences) / 2


def test_a_crash_and_a_wrong_error_are_found(tmp_path, monkeypatch):
    """The checks of a try fail where the reader does."""

    def fail(*_: object, **__: object) -> list:
        raise ZeroDivisionError

    monkeypatch.setattr("tests.fuzz.attempts.read_recordings", fail)
    with pytest.raises(ZeroDivisionError):
        try_recording("csv", 1, tmp_path)
    assert mutate(b"", __import__("random").Random(1)) is not None


@pytest.mark.fuzz
@pytest.mark.parametrize("kind", [*FORMATS, *KINDS])
def test_an_hour_of_tries_in_processes_of_their_own(kind):
    findings = hunt(kind, FIRST, HOUR / len([*FORMATS, *KINDS]))
    print(f"{kind}: {findings.tries} tries, {dict(findings.outcomes)}, {len(findings.faults)} faults")
    assert not findings.faults
