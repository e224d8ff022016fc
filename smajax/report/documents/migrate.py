"""Documents of earlier versions of smajax, brought to the current schema.

Schema 2 of a document has the keys of schema 1; only names of parameters changed, in keys and in lists of names. The
first documents of schema 1 lacked some of the keys.
"""

from collections.abc import Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.renamed_keys import current_name
from smajax.report.documents.base import Document

# Content of keys that the first documents of schema 1 lacked.
_FIRST_FIT = {
    "kind": "",
    "inputs": [],
    "fixed": {},
    "correlations": {"parameters": [], "matrix": []},
    "discretisation": {},
    "profiles": {},
    "warnings": [],
}
_FIRST_DIAGNOSIS = {
    "evidence": [],
    "recordings": [],
    "left_out": [],
    "base_fit_at_rest": True,
    "preflight": [],
    "residual": {},
    "free_form": None,
}


def current_content(content: Mapping[str, Any], model: type[Document]) -> dict[str, Any]:
    """Return the content of a document under the current schema of its model.

    Args:
        content: The content of the file.
        model: Model of the document.

    Raises:
        InputError: If the file has another schema.
    """
    schema = content.get("schema")
    if schema == model.SCHEMA:
        return dict(content)
    if schema in model.EARLIER:
        return _with_current_names(_with_all_keys(content)) | {"schema": model.SCHEMA}
    readable = " and ".join([*model.EARLIER, model.SCHEMA])
    family, _, version = str(schema).rpartition("/")
    if family == model.SCHEMA.rpartition("/")[0] and version.isdigit():
        raise InputError(f"schema = {schema!r} is of a later version of smajax, this one reads {readable}: update it")
    raise InputError(f"schema = {schema!r} is not that of this file: smajax reads {readable} here")


def _with_all_keys(content: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of a document of schema 1 with all keys."""
    if content["schema"] == "smajax.diagnosis/1":
        filled = _FIRST_DIAGNOSIS | dict(content)
        tables = [key for key in ("ranking", "preflight") if isinstance(filled.get(key), list)]
        return filled | {key: [_with(entry, "why", "") for entry in filled[key]] for key in tables}
    if content["schema"] != "smajax.fit/1":
        return dict(content)
    observed = list(content["rmse"]) if isinstance(content.get("rmse"), dict) else []
    filled = _FIRST_FIT | {"observed": observed} | dict(content)
    entries = filled.get("parameters")
    if isinstance(entries, dict):
        filled["parameters"] = {name: _with(entry, "bounds", [None, None]) for name, entry in entries.items()}
    if isinstance(filled.get("recordings"), list):
        filled["recordings"] = [_with(entry, "notes", []) for entry in filled["recordings"]]
    return filled


def _with(entry: Any, key: str, default: Any) -> Any:
    """Return a table with a key, if it is a table."""
    return {key: default} | entry if isinstance(entry, dict) else entry


def _with_current_names(value: Any) -> Any:
    """Return a value with the current names of parameters in keys and in lists of texts."""
    if isinstance(value, Mapping):
        return {current_name(key): _with_current_names(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_renamed(item) if isinstance(item, str) else _with_current_names(item) for item in value]
    return value


def _renamed(text: str) -> str:
    """Return a text of a list with the current name of the parameter that it begins with, such as "NAME (BOUND)"."""
    name, space, rest = text.partition(" ")
    return current_name(name) + space + rest
