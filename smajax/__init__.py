"""smajax: differentiable models of shape-memory-alloy actuators for estimation, diagnosis and control.

The public names are loaded when they are first used, so that the command line and a mistake in a file stay fast::

    import smajax as sma

    result = sma.fit("rig.toml", "train.csv", holdout="holdout.csv")
    print(result)
"""

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.2.0"

if TYPE_CHECKING:
    from smajax.api.compare import ComparisonStudy, compare
    from smajax.api.diagnose import DiagnosisStudy, diagnose
    from smajax.api.fit import FitStudy, Parameter, fit
    from smajax.api.load import load
    from smajax.api.predict import PredictionStudy, predict
    from smajax.api.study import Study
    from smajax.api.sweep import SweepStudy, sweep
    from smajax.errors import Cancelled, InputError, NumericsError
    from smajax.files.rig_file import Rig, read_rig
    from smajax.plant import effects, materials, mechanisms
    from smajax.plant.plant import Plant
    from smajax.progress import ProgressEvent
    from smajax.recordings.read import read_recording
    from smajax.recordings.recording import Recording
    from smajax.simulation.inputs import Inputs, discretise
    from smajax.simulation.run import Simulation, simulate

# Module of each public name, by name; a room stands for itself.
_MODULES = {
    "Cancelled": "smajax.errors",
    "ComparisonStudy": "smajax.api.compare",
    "DiagnosisStudy": "smajax.api.diagnose",
    "FitStudy": "smajax.api.fit",
    "InputError": "smajax.errors",
    "Inputs": "smajax.simulation.inputs",
    "NumericsError": "smajax.errors",
    "Parameter": "smajax.api.fit",
    "Plant": "smajax.plant.plant",
    "PredictionStudy": "smajax.api.predict",
    "ProgressEvent": "smajax.progress",
    "Recording": "smajax.recordings.recording",
    "Rig": "smajax.files.rig_file",
    "Simulation": "smajax.simulation.run",
    "Study": "smajax.api.study",
    "SweepStudy": "smajax.api.sweep",
    "compare": "smajax.api.compare",
    "diagnose": "smajax.api.diagnose",
    "discretise": "smajax.simulation.inputs",
    "fit": "smajax.api.fit",
    "load": "smajax.api.load",
    "predict": "smajax.api.predict",
    "read_recording": "smajax.recordings.read",
    "read_rig": "smajax.files.rig_file",
    "simulate": "smajax.simulation.run",
    "sweep": "smajax.api.sweep",
}
_ROOMS = {
    "effects": "smajax.plant.effects",
    "materials": "smajax.plant.materials",
    "mechanisms": "smajax.plant.mechanisms",
}

__all__ = [
    "Cancelled",
    "ComparisonStudy",
    "DiagnosisStudy",
    "FitStudy",
    "InputError",
    "Inputs",
    "NumericsError",
    "Parameter",
    "Plant",
    "PredictionStudy",
    "ProgressEvent",
    "Recording",
    "Rig",
    "Simulation",
    "Study",
    "SweepStudy",
    "__version__",
    "compare",
    "diagnose",
    "discretise",
    "effects",
    "fit",
    "load",
    "materials",
    "mechanisms",
    "predict",
    "read_recording",
    "read_rig",
    "simulate",
    "sweep",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name in _ROOMS:
        value = importlib.import_module(_ROOMS[name])
    elif name in _MODULES:
        value = getattr(importlib.import_module(_MODULES[name]), name)
    else:
        raise AttributeError(f"module 'smajax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
