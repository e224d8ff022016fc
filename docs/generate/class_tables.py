"""The tables of the shipped classes, with which the command line checks files before JAX is loaded.

    python -m docs.generate.class_tables

writes data/classes.json, which a test compares with the classes.
"""

import json

from smajax.control.controller_file.schema import controller_kinds
from smajax.files.class_tables import classes_document
from smajax.files.loaded_classes import LOADED_CLASSES
from smajax.recordings.datasets import data_path


def text() -> str:
    """Return the content of the file; classes that were registered in this process are in it, too."""
    controllers = {kind: list(options) for kind, options in controller_kinds().items()}
    return json.dumps(classes_document(LOADED_CLASSES) | {"controllers": controllers}, indent=1) + "\n"


if __name__ == "__main__":
    data_path("classes.json").write_text(text(), encoding="utf-8")
