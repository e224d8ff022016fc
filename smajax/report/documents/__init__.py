"""Result documents: a pydantic model for each JSON file that a command writes.

The field descriptions say what a value means and in which unit it is. What smajax writes is checked against the model
(``Document.check``), which forbids other keys; ``read_document`` reads the document of a folder, also of an earlier
version. ``schemas`` makes the published JSON schemas from the models.

``base`` has the base classes, ``parts`` what several documents share, ``catalogue`` the list of all; ``migrate`` brings
documents of earlier versions to the current schema.
"""

from smajax.report.documents.base import Document
from smajax.report.documents.catalogue import DOCUMENTS
from smajax.report.documents.compare import CompareDocument
from smajax.report.documents.controller import ControllerDocument
from smajax.report.documents.diagnosis import DiagnosisDocument
from smajax.report.documents.fit import FitDocument
from smajax.report.documents.properties import PropertiesDocument
from smajax.report.documents.read import read_document, read_fit, read_run
from smajax.report.documents.run import RunDocument, SimulationDocument
from smajax.report.documents.schemas import write_schemas
from smajax.report.documents.sweep import SweepDocument
from smajax.report.documents.tune import TuneDocument
from smajax.report.documents.write import write_result

__all__ = [
    "DOCUMENTS",
    "CompareDocument",
    "ControllerDocument",
    "DiagnosisDocument",
    "Document",
    "FitDocument",
    "PropertiesDocument",
    "RunDocument",
    "SimulationDocument",
    "SweepDocument",
    "TuneDocument",
    "read_document",
    "read_fit",
    "read_run",
    "write_result",
    "write_schemas",
]
