"""The command line, from the annotations of the typer commands."""

import enum
import inspect
import typing
from typing import Any, NamedTuple

from docs.generate.markdown import code, first_sentence, table
from smajax.app.cli import app


class Parameter(NamedTuple):
    """An argument or option of a command.

    Attributes:
        names: How it is written.
        meaning: What it does.
        is_option: Whether it is an option.
        panel: Group of the option; empty for its own.
    """

    names: tuple[str, ...]
    meaning: str
    is_option: bool
    panel: str


def commands() -> str:
    """Return a section for each command, with its arguments and options."""
    return "\n".join(_command(name, function) for name, function in _functions().items())


def command_list() -> str:
    """Return a table of the commands, with their arguments and what they do."""
    rows = [
        (f"[`{_usage(name, function)}`](#{name})", first_sentence(function)) for name, function in _functions().items()
    ]
    return table(("command", "what it does"), rows)


def reading_options() -> str:
    """Return the options that every command which reads recordings has."""
    options = [p for p in _parameters(_functions()["fit"]) if p.panel]
    return table(("option", "meaning"), [_row(p) for p in options])


def _functions() -> dict[str, Any]:
    return {
        info.name or info.callback.__name__: info.callback
        for info in app.registered_commands
        if info.callback is not None
    }


def _command(name: str, function: Any) -> str:
    parameters = _parameters(function)
    arguments, options = ([p for p in parameters if p.is_option is kind] for kind in (False, True))
    usage = _usage(name, function)
    text = f"\n### smajax {name} {{ #{name} }}\n\n{first_sentence(function)}\n\n```text\n{usage}\n```\n\n"
    text += table(("argument", "meaning"), [_row(p) for p in arguments])
    text += "\n" + table(("option", "meaning"), [_row(p) for p in options if not p.panel])
    if any(p.panel for p in options):
        text += "\nIt also takes the [options of reading](#options-of-reading).\n"
    return text


def _usage(name: str, function: Any) -> str:
    """The arguments of a command as they are written."""
    parameters = _parameters(function)
    arguments = [p.names[0] for p in parameters if not p.is_option]
    return " ".join(["smajax", name, *arguments, *["[OPTIONS]"] * any(p.is_option for p in parameters)])


def _row(parameter: Parameter) -> tuple[str, str]:
    return ", ".join(map(code, parameter.names)), parameter.meaning


def _parameters(function: Any) -> list[Parameter]:
    signature = inspect.signature(function, eval_str=True)
    return [_parameter(name, p) for name, p in signature.parameters.items()]


def _parameter(name: str, parameter: inspect.Parameter) -> Parameter:
    kind, info = typing.get_args(parameter.annotation)[:2]
    is_option = type(info).__name__ == "OptionInfo"
    words = [w for w in (typing.get_args(kind) or (kind,)) if w is not type(None)]
    plain = words[0] if inspect.isclass(words[0]) else str
    # In an annotation, typer keeps the first name where a default would be.
    first = info.default if isinstance(info.default, str) else ""
    names = tuple(name for name in (first, *(info.param_decls or ())) if name.startswith("-"))
    if is_option and plain is not bool:
        names = tuple(f"{n} {info.metavar or {int: 'NUMBER', float: 'NUMBER'}.get(plain, 'TEXT')}" for n in names)
    elif not is_option:
        names = (info.metavar or name.upper(),)
    meaning = _plain(info.help)
    if issubclass(plain, enum.Enum) and is_option:
        meaning += f" One of {', '.join(code(choice.value) for choice in plain)}."
    default = parameter.default
    if default not in (inspect.Parameter.empty, None, False, True, ()) and str(default) != ".":
        meaning += f" Default: {code(getattr(default, 'value', default))}."
    panel = getattr(info, "rich_help_panel", None)
    return Parameter(names, meaning, is_option, panel if isinstance(panel, str) else "")


def _plain(text: str | None) -> str:
    return " ".join((text or "").replace("\\[", "[").split())
