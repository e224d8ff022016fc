"""Packing of models as FMUs: model description, equations, and the binary of pythonfmu through which a tool calls them.

Source: FMI 2.0.4, section 2.2 (model description), https://fmi-standard.org.
"""

import hashlib
import importlib.metadata
import io
import json
import math
import re
import zipfile
from html import escape
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from smajax import __version__
from smajax.control.export.fmu.model import Model, Variable
from smajax.errors import InputError
from smajax.units import base_units

# Names of the SI base units in FMI by those of the unit library.
_BASES = {
    "kilogram": "kg",
    "meter": "m",
    "second": "s",
    "ampere": "A",
    "kelvin": "K",
    "mole": "mol",
    "candela": "cd",
    "radian": "rad",
}
# Characters that XML 1.0 cannot have (section 2.2).
_NOT_XML = re.compile("[^\\t\\n\\r\\x20-\\ud7ff\\ue000-\\ufffd\\U00010000-\\U0010ffff]")
_PAGE = """<!DOCTYPE html><meta charset="utf-8"><title>{name}</title><h1>{name}</h1>
<p>This unit is {meaning}, written by smajax {version}. It needs a Python with NumPy; on Linux, a tool that is not
written in Python has to be started with LD_PRELOAD set to libpython3.X.so. Values are in SI units and degC.
{timing}</p>
<p>In a closed loop, step the controller before the plant: it then acts on the present state of the plant, and not on
that of one step ago.</p>
"""
_TIMING = {
    "longest": "It divides a communication step into steps of at most {:.4g} s, and holds its inputs meanwhile.",
    "period": "It samples its inputs every {:.4g} s, whatever the communication step is, and holds its command.",
}
# Numbers of characters of the content's hash in the identifier and in the GUID of an FMU.
_IDENTIFIER_LENGTH = 8
_GUID_LENGTH = 32
_LOG = ("logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logAll")


def pack_fmu(model: Model) -> bytes:
    """Pack a model as an FMU; the same model gives the same bytes.

    Args:
        model: The model of a plant or a controller.

    Returns:
        The content of the FMU, a zip file.

    Raises:
        InputError: if pythonfmu is not installed.
    """
    try:
        import pythonfmu
    except ImportError:
        raise InputError(
            "an FMU needs the package pythonfmu, which is not installed: pip install 'smajax[fmu]'"
        ) from None
    model = model._replace(name=_xml_text(model.name), meaning=_xml_text(model.meaning))
    home = Path(pythonfmu.__file__).parent
    slave = Path(__file__).with_name("slave.py").read_bytes()
    variables = [
        {"name": v.name, "causality": v.causality} | ({} if v.start is None else {"start": v.start})
        for v in model.variables
    ]
    settings = json.dumps({"smajax": __version__, **model.timing, "variables": variables}, indent=1).encode()
    content = hashlib.sha256(b"\0".join((settings, model.equations.encode(), slave, model.name.encode()))).hexdigest()
    # Modules of different FMUs need different names, since one Python process may run several FMUs.
    identifier = f"smajax_{model.kind}_{content[:_IDENTIFIER_LENGTH]}"
    files = {
        "modelDescription.xml": model_description(model, identifier, content[:_GUID_LENGTH]),
        "resources/slavemodule.txt": identifier.encode(),
        f"resources/{identifier}.py": slave,
        f"resources/{identifier}_equations.py": model.equations.encode(),
        "resources/model.json": settings,
        "documentation/index.html": _page(model),
    }
    files |= {f"resources/pythonfmu/{file.name}": file.read_bytes() for file in sorted(home.glob("*.py"))}
    for file in sorted((home / "resources" / "binaries").glob("*/*pythonfmu-export.*")):
        files[f"binaries/{file.parent.name}/{identifier}{file.suffix}"] = file.read_bytes()
    for file in importlib.metadata.files("pythonfmu") or ():
        if file.name == "LICENSE":
            files["documentation/licenses/pythonfmu.txt"] = file.read_binary()
    return _zipped(files)


def _xml_text(text: str) -> str:
    """Return a text without the characters that XML cannot have, not even as references."""
    return _NOT_XML.sub("\N{REPLACEMENT CHARACTER}", text)


