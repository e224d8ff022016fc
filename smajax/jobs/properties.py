"""The job of ``smajax properties``: ASTM E3097 temperatures and strains of thermal cycles, and a parameter set to start a fit from."""

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax import __version__, recording
from smajax.cycle_set import Level, guessed, parameter_set
from smajax.errors import InputError
from smajax.parameter_file import write_parameters
from smajax.recording import Recording
from smajax.report.summary import table
from smajax.thermal_cycles import Cycle, Tangent, Value, analyse, mean_of, unpaired, unsteadiness

SCHEMA = "smajax.properties/1"
_NOISY = 0.5  # K of noise from row to row above which temperatures are smoothed
_ROWS = 9
_LEFT_OUT = "-"
_TEXT = (".csv", ".txt")
_NAMED = "--columns, as in --columns 'temperature [degC],strain [%]'"
# Cures that a rig would have, and this command's.
_CURES = (
    (r'set delimiter = " " under \[channels\] in the rig', "give --delimiter space"),
    (r", or, if it is right, give \w+ any_scale = true under \[channels\] in the rig", ""),
    (r'set delimiter = ("[^"]+") and decimal = "," under \[channels\] in the rig', r"give --delimiter \1 --decimal ,"),
    (r'set delimiter = ("[^"]+")( under \[channels\] in the rig)?', r"give --delimiter \1"),
    (r'set decimal = "," under \[channels\] in the rig', "give --decimal ,"),
    (r"set delimiter and decimal under \[channels\]", "give --delimiter and --decimal"),
    (r"begin with a row like '[^']+'", f"name the columns by {_NAMED}"),
    (r"correct it, or leave such rows out with --drop-bad-rows", "correct it, or take its row out"),
    (r"sort the rows by time, or leave such rows out with --drop-bad-rows", "sort the rows by time"),
    (r", or take it out of \[fit\] observe", ""),
)
_CURES_OF_TEXT = (
    (r"rename it, map it under \[channels\].*", f"rename it, or name it by {_NAMED}"),
    (r"or give the unit under \[channels\]", "in the file or by --columns"),
    (r"or map one to \w+ under \[channels\] in the rig", f"or name the columns by {_NAMED}"),
)
_CURES_OF_MAT = (
    (r"rename it, map it under \[channels\].*", "save one vector per channel, named temperature, strain and stress"),
    (r"write the header like '(\w+) \[([^]]+)\]', or give the unit under \[channels\]", r"save a struct beside it with units.\1 = '\2'"),
    (r"so add a column '(\w+) [^']*' or map one to \w+ under \[channels\] in the rig", r"so save a vector \1 beside them"),
    (
        r"give the file headers like 'temperature \[degC\]'",
        "name its variables temperature and strain, with a struct units: units.strain = '%'",
    ),
)
_CURES_OF_OTHERS = (
    (r"rename it, map it under \[channels\].*", "rename it in the file, or take it out"),
    (r", or give the unit under \[channels\]", ""),
    (r" or map one to \w+ under \[channels\] in the rig", ""),
)
_HELD = (0.1, 5e6)  # share of a cycle's stress, and Pa: within the sum of both its rows stand under one stress
_STEADY = 0.9  # of its rows that have to
_SAME = (0.02, 2e6)  # likewise for cycles that stand under the same stress
_LABELS = {
    "martensite_start": "M_s", "martensite_finish": "M_f", "austenite_start": "A_s", "austenite_finish": "A_f",
    "transformation_strain": "transformation strain", "actuation_strain": "actuation strain", "width": "hysteresis width",
    "span": "span A_f - M_f",
}  # fmt: skip
_STRAINS = ("transformation_strain", "actuation_strain")
_DEFINITIONS = {
    "lines": "Start and finish are where three straight lines meet that are laid by least squares. Where a transformation begins or ends "
    "gradually, the tangent at its steepest place gives others (--tangent steepest).",
    "steepest": "Start and finish are where the tangent at the transformation's steepest place meets the plateaus' lines.",
}
_OF_A_CYCLE = re.compile(r"(?P<name>.*), cycle (?P<number>\d+) \((?P<rows>rows \d+ to \d+)\): (?P<why>.*)")
_LISTED = 6  # stretches of cycles' numbers that are listed
_WAYS = {True: "cooling", False: "heating"}
_PARTNERS = {"cooling": "heating after", "heating": "cooling before"}


