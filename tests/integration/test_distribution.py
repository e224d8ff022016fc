"""The wheel and the source distribution: what they hold, and that the commands run from the wheel alone."""

import json
import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from hatchling.builders.sdist import SdistBuilder
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement

from tests.conftest import ROOT

# Files at the top that building, testing and citing need.
META_FILES = {
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "CITATION.cff",
    "LICENSE",
    "pyproject.toml",
    "PKG-INFO",
    ".gitignore",
}
FOLDERS = {"smajax", "data", "tests", "experiments", "docs"}

# A sweep and its table, where only the packages named in an argument can be imported.
SWEEP_WITHOUT_EXTRAS = """
import importlib.machinery, importlib.metadata, sys
allowed, owners = set(sys.argv[1].split(",")), importlib.metadata.packages_distributions()
class Finder(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        distributions = {owner.lower().replace("_", "-") for owner in owners.get(name.partition(".")[0], ["smajax"])}
        return super().find_spec(name, path, target) if allowed & distributions else None
sys.meta_path = [Finder if finder is importlib.machinery.PathFinder else finder for finder in sys.meta_path]
import smajax as sma
swept = sma.sweep("sweep.toml")
print(len(swept.pareto), len(swept.to_pandas()))
"""


def without_extras(requirements: list[str]) -> set[str]:
    """Names of the distributions that these requirements bring where no extra is asked for."""
    needed, waiting = {"smajax"}, [Requirement(text) for text in requirements]
    while waiting:
        requirement = waiting.pop()
        name = requirement.name.lower().replace("_", "-")
        if name in needed or (requirement.marker and not requirement.marker.evaluate({"extra": ""})):
            continue
        needed.add(name)
        waiting += map(Requirement, metadata.requires(name) or [])
    return needed


@pytest.fixture(scope="module")
def sources(tmp_path_factory) -> Path:
    """The files that the distributions are built from, without what git ignores."""
    target = tmp_path_factory.mktemp("sources") / "smajax"
    target.mkdir()
    ignore = shutil.ignore_patterns("__pycache__", ".*_cache", "out", "build", "dist")
    for folder in FOLDERS:
        shutil.copytree(ROOT / folder, target / folder, ignore=ignore)
    for name in META_FILES - {"PKG-INFO"}:
        shutil.copy(ROOT / name, target / name)
    return target


@pytest.fixture(scope="module")
def wheel(sources, tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    return Path(next(WheelBuilder(str(sources)).build(directory=str(folder), versions=["standard"])))


def files_below(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}


def test_the_wheel_holds_the_package_and_its_data_and_nothing_else(sources, wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    package = {f"smajax/{name}" for name in files_below(sources / "smajax")}
    data = {f"smajax/data/{name}" for name in files_below(sources / "data")}
    rest = {name for name in names - package - data if not name.split("/")[0].endswith(".dist-info")}
    assert package | data <= names and not rest


def test_the_source_distribution_holds_what_building_and_testing_need(sources, tmp_path):
    archive = Path(next(SdistBuilder(str(sources)).build(directory=str(tmp_path), versions=["standard"])))
    with tarfile.open(archive) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert files_below(sources) <= names
    assert {name for name in names if "/" not in name} == META_FILES
    assert {name.partition("/")[0] for name in names if "/" in name} == FOLDERS


@pytest.mark.slow
def test_a_command_runs_from_the_wheel_alone_and_finds_the_shipped_files(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    environment = {key: value for key, value in os.environ.items() if key not in ("XLA_FLAGS", "EQX_ON_ERROR")}
    environment |= {"PYTHONPATH": str(tmp_path / "installed"), "PYTHONSAFEPATH": "1"}

    def run(*words: str) -> str:
        command = [sys.executable, "-m", "smajax", *words]
        result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        return result.stdout

    run("init", "dead-weight", "--out", "bench")
    assert "train.csv: " in run("check", "bench/example.toml", "bench/train.csv")
    code = (
        "import smajax as sma; print(sma.__file__)\n"
        "study = sma.predict('bench/example.toml', 'bench/train.csv'); print(study.success); study.save('predicted')\n"
        "print(len(sma.load('predicted').plot().data) > 0)"
    )
    command = [sys.executable, "-c", code]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
    place, *answers = result.stdout.split()
    assert Path(place).is_relative_to(tmp_path / "installed") and answers == ["True", "True"]
    assert (tmp_path / "installed" / "smajax" / "py.typed").is_file()


@pytest.mark.slow
def test_a_sweep_and_its_table_need_no_extra(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    requirements = next((tmp_path / "installed").glob("*.dist-info")) / "METADATA"
    lines = requirements.read_text("utf-8").partition("\n\n")[0].splitlines()
    needed = without_extras([line.partition(": ")[2] for line in lines if line.startswith("Requires-Dist: ")])
    assert "jax" in needed and "openpyxl" not in needed
    rigs = tmp_path / "installed" / "smajax" / "data"
    text = (rigs / "sweeps" / "flexural.toml").read_text("utf-8").replace("designs = 256", "designs = 4")
    (tmp_path / "sweep.toml").write_text(text.replace('"../', f'"{rigs}/'), "utf-8")
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed"), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-c", SWEEP_WITHOUT_EXTRAS, ",".join(needed)]
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    front, designs = map(int, result.stdout.split())
    assert 1 <= front <= designs == 4


@pytest.mark.slow
def test_the_types_of_all_public_names_are_complete(wheel, tmp_path):
    """What other packages leave without a type is not counted."""
    zipfile.ZipFile(wheel).extractall(tmp_path / "installed")
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    command = [sys.executable, "-m", "pyright", "--verifytypes", "smajax", "--ignoreexternal", "--outputjson"]
    environment = os.environ | {"PYTHONPATH": str(tmp_path / "installed"), "PATH": path}
    result = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    report = json.loads(result.stdout)["typeCompleteness"]
    names = {symbol["name"] for symbol in report["symbols"]}
    assert {"smajax.fit", "smajax.simulate", "smajax.rollout", "smajax.register"} <= names
    assert [symbol["name"] for symbol in report["symbols"] if not symbol["isTypeKnown"]] == []
    assert report["completenessScore"] == 1.0