def _page(model: Model) -> bytes:
    """The documentation page of the FMU."""
    ((timing, seconds),) = model.timing.items()
    return _PAGE.format(
        name=escape(model.name),
        meaning=escape(model.meaning),
        version=__version__,
        timing=_TIMING[timing].format(seconds),
    ).encode()


def _zipped(files: dict[str, bytes]) -> bytes:
    """The content of a zip file without times of modification."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as packed:
        for name, content in files.items():
            packed.writestr(zipfile.ZipInfo(name), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def model_description(model: Model, identifier: str, guid: str) -> bytes:
    """Return the content of ``modelDescription.xml``.

    Args:
        model: The model.
        identifier: Name of the binary and of the Python modules in the FMU.
        guid: Identifier of the content.
    """
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="2.0",
        modelName=model.name,
        guid=guid,
        description=model.meaning,
        generationTool=f"smajax {__version__}",
        variableNamingConvention="structured",
    )
    _add(
        root,
        "CoSimulation",
        modelIdentifier=identifier,
        needsExecutionTool=True,
        canHandleVariableCommunicationStepSize=True,
        canNotUseMemoryManagementFunctions=True,
        canGetAndSetFMUstate=True,
    )
    _describe_units(root, model)
    log = _add(root, "LogCategories")
    for category in _LOG:
        _add(log, "Category", name=category)
    _add(root, "DefaultExperiment", stepSize=next(iter(model.timing.values())))
    variables = _add(root, "ModelVariables")
    for place, variable in enumerate(model.variables):
        _describe_variable(variables, place, variable)
    _describe_structure(root, model)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="UTF-8", xml_declaration=True)


def _describe_units(root: ElementTree.Element, model: Model) -> None:
    """Add the definitions of all units in SI base units."""
    units = sorted({v.unit for v in model.variables} - {"1"})
    if not units:
        return
    definitions = _add(root, "UnitDefinitions")
    for unit in units:
        factor, offset, powers = base_units(unit)
        scale: dict[str, Any] = {_BASES[base]: power for base, power in powers.items()}
        scale |= {k: v for k, v, usual in (("factor", factor, 1.0), ("offset", offset, 0.0)) if v != usual}
        _add(_add(definitions, "Unit", name=unit), "BaseUnit", **scale)


def _describe_structure(root: ElementTree.Element, model: Model) -> None:
    """Add the outputs, and the inputs on which they depend directly."""
    structure = _add(root, "ModelStructure")
    inputs = [i for i, v in enumerate(model.variables, 1) if v.causality == "input"]
    outputs = [(i, v) for i, v in enumerate(model.variables, 1) if v.causality == "output"]
    unknowns = _add(structure, "Outputs")
    for i, v in outputs:
        _add(unknowns, "Unknown", index=i, dependencies=" ".join(map(str, inputs if v.direct else [])))
    unknowns = _add(structure, "InitialUnknowns")
    for i, _ in outputs:
        _add(unknowns, "Unknown", index=i)


def _describe_variable(parent: ElementTree.Element, value_reference: int, variable: Variable) -> None:
    """Add a variable; its value reference is its position in the model."""
    attributes: dict[str, Any] = {"name": variable.name, "valueReference": value_reference}
    attributes |= {"description": variable.meaning}
    attributes |= {"causality": variable.causality, "variability": variable.variability}
    initial = {"parameter": "exact", "output": "calculated"}.get(variable.causality)
    entry = _add(parent, "ScalarVariable", **attributes, **({"initial": initial} if initial else {}))
    real = {"unit": None if variable.unit == "1" else variable.unit, "start": variable.start}
    real |= {k: v for k, v in (("min", variable.lower), ("max", variable.upper)) if math.isfinite(v)}
    _add(entry, "Real", **{k: v for k, v in real.items() if v is not None})


def _add(parent: ElementTree.Element, tag: str, /, **attributes: Any) -> ElementTree.Element:
    """Add and return a child with its attributes; numbers are written with all their digits."""
    return ElementTree.SubElement(
        parent, tag, {k: str(v).lower() if isinstance(v, bool) else _xml_text(str(v)) for k, v in attributes.items()}
    )
