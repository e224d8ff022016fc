"""SWEEP.toml: which rig, what varies, under which input, what counts, and what has to be kept.

    [sweep]
    rig = "rig.toml"
    sampling = "sobol"                # sobol, latin-hypercube, grid
    designs = 1024
    [parameters]                      # what varies: a range, or { from, to, scale, points }, or { values }
    wire.diameter = ["0.1 mm", "0.4 mm"]
    input.amplitude = ["0.2 A", "2 A"]
    [input]
    wave = "square"                   # square, sine, triangle; or a recording
    amplitude = "0.4 A"
    frequency = "0.1 Hz"
    [objectives]
    stroke = "max"
    [constraints]
    peak_temperature = { at_most = "120 degC" }

A rig starts cold, and what is read off a cycle is that of the last one. The column ``settling``, always there, is the gap between this
cycle's start and end over its range: 0 where the response repeats itself, and up to 1 % counts as settled. How many designs are beyond
that is said; they stay in the table, and ``settling = { at_most = "1 %" }`` among the constraints keeps them from being the best.

Every mistake is one sentence that names file and key. A sweep's ``header`` holds all that it depends on, and gives the same sweep back.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, Field

from smajax import __version__, parameters
from smajax.errors import InputError
from smajax.parameters import ORDERED, Declaration
from smajax.recording import Floats
from smajax.rig_schema import as_text, one_of, quantity
from smajax.sweep import space
from smajax.sweep.chunks import CHUNK
from smajax.sweep.space import SAMPLINGS, Axis
from smajax.sweep.study import AbstractStudy
from smajax.sweep.table import read_header
from smajax.sweep_subject import NAMES, Subject, again, read_subject
from smajax.toml_file import STRICT, advice, check_schema, parse, quantity_at, read_text, show, validate
from smajax.units import unit_of
from smajax.versions import versions

WAYS = ("max", "min")
SCALES = ("even", "log")
_SECTIONS = ("schema", "sweep", "parameters", "input", "objectives", "constraints", "refine")
_MOST = 100_000_000
# With fewer the indices' intervals say nothing.
_LEAST_BASE = 64
# What some metrics cannot exceed.
_MOST_OF = {"efficiency": 1.0, "settling": 1.0}


class _Sweep(BaseModel):
    model_config = STRICT
    rig: str = Field(examples=['"rig.toml"'])
    sampling: Annotated[str, one_of(SAMPLINGS)] = "sobol"
    designs: int = Field(1024, ge=1, le=_MOST, examples=["1024"])
    seed: int = Field(0, ge=0, le=2**32 - 1, examples=["0"])
    chunk: int = Field(CHUNK, ge=1, le=1_000_000, examples=["1024"])
    metrics: list[str] | None = Field(None, examples=['["stroke", "efficiency"]'])
    gradients: bool = Field(False, examples=["true"])
    sensitivity: bool | None = Field(None, examples=["false"])


class _Range(BaseModel):
    model_config = STRICT
    from_: Any = Field(None, alias="from", examples=['"0.1 mm"'])
    to: Any = Field(None, examples=['"0.4 mm"'])
    scale: Annotated[str, one_of(SCALES)] = "even"
    points: int = Field(5, ge=2, le=100_000, examples=["5"])
    values: list[Any] | None = Field(None, max_length=100_000, examples=['["0.1 mm", "0.2 mm"]'])


class _Limit(BaseModel):
    model_config = STRICT
    at_least: Any = Field(None, examples=['"5 mm"'])
    at_most: Any = Field(None, examples=['"120 degC"'])


class _Refine(BaseModel):
    model_config = STRICT
    starts: int = Field(3, ge=1, le=1000, examples=["3"])


@dataclass(frozen=True, eq=False)
class SweepFile:
    """A sweep as its file has it, in internal units.

    ``constraints`` are lower and upper ends by metric, ``units_of`` those in which the file has them, ``objectives`` are ``max`` or
    ``min``, ``refined`` is from how many of the best designs to go on by gradients, ``sensitivity`` whether Sobol indices are wanted.
    ``text`` is the file's.
    """

    name: str
    text: str
    subject: Subject
    axes: tuple[Axis, ...]
    sampling: str
    count: int
    seed: int
    chunk: int
    metrics: tuple[str, ...]
    gradients: bool
    sensitivity: bool
    objectives: Mapping[str, str]
    constraints: Mapping[str, tuple[float, float]]
    units_of: Mapping[str, str]
    refined: int

    def designs(self) -> Floats:
        """The designs, shape ``(m, axes)``."""
        return space.draw(self.axes, self.sampling, self.count, self.seed)

    def study(self) -> AbstractStudy:
        """What is asked of each design."""
        return self.subject.study(tuple(axis.name for axis in self.axes), self.metrics)

    def base(self) -> int:
        """How many designs Sobol indices start from, a power of two: all of theirs are at most half as many as the sweep's; 0 for none."""
        if not self.sensitivity:
            return 0
        fitting = self.count / _least_designs(len(self.axes)) * _LEAST_BASE
        return 2 ** int(math.log2(fitting)) if fitting >= _LEAST_BASE else 0

    def no_indices(self) -> str:
        """Why there are no Sobol indices, as a sentence; empty if there are, or if none were wanted."""
        if self.sampling == "grid" or any(axis.values for axis in self.axes):
            return "No Sobol indices, which need ranges drawn at random: sampling by sobol or latin-hypercube, and no listed values."
        if self.sensitivity and not self.base():
            return f"No Sobol indices, which need at least {_least_designs(len(self.axes)):,} designs of so many parameters."
        return ""

    def header(self) -> dict[str, Any]:
        """All that the sweep depends on, as a JSON document: see ``from_header``."""
        own = {"rig": self.subject.to_toml(), "rig_name": self.subject.name, "recording": self.subject.recorded()}
        return {"schema": 1, "smajax": __version__, "versions": versions(), "name": self.name, "sweep": self.text, **own}


