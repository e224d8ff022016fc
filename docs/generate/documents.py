"""The result documents, from their pydantic models."""

import inspect
import types
import typing
from typing import Any

from pydantic import BaseModel

from docs.generate.markdown import code, docstring, table
from smajax.report.documents.catalogue import CONTROLLER, DOCUMENTS, RUN, DocumentFile


def documents() -> str:
    """Return a section for each document, with a table for each of its parts."""
    every = {**DOCUMENTS, "every command": RUN, "tune, export": CONTROLLER}
    return "\n".join(_document(command, file) for command, file in every.items())


def _document(command: str, file: DocumentFile) -> str:
    schema = file.model.model_fields["schema_name"].annotation
    text = f"\n## {file.name} of {command}\n\n{docstring(file.model)}\n\nSchema: {_type(schema)}.\n\n"
    return text + "\n".join(_part(model, nested=model is not file.model) for model in _models(file.model))


def _models(model: type[BaseModel]) -> list[type[BaseModel]]:
    """The model and its parts, each once, in the order in which they are named."""
    models, waiting = [], [model]
    while waiting:
        current = waiting.pop(0)
        if current in models:
            continue
        models.append(current)
        for field in current.model_fields.values():
            waiting += [part for part in _parts(field.annotation) if part not in models]
    return models


def _parts(annotation: Any) -> list[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [part for argument in typing.get_args(annotation) for part in _parts(argument)]


def _part(model: type[BaseModel], nested: bool) -> str:
    head = f"\n**{model.__name__}**: {' '.join(docstring(model).split())}\n\n" if nested else ""
    rows = [
        (code(field.alias or name), _type(field.annotation), field.description or "")
        for name, field in model.model_fields.items()
    ]
    return head + table(("field", "type", "meaning and unit"), rows)


def _type(annotation: Any) -> str:
    """A type in words."""
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation is type(None):
        return "null"
    if origin in (typing.Union, types.UnionType):
        return " or ".join(_type(argument) for argument in arguments)
    if origin is typing.Literal:
        return " or ".join(f'"{value}"' for value in arguments)
    if origin is typing.Annotated:
        return _type(arguments[0])
    if origin is list:
        return f"list of {_type(arguments[0])}"
    if origin is dict:
        return f"table of {_type(arguments[1])}"
    names = {str: "text", float: "number", int: "whole number", bool: "true or false", Any: "any"}
    return names.get(annotation, getattr(annotation, "__name__", str(annotation)))
