"""Data sets: recordings that ship with smajax, and public ones that are fetched on request.

``data/public-recordings.toml`` lists the public ones with repository, commit, licence and the SHA-256 of each file.
They are read from the folder in the environment variable ``SMAJAX_DATA`` (``SMAJAX_DATA/NAME/FILE``) if it is set, else
fetched once into the cache of the user.
"""

import hashlib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

from smajax.errors import InputError, suggestion

ADDRESS = "https://raw.githubusercontent.com"
# Environment variable with the folder of local copies.
LOCAL = "SMAJAX_DATA"
# Bytes that are hashed at a time; the size has no effect on the result.
_BLOCK_BYTES = 1 << 20


@dataclass(frozen=True)
class PublicFile:
    """One file of a public recording.

    Attributes:
        name: Name of the local file.
        sha256: SHA-256 of the file in hexadecimal.
        path: Path in the repository; ``None`` if the file has no public address in this form.
    """

    name: str
    sha256: str
    path: str | None = None


@dataclass(frozen=True)
class Dataset:
    """A named folder of recordings.

    Attributes:
        name: Name of the data set.
        description: Content of the recordings in a few words.
        licence: Licence of the recordings.
        repository: Owner and name of the public repository; empty for a shipped data set.
        commit: Commit in the repository.
        files: Files of a public data set.
        note: Remarks on files without a public address.
        folder: Folder of a shipped data set.
    """

    name: str
    description: str
    licence: str
    repository: str = ""
    commit: str = ""
    files: tuple[PublicFile, ...] = ()
    note: str = ""
    folder: Path | None = None

    @property
    def source(self) -> str:
        """Origin of the data set in a few words."""
        return f"{self.repository} at {self.commit[:10]}" if self.repository else "ships with smajax"

    def address(self, file: PublicFile) -> str:
        """Return the public address of a file of the data set."""
        return f"{ADDRESS}/{self.repository}/{self.commit}/{quote(file.path or '')}"


def data_path(*parts: str) -> Path:
    """Return the path of a shipped file or folder.

    Args:
        *parts: Names of folders and file below ``data``, in the installed package or else in the checkout.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "data"
    return (installed if installed.is_dir() else package.parent / "data").joinpath(*parts)


def datasets() -> dict[str, Dataset]:
    """Return all data sets by name, shipped ones first."""
    return _shipped_datasets() | _public_datasets()


def find(name: str) -> Dataset:
    """Return the data set with a name.

    Raises:
        InputError: If there is none; the message has the most similar name.
    """
    available = datasets()
    if name not in available:
        hint = suggestion(name, available)
        raise InputError(f"there is no data set '{name}'{hint}: 'smajax datasets list' shows all")
    return available[name]


def get(name: str) -> tuple[Path, tuple[str, ...]]:
    """Return the folder with the files of a data set, which are fetched if necessary.

    Returns:
        The folder, and the names of files that are not available in this form.

    Raises:
        InputError: If there is no such data set, or a file cannot be fetched or has another SHA-256.
    """
    dataset = find(name)
    if dataset.folder is not None:
        return dataset.folder, ()
    local = os.environ.get(LOCAL)
    if local:
        folder = Path(local) / name
        if not folder.is_dir():
            cure = f"point {LOCAL} to the folder that holds '{name}', or unset it to fetch"
            raise InputError(f"{folder}: there is no such folder: {cure}")
        return folder, tuple(file.name for file in dataset.files if not _is_present(folder / file.name, file))
    return _fetch(dataset), tuple(file.name for file in dataset.files if file.path is None)


def _fetch(dataset: Dataset) -> Path:
    """Fetch the files of a public data set into the cache, and return their folder."""
    import pooch  # here, since `import smajax.recordings.datasets` has to be fast

    if all(file.path is None for file in dataset.files):
        cure = f"point {LOCAL} to a folder that has a copy"
        raise InputError(f"{dataset.name} has no public address: {dataset.note}; {cure}")
    folder = Path(pooch.os_cache("smajax")) / "datasets" / dataset.name
    for file in dataset.files:
        if file.path is None:
            continue
        address = dataset.address(file)
        try:
            pooch.retrieve(address, f"sha256:{file.sha256}", fname=file.name, path=folder, progressbar=False)
        except ValueError:
            problem = "the fetched file is not the listed one (its SHA-256 differs)"
            raise InputError(f"{address}: {problem}: try again, or report it") from None
        except OSError as error:  # also every error of requests, with which pooch fetches
            reason = str(error) if isinstance(error, PermissionError) else type(error).__name__
            cure = f"check the network, or point {LOCAL} to a folder that has a copy"
            raise InputError(f"{address}: the file cannot be fetched ({reason}): {cure}") from None
    return folder


def _is_present(path: Path, file: PublicFile) -> bool:
    """Return whether there is a local copy; refuse a different file."""
    if not path.is_file():
        return False
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK_BYTES):
            digest.update(block)
    if digest.hexdigest() != file.sha256:
        problem = "this is not the listed file (its SHA-256 differs)"
        raise InputError(f"{path}: {problem}: replace it, or unset {LOCAL} to fetch it")
    return True


def _shipped_datasets() -> dict[str, Dataset]:
    """Return the shipped data sets; the first line of the rig file is the description."""
    shipped = {}
    for rig in sorted(data_path("recordings").glob("*/rig.toml")):
        description = rig.read_text("utf-8").split("\n", 1)[0].lstrip("# ").rstrip()
        shipped[rig.parent.name] = Dataset(rig.parent.name, description, "that of smajax", folder=rig.parent)
    return shipped


def _public_datasets() -> dict[str, Dataset]:
    tables: Mapping[str, Any] = tomllib.loads(data_path("public-recordings.toml").read_text("utf-8"))
    return {
        name: Dataset(name, **{**table, "files": tuple(PublicFile(**file) for file in table["files"])})
        for name, table in tables.items()
        if isinstance(table, dict)
    }
