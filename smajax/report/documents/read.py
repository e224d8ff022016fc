"""Reading of the documents of a result folder, also of those that earlier versions of smajax wrote.

Unknown keys are kept and not checked, since a later version of smajax may add some; a missing key or a value of
another type is reported in one sentence with file, key and cure.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from smajax.errors import InputError
from smajax.files.result_folder import read_json
from smajax.files.toml import show
from smajax.report.documents.base import Document
from smajax.report.documents.catalogue import DOCUMENTS, RUN
from smajax.report.documents.fit import FitDocument
from smajax.report.documents.migrate import current_content
from smajax.report.documents.run import RunDocument

Model = TypeVar("Model", bound=Document)

_CURE = "the file was changed after smajax wrote it, so run the command again"


def read_document(folder: str | Path) -> Document:
    """Read the result document of a folder.

    Args:
        folder: A result folder of any command.

    Returns:
        The document; its class depends on the command. That of a simulation is run.json.

    Raises:
        InputError: If smajax did not write the folder, or its document is missing or damaged.
    """
    run = read_run(folder)
    name, model = DOCUMENTS[run.command]
    if not (Path(folder) / name).is_file() and run.exit_code:
        problem = f"the run of 'smajax {run.command}' failed (exit code {run.exit_code}) and left no {name}"
        raise InputError(f"{folder}: {problem}: run the command again")
    return _read(Path(folder), name, model)


def read_run(folder: str | Path) -> RunDocument:
    """Read run.json of a result folder: how it was made.

    Raises:
        InputError: If smajax did not write the folder, or the file is missing or damaged.
    """
    return _read(Path(folder), RUN.name, RunDocument)


def read_fit(folder: str | Path) -> FitDocument:
    """Read fit.json of a result folder.

    Raises:
        InputError: If smajax did not write the folder, or the file is missing or damaged.
    """
    return _read(Path(folder), DOCUMENTS["fit"].name, FitDocument)


def _read(folder: Path, name: str, model: type[Model]) -> Model:
    content = read_json(folder, name)
    try:
        content = current_content(content, model)
        return model.from_dict(content)
    except InputError as error:
        raise InputError(f"{folder / name}: {error}") from None
    except ValidationError as error:
        problem = describe_error(error.errors(include_url=False)[0], content)
        raise InputError(f"{folder / name}: {problem}: {_CURE}") from None


def describe_error(error: Any, content: Mapping[str, Any]) -> str:
    """Return one of pydantic's errors as a clause that names the key.

    Args:
        error: The error, as ``ValidationError.errors`` lists it.
        content: The content of the document.
    """
    value: Any = content
    location, keys = error["loc"], []
    for part in location:
        # The location of a union ends with the name of a type, which is no key of the content.
        is_key = isinstance(value, Mapping) and part in value
        is_index = isinstance(value, list) and isinstance(part, int)
        if not is_key and not is_index:
            break
        value = value[part]
        keys.append(part)
    place = "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).lstrip(".")
    if error["type"] == "missing":
        return f"{place + '.' if place else ''}{location[-1]} is missing"
    if error["type"] == "value_error":
        reason = str(error["ctx"]["error"])
        return f"{place}: {reason}" if place else reason
    message = error["msg"]
    return f"{place} = {show(value)} is wrong: {message[0].lower()}{message[1:]}"