class PropertiesJob(NamedTuple):
    """What to read; ``smooth`` rows of temperature (``None``: as its noise asks), ``write_set`` a parameter file to write for ``model``.

    ``columns`` are headers of text files without ("temperature [degC]", or "-" for one to leave out), ``delimiter`` separates them, and
    ``decimal`` is their numbers' sign. ``tangent`` says which line is laid along the transformation: see ``thermal_cycles.analyse``.
    """

    paths: Sequence[Path]
    smooth: int | None = None
    write_set: Path | None = None
    model: str = "brinson"
    columns: Sequence[str] | None = None
    delimiter: str = ","
    decimal: str = "."
    tangent: Tangent = "lines"


@dataclasses.dataclass(frozen=True)
class Read:
    """What was read of one recording, or of its cycles at one stress: their ``stress`` in Pa where it was recorded.

    ``alone`` are its branches that are in no cycle: see ``thermal_cycles.unpaired``.
    """

    recording: Recording
    smooth: int
    cycles: list[Cycle]
    refused: list[str]
    stress: float | None
    alone: Sequence[tuple[int, int, bool]] = ()


def run_properties(job: PropertiesJob, progress: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Reads all recordings and gives the document that is printed; ``progress`` is told which cycle is read.

    Raises ``InputError`` if no cycle of any of them can be read, or for a file that is given twice.
    """
    files = [path.resolve() for path in job.paths]
    for k, path in enumerate(job.paths):
        if files[k] in files[:k]:
            raise InputError(f"{path}: this file is given twice, so its cycles would count twice: give each file once")
    read = [one for path in job.paths for one in _read(path, job, progress)]
    refused = [sentence for one in read for sentence in one.refused]
    if not any(one.cycles for one in read):
        raise InputError("; ".join(_once(refused)))
    document = {
        "schema": SCHEMA,
        "tangent": job.tangent,
        "definition": _DEFINITIONS[job.tangent],
        "recordings": [_entry(one) for one in read],
        "refused": refused,
        "smajax": __version__,
    }
    if job.write_set is not None:
        entries = parameter_set([Level(one.recording.name, one.stress, mean_of(one.cycles)) for one in read if one.cycles], job.model)
        names = ", ".join(dict.fromkeys(one.recording.name for one in read if one.cycles))
        write_parameters(job.write_set, entries, {"title": f"read by tangents from {names}", "source": "smajax properties"})
        document["guessed"] = guessed(entries)
    return document


def _read(path: Path, job: PropertiesJob, progress: Callable[[str], None]) -> list[Read]:
    wanted = {"required": ("temperature",), "observed": ("strain",), "clock": False, "ignore": (_LEFT_OUT,)}
    try:
        one = recording.read(path, **wanted, headers=job.columns, delimiter=job.delimiter, decimal=job.decimal)
    except InputError as error:
        raise InputError(_by_options(str(error), path.suffix.lower())) from None
    warm = one.channels["temperature"]
    rows = job.smooth if job.smooth is not None else _ROWS if unsteadiness(warm) > _NOISY else 1
    try:
        found, refused = analyse(one.name, warm, one.channels["strain"], smooth=rows, tangent=job.tangent, progress=progress)
        alone = unpaired(one.name, warm, smooth=rows)
    except InputError as error:
        return [Read(one, rows, [], [str(error)], None)]
    if "stress" not in one.channels:
        return [Read(one, rows, found, refused, None, alone)]
    levels, moving = _by_stress(one, found)
    if not levels:
        return [Read(one, rows, [], refused + moving, None, alone)]
    return [Read(one, rows, cycles, [] if k else refused + moving, stress, () if k else alone) for k, (stress, cycles) in enumerate(levels)]


def _by_stress(one: Recording, found: Sequence[Cycle]) -> tuple[list[tuple[float, list[Cycle]]], list[str]]:
    """Stresses with the cycles at each, in the order of the cycles, and a sentence for each cycle in which the stress moves."""
    levels: list[tuple[float, list[Cycle]]] = []
    moving = []
    for cycle in found:
        stress = one.channels["stress"][cycle.rows[0] : cycle.rows[1] + 1]
        middle = float(np.median(stress))
        if np.mean(_near(stress, middle, _HELD)) < _STEADY:
            told = f"its stress goes from {np.min(stress) / 1e6:.4g} to {np.max(stress) / 1e6:.4g} MPa"
            rows = f"rows {cycle.rows[0] + 1} to {cycle.rows[1] + 1}"
            moving.append(f"{one.name}, cycle {cycle.number} ({rows}): {told}: hold one stress throughout a cycle")
            continue
        known = next((level for level in levels if _near(level[0], middle, _SAME)), None)
        if known is None:
            levels.append((middle, [cycle]))
        else:
            known[1].append(cycle)
    return levels, moving


def _near(stress: np.ndarray | float, level: float, within: tuple[float, float]) -> np.ndarray:
    return np.abs(stress - level) <= within[0] * abs(level) + within[1]


def _by_options(sentence: str, ending: str) -> str:
    """A sentence about a file of this ending whose cure is in a rig, with what this command has in its place."""
    own = _CURES_OF_TEXT if ending in _TEXT else _CURES_OF_MAT if ending == ".mat" else _CURES_OF_OTHERS
    for said, instead in (*_CURES, *own):
        sentence = re.sub(said, instead, sentence)
    return sentence


def _once(refused: Sequence[str]) -> list[str]:
    """Sentences about cycles, those that say the same of a file's cycles, numbers apart, said once."""
    alike: dict[tuple[str, str], list[re.Match[str]]] = {}
    told: dict[tuple[str, str], str] = {}
    for sentence in refused:
        found = _OF_A_CYCLE.fullmatch(sentence)
        key = (found["name"], re.sub(r"\d[\d.e+-]*", "", found["why"])) if found else ("", sentence)
        alike[key] = [*alike.get(key, []), *([found] if found else [])]
        told[key] = sentence
        if len(alike[key]) > 1:
            first, numbers = alike[key][0], _stretches([int(one["number"]) for one in alike[key]])
            told[key] = f"{first['name']}, {len(alike[key])} cycles ({numbers}), the first of them ({first['rows']}): {first['why']}"
    return list(told.values())


def _stretches(numbers: Sequence[int]) -> str:
    """Rising numbers, those that follow each other as "3 to 7"."""
    ends = [k for k in range(len(numbers)) if k + 1 == len(numbers) or numbers[k + 1] > numbers[k] + 1]
    begins = [0, *(k + 1 for k in ends[:-1])]
    told = [f"{numbers[a]}" if a == b else f"{numbers[a]} to {numbers[b]}" for a, b in zip(begins, ends, strict=True)]
    left = len(numbers) - begins[_LISTED] if len(told) > _LISTED else 0
    return ", ".join(told[:_LISTED]) + (f" and {left} more" if left else "")


def _entry(one: Read) -> dict[str, Any]:
    def shown(values: Mapping[str, Value]) -> dict[str, Any]:
        return {
            n: {"value": v.value, "lower95": v.lower95, "upper95": v.upper95, "unit": "1" if n in _STRAINS else _unit(n)}
            for n, v in values.items()
        }

    return {
        "name": one.recording.name,
        "sha256": one.recording.sha256,
        "stress_Pa": one.stress,
        "smoothed_rows": one.smooth,
        "mean": shown(mean_of(one.cycles)) if one.cycles else None,
        "cycles": [
            {
                "number": c.number,
                "rows": [c.rows[0] + 1, c.rows[1] + 1],
                "loops_left_out": [[first + 1, last + 1] for first, last in c.loops],
                "values": shown(c.values),
            }
            for c in one.cycles
        ],
        "in_no_cycle": [{"rows": [first + 1, last + 1], "branch": _WAYS[cools]} for first, last, cools in one.alone],
    }


def _unit(name: str) -> str:
    return "1" if name in _STRAINS else "K" if name in ("width", "span") else "degC"


def text(document: Mapping[str, Any]) -> str:
    """What the command prints: the mean of each recording's cycles with the interval of that mean."""
    lines = []
    for one in document["recordings"]:
        if one["mean"] is None:
            continue
        count, stress = len(one["cycles"]), one["stress_Pa"]
        told = f"{one['name']}: {count} cycle{'s' if count > 1 else ''}"
        told += f" at {stress / 1e6:.4g} MPa" if stress is not None else ""
        told += f", temperatures smoothed over {one['smoothed_rows']} rows" if one["smoothed_rows"] > 1 else ""
        rows = []
        for name, v in one["mean"].items():
            scale, digits, unit = (100.0, 3, "%") if name in _STRAINS else (1.0, 2, _unit(name))
            rows.append((_LABELS[name], *(f"{scale * v[k]:.{digits}f}" for k in ("value", "lower95", "upper95")), unit))
        lines += [told, *table([("property", "mean", "95 % from", "to", "unit"), *rows], right=(1, 2, 3))]
        lines += [
            f"Left out of cycle {c['number']}: rows {first} to {last}, a loop within it."
            for c in one["cycles"]
            for first, last in c["loops_left_out"]
        ]
        lines += [
            f"Left out: rows {a['rows'][0]} to {a['rows'][1]}, a {a['branch']} without a {_PARTNERS[a['branch']]} it in the file."
            for a in one["in_no_cycle"]
        ]
        lines.append("")
    lines += [document["definition"], *(f"Not read: {sentence}." for sentence in _once(document["refused"]))]
    return "\n".join(lines).rstrip()
