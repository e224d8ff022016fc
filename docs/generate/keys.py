"""Every key of the input files, from the models of their sections and the declarations of parameters."""

import functools
import inspect
import math
import re
import tomllib
import types
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Union, get_args, get_origin

import annotated_types
from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from docs.generate.effects import value_text
from docs.generate.markdown import code, table
from smajax.control.controller_file import schema as controller
from smajax.control.controllers.registry import controller_class, file_kinds
from smajax.files import channel_settings, material_limits, rig_schema, rig_structure
from smajax.files.parameter_sets import EntryTable
from smajax.files.recording_settings import RecordingSection
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import choose_stages
from smajax.files.validators import OneOf
from smajax.parameters.definitions import Declaration, declarations
from smajax.plant.drive import DRIVES
from smajax.plant.materials.registry import MATERIALS
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.recordings.datasets import data_path
from smajax.recordings.read_options import ReadOptions
from smajax.sweeps import schema as sweep

HEAD = ("key", "type, default, bounds", "meaning", "example")
KINDS = {str: "text", int: "whole number", float: "number", bool: "true or false", list: "list", dict: "table"}
# Examples of gains, for a current and a displacement.
GAINS = {
    "kp": '"30 A/m"',
    "ki": '"10 A/m/s"',
    "kd": '"0.5 A s/m"',
    "filter_time": '"50 ms"',
    "kb": '"100 1/m"',
    "tuning_point": '"4 mm"',
    "kp_rest": '"20 A/m"',
    "band": '"0.2 mm"',
    "rate_p": "0.1",
    "rate_i": "0.1",
    "rate_d": "0.001",
}
# Sections of parameters in the order of a rig file.
ORDER = ("wire", "material", "heat", "drive", "environment", "initial", "cells", "grains")


def rig_keys() -> str:
    """Return the keys of a rig file."""
    return "\n".join(
        [
            _model("rig", rig_schema.RigSection),
            _model("fit", rig_schema.FitSection),
            *_parameter_sections(),
            _sensor_section(),
            _model("channels", channel_settings.Layout, "Options that are not channels:"),
            _model("channels.CHANNEL", channel_settings.Column, 'A column, as in `force = {column = "ADC", ...}`:'),
            _recording_section(),
        ]
    )


def device_keys() -> str:
    """Return the keys of the rig files of actuators that are no wires on a mechanism, a part for each kind."""
    parts = []
    for kind, actuator in rig_classes().actuators.items():
        shipped = tomllib.loads((data_path("actuators", kind) / "rig.toml").read_text("utf-8"))
        parts.append(f"\n## {kind} {{ #{kind} }}\n")
        for section, part in actuator.rig_sections().items():
            rows = [
                _declared(section, key, declared, shipped.get(section, {}).get(key))
                for key, declared in declarations(part).items()
            ]
            parts.append(f"\n### [{section}] {{ #{kind}-{section} }}\n\n{table(HEAD, rows)}")
    return "\n".join(parts)


def set_keys() -> str:
    """Return the keys of a parameter set."""
    sections = {
        "SECTION.KEY": (
            EntryTable,
            "A parameter by the name that it has in a rig file, such as `[material.martensite_start]`:",
        ),
        "limits": (material_limits.LimitSections, "What the material bears; a sweep keeps to it:"),
        "limits.NAME": (material_limits.LimitTable, "The keys of a limit:"),
        "catalogue": (material_limits.CatalogueTable, "The diameters in which the wire is sold:"),
    }
    return "\n".join(_model(name, model, note) for name, (model, note) in sections.items())


def controller_keys() -> str:
    """Return the keys of a controller file."""
    sections = {
        "controller": controller.ControllerSection,
        "reference": controller.ReferenceSection,
        "tune": controller.TuneSection,
        "limits": controller.LimitsSection,
        "feedforward": controller.FeedforwardSection,
        "sensor": controller.SensorSection,
        "instruments": controller.InstrumentsSection,
        "temperature_limiter": controller.TemperatureLimiterSection,
        "estimator": controller.EstimatorSection,
        "robust": controller.RobustSection,
        "change": controller.ChangeSection,
    }
    texts = [_model(name, model) for name, model in sections.items()]
    return "\n".join([texts[0], _gains(), *texts[1:]])


