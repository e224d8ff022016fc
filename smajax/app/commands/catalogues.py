"""Jobs of ``smajax effects`` and ``smajax sets``: effects and parameter sets with keys, units, sizes and sources."""

import inspect
import math
from pathlib import Path
from textwrap import wrap

from smajax.errors import InputError, suggestion
from smajax.files.material_limits import LIMIT_UNITS, Limit, read_catalogue, read_limits
from smajax.files.parameter_sets import Entry, find_set, read_header, read_parameters, shipped_sets
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.effects.base import AbstractEffect
from smajax.report.summary import table
from smajax.units import as_text

# Width of the text in columns of a terminal.
_WIDTH = 110
# Longest source in a table; it is whole in the description of one effect or set.
_LONGEST_SOURCE = 60


def effects_text(key: str | None = None) -> str:
    """Describe all effects of the catalogue, or one with all its parameters.

    Args:
        key: Key of the effect; ``None`` for all.

    Raises:
        InputError: If there is no such effect.
    """
    effects = catalogue()
    if key is None:
        rows = [
            (name, effect.stage, as_text(effect.typical, _strength_unit(effect)), _short(effect.source))
            for name, effect in sorted(effects.items(), key=lambda item: (item[1].stage, item[0]))
        ]
        lines = table([("effect", "stage", "typical strength", "source"), *rows])
        return "\n".join(line.rstrip() for line in [*lines, "", "smajax effects KEY describes one of them."])
    if key not in effects:
        raise InputError(
            f"there is no effect '{key}'{suggestion(key, effects)}: 'smajax effects' lists those that there are"
        )
    return "\n".join(line.rstrip() for line in effect_lines(key, effects[key]))


def sets_text(name: str | None = None) -> str:
    """Describe all shipped parameter sets, or the values of one.

    Args:
        name: Name of a shipped set, or the path of a file; ``None`` for all shipped ones.

    Raises:
        InputError: If there is no such set, or the file is not valid.
    """
    if name is None:
        lines: list[str] = []
        for shipped in shipped_sets():
            path = find_set(shipped)
            header, entries = read_header(path), read_parameters(path)
            lines.append(f"{shipped}: {header.get('title', '')} ({len(entries)} values)")
            lines += wrap(f"from {header['source']}", _WIDTH, initial_indent="    ", subsequent_indent="    ") * (
                "source" in header
            )
        return "\n".join([*lines, "", "smajax sets NAME lists the values of one of them."])
    path = find_set(name, place="set ")
    header = read_header(path)
    lines = [f"{name}: {header.get('title', '')}", *wrap(str(header.get("source", "")), _WIDTH), ""]
    rows = [(key, as_text(e.value, e.unit), _range_text(e), e.source) for key, e in read_parameters(path).items()]
    lines += table([("parameter", "value", "bounds", "source"), *rows]) if rows else ["It has no parameters."]
    lines += _limit_lines(path, name)
    use = name if Path(name).suffix == ".toml" else path.stem
    return "\n".join(line.rstrip() for line in [*lines, "", f'In a rig file: [rig] parameters = "{use}"'])


def _limit_lines(path: Path, name: str) -> list[str]:
    """Lines on the limits and the stock diameters of a parameter set; none for a set without them."""
    limits, stock, lines = read_limits(path, name), read_catalogue(path, name), []
    if limits is not None:
        entries = [("stress", limit) for limit in limits.stress]
        entries += [(key, limit) for key in ("temperature", "strain") if (limit := getattr(limits, key)) is not None]
        rows = [(key, _limit_text(key, limit), limit.source) for key, limit in entries]
        lines += ["", *table([("limit in a sweep", "at most", "source"), *rows])]
    if stock is not None:
        sizes = ", ".join(as_text(size, "m") for size in stock.diameters)
        lines += ["", *wrap(f"Stock diameters of {stock.wire}: {sizes} ({stock.source})", _WIDTH)]
    return lines


def _limit_text(key: str, limit: Limit) -> str:
    size = f"{100.0 * limit.value:g} %" if key == "strain" else as_text(limit.value, LIMIT_UNITS[key])
    return size + (f" for {limit.cycles:,.0f} cycles" if limit.cycles else "")


def effect_lines(key: str, effect: type[AbstractEffect]) -> list[str]:
    """Return the text about one effect: what it is, its parameters, where it applies, and how a rig file names it.

    Args:
        key: Key of the effect.
        effect: Its class.
    """
    unit = _strength_unit(effect)
    lines = [*wrap(f"{key}: {_first_paragraph(effect)}", _WIDTH), ""]
    rows = [
        (
            f"effects.{key}.{name}",
            _value_text(effect.typical if name == "strength" else d.default, d.unit),
            " .. ".join(_value_text(end, d.unit) for end in (d.lower, d.upper)),
            d.meaning,
        )
        for name, d in declarations(effect).items()
    ]
    lines += table([("parameter", "typical or default", "bounds", "meaning"), *rows])
    lines += ["", f"Stage: {effect.stage}", f"Source of the typical strength: {effect.source or 'none given'}"]
    if effect.needs:
        lines.append(f"Needs: {', '.join(effect.needs)}")
    if effect.excluded_by:
        lines.append(f"Not where a rig has: {', '.join(effect.excluded_by)}")
    if similar := similar_effects(key):
        lines.append(f"Explains similar residuals as: {', '.join(similar)}")
    if effect.remedy:
        lines += wrap(f"On the bench: {effect.remedy}", _WIDTH)
    return [*lines, f'In a rig file: [effects.{key}] and below it strength = "{as_text(effect.typical, unit)}"']


def similar_effects(key: str) -> list[str]:
    """Return the keys of the effects that explain similar residuals; the relation holds both ways.

    Args:
        key: Key of the effect.
    """
    effects = catalogue()
    return sorted(k for k in effects if k in effects[key].confused_with or key in effects[k].confused_with)


def _strength_unit(effect: type[AbstractEffect]) -> str:
    return declarations(effect)["strength"].unit


def _first_paragraph(effect: type[AbstractEffect]) -> str:
    return " ".join((inspect.getdoc(effect) or "").partition("\n\n")[0].split())


def _short(text: str) -> str:
    return text if len(text) <= _LONGEST_SOURCE else f"{text[: _LONGEST_SOURCE - 3]}..."


def _value_text(value: float | None, unit: str) -> str:
    return "none" if value is None or not math.isfinite(value) else as_text(value, unit)


def _range_text(entry: Entry) -> str:
    if not math.isfinite(entry.lower) and not math.isfinite(entry.upper):
        return "-"
    return " .. ".join(_value_text(end, entry.unit) for end in (entry.lower, entry.upper))
