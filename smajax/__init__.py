"""smajax: differentiable models of shape-memory-alloy actuators for estimation, diagnosis and control.

The public names by task; each has its own help, such as ``help(smajax.fit)``::

    import smajax as sma

    print(sma.fit("rig.toml", "train.csv", holdout="holdout.csv"))

- Fit and diagnose: ``fit``, ``predict``, ``diagnose``, ``compare``, ``thermal_cycle_properties``. Design: ``sweep``,
  ``tune``. They return a ``Study``: ``FitStudy`` (of ``Parameter``), ``PredictionStudy``, ``DiagnosisStudy``,
  ``ComparisonStudy``, ``PropertiesStudy`` (of ``Property``), ``SweepStudy``, ``TuningStudy``. ``load`` reads a saved
  one. ``ProgressEvent`` is what their callback ``progress`` gets.
- Files: ``read_rig`` returns a ``Rig``, ``Rig.read`` and ``read_recording`` a ``Recording``, ``read_recordings``
  several by ``ReadOptions``, ``import_recording`` a ``RecordingImport`` of a file whose columns it recognises,
  ``load_material`` a material with the values of a parameter set.
- Loops of your own: ``discretise`` returns ``Inputs``. Safe under ``jax.jit``, ``jax.vmap`` and ``jax.grad``:
  ``simulate`` returns a ``Simulation`` with a ``SimulationStatus``; ``init``, ``step`` and ``observe`` take single
  steps; ``rollout`` of a ``ClosedLoop`` over a ``Scenario`` returns a ``Rollout``.
- Plants without a rig file: ``Plant`` of ``Wire`` or ``Coil``, ``Environment``, ``Initial``; a drive (``CurrentDrive``,
  ``VoltageDrive``, ``PowerDrive``, ``DutyDrive``, ``NoDrive``); heat (``PolynomialConvection``, ``PowerLawConvection``,
  ``PrescribedTemperature``); a ``Sensor``.
- Classes of your own: ``register`` makes them known by name, ``parameter`` declares their parameters; base classes are
  in the modules ``materials``, ``mechanisms``, ``effects`` and ``controllers``. These four are attributes and not
  submodules: write ``sma.effects`` or ``from smajax import effects``, since ``import smajax.effects`` does not exist.
- Errors: ``InputError``, ``NumericsError``, ``DerivativeError``, ``Cancelled``.

All are loaded when they are first used, so that the command line and a mistake in a file stay fast.
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
    from smajax.api.properties import PropertiesStudy, Property, thermal_cycle_properties
    from smajax.api.recording_import import RecordingImport, import_recording
    from smajax.api.registration import register
    from smajax.api.study import Study
    from smajax.api.sweep import SweepStudy, sweep
    from smajax.api.tune import TuningStudy, tune
    from smajax.control import controllers
    from smajax.control.loop.closed_loop import ClosedLoop
    from smajax.control.loop.rollout import Rollout, Scenario, rollout
    from smajax.errors import Cancelled, DerivativeError, InputError, NumericsError
    from smajax.files.parameter_sets import load_material
    from smajax.files.rig_file import Rig, read_rig
    from smajax.parameters import parameter
    from smajax.plant import effects, materials, mechanisms
    from smajax.plant.coil import Coil
    from smajax.plant.convection import PolynomialConvection, PowerLawConvection
    from smajax.plant.drive import CurrentDrive, DutyDrive, NoDrive, PowerDrive, VoltageDrive
    from smajax.plant.heat import PrescribedTemperature
    from smajax.plant.plant import Plant
    from smajax.plant.sensor import Sensor
    from smajax.plant.wire import Environment, Initial, Wire
    from smajax.progress import ProgressEvent
    from smajax.recordings.read import read_recording, read_recordings
    from smajax.recordings.read_options import ReadOptions
    from smajax.recordings.recording import Recording
    from smajax.simulation.inputs import Inputs, discretise
    from smajax.simulation.plant_functions import init, observe, step
    from smajax.simulation.run import Simulation, simulate
    from smajax.simulation.status import SimulationStatus

# Module of each public name.
_MODULES = {
    "Cancelled": "smajax.errors",
    "ClosedLoop": "smajax.control.loop.closed_loop",
    "Coil": "smajax.plant.coil",
    "ComparisonStudy": "smajax.api.compare",
    "CurrentDrive": "smajax.plant.drive",
    "DerivativeError": "smajax.errors",
    "DiagnosisStudy": "smajax.api.diagnose",
    "DutyDrive": "smajax.plant.drive",
    "Environment": "smajax.plant.wire",
    "FitStudy": "smajax.api.fit",
    "Initial": "smajax.plant.wire",
    "InputError": "smajax.errors",
    "Inputs": "smajax.simulation.inputs",
    "NoDrive": "smajax.plant.drive",
    "NumericsError": "smajax.errors",
    "Parameter": "smajax.api.fit",
    "Plant": "smajax.plant.plant",
    "PolynomialConvection": "smajax.plant.convection",
    "PowerDrive": "smajax.plant.drive",
    "PowerLawConvection": "smajax.plant.convection",
    "PredictionStudy": "smajax.api.predict",
    "PrescribedTemperature": "smajax.plant.heat",
    "ProgressEvent": "smajax.progress",
    "PropertiesStudy": "smajax.api.properties",
    "Property": "smajax.api.properties",
    "Recording": "smajax.recordings.recording",
    "RecordingImport": "smajax.api.recording_import",
    "Rig": "smajax.files.rig_file",
    "Rollout": "smajax.control.loop.rollout",
    "Scenario": "smajax.control.loop.rollout",
    "Sensor": "smajax.plant.sensor",
    "Simulation": "smajax.simulation.run",
    "SimulationStatus": "smajax.simulation.status",
    "Study": "smajax.api.study",
    "SweepStudy": "smajax.api.sweep",
    "TuningStudy": "smajax.api.tune",
    "VoltageDrive": "smajax.plant.drive",
    "Wire": "smajax.plant.wire",
    "compare": "smajax.api.compare",
    "diagnose": "smajax.api.diagnose",
    "discretise": "smajax.simulation.inputs",
    "fit": "smajax.api.fit",
    "import_recording": "smajax.api.recording_import",
    "init": "smajax.simulation.plant_functions",
    "load": "smajax.api.load",
    "load_material": "smajax.files.parameter_sets",
    "observe": "smajax.simulation.plant_functions",
    "parameter": "smajax.parameters",
    "predict": "smajax.api.predict",
    "read_recording": "smajax.recordings.read",
    "read_recordings": "smajax.recordings.read",
    "ReadOptions": "smajax.recordings.read_options",
    "read_rig": "smajax.files.rig_file",
    "register": "smajax.api.registration",
    "rollout": "smajax.control.loop.rollout",
    "simulate": "smajax.simulation.run",
    "step": "smajax.simulation.plant_functions",
    "sweep": "smajax.api.sweep",
    "thermal_cycle_properties": "smajax.api.properties",
    "tune": "smajax.api.tune",
}
# Public names that are modules themselves.
_SUBPACKAGES = {
    "controllers": "smajax.control.controllers",
    "effects": "smajax.plant.effects",
    "materials": "smajax.plant.materials",
    "mechanisms": "smajax.plant.mechanisms",
}

__all__ = [
    "Cancelled",
    "ClosedLoop",
    "Coil",
    "ComparisonStudy",
    "CurrentDrive",
    "DerivativeError",
    "DiagnosisStudy",
    "DutyDrive",
    "Environment",
    "FitStudy",
    "Initial",
    "InputError",
    "Inputs",
    "NoDrive",
    "NumericsError",
    "Parameter",
    "Plant",
    "PolynomialConvection",
    "PowerDrive",
    "PowerLawConvection",
    "PredictionStudy",
    "PrescribedTemperature",
    "ProgressEvent",
    "PropertiesStudy",
    "Property",
    "ReadOptions",
    "Recording",
    "RecordingImport",
    "Rig",
    "Rollout",
    "Scenario",
    "Sensor",
    "Simulation",
    "SimulationStatus",
    "Study",
    "SweepStudy",
    "TuningStudy",
    "VoltageDrive",
    "Wire",
    "__version__",
    "compare",
    "controllers",
    "diagnose",
    "discretise",
    "effects",
    "fit",
    "import_recording",
    "init",
    "load",
    "load_material",
    "materials",
    "mechanisms",
    "observe",
    "parameter",
    "predict",
    "read_recording",
    "read_recordings",
    "read_rig",
    "register",
    "rollout",
    "simulate",
    "step",
    "sweep",
    "thermal_cycle_properties",
    "tune",
]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used."""
    if name in _SUBPACKAGES:
        value = importlib.import_module(_SUBPACKAGES[name])
    elif name in _MODULES:
        value = getattr(importlib.import_module(_MODULES[name]), name)
    else:
        raise AttributeError(f"module 'smajax' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
