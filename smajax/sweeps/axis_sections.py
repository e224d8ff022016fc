"""The section ``[parameters]`` of a SWEEP.toml: the parameters that vary, and their ranges."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from smajax import parameters
from smajax.errors import InputError
from smajax.files.material_limits import Catalogue, read_catalogue
from smajax.files.parameter_sets import find_set
from smajax.files.renamed_keys import current_name
from smajax.files.toml import advice, quantity_at, show, validate
from smajax.files.validators import quantity
from smajax.parameters.definitions import ORDERED_PAIRS, Declaration
from smajax.sweeps.schema import INPUT, SHAPES, Range
from smajax.sweeps.space import Axis
from smajax.units import as_text

if TYPE_CHECKING:
    from smajax.sweeps.subject import Subject

# Keys that distinguish the table of a range from a section of parameters.
_RANGE_KEYS = frozenset(("from", "to", "values", "scale", "points", "catalogue"))
# Axis whose values are names of shapes.
_WAVE = f"{INPUT}wave"


def read_axes(
    data: Mapping[str, Any],
    declarations: Mapping[str, Declaration],
    sampling: str,
    catalogues: Mapping[str, Catalogue],
) -> tuple[Axis, ...]:
    """Read the axes of a sweep.

    Args:
        data: Data of the sweep file.
        declarations: Parameters that can vary, by name; names of earlier versions are read as the current ones.
        sampling: ``grid``, ``latin-hypercube`` or ``sobol``.
        catalogues: Catalogues that the axes name, by name; see ``read_catalogues``.

    Returns:
        The axes in the order of the file, in internal units.

    Raises:
        InputError: If the section is missing, or a parameter or its range is not valid.
    """
    section = data.get("parameters")
    if not isinstance(section, dict) or not section:
        raise InputError(
            'the section [parameters] is missing: say what varies, as in wire.diameter = ["0.1 mm", "0.4 mm"]'
        )
    axes: list[Axis] = []
    for name, value in ((current_name(name), value) for name, value in _flatten(section)):
        if any(axis.name == name for axis in axes):
            raise InputError(f'parameters.{name} is given twice, as {name} and as "{name}": take one of the two out')
        if name == _WAVE and f"{INPUT}frequency" in declarations:
            axes.append(_read_waves(value))
            continue
        if name not in declarations:
            raise InputError(
                f"parameters.{name} is not a parameter of this rig{advice(name, declarations, 'its parameters are')}"
            )
        try:
            axes.append(_read_axis(name, value, declarations[name], catalogues))
        except InputError as error:
            raise InputError(f"parameters.{name}: {error}") from None
        if sampling != "grid" and isinstance(value, dict) and "points" in value:
            raise InputError(
                f'parameters.{name}.points applies to a grid only: set sweep.sampling = "grid", or take it out'
            )
    return tuple(axes)


def _flatten(section: Mapping[str, Any], prefix: str = "") -> list[tuple[str, Any]]:
    """Names with their values; wire.diameter = ... and "wire.diameter" = ... are the same."""
    entries = []
    for key, value in section.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict) and not set(value) & _RANGE_KEYS:
            entries += _flatten(value, f"{name}.")
        else:
            entries.append((name, value))
    return entries


def catalogue_names(data: Mapping[str, Any]) -> list[str]:
    """Return the names of the catalogues that the section names.

    Args:
        data: Data of the sweep file.
    """
    section = data.get("parameters")
    entries = _flatten(section) if isinstance(section, dict) else []
    return [v["catalogue"] for _, v in entries if isinstance(v, dict) and isinstance(v.get("catalogue"), str)]


def read_catalogues(data: Mapping[str, Any], folder: Path) -> dict[str, Catalogue]:
    """Read the catalogues that the section names.

    Args:
        data: Data of the sweep file.
        folder: Folder from which paths of parameter sets start.

    Returns:
        Catalogues by their names in the file.

    Raises:
        InputError: If a parameter set is not known, or has no catalogue.
    """
    catalogues = {}
    for name in catalogue_names(data):
        catalogue = read_catalogue(find_set(name, folder, "parameters: catalogue "), name)
        if catalogue is None:
            raise InputError(
                f"parameters: parameter set {name} has no section [catalogue]: name another one, such as flexinol or "
                "smartflex, or list values"
            )
        catalogues[name] = catalogue
    return catalogues


def _read_waves(value: Any) -> Axis:
    """The axis of shapes of the input."""
    settings = validate(Range, value, _WAVE) if isinstance(value, dict) else None
    names = settings.values if settings is not None else None
    if not names:
        raise InputError(f'parameters.{_WAVE} = {show(value)} is not a list: write {{ values = ["square", "sine"] }}')
    for name in names:
        if name not in SHAPES:
            raise InputError(f"parameters.{_WAVE}: {show(name)} is not known: choose {', '.join(SHAPES)}")
    labels = tuple(dict.fromkeys(names))
    return Axis(_WAVE, "1", 0.0, len(labels) - 1.0, values=tuple(map(float, range(len(labels)))), labels=labels)


def _read_axis(name: str, value: Any, declaration: Declaration, catalogues: Mapping[str, Catalogue]) -> Axis:
    if isinstance(value, list):
        if len(value) != 2:
            raise InputError(f'{show(value)} is not a range: write ["low", "high"], or {{ values = [...] }} for a list')
        settings = Range.model_validate({"from": value[0], "to": value[1]})
    elif isinstance(value, dict):
        settings = validate(Range, value, name)
        if settings.catalogue is not None:
            return _catalogue_axis(name, value, catalogues[settings.catalogue])
    else:
        raise InputError(
            f'{show(value)} is not a range: write ["low", "high"], or {{ from = "low", to = "high", scale = "log" }}'
        )
    if settings.values is not None:
        extra = [key for key in ("scale", "points") if isinstance(value, dict) and key in value]
        return _listed_axis(name, settings, extra, declaration)
    return _ranged_axis(name, settings, declaration)


def _catalogue_axis(name: str, value: Mapping[str, Any], catalogue: Catalogue) -> Axis:
    """The axis of the stock diameters of a catalogue between ``from`` and ``to``, if these are given."""
    if name != "wire.diameter":
        raise InputError("a catalogue has diameters of wires: only wire.diameter takes one")
    if extra := [key for key in ("scale", "points", "values") if key in value]:
        raise InputError(f"{extra[0]} has no place next to catalogue: take one of the two out")
    ends = [
        quantity_at(value[key], "m", key) if key in value else otherwise
        for key, otherwise in (("from", 0.0), ("to", math.inf))
    ]
    sizes = tuple(size for size in catalogue.diameters if ends[0] <= size <= ends[1])
    if not sizes:
        raise InputError(f"no diameter of {catalogue.wire} is in this range: widen it")
    return Axis(name, "m", min(sizes), max(sizes), values=sizes, catalogue=catalogue.wire)


def _listed_axis(name: str, settings: Range, extra_keys: Sequence[str], declaration: Declaration) -> Axis:
    listed = settings.values or []
    if settings.from_ is not None or settings.to is not None:
        raise InputError("it has both values and a range: take one of the two out")
    if extra_keys:
        raise InputError(f"{extra_keys[0]} has no place next to values: take one of the two out")
    if not listed:
        raise InputError("its list of values is empty: give at least one")
    values = tuple(quantity(v, declaration) for v in listed)
    if declaration.whole:
        broken = [text for text, number in zip(listed, values, strict=True) if number != round(number)]
        if broken:
            raise InputError(f"{show(broken[0])} is not a whole number, as {name} must be: give whole numbers")
    return Axis(name, declaration.unit, min(values), max(values), values=values)


def _ranged_axis(name: str, settings: Range, declaration: Declaration) -> Axis:
    if settings.from_ is None or settings.to is None:
        missing = "from" if settings.from_ is None else "to"
        raise InputError(f"'{missing}' is missing: a range needs both from and to, or give values")
    lower, upper = (quantity(v, declaration) for v in (settings.from_, settings.to))
    shown = f"from {show(settings.from_)} to {show(settings.to)}"
    if not lower < upper:
        raise InputError(f"the range {shown} is empty: give a lower end and a higher one")
    log = settings.scale == "log"
    if log and not lower > 0.0:
        raise InputError(f"a log scale cannot begin at {show(settings.from_)}: give a lower end above 0")
    if declaration.whole:
        first, last = math.ceil(lower), math.floor(upper)
        if not first < last:
            raise InputError(
                f"{name} is a whole number, and {shown} there are no two whole numbers: widen the range, or give values"
            )
        lower, upper = float(first), float(last)
    return Axis(name, declaration.unit, lower, upper, log, settings.points, whole=declaration.whole)


def check_order(axes: Sequence[Axis], subject: "Subject") -> None:
    """Check the ranges of parameters of which one must stay below the other in every design.

    Args:
        axes: Axes of the space.
        subject: The rig or actuator; parameters that do not vary have its values.

    Raises:
        InputError: If two such ranges overlap.
    """
    declarations, ends = subject.declarations, {}
    for axis in axes:
        ends |= dict.fromkeys(parameters.expand([axis.name]), (axis.lower, axis.upper))
    for low, high in ORDERED_PAIRS:
        if low not in declarations or high not in declarations or not {low, high} & ends.keys():
            continue
        below, above = (ends.get(n) or (subject.value(n),) * 2 for n in (low, high))
        if not below[1] < above[0]:
            shown = [as_text(value, declarations[n].unit) for n, value in ((low, below[1]), (high, above[0]))]
            raise InputError(
                f"parameters: {low} up to {shown[0]} does not stay below {high} from {shown[1]}: "
                "narrow one of the ranges"
            )