def sweep_keys() -> str:
    """Return the keys of a sweep file."""
    sections = {
        "sweep": (sweep.SweepSection, ""),
        "parameters": (sweep.Range, 'A parameter by its name, as a range `["0.1 mm", "0.4 mm"]` or a table:'),
        "input": (sweep.InputSection, ""),
        "objectives": (None, 'A metric by its name: `"max"` or `"min"`. Metrics: ' + _metrics()),
        "constraints": (sweep.Limit, "A metric by its name, with a table:"),
        "margins": (sweep.MarginSection, ""),
        "refine": (sweep.RefineSection, ""),
    }
    return "\n".join(_model(name, model, note) for name, (model, note) in sections.items())


def _metrics() -> str:
    from smajax.sweeps.subject import METRIC_NAMES

    return ", ".join(map(code, METRIC_NAMES)) + ", and those of an actuator."


def _model(section: str, model: type[BaseModel] | None, note: str = "") -> str:
    head = f"\n## [{section}] {{ #{section.replace('.', '-').lower()} }}\n\n" + (f"{note}\n\n" if note else "")
    if model is None:
        return head
    return head + table(HEAD, [_row(field.alias or name, field) for name, field in model.model_fields.items()])


def _row(key: str, field: FieldInfo) -> tuple[str, str, str, str]:
    facts = [_kind(field.annotation, field.examples), *_choices(field), *_limits(field.metadata)]
    default = field.get_default(call_default_factory=True) if not field.is_required() else None
    if field.is_required():
        facts.append("required")
    elif default in ([], {}):
        facts.append("empty by default")
    else:
        facts.append("may be left out" if default is None else f"{_toml(default)} by default")
    example = str(field.examples[0]) if field.examples else (_toml(default) if default is not None else "")
    return code(key), "; ".join(fact for fact in facts if fact), field.description or "", code(example)


def _toml(value: Any) -> str:
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else f"{value}"


def _choices(field: FieldInfo) -> list[str]:
    """The words that a key accepts."""
    parts = [*field.metadata, *(part for a in get_args(field.annotation) for part in getattr(a, "__metadata__", ()))]
    checks = [part.func for part in parts if isinstance(part, BeforeValidator)]
    return [", ".join(check.choices) for check in checks if isinstance(check, OneOf)]


def _kind(annotation: Any, examples: Sequence[Any] | None = None) -> str:
    """The type of a key in words; of a value of any type that of its example."""
    if annotation is Any:
        example = str((examples or [""])[0])
        table, text = example.startswith("{"), re.match(r'"[A-Za-z]', example)
        return "table" if table else "text" if text else "quantity"
    if get_origin(annotation) in (Union, types.UnionType):
        return _kind(next(part for part in get_args(annotation) if part is not type(None)))
    if get_origin(annotation) is list:
        entry = _kind(get_args(annotation)[0], [str(example)[1:] for example in examples or []])
        return "list of " + {"text": "texts", "number": "numbers", "quantity": "quantities"}.get(entry, "tables")
    if hasattr(annotation, "__metadata__"):
        return _kind(get_args(annotation)[0])
    return KINDS.get(get_origin(annotation) or annotation, "text")


def _limits(metadata: Iterable[Any]) -> list[str]:
    texts = []
    for limit in metadata:
        if isinstance(limit, annotated_types.Ge):
            texts.append(f"at least {limit.ge}")
        elif isinstance(limit, annotated_types.Gt):
            texts.append(f"above {limit.gt}")
        elif isinstance(limit, annotated_types.Le):
            texts.append(f"at most {limit.le}")
        elif isinstance(limit, annotated_types.MinLen) and limit.min_length > 1:
            texts.append(f"{limit.min_length} entries")
    return texts


def _declared(section: str, key: str, declared: Declaration, shipped: Any = None) -> tuple[str, str, str, str]:
    bounds = f"{value_text(declared.lower, declared.unit)} to {value_text(declared.upper, declared.unit)}"
    default = value_text(declared.default, declared.unit)
    kind = "whole number" if declared.whole else "quantity"
    state = default if declared.default is None or default == "derived" else f"{default} by default"
    example = _example(f"{section}.{key}", declared) if shipped is None else _toml(shipped)
    return code(key), f"{kind}; {bounds}; {state}", declared.meaning, code(example)


def _example(name: str, declared: Declaration) -> str:
    """A value of a shipped rig file, else the default, else the unit."""
    if name in _shipped_values():
        return _toml(_shipped_values()[name])
    number = declared.default if declared.default is not None else math.nan
    return f'"{value_text(number if math.isfinite(number) else _inside(declared), declared.unit)}"'


