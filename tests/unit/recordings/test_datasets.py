"""Data sets: shipped ones, local copies of public ones, and fetching from a local test server."""

import hashlib
import shutil
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import pytest

from smajax.errors import InputError
from smajax.recordings import datasets
from smajax.recordings.datasets import Dataset, PublicFile


def test_the_list_names_source_licence_and_hashes():
    catalogue = datasets.datasets()
    shipped = [d for d in catalogue.values() if d.folder is not None]
    public = [d for d in catalogue.values() if d.folder is None]
    assert {d.name for d in shipped} >= {"dead-weight", "bias-spring", "rotary", "testing-machine", "isobaric"}
    assert len(public) == 12
    for dataset in public:
        assert dataset.description
        assert dataset.licence
        assert len(dataset.commit) == 40
        for file in dataset.files:
            assert len(file.sha256) == 64
            if file.path is not None:
                address = dataset.address(file)
                assert address.startswith(f"https://raw.githubusercontent.com/{dataset.repository}/{dataset.commit}/")
                assert " " not in address


def test_the_folder_of_a_shipped_data_set():
    folder, missing = datasets.get("dead-weight")
    assert (folder / "train.csv").is_file()
    assert not missing


def test_an_unknown_name_suggests_a_similar_one():
    with pytest.raises(InputError, match="did you mean 'asmada-cyclic'"):
        datasets.get("asmada-cyclc")


def test_a_local_copy_is_used_and_checked(shared, monkeypatch, tmp_path):
    monkeypatch.setenv("SMAJAX_DATA", str(shared / "data"))
    for name, dataset in datasets.datasets().items():
        folder, missing = datasets.get(name)
        assert folder.is_dir()
        assert not missing, name
        assert dataset.folder is not None or folder == shared / "data" / name
    shutil.copytree(shared / "data" / "confluent-diamond", tmp_path / "confluent-diamond")
    (tmp_path / "confluent-diamond" / "QoI_expt_load.csv").write_text("0,0\n")
    monkeypatch.setenv("SMAJAX_DATA", str(tmp_path))
    with pytest.raises(InputError, match="SHA-256 differs"):
        datasets.get("confluent-diamond")
    with pytest.raises(InputError, match="there is no such folder"):
        datasets.get("asmada-cyclic")


def test_a_data_set_without_a_public_address(monkeypatch):
    monkeypatch.delenv("SMAJAX_DATA", raising=False)
    with pytest.raises(InputError, match=r"no public address: tables taken out of the repository's DataE\.m"):
        datasets.get("morphing-forc")


@pytest.fixture
def server(tmp_path, monkeypatch):
    """Serve one data set on this machine instead of the public server, with a separate cache."""
    content = b"time [s],current [A]\n0,0\n1,0.1\n"
    place = tmp_path / "public" / "some" / "repo" / ("0" * 40) / "a folder"
    place.mkdir(parents=True)
    (place / "run 1.csv").write_bytes(content)

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    running = ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(tmp_path / "public")))
    threading.Thread(target=running.serve_forever, daemon=True).start()
    files = (
        PublicFile("run 1.csv", hashlib.sha256(content).hexdigest(), "a folder/run 1.csv"),
        PublicFile("typed.csv", "0" * 64),
    )
    dataset = Dataset("one", "a test", "none stated", "some/repo", "0" * 40, files)
    monkeypatch.setattr(datasets, "ADDRESS", f"http://127.0.0.1:{running.server_port}")
    monkeypatch.setattr(datasets, "datasets", lambda: {"one": dataset})
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv("SMAJAX_DATA", raising=False)
    yield place / "run 1.csv"
    running.shutdown()
    running.server_close()


def test_a_public_recording_is_fetched_once_and_compared(server):
    folder, missing = datasets.get("one")
    assert (folder / "run 1.csv").read_bytes() == server.read_bytes()
    assert missing == ("typed.csv",)
    server.unlink()
    assert datasets.get("one")[0] == folder


def test_changed_and_missing_files_are_refused(server):
    server.write_text("something else")
    with pytest.raises(InputError, match="SHA-256 differs"):
        datasets.get("one")
    server.unlink()
    with pytest.raises(InputError, match="the file cannot be fetched"):
        datasets.get("one")
