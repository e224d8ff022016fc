"""SWEEP.toml: the rig, the parameters that vary, the input, the objectives and the constraints of a sweep.

    [sweep]
    rig = "rig.toml"
    sampling = "sobol"                # sobol, latin-hypercube, grid
    designs = 1024
    [parameters]                      # each a range, { from, to, scale, points } or { values }
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
    [margins]
    vary = { "environment.ambient" = "3 K" }

Limits of the material hold in addition (``safe_limits``): ``limits`` under [sweep] names their parameter set, ``life``
the number of cycles. A rig starts cold, and the metrics of a cycle are those of the last one. Every table has the
column ``settling``: the gap between start and end of the last cycle over its range. It is 0 for a periodic response,
and a design with at most 1 % has settled. The summary counts the designs that have not; they stay in the table, and the
constraint ``settling = { at_most = "1 %" }`` excludes them from the best designs.

An error message is one sentence that names file and key. A sweep's ``header`` holds everything that the sweep depends
on; ``from_header`` reproduces the sweep.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from smajax import __version__
from smajax.errors import InputError
from smajax.files.material_limits import Catalogue, MaterialLimits
from smajax.files.toml import parse_toml, read_text, validate
from smajax.files.versions import package_versions
from smajax.sweeps.axis_sections import check_order, read_axes, read_catalogues
from smajax.sweeps.goal_sections import check_metrics, constraint_units, read_constraints, read_objectives
from smajax.sweeps.margin_section import read_margins, with_margins
from smajax.sweeps.margins import Margins, margins_from_document
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.safe_limits import NO_LIMITS, SafeLimit, choose_limits, rebuild_limits, safe_limits, with_safe_limits
from smajax.sweeps.schema import MAX_DESIGNS, RefineSection, SweepSection, read_head
from smajax.sweeps.space import Axis, draw_designs
from smajax.sweeps.subject import RigSubject, Subject, read_subject, rebuild_subject
from smajax.sweeps.table import read_header

# Smallest number of rows of A and B for Sobol indices: with fewer the intervals are as wide as the indices.
_MIN_BASE = 64


@dataclass(frozen=True)
class ExternalData:
    """What a sweep takes from files other than those of the rig and the recording.

    Attributes:
        limits: Limits of the material; ``None`` for none.
        catalogues: Catalogues that the axes name, by name.
        margins: Deviations of the margins, without metrics; ``None`` for none.
    """

    limits: MaterialLimits | None = None
    catalogues: Mapping[str, Catalogue] = field(default_factory=dict)
    margins: Margins | None = None

    def to_document(self) -> dict[str, Any]:
        """Return the data as JSON documents by key, for ``rebuild_external``."""
        return {
            "limits": self.limits.to_document() if self.limits else None,
            "catalogues": {n: asdict(catalogue) for n, catalogue in self.catalogues.items()},
            "margins": self.margins.to_document() if self.margins else None,
        }


def _read_external(data: Mapping[str, Any], subject: Subject, folder: Path) -> ExternalData:
    """Read the files that a sweep names."""
    head, catalogues, limits = read_head(data), read_catalogues(data, folder), None
    if isinstance(subject, RigSubject):
        limits = choose_limits(head.limits, subject.rig, folder, tuple(catalogues))
    elif head.limits not in (None, NO_LIMITS):
        raise InputError("sweep.limits has no place with an actuator, whose metrics are its own: take it out")
    return ExternalData(limits, catalogues, read_margins(data, subject, folder))


def _rebuild_external(header: Mapping[str, Any]) -> ExternalData:
    """Return the external data of a header; a header of an earlier version has none."""
    catalogues = {
        n: Catalogue(**{**entry, "diameters": tuple(entry["diameters"])})
        for n, entry in header.get("catalogues", {}).items()
    }
    return ExternalData(rebuild_limits(header.get("limits")), catalogues, margins_from_document(header.get("margins")))


@dataclass(frozen=True, eq=False)
class SweepFile:
    """Description of a sweep, in internal units, as read from its file.

    Attributes:
        name: Name of the file.
        text: Text of the file.
        subject: The rig or actuator.
        axes: Axes of the space.
        sampling: ``grid``, ``latin-hypercube`` or ``sobol``.
        count: Number of designs.
        seed: Seed of the random numbers.
        chunk: Largest number of designs in a chunk.
        metrics: Names of the metrics to evaluate.
        gradients: Whether the table has the metrics' derivatives.
        sensitivity: Whether Sobol indices are estimated.
        objectives: ``max`` or ``min`` by metric.
        constraints: Lower and upper bound by metric, limits of the material included; with margins, of the metrics with
            margin.
        constraint_units: Unit of each constraint in the file, by metric.
        refine_starts: Number of best designs that are refined; 0 for none.
        external: What the sweep takes from other files.
        limits: Limits of the material that hold.
        margins: Margins of the constraints; ``None`` for none.
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
    constraint_units: Mapping[str, str]
    refine_starts: int
    external: ExternalData
    limits: tuple[SafeLimit, ...]
    margins: Margins | None

    def designs(self) -> Float[np.ndarray, "designs axes"]:
        """Return the designs, shape ``(m, axes)``."""
        return draw_designs(self.axes, self.sampling, self.count, self.seed)

    def problem(self) -> AbstractSweepProblem:
        """Return the map from a design to its metrics."""
        return self.subject.problem(tuple(axis.name for axis in self.axes), self.metrics, self.margins)

    def sobol_base(self) -> int:
        """Return the number of rows of A and B for Sobol indices, a power of two; 0 for no indices.

        The indices take at most half as many designs as the sweep itself.
        """
        if not self.sensitivity:
            return 0
        base = self.count / _min_designs(len(self.axes)) * _MIN_BASE
        return 2 ** int(math.log2(base)) if base >= _MIN_BASE else 0

    def missing_indices_note(self) -> str:
        """Return a sentence that says why there are no Sobol indices; empty if there are, or if none are due."""
        if self.sampling == "grid" or any(axis.values for axis in self.axes):
            return (
                "No Sobol indices: they need ranges sampled at random (sampling by sobol or latin-hypercube) and no "
                "listed values."
            )
        if self.sensitivity and not self.sobol_base():
            least = _min_designs(len(self.axes))
            return f"No Sobol indices: they need at least {least:,} designs with {len(self.axes)} parameters."
        return ""

    def header(self) -> dict[str, Any]:
        """Return everything that the sweep depends on, as a JSON document; see ``from_header``."""
        return {
            "schema": 1,
            "smajax": __version__,
            "versions": package_versions(),
            "name": self.name,
            "sweep": self.text,
            "rig": self.subject.to_toml(),
            "rig_name": self.subject.name,
            "recording": self.subject.recording_document(),
            **self.external.to_document(),
        }


