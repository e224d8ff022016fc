"""JSON schemas of the result documents, made from their models.

    python -m smajax.report.documents FOLDER

writes them; docs/reference/schemas has the published ones.
"""

import json
from pathlib import Path
from typing import Any

from smajax.report.documents.catalogue import CONTROLLER, DOCUMENTS, RUN, DocumentFile

_DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, dict[str, Any]]:
    """Return the JSON schema of each document by the name of its file."""
    files = {DOCUMENTS[command].name.removesuffix(".json"): DOCUMENTS[command] for command in DOCUMENTS}
    files |= {"simulation": DOCUMENTS["simulate"], "run": RUN, "controller": CONTROLLER}
    return {f"{name}.schema.json": _schema(file) for name, file in files.items()}


def write_schemas(folder: str | Path) -> list[Path]:
    """Write the JSON schemas into a folder, which is created if necessary.

    Returns:
        The paths of the files.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, schema in schemas().items():
        paths.append(folder / name)
        paths[-1].write_text(json.dumps(schema, indent=2, ensure_ascii=False) + "\n", "utf-8")
    return paths


def _schema(file: DocumentFile) -> dict[str, Any]:
    """Return the schema of what smajax writes: without keys that the model does not have."""
    schema = file.model.model_json_schema()
    for part in [schema, *schema.get("$defs", {}).values()]:
        if "properties" in part:
            part["additionalProperties"] = False
    return {"$schema": _DIALECT} | schema | {"title": f"{file.name} of smajax, schema {file.model.SCHEMA}"}