def _inside(declared: Declaration) -> float:
    """A number of one digit within the bounds of a parameter that has no usual value."""
    if declared.lower <= 0.0 <= declared.upper:
        return min(1.0, declared.upper)
    upper = declared.upper if math.isfinite(declared.upper) else 100.0 * declared.lower
    return float(f"{math.copysign(math.sqrt(declared.lower * upper), declared.lower):.0e}")


@functools.cache
def _shipped_values() -> dict[str, Any]:
    """The values of the shipped rig files by parameter name."""
    values: dict[str, Any] = {}
    for path in sorted([*data_path("templates").glob("*.toml"), *data_path("recordings").glob("*/rig.toml")]):
        for section, content in tomllib.loads(path.read_text("utf-8")).items():
            if isinstance(content, dict):
                values |= {
                    f"{section}.{key}": value for key, value in content.items() if f"{section}.{key}" not in values
                }
    return values


def _parameter_sections() -> list[str]:
    """The sections of parameters of all kinds of rigs, controls and material laws."""
    sections: dict[str, dict[str, Declaration]] = {}
    owners: dict[str, dict[str, set[str]]] = {}
    structure = rig_structure.Structure(9, 6)
    for kind in MECHANISMS:
        for model in MATERIALS:
            for control in DRIVES:
                cells = structure if kind != "path" else rig_structure.UNIFORM
                for exponent in (False, True):
                    stages = choose_stages(kind, control, model, (), exponent, cells)
                    for name, declared in stages.table().items():
                        section, _, key = name.partition(".")
                        sections.setdefault(section, {}).setdefault(key, declared)
                        owners.setdefault(section, {}).setdefault(key, set()).add(model)
    names = [*(n for n in ORDER if n in sections), *sorted(n for n in sections if n not in ORDER)]
    return [_parameters(name, sections[name], owners[name]) for name in names]


def _parameters(section: str, keys: Mapping[str, Declaration], owners: Mapping[str, set[str]]) -> str:
    models = {"wire": rig_structure.WireStructure, "material": rig_structure.MaterialStructure}
    rows = [_declared(section, key, declared) for key, declared in keys.items()]
    if section in models:
        rows += [_row(key, field) for key, field in models[section].model_fields.items()]
    laws = {key: laws for key, laws in owners.items() if len(laws) < len(MATERIALS)}
    groups = sorted({tuple(sorted(its)) for its in laws.values()})
    keys_of = {group: [code(key) for key, its in laws.items() if tuple(sorted(its)) == group] for group in groups}
    note = "".join(f"- {', '.join(keys_of[group])}: {', '.join(group)}\n" for group in groups)
    note = f"\nKeys of some material laws only:\n\n{note}" if note else ""
    return f"\n## [{section}] {{ #{section} }}\n\n" + table(HEAD, rows) + note


def _sensor_section() -> str:
    rows = [
        (
            "`CHANNEL_gain`",
            "number; 0.1 to 10; 1 by default",
            "gain of the sensor of a channel",
            "`displacement_gain = 1.02`",
        ),
        (
            "`CHANNEL_offset`",
            "quantity; 0 by default",
            "offset of the sensor: reading = gain times value plus offset",
            '`displacement_offset = "0.3 mm"`',
        ),
    ]
    return "\n## [sensor] { #sensor }\n\n" + table(HEAD, rows)


def _recording_section() -> str:
    text = inspect.cleandoc(ReadOptions.__doc__ or "")  # Python 3.13 removes the indentation itself
    described = dict(re.findall(r"^    (\w+): ((?:.|\n        )+)", text, re.MULTILINE))
    rows = [
        (
            *_row(name, field)[:2],
            " ".join(described[name].replace("``", "`").split()),
            _row(name, field)[3],
        )
        for name, field in RecordingSection.model_fields.items()
    ]
    return "\n## [recording] { #recording }\n\n" + table(HEAD, rows)


def _gains() -> str:
    """The gains of each kind of controller, from its class."""
    from smajax.parameters import declarations

    rows = []
    for kind in file_kinds():
        for name, declared in declarations(controller_class(kind)).items():
            if name in ("lower", "upper"):  # controller.output
                continue
            lower = "at least 0; " if declared.lower == 0.0 else ""
            state = "required" if declared.default is None else f"{declared.default:g} by default"
            facts = f"quantity in {declared.unit}; {lower}{state}"
            rows.append((code(kind), code(name), facts, declared.meaning, code(GAINS[name])))
    note = "`u` is the unit of the command and `y` that of the channel: A and m in the examples."
    return f"\n## [gains] {{ #gains }}\n\n{note}\n\n" + table(("kind", *HEAD), rows)
