"""Pages of the Python reference: names and modules for mkdocstrings, which reads their docstrings."""

import importlib
import pkgutil
from collections.abc import Iterable

import smajax
from docs.generate.markdown import docstring, first_sentence, table

# Public names of smajax by page; tests/unit/test_site.py holds that each is on one.
GROUPS = {
    "studies": (
        "Studies",
        "Fits, diagnoses, comparisons, predictions, tuning, sweeps and properties, and what they return.",
        "fit FitStudy Parameter diagnose DiagnosisStudy compare ComparisonStudy predict PredictionStudy tune "
        "TuningStudy sweep SweepStudy thermal_cycle_properties PropertiesStudy Property load Study ProgressEvent",
    ),
    "files": (
        "Files and recordings",
        "Rigs, recordings, and files whose columns are recognised.",
        "read_rig Rig read_recording read_recordings Recording ReadOptions import_recording RecordingImport "
        "load_material",
    ),
    "loops": (
        "Loops of your own",
        "Differentiable functions; safe under `jax.jit`, `jax.vmap` and first derivatives.",
        "discretise Inputs simulate Simulation SimulationStatus init step observe rollout ClosedLoop Scenario Rollout",
    ),
    "plants": (
        "Plants without a rig file",
        "The parts of a plant.",
        "Plant Wire Coil Environment Initial Sensor CurrentDrive VoltageDrive PowerDrive DutyDrive NoDrive "
        "PolynomialConvection PowerLawConvection PrescribedTemperature",
    ),
    "own-classes": (
        "Classes of your own",
        "Registration, and the declaration of parameters. The base classes are on the pages of materials, mechanisms, "
        "effects and controllers.",
        "register parameter",
    ),
    "errors": (
        "Errors",
        "What smajax raises on purpose.",
        "InputError NumericsError DerivativeError Cancelled",
    ),
}
# The public modules, and the package of each.
MODULES = {
    "materials": ("Materials", "smajax.plant.materials"),
    "mechanisms": ("Mechanisms", "smajax.plant.mechanisms"),
    "effects": ("Effects", "smajax.plant.effects"),
    "controllers": ("Controllers", "smajax.control.controllers"),
}
# The rooms from the top downwards; tests/unit/test_site.py compares them with the folders.
ROOMS = ("numerics", "parameters", "plant", "laws", "actuators", "recordings", "files", "simulation", "fitting")
ROOMS += ("diagnosis", "properties", "comparison", "control", "sweeps", "report", "api", "app")


def api_pages() -> dict[str, str]:
    """Return the pages by path."""
    pages = {
        f"reference/api/{name}.md": _page(title, text, [_place(n) for n in names.split()])
        for name, (title, text, names) in GROUPS.items()
    }
    for name, (title, package) in MODULES.items():
        pages[f"reference/api/{name}.md"] = _page(
            f"{title}: sma.{name}", docstring(_module(package)), _members(package)
        )
    return pages | {"reference/api/rooms.md": _rooms()}


def public_names() -> str:
    """Return a table of the public names with their pages."""
    rows = [
        (f"[`sma.{name}`](api/{page}.md)", first_sentence(getattr(smajax, name)))
        for page, (_, _, names) in GROUPS.items()
        for name in names.split()
    ]
    rows += [
        (f"[`sma.{page}`](api/{page}.md)", first_sentence(_module(package))) for page, (_, package) in MODULES.items()
    ]
    return table(("name", "what it is"), rows)


def _module(name: str) -> object:
    return importlib.import_module(name)


def _place(name: str) -> str:
    """The full path of a public name."""
    return f"{getattr(smajax, name).__module__}.{getattr(smajax, name).__name__}"


def _members(package: str) -> list[str]:
    """Full paths of the public classes and functions of a package."""
    module: object = _module(package)
    members = [getattr(module, name) for name in getattr(module, "__all__", ())]
    return [f"{m.__module__}.{m.__name__}" for m in members if getattr(m, "__module__", "").startswith("smajax.")]


def _page(title: str, text: str, names: Iterable[str]) -> str:
    return f"# {title}\n\n{text}\n\n" + "\n\n".join(f"::: {name}" for name in names) + "\n"


def _rooms() -> str:
    """The rooms of the package: what each is for, and its modules."""
    parts = ["# Rooms of the package\n\nA room imports only rooms above it. What its modules are for:\n"]
    for room in ROOMS:
        module = _module(f"smajax.{room}")
        rows = []
        for found in pkgutil.iter_modules(getattr(module, "__path__", [])):
            if not found.name.startswith("_"):
                rows.append((f"`{found.name}`", first_sentence(_module(f"smajax.{room}.{found.name}"))))
        parts.append(f"## smajax.{room}\n\n{docstring(module)}\n\n{table(('module', 'content'), rows)}")
    return "\n\n".join(parts)