def _least_designs(axes: int) -> int:
    return 2 * _LEAST_BASE * (axes + 2)


def read_sweep(path: str | Path) -> SweepFile:
    """Read and check a SWEEP.toml, or the table of an earlier sweep, which is then made again. InputError: place and cure."""
    path = Path(path)
    if path.suffix.lower() == ".parquet" and path.is_file():
        return from_header(read_header(path))
    text = read_text(path, "sweep")
    data = parse(text, str(path))
    try:
        subject = read_subject(path.parent / _head(data).rig, data, path.parent)
        return _sweep(data, path.name, text, subject)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def from_header(header: Mapping[str, Any]) -> SweepFile:
    """The sweep of a ``SweepFile.header``, wherever its files are."""
    data = parse(header["sweep"], header["name"])
    subject = again(header["rig"], data, header["rig_name"], header["recording"])
    return _sweep(data, header["name"], header["sweep"], subject)


def _head(data: Mapping[str, Any]) -> _Sweep:
    for key, value in data.items():
        if key not in _SECTIONS:
            what = f"[{key}] is not a section of a sweep" if isinstance(value, dict) else f"{key} is not known"
            raise InputError(f"{what}{advice(key, _SECTIONS, 'the sections are')}")
    check_schema(data)
    if "sweep" not in data:
        raise InputError('the section [sweep] is missing: add [sweep] with a line like rig = "rig.toml"')
    return validate(_Sweep, data["sweep"], "sweep")


def _sweep(data: Mapping[str, Any], name: str, text: str, subject: Subject) -> SweepFile:
    head, units = _head(data), subject.units
    axes = _axes(data, subject.table, head.sampling)
    if head.sampling == "grid" and "designs" in data["sweep"]:
        raise InputError("sweep.designs has no place with a grid, which has as many as its axes' points make: take it out, or give points")
    count = math.prod(len(axis.grid()) for axis in axes) if head.sampling == "grid" else head.designs
    if count > _MOST:
        raise InputError(f"the grid has {count:,} designs: take fewer points, at most {_MOST:,} in all")
    objectives, constraints = _objectives(data, units), _constraints(data, subject, axes)
    asked = subject.usual if head.metrics is None else _known("sweep.metrics", head.metrics, units)
    metrics = tuple(dict.fromkeys([*asked, *objectives, *constraints, *subject.always]))
    subject.check(axes, metrics)
    ranged = head.sampling != "grid" and not any(axis.values for axis in axes)
    if head.sensitivity and not ranged:
        raise InputError("sweep.sensitivity needs ranges drawn at random: set sampling to sobol or latin-hypercube, or take it out")
    if head.sensitivity and count < _least_designs(len(axes)):
        least = f"at least {_least_designs(len(axes)):,} designs with {len(axes)} parameters"
        raise InputError(f"sweep.sensitivity needs {least}, and sweep.designs is {count:,}: raise it, or take sensitivity out")
    if "refine" in data and not objectives:
        raise InputError('[refine] needs to know what is better: add [objectives] with a line like stroke = "max"')
    _check_order(axes, subject)
    return SweepFile(
        name=name, text=text, subject=subject, axes=axes, sampling=head.sampling, count=count, seed=head.seed, chunk=head.chunk,
        metrics=metrics, gradients=head.gradients, sensitivity=ranged if head.sensitivity is None else head.sensitivity,
        objectives=objectives, constraints=constraints, units_of=_units_of(data),
        refined=validate(_Refine, data["refine"], "refine").starts if "refine" in data else 0,
    )  # fmt: skip


