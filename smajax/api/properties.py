"""Properties of thermal cycles by ASTM E3097, and start values of a fit."""

import dataclasses
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, get_args

from smajax.api.run_record import Clock, run_record
from smajax.api.study import FileContent, Study, interval_of
from smajax.arguments import whole_number
from smajax.errors import InputError, suggestion
from smajax.files.parameter_sets import parameters_text
from smajax.progress import ProgressCallback, Reporter
from smajax.properties.branch_properties import Tangent
from smajax.properties.recording_analysis import CycleAnalysis, analyse_recordings
from smajax.properties.start_values import assumed_values
from smajax.recordings.read import read_recordings
from smajax.recordings.recording import Recording
from smajax.recordings.sources import as_source_list, is_path
from smajax.report.prediction import recording_series
from smajax.report.properties import properties_document
from smajax.units import as_text

# Header of a column that is not read.
IGNORED_COLUMN = "-"
START_VALUES = "start-values.toml"


class Property(NamedTuple):
    """Mean of a property over thermal cycles.

    Attributes:
        value: Mean, in ``unit``.
        interval: Lower and upper end of the 95 % interval; ``None`` where the cycles do not determine it.
        unit: Unit.
    """

    value: float
    interval: tuple[float, float] | None
    unit: str


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PropertiesStudy(Study):
    """Properties of thermal cycles; ``study["austenite_finish"]`` is the mean of one at a single stress.

    Attributes:
        analysis: Cycles and means as numbers; ``None`` for a loaded study.
    """

    command = "properties"
    document_name = "properties.json"

    analysis: CycleAnalysis | None = None

    @property
    def means(self) -> tuple[tuple[float | None, dict[str, Property]], ...]:
        """Stress in Pa (``None`` where it was not recorded) and mean properties of each group of cycles."""
        return tuple(
            (entry["stress_Pa"], {name: _property(value) for name, value in entry["mean"].items()})
            for entry in self.document["recordings"]
            if entry["mean"] is not None
        )

    def __getitem__(self, name: str) -> Property:
        """Return the mean of a property.

        Args:
            name: Name of the property, such as ``austenite_finish``.

        Raises:
            InputError: If the name is unknown, or there are cycles at several stresses, or of several recordings.
        """
        groups = list(self.means)
        if len(groups) > 1:
            found = ", ".join(
                "no stress" if stress is None else as_text(float(f"{stress:.4g}"), "Pa") for stress, _ in groups
            )
            raise InputError(
                f"there are cycles of {len(groups)} stresses or recordings ({found}), each with its own '{name}': take "
                f"one of .means, as in study.means[0][1]['{name}'], or give a recording under one stress"
            )
        properties = groups[0][1]
        if name not in properties:
            raise InputError(f"'{name}' is not a property of thermal cycles: they are {', '.join(properties)}")
        return properties[name]


def thermal_cycle_properties(
    recordings: Any,
    *,
    smooth: int | None = None,
    tangent: Tangent = "lines",
    model: str | None = None,
    progress: ProgressCallback | None = None,
    **reading: Any,
) -> PropertiesStudy:
    """Estimate the ASTM E3097 temperatures and strains of thermal cycles by tangents, with intervals.

    Args:
        recordings: Recordings with temperature and strain: one or a list, each a path, a table in memory, or a
            ``Recording``.
        smooth: Rows of the running median of the temperatures, an odd number; by default as their noise requires.
        tangent: Line along the transformation: one of three fitted ``lines``, or the tangent where it is ``steepest``.
        model: Material law whose start values are saved as start-values.toml; ``None`` for none.
        progress: Function that gets a ``ProgressEvent`` for each cycle.
        **reading: Options of ``ReadOptions``, such as ``columns`` ("temperature [degC]", or "-" for a column to
            ignore), ``delimiter``, ``skip_rows`` or ``sheet="all"``.

    Raises:
        InputError: If no cycle of any recording can be analysed, or a recording is given twice or cannot be used.
        Cancelled: If the callback stopped the analysis.
    """
    clock, reporter = Clock(), Reporter(progress)
    if tangent not in get_args(Tangent):
        raise InputError(
            f"tangent = '{tangent}' is not known{suggestion(tangent, get_args(Tangent))}: it is 'lines' or 'steepest'"
        )
    if smooth is not None:
        smooth = whole_number("thermal_cycle_properties", "smooth", smooth, 1, sys.maxsize)
    reporter.phase("reading")
    with clock.time("read"):
        read = _read(as_source_list(recordings), reading)
    with clock.time("analyse"):
        analysis = analyse_recordings(read, smooth=smooth, tangent=tangent, progress=reporter.phase)
    reporter.finish("writing the report")
    files: dict[str, FileContent] = {}
    guessed = None
    if model is not None:
        entries = analysis.start_values(model)
        names = ", ".join(dict.fromkeys(level.recording for level in analysis.levels))
        header = {"title": f"read by tangents from {names}", "source": "smajax properties"}
        files[START_VALUES] = parameters_text(entries, header).encode()
        guessed = assumed_values(entries)
    return PropertiesStudy(
        document=properties_document(analysis, guessed),
        series=tuple(recording_series(recording, "cycles", {}) for recording in read),
        run=run_record("properties", "", clock, None, 0),
        files=files,
        analysis=analysis,
    )


def _read(sources: Sequence[Any], options: Mapping[str, Any]) -> list[Recording]:
    """Read the recordings; refuse a file that is given twice. An error has the file as its field ``path``."""
    paths = [Path(source).resolve() if is_path(source) else None for source in sources]
    for k, path in enumerate(paths):
        if path is not None and path in paths[:k]:
            raise InputError(
                f"{sources[k]}: this file is given twice, so its cycles would count twice: give each file once"
            )
    channels = {"required": ("temperature",), "observed": ("strain",)}
    read: list[Recording] = []
    for source, path in zip(sources, paths, strict=True):
        try:
            read += read_recordings(source, **channels, clock=False, ignore=(IGNORED_COLUMN,), **options)
        except InputError as error:
            error.fields["path"] = path
            raise
    return read


def _property(entry: Mapping[str, Any]) -> Property:
    """The property of an entry of properties.json."""
    return Property(entry["value"], interval_of(entry), entry["unit"])
