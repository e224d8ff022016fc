"""Models packed as FMUs: model description, equations, and the binary of pythonfmu that lets a co-simulation call them."""

import hashlib
import importlib.metadata
import io
import json
import math
import zipfile
from html import escape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from smajax import __version__
from smajax.errors import InputError
from smajax.fmu.models import Model, Variable
from smajax.units import base_units

_BASES = {"kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd", "radian": "rad"}
_PAGE = """<!DOCTYPE html><title>{name}</title><h1>{name}</h1>
<p>This unit is {meaning}, written by smajax {version}. It runs where a Python with NumPy is; on Linux, a tool that is not Python has to be
started with LD_PRELOAD set to libpython3.X.so. Values are in SI units and degC. {timing}</p>
<p>In a closed loop, step the controller before the plant: it then acts on what the plant is, and not on what it was a step ago.</p>
"""
_TIMING = {
    "longest": "It divides a communication step by itself into steps of at most {:.4g} s, and holds its inputs meanwhile.",
    "period": "It samples its inputs every {:.4g} s, whatever the communication step is, and holds its command between.",
}
_LOG = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll")


def write_fmu(path: Path, model: Model) -> None:
    """Writes the FMU of a model: the same file for the same model. Raises ``InputError`` if pythonfmu is not installed."""
    path.write_bytes(fmu(model))


def fmu(model: Model) -> bytes:
    """The FMU of a model, as ``write_fmu`` writes it."""
    try:
        import pythonfmu
    except ImportError:
        raise InputError("an FMU needs the package pythonfmu, which is not installed: pip install 'smajax[fmu]'") from None
    home = Path(pythonfmu.__file__).parent
    slave = Path(__file__).with_name("slave.py").read_bytes()
    listed = [{"name": v.name, "causality": v.causality} | ({} if v.start is None else {"start": v.start}) for v in model.variables]
    told = json.dumps({"smajax": __version__, **model.timing, "variables": listed}, indent=1).encode()
    content = hashlib.sha256(b"\0".join((told, model.equations.encode(), slave, model.name.encode()))).hexdigest()
    identifier = f"smajax_{model.kind}_{content[:8]}"  # of its own: one Python may hold many FMUs
    files = {
        "modelDescription.xml": describe(model, identifier, content[:32]),
        "resources/slavemodule.txt": identifier.encode(),
        f"resources/{identifier}.py": slave,
        f"resources/{identifier}_equations.py": model.equations.encode(),
        "resources/model.json": told,
    }
    ((timing, seconds),) = model.timing.items()
    told_to = {
        "name": escape(model.name),
        "meaning": escape(model.meaning),
        "version": __version__,
        "timing": _TIMING[timing].format(seconds),
    }
    files["documentation/index.html"] = _PAGE.format(**told_to).encode()
    files |= {f"resources/pythonfmu/{file.name}": file.read_bytes() for file in sorted(home.glob("*.py"))}
    for file in sorted((home / "resources" / "binaries").glob("*/*pythonfmu-export.*")):
        files[f"binaries/{file.parent.name}/{identifier}{file.suffix}"] = file.read_bytes()
    for file in importlib.metadata.files("pythonfmu") or ():
        if file.name == "LICENSE":
            files["documentation/licenses/pythonfmu.txt"] = file.read_binary()
    whole = io.BytesIO()
    with zipfile.ZipFile(whole, "w") as packed:
        for name, inside in files.items():
            packed.writestr(zipfile.ZipInfo(name), inside, zipfile.ZIP_DEFLATED)
    return whole.getvalue()


def describe(model: Model, identifier: str, guid: str) -> bytes:
    """The text of ``modelDescription.xml`` (FMI 2.0.4, section 2.2)."""
    root = ElementTree.Element(
        "fmiModelDescription", fmiVersion="2.0", modelName=model.name, guid=guid, description=model.meaning,
        generationTool=f"smajax {__version__}", variableNamingConvention="structured",
    )  # fmt: skip
    _add(
        root, "CoSimulation", modelIdentifier=identifier, needsExecutionTool=True, canHandleVariableCommunicationStepSize=True,
        canNotUseMemoryManagementFunctions=True, canGetAndSetFMUstate=True,
    )  # fmt: skip
    units = sorted({v.unit for v in model.variables} - {"1"})
    if units:
        listed = _add(root, "UnitDefinitions")
        for unit in units:
            factor, offset, powers = base_units(unit)
            scale: dict[str, Any] = {_BASES[base]: power for base, power in powers.items()}
            scale |= {k: v for k, v, usual in (("factor", factor, 1.0), ("offset", offset, 0.0)) if v != usual}
            _add(_add(listed, "Unit", name=unit), "BaseUnit", **scale)
    log = _add(root, "LogCategories")
    for category in _LOG:
        _add(log, "Category", name=category)
    _add(root, "DefaultExperiment", stepSize=next(iter(model.timing.values())))
    variables = _add(root, "ModelVariables")
    for place, variable in enumerate(model.variables):
        _describe_variable(variables, place, variable)
    structure = _add(root, "ModelStructure")
    inputs = [i for i, v in enumerate(model.variables, 1) if v.causality == "input"]
    outputs = [(i, v) for i, v in enumerate(model.variables, 1) if v.causality == "output"]
    listed = _add(structure, "Outputs")
    for i, v in outputs:
        _add(listed, "Unknown", index=i, dependencies=" ".join(map(str, inputs if v.direct else [])))
    listed = _add(structure, "InitialUnknowns")
    for i, _ in outputs:
        _add(listed, "Unknown", index=i)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _describe_variable(parent: ElementTree.Element, place: int, variable: Variable) -> None:
    given: dict[str, Any] = {"name": variable.name, "valueReference": place, "description": variable.meaning}
    given |= {"causality": variable.causality, "variability": variable.variability}
    initial = {"parameter": "exact", "output": "calculated"}.get(variable.causality)
    entry = _add(parent, "ScalarVariable", **given, **({"initial": initial} if initial else {}))
    real = {"unit": None if variable.unit == "1" else variable.unit, "start": variable.start}
    real |= {k: v for k, v in (("min", variable.lower), ("max", variable.upper)) if math.isfinite(v)}
    _add(entry, "Real", **{k: v for k, v in real.items() if v is not None})


def _add(parent: ElementTree.Element, tag: str, /, **given: Any) -> ElementTree.Element:
    """A child with its attributes; numbers so that they are read back exactly."""
    return ElementTree.SubElement(parent, tag, {k: str(v).lower() if isinstance(v, bool) else str(v) for k, v in given.items()})