def _known(place: str, names: Sequence[str], units: Mapping[str, str]) -> Sequence[str]:
    for name in names:
        if name not in units:
            raise InputError(f"{place}: {show(name)} is not a metric{_no_metric(name, units)}")
    return names


def _no_metric(name: str, units: Mapping[str, str]) -> str:
    """The end of a sentence about a metric that what is swept does not have: why, where others have it, and those that it has."""
    if name in NAMES:
        return f" of this machine, but of rigs with wires: its metrics are {', '.join(units)}"
    return advice(name, units, "the metrics are")


def _axes(data: Mapping[str, Any], table: Mapping[str, Declaration], sampling: str) -> tuple[Axis, ...]:
    content = data.get("parameters")
    if not isinstance(content, dict) or not content:
        raise InputError('the section [parameters] is missing: say what varies, as in wire.diameter = ["0.1 mm", "0.4 mm"]')
    axes: list[Axis] = []
    for name, value in _flat(content):
        if any(axis.name == name for axis in axes):
            raise InputError(f'parameters.{name} is given twice, as {name} and as "{name}": take one of the two out')
        if name not in table:
            raise InputError(f"parameters.{name} is not a parameter of this rig{advice(name, table, 'its parameters are')}")
        try:
            axes.append(_axis(name, value, table[name]))
        except InputError as error:
            raise InputError(f"parameters.{name}: {error}") from None
        if sampling != "grid" and isinstance(value, dict) and "points" in value:
            raise InputError(f'parameters.{name}.points is of a grid only: set sweep.sampling = "grid", or take it out')
    return tuple(axes)


def _flat(content: Mapping[str, Any], above: str = "") -> list[tuple[str, Any]]:
    """Keys with their values, whether written wire.diameter = ... or "wire.diameter" = ..."""
    found = []
    for key, value in content.items():
        name = f"{above}{key}"
        if isinstance(value, dict) and not set(value) & {"from", "to", "values", "scale", "points"}:
            found += _flat(value, f"{name}.")
        else:
            found.append((name, value))
    return found


def _axis(name: str, value: Any, declaration: Declaration) -> Axis:
    if isinstance(value, list):
        if len(value) != 2:
            raise InputError(f'{show(value)} is not a range: write ["low", "high"], or {{ values = [...] }} for a list')
        given = _Range.model_validate({"from": value[0], "to": value[1]})
    elif isinstance(value, dict):
        given = validate(_Range, value, name)
    else:
        raise InputError(f'{show(value)} is not a range: write ["low", "high"], or {{ from = "low", to = "high", scale = "log" }}')
    if given.values is not None:
        if given.from_ is not None or given.to is not None:
            raise InputError("it has both values and a range: take one of the two out")
        if extra := [key for key in ("scale", "points") if isinstance(value, dict) and key in value]:
            raise InputError(f"{extra[0]} has no place beside values: take one of the two out")
        if not given.values:
            raise InputError("its list of values is empty: give at least one")
        values = tuple(quantity(v, declaration) for v in given.values)
        if declaration.whole and (broken := [v for v, number in zip(given.values, values, strict=True) if number != round(number)]):
            raise InputError(f"{show(broken[0])} is not a whole number, and {name} counts something: give whole ones")
        return Axis(name, declaration.unit, min(values), max(values), values=values)
    if given.from_ is None or given.to is None:
        raise InputError(f"'{'from' if given.from_ is None else 'to'}' is missing: a range has both, or give values")
    lower, upper = (quantity(v, declaration) for v in (given.from_, given.to))
    if not lower < upper:
        raise InputError(f"the range from {show(given.from_)} to {show(given.to)} is empty: give a lower end and a higher one")
    if given.scale == "log" and not lower > 0.0:
        raise InputError(f"a log scale cannot begin at {show(given.from_)}: begin above 0")
    if declaration.whole:
        first, last = math.ceil(lower), math.floor(upper)
        if not first < last:
            shown = f"from {show(given.from_)} to {show(given.to)}"
            raise InputError(f"{name} counts something, and {shown} there are no two whole numbers: widen the range, or give values")
        lower, upper = float(first), float(last)
    return Axis(name, declaration.unit, lower, upper, given.scale == "log", given.points, whole=declaration.whole)


