"""Job of ``smajax properties``: properties of thermal cycles, and a parameter set to start a fit from."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from smajax.app.commands.properties_hints import hints_of_this_command
from smajax.errors import InputError
from smajax.files.parameter_sets import write_parameters
from smajax.properties.branch_properties import Tangent
from smajax.properties.start_values import StressLevel, assumed_values, make_start_values
from smajax.properties.stress_levels import StressGroup, analyse_recording
from smajax.properties.thermal_cycles import mean_properties
from smajax.recordings.read import read_recording
from smajax.report.properties import merge_sentences, properties_document

# Header of a column that is not read.
_IGNORED_COLUMN = "-"


class PropertiesJob(NamedTuple):
    """Files and options of an analysis of thermal cycles.

    Attributes:
        paths: Recordings with temperature and strain.
        smooth: Rows of the running median of the temperatures; ``None`` to choose them by the noise.
        write_set: Parameter set to write, with start values for ``model``.
        model: Material law of the parameter set.
        columns: Headers of text files without a header row ("temperature [degC]", or "-" for a column to ignore).
        delimiter: Character between the columns.
        decimal: Decimal sign of the numbers.
        tangent: Line along the transformation, see ``analyse_cycles``.
    """

    paths: Sequence[Path]
    smooth: int | None = None
    write_set: Path | None = None
    model: str = "brinson"
    columns: Sequence[str] | None = None
    delimiter: str = ","
    decimal: str = "."
    tangent: Tangent = "lines"


def run_properties(job: PropertiesJob, progress: Callable[[str], None] = lambda text: None) -> dict[str, Any]:
    """Analyse all recordings and return the document that is printed.

    Args:
        job: Files and options.
        progress: Function that is called with the name of each cycle before its analysis.

    Returns:
        The document: properties with intervals of each cycle and of the means.

    Raises:
        InputError: If no cycle of any recording can be analysed, or a file is given twice or cannot be used.
    """
    files = [path.resolve() for path in job.paths]
    for k, path in enumerate(job.paths):
        if files[k] in files[:k]:
            raise InputError(f"{path}: this file is given twice, so its cycles would count twice: give each file once")
    groups = [group for path in job.paths for group in _analyse_file(path, job, progress)]
    if not any(group.cycles for group in groups):
        raise InputError("; ".join(merge_sentences([sentence for group in groups for sentence in group.refused])))
    guessed = None
    if job.write_set is not None:
        guessed = _write_start_values(job.write_set, job.model, [g for g in groups if g.cycles])
    return properties_document(groups, job.tangent, guessed)


def _analyse_file(path: Path, job: PropertiesJob, progress: Callable[[str], None]) -> list[StressGroup]:
    """Read a file and analyse its cycles; the messages of reading errors name the options of this command."""
    try:
        thermal = read_recording(
            path,
            required=("temperature",),
            observed=("strain",),
            clock=False,
            ignore=(_IGNORED_COLUMN,),
            headers=job.columns,
            delimiter=job.delimiter,
            decimal=job.decimal,
        )
    except InputError as error:
        raise InputError(hints_of_this_command(str(error), path.suffix.lower())) from None
    return analyse_recording(thermal, smooth=job.smooth, tangent=job.tangent, progress=progress)


def _write_start_values(path: Path, model: str, groups: Sequence[StressGroup]) -> str:
    """Write the parameter set, and return a sentence on the values that do not come from the cycles."""
    levels = [StressLevel(g.recording.name, g.stress, mean_properties(g.cycles)) for g in groups]
    entries = make_start_values(levels, model)
    names = ", ".join(dict.fromkeys(g.recording.name for g in groups))
    write_parameters(path, entries, {"title": f"read by tangents from {names}", "source": "smajax properties"})
    return assumed_values(entries)
