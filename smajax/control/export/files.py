"""All exports of a tuned controller as files: C header, JSON document, and the FMUs of plant and controller."""

from typing import NamedTuple

from smajax import __version__
from smajax.channels import CHANNELS
from smajax.control.export.c_header import c_header
from smajax.control.export.fmu.controller_model import controller_model
from smajax.control.export.fmu.pack import pack_fmu
from smajax.control.export.fmu.plant_model import plant_model
from smajax.control.export.json_document import controller_document
from smajax.control.tuning.tuning_study import ControllerTuning
from smajax.errors import InputError
from smajax.files.documents import to_json


class ExportedFiles(NamedTuple):
    """Exports of a controller.

    Attributes:
        contents: Content of each file by its name.
        missing: Reason for each file that cannot be written, by its name.
    """

    contents: dict[str, bytes]
    missing: dict[str, str]


def export_files(study: ControllerTuning) -> ExportedFiles:
    """Export a tuned controller and its plant in all forms.

    Args:
        study: Result of a tuning.

    Returns:
        The files ``controller.json``, ``controller.h``, ``plant.fmu`` and ``controller.fmu``, as far as they can be
        written.
    """
    settings, loop = study.settings, study.tuned.loop
    plant = settings.system.plant
    units = (CHANNELS[plant.drive.control].unit, CHANNELS[loop.channel].unit)
    start = float(settings.scenario.initial_reference)
    exports = ExportedFiles({}, {})
    for name, content in (
        ("controller.json", lambda: to_json(controller_document(loop, settings.units)).encode()),
        ("controller.h", lambda: c_header(loop, units, __version__, start).encode()),
        ("plant.fmu", lambda: pack_fmu(plant_model(plant, study.rig.name))),
        ("controller.fmu", lambda: pack_fmu(controller_model(loop, units, settings.units, settings.name))),
    ):
        try:
            exports.contents[name] = content()
        except InputError as error:
            exports.missing[name] = str(error)
    return exports