def _objectives(data: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    content = data.get("objectives", {})
    if not isinstance(content, dict):
        raise InputError('[objectives] is a section, not a value: write lines like stroke = "max" below it')
    for name, way in content.items():
        if name not in units:
            raise InputError(f"objectives.{name} is not a metric{_no_metric(name, units)}")
        if way not in WAYS:
            raise InputError(f'objectives.{name} = {show(way)} is not known: it is "max" or "min"')
    return dict(content)


def _constraints(data: Mapping[str, Any], subject: Subject, axes: Sequence[Axis]) -> dict[str, tuple[float, float]]:
    units = subject.units
    content = data.get("constraints", {})
    if not isinstance(content, dict):
        raise InputError('[constraints] is a section: write lines like peak_temperature = { at_most = "120 degC" } below it')
    found = {}
    for name, value in content.items():
        if name not in units:
            raise InputError(f"constraints.{name} is not a metric{_no_metric(name, units)}")
        given = validate(_Limit, value, f"constraints.{name}")
        ends = []
        for key, open_end in (("at_least", -math.inf), ("at_most", math.inf)):
            told = getattr(given, key)
            ends.append(open_end if told is None else quantity_at(told, units[name], f"constraints.{name}.{key}"))
        if ends == [-math.inf, math.inf]:
            raise InputError(f'constraints.{name} says nothing: write at_least = "..." or at_most = "..." in it')
        if ends[0] > ends[1]:
            shown = f"at least {show(given.at_least)} and at most {show(given.at_most)}"
            raise InputError(f"constraints.{name}: nothing is {shown}: correct one of the two")
        if ends[1] < 0.0 and units[name] != "degC":
            raise InputError(
                f"constraints.{name}: at_most = {show(given.at_most)} can never be kept, as a {name} is not negative: correct it"
            )
        if ends[1] < (coldest := subject.coldest(name, axes)):
            end, limit = show(given.at_most), f"{coldest:g} {units[name]}"
            raise InputError(f"constraints.{name}: at_most = {end} can never be kept, as it is never below {limit}: correct it")
        if ends[0] > (top := _MOST_OF.get(name, math.inf)):
            raise InputError(
                f"constraints.{name}: at_least = {show(given.at_least)} can never be kept, as it is never above {top:g}: correct it"
            )
        found[name] = (ends[0], ends[1])
    return found


def _units_of(data: Mapping[str, Any]) -> dict[str, str]:
    """The unit in which each constraint is written, of two ends the lower one's."""
    return {name: unit_of(limit.get("at_least", limit.get("at_most"))) for name, limit in data.get("constraints", {}).items()}


def _check_order(axes: Sequence[Axis], subject: Subject) -> None:
    """Refuses axes along which a transformation would lose its band, or a coil its room."""
    table, ends = subject.table, {}
    for axis in axes:
        ends |= dict.fromkeys(parameters.TIES.get(axis.name, (axis.name,)), (axis.lower, axis.upper))
    for low, high in ORDERED:
        if low not in table or high not in table or not {low, high} & ends.keys():
            continue
        below, above = (ends.get(n) or (subject.value(n),) * 2 for n in (low, high))
        if not below[1] < above[0]:
            shown = [as_text(value, table[n].unit) for n, value in ((low, below[1]), (high, above[0]))]
            raise InputError(f"parameters: {low} up to {shown[0]} does not stay below {high} from {shown[1]}: narrow one of the ranges")
