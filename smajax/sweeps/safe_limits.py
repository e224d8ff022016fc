"""Safe limits of the material as constraints of a sweep, and the choice of their parameter set."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from smajax.errors import InputError
from smajax.files.material_limits import LIMIT_UNITS, Limit, MaterialLimits, limits_from_document, read_limits
from smajax.files.parameter_sets import find_set
from smajax.files.rig_file import Rig
from smajax.units import as_text

# Value of ``sweep.limits`` that turns the limits off.
NO_LIMITS = "none"
# Set whose limits hold where neither the sweep nor the set of the rig has any: actuator wires of nickel-titanium.
DEFAULT_SET = "flexinol"
# Metric that each limit bounds.
METRIC_OF_LIMIT = {"stress": "peak_stress", "temperature": "peak_temperature", "strain": "strain_range"}


class SafeLimit(NamedTuple):
    """Limit of the material that holds for all designs.

    Attributes:
        metric: Name of the metric that it bounds from above.
        value: The bound in the metric's internal unit.
        source: Where it comes from.
        cycles: Number of cycles that a wire bears at this stress; ``None`` for other quantities.
        parameter_set: Name of the parameter set.
    """

    metric: str
    value: float
    source: str
    cycles: float | None
    parameter_set: str

    def in_words(self) -> str:
        """Return the limit with its value."""
        unit = next(LIMIT_UNITS[name] for name, metric in METRIC_OF_LIMIT.items() if metric == self.metric)
        shown = as_text(self.value, unit) if unit != "1" else f"{100.0 * self.value:g} %"
        return f"{self.metric} at most {shown}" + (f" for {self.cycles:,.0f} cycles" if self.cycles else "")


def choose_limits(name: str | None, rig: Rig, folder: Path, catalogues: Sequence[str] = ()) -> MaterialLimits | None:
    """Return the limits of the material of a rig.

    Args:
        name: ``sweep.limits``: the name or path of a parameter set, ``none``, or ``None`` for the default: the set that
            the rig names or that of a catalogue, the first that has limits, else ``DEFAULT_SET``.
        rig: The rig.
        folder: Folder from which a path starts.
        catalogues: Names of the parameter sets whose catalogues the axes name.

    Returns:
        The limits; ``None`` if they are turned off.

    Raises:
        InputError: If the set is not known, or has no limits.
    """
    if name == NO_LIMITS:
        return None
    if name is not None:
        limits = read_limits(find_set(name, folder, "sweep.limits = "), name)
        if limits is None:
            raise InputError(
                f'sweep.limits = "{name}" has no section [limits]: add one to that set, name another set such as '
                f'"{DEFAULT_SET}", or write limits = "{NO_LIMITS}"'
            )
        return limits
    named = [rig.parameter_set] if rig.parameter_set is not None else []
    for own, path in [*named, *((catalogue, find_set(catalogue, folder)) for catalogue in catalogues)]:
        if limits := read_limits(path, own):
            return limits
    return read_limits(find_set(DEFAULT_SET), DEFAULT_SET)


def rebuild_limits(document: Mapping[str, Any] | None) -> MaterialLimits | None:
    """Return the limits of a sweep's header; ``None`` for one without limits, such as that of an earlier version."""
    return limits_from_document(document) if document is not None else None


def safe_limits(limits: MaterialLimits | None, life: float, metrics: Mapping[str, str]) -> tuple[SafeLimit, ...]:
    """Return the limits that hold for the metrics of a rig.

    Args:
        limits: The limits of the material; ``None`` for none.
        life: Number of cycles that a wire is to last.
        metrics: Internal units of the rig's metrics by name.

    Raises:
        InputError: If the limits have no stress for so many cycles.
    """
    if limits is None:
        return ()
    try:
        chosen: Mapping[str, Limit] = limits.for_life(life)
    except InputError as error:
        raise InputError(f'sweep.life: {error}, or write limits = "{NO_LIMITS}"') from None
    return tuple(
        SafeLimit(METRIC_OF_LIMIT[n], limit.value, limit.source, limit.cycles, limits.name)
        for n, limit in chosen.items()
        if METRIC_OF_LIMIT[n] in metrics
    )


def with_safe_limits(
    constraints: Mapping[str, tuple[float, float]], limits: tuple[SafeLimit, ...]
) -> dict[str, tuple[float, float]]:
    """Return constraints together with limits of the material; of two upper bounds the lower one holds.

    Args:
        constraints: Lower and upper bound by metric.
        limits: The limits.

    Raises:
        InputError: If a constraint asks for more than a limit allows.
    """
    both = dict(constraints)
    for limit in limits:
        low, high = constraints.get(limit.metric, (-np.inf, np.inf))
        if low > limit.value:
            raise InputError(
                f"constraints.{limit.metric}: its lower bound is above the limit of the material, {limit.in_words()} "
                f'(parameter set {limit.parameter_set}): lower it, or write limits = "{NO_LIMITS}" under [sweep]'
            )
        both[limit.metric] = (low, min(high, limit.value))
    return both