def _min_designs(axes: int) -> int:
    return 2 * _MIN_BASE * (axes + 2)


def read_sweep(path: str | Path) -> SweepFile:
    """Read and check a SWEEP.toml, or the table (Parquet) of an earlier sweep, which is then reproduced.

    Args:
        path: The file; relative paths in it start from its folder.

    Raises:
        InputError: If the file, the rig or a recording cannot be read or is not valid.
    """
    path = Path(path)
    if path.suffix.lower() == ".parquet" and path.is_file():
        return from_header(read_header(path))
    text = read_text(path, "sweep")
    data = parse_toml(text, str(path))
    try:
        subject = read_subject(path.parent / read_head(data).rig, data, path.parent)
        external = _read_external(data, subject, path.parent)
        return _read_sweep(data, path.name, text, subject, external)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def from_header(header: Mapping[str, Any]) -> SweepFile:
    """Return the sweep of a ``SweepFile.header``, also of an earlier version; its files need not exist.

    Args:
        header: What ``SweepFile.header`` returned, with ``name``, ``sweep``, ``rig``, ``rig_name`` and ``recording``.

    Raises:
        InputError: If the sweep of the header is not valid in this version.
    """
    data = parse_toml(header["sweep"], header["name"])
    subject = rebuild_subject(header["rig"], data, header["rig_name"], header["recording"])
    return _read_sweep(data, header["name"], header["sweep"], subject, _rebuild_external(header))


def _read_sweep(data: Mapping[str, Any], name: str, text: str, subject: Subject, external: ExternalData) -> SweepFile:
    head = read_head(data)
    axes = read_axes(data, subject.declarations, head.sampling, external.catalogues)
    subject = subject.with_axes(axes)
    count = _count_designs(data, head, axes)
    objectives, constraints = read_objectives(data, subject.units), read_constraints(data, subject, axes)
    limits = safe_limits(external.limits, head.life, subject.units)
    constraints = with_safe_limits(constraints, limits)
    chosen = subject.default_metrics
    if head.metrics is not None:
        chosen = check_metrics("sweep.metrics", head.metrics, subject.units)
    metrics = tuple(dict.fromkeys([*chosen, *objectives, *constraints, *subject.required_metrics]))
    subject.check(axes, metrics)
    margins = None
    if external.margins is not None:
        margins, constraints = with_margins(external.margins, data, constraints)
    sensitivity = _read_sensitivity(head, axes, count)
    if "refine" in data and not objectives:
        raise InputError('[refine] needs an objective: add [objectives] with a line like stroke = "max"')
    check_order(axes, subject)
    return SweepFile(
        name=name,
        text=text,
        subject=subject,
        axes=axes,
        sampling=head.sampling,
        count=count,
        seed=head.seed,
        chunk=head.chunk,
        metrics=metrics,
        gradients=head.gradients,
        sensitivity=sensitivity,
        objectives=objectives,
        constraints=constraints,
        constraint_units=constraint_units(data, constraints),
        refine_starts=validate(RefineSection, data["refine"], "refine").starts if "refine" in data else 0,
        external=external,
        limits=limits,
        margins=margins,
    )


def _count_designs(data: Mapping[str, Any], head: SweepSection, axes: tuple[Axis, ...]) -> int:
    if head.sampling == "grid" and "designs" in data["sweep"]:
        raise InputError(
            "sweep.designs has no place with a grid, whose number of designs follows from the points of its axes: "
            "take it out, or give points"
        )
    count = math.prod(len(axis.grid()) for axis in axes) if head.sampling == "grid" else head.designs
    if count > MAX_DESIGNS:
        raise InputError(f"the grid has {count:,} designs: take fewer points, at most {MAX_DESIGNS:,} in all")
    return count


def _read_sensitivity(head: SweepSection, axes: tuple[Axis, ...], count: int) -> bool:
    """Whether Sobol indices are estimated: by default where designs are drawn at random from ranges."""
    random_ranges = head.sampling != "grid" and not any(axis.values for axis in axes)
    if head.sensitivity and not random_ranges:
        raise InputError(
            "sweep.sensitivity needs ranges drawn at random: set sampling to sobol or latin-hypercube, or take it out"
        )
    if head.sensitivity and count < _min_designs(len(axes)):
        least = f"at least {_min_designs(len(axes)):,} designs with {len(axes)} parameters"
        raise InputError(
            f"sweep.sensitivity needs {least}, and sweep.designs is {count:,}: raise it, or take sensitivity out"
        )
    return random_ranges if head.sensitivity is None else head.sensitivity
