"""The result documents: file name and model by command."""

from collections.abc import Mapping
from typing import NamedTuple

from smajax.report.documents.base import Document
from smajax.report.documents.compare import CompareDocument
from smajax.report.documents.controller import ControllerDocument
from smajax.report.documents.diagnosis import DiagnosisDocument
from smajax.report.documents.fit import FitDocument
from smajax.report.documents.properties import PropertiesDocument
from smajax.report.documents.run import RunDocument, SimulationDocument
from smajax.report.documents.sweep import SweepDocument
from smajax.report.documents.tune import TuneDocument


class DocumentFile(NamedTuple):
    """A document in a result folder.

    Attributes:
        name: Name of the file.
        model: Model of the document.
    """

    name: str
    model: type[Document]


# The result document of each command.
DOCUMENTS: Mapping[str, DocumentFile] = {
    "fit": DocumentFile("fit.json", FitDocument),
    "diagnose": DocumentFile("diagnosis.json", DiagnosisDocument),
    "compare": DocumentFile("compare.json", CompareDocument),
    "tune": DocumentFile("tune.json", TuneDocument),
    "sweep": DocumentFile("sweep.json", SweepDocument),
    "properties": DocumentFile("properties.json", PropertiesDocument),
    "simulate": DocumentFile("run.json", SimulationDocument),
}
RUN = DocumentFile("run.json", RunDocument)
CONTROLLER = DocumentFile("controller.json", ControllerDocument)
