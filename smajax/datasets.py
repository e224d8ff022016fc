"""Recordings by name: those that ship with smajax, and public ones of others that are fetched on request.

The public ones are listed in ``data/public-recordings.toml`` with repository, commit, licence and the SHA-256 of each file. They are looked
for in the folder that the environment variable ``SMAJAX_DATA`` names (``SMAJAX_DATA/NAME/FILE``), else fetched once into the user's cache.
"""

import hashlib
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from smajax.errors import InputError, nearest

ADDRESS = "https://raw.githubusercontent.com"
LOCAL = "SMAJAX_DATA"
_BLOCK = 1 << 20


@dataclass(frozen=True)
class PublicFile:
    """One file of a public recording; ``path`` is that in the repository, ``None`` where it has no public address in this form."""

    name: str
    sha256: str
    path: str | None = None


@dataclass(frozen=True)
class Dataset:
    """A named folder of recordings. ``folder`` is that of a shipped one, and then ``files`` is empty and there is no repository."""

    name: str
    what: str
    licence: str
    repository: str = ""
    commit: str = ""
    files: tuple[PublicFile, ...] = ()
    note: str = ""
    folder: Path | None = None

    @property
    def source(self) -> str:
        """Where it comes from, in a few words."""
        return f"{self.repository} at {self.commit[:10]}" if self.repository else "ships with smajax"

    def address(self, file: PublicFile) -> str:
        """The public address of one of its files."""
        return f"{ADDRESS}/{self.repository}/{self.commit}/{quote(file.path or '')}"


def shipped(*parts: str) -> Path:
    """The path of a shipped file or folder: in the package's ``data`` once installed, in the checkout's ``data`` before."""
    package = Path(__file__).resolve().parent
    packaged = package / "data"
    return (packaged if packaged.is_dir() else package.parent / "data").joinpath(*parts)


def datasets() -> dict[str, Dataset]:
    """All recordings by name, shipped ones first."""
    return _shipped_ones() | _public_ones()


def find(name: str) -> Dataset:
    """The recording of that name. InputError with the nearest one if there is none."""
    known = datasets()
    if name not in known:
        raise InputError(f"there is no data set '{name}'{nearest(name, known)}: 'smajax datasets list' shows all")
    return known[name]


def get(name: str) -> tuple[Path, tuple[str, ...]]:
    """The folder with a recording's files, fetched if need be, and the names of files that cannot be had in this form.

    Raises InputError if a file cannot be fetched or is not the one that was listed.
    """
    dataset = find(name)
    if dataset.folder is not None:
        return dataset.folder, ()
    local = os.environ.get(LOCAL)
    if local:
        folder = Path(local) / name
        if not folder.is_dir():
            raise InputError(f"{folder}: there is no such folder: point {LOCAL} to the folder that holds '{name}', or unset it to fetch")
        return folder, tuple(file.name for file in dataset.files if not _same(folder / file.name, file))
    return _fetch(dataset), tuple(file.name for file in dataset.files if file.path is None)


def _fetch(dataset: Dataset) -> Path:
    import pooch  # here, since `import smajax.datasets` has to be quick
    import requests

    if all(file.path is None for file in dataset.files):
        raise InputError(f"{dataset.name} has no public address: {dataset.note}; point {LOCAL} to a folder that has a copy")
    folder = Path(pooch.os_cache("smajax")) / "datasets" / dataset.name
    for file in dataset.files:
        if file.path is None:
            continue
        address = dataset.address(file)
        try:
            pooch.retrieve(address, f"sha256:{file.sha256}", fname=file.name, path=folder, progressbar=False)
        except ValueError:
            raise InputError(f"{address}: what came is not the listed file (its SHA-256 differs): try again, or report it") from None
        except (OSError, requests.RequestException) as error:
            reason = str(error) if isinstance(error, PermissionError) else type(error).__name__
            cure = f"check the network, or point {LOCAL} to a folder that has a copy"
            raise InputError(f"{address}: the file cannot be fetched ({reason}): {cure}") from None
    return folder


def _same(path: Path, file: PublicFile) -> bool:
    """Whether the local copy is there; a copy that differs is refused."""
    if not path.is_file():
        return False
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(_BLOCK):
            digest.update(block)
    if digest.hexdigest() != file.sha256:
        raise InputError(f"{path}: this is not the listed file (its SHA-256 differs): replace it, or unset {LOCAL} to fetch it")
    return True


def _shipped_ones() -> dict[str, Dataset]:
    found = {}
    for rig in sorted(shipped("recordings").glob("*/rig.toml")):
        first = rig.read_text("utf-8").split("\n", 1)[0].lstrip("# ").rstrip()
        found[rig.parent.name] = Dataset(rig.parent.name, first, "that of smajax", folder=rig.parent)
    return found


def _public_ones() -> dict[str, Dataset]:
    tables: Mapping = tomllib.loads(shipped("public-recordings.toml").read_text("utf-8"))
    return {
        name: Dataset(name, **{**table, "files": tuple(PublicFile(**file) for file in table["files"])})
        for name, table in tables.items()
        if isinstance(table, dict)
    }
