"""Arguments of the public functions: rigs and recordings as objects, as paths, or in memory."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeAlias

import equinox as eqx
import jax
import numpy as np

from smajax.errors import InputError
from smajax.files.rig_file import Rig, parse_rig, read_rig
from smajax.files.warm_start import warm_start_plant
from smajax.plant.plant import Plant
from smajax.recordings.sources import TAKES, as_source_list, is_path, is_recording_source

# A rig, the path of its file, or a dictionary with the sections of a rig file.
RigSource: TypeAlias = Rig | str | Path | Mapping[str, Any]


def as_rig(rig: RigSource, **options: bool) -> Rig:
    """Return a rig; one that is given as a file or a dictionary is read first.

    Args:
        rig: The rig, the path of its file, or a dictionary with the sections of a rig file.
        **options: Options of ``read_rig``; they have no effect on a rig that was read before.

    Raises:
        InputError: If the file is missing or invalid.
    """
    return rig if isinstance(rig, Rig) else read_rig(rig, **options)


def rig_text(rig: Rig) -> str:
    """Return a rig as the text of a file: the text that it was read from, or a new one if it was changed since.

    Args:
        rig: The rig.
    """
    if rig.text is None:
        return rig.to_toml()
    folder = rig.path.parent if rig.path is not None else None
    same = parse_rig(rig.text, rig.name, folder, drop_misplaced=True)
    settings, given = ((r.fit, r.channels, r.interpolation, r.recording) for r in (same, rig))
    return rig.text if settings == given and _are_equal(same.plant, rig.plant) else rig.to_toml()


def _are_equal(first: Plant, second: Plant) -> bool:
    """Whether two plants are equal, compared by NumPy: with JAX each shape would be compiled."""

    def as_numpy(plant: Plant) -> Any:
        return jax.tree.map(lambda leaf: np.asarray(leaf) if eqx.is_array(leaf) else leaf, plant)

    return bool(eqx.tree_equal(as_numpy(first), as_numpy(second)))


def with_start(rig: Rig, start: str | Path | None) -> Rig:
    """Return the rig with the start values of a parameter set.

    Args:
        rig: The rig.
        start: File of the parameter set; ``None`` for the rig's own values.
    """
    if start is None:
        return rig
    if not is_path(start):
        cure = "give the path of a parameter set, such as the fit.toml of an earlier fit"
        raise InputError(f"start is of type {type(start).__name__}: {cure}")
    return dataclasses.replace(rig, plant=warm_start_plant(rig, Path(start)))


def recording_sources(argument: str, sources: Any) -> list[Any]:
    """Return the recordings of an argument as a list.

    Args:
        argument: Name of the argument in messages.
        sources: A recording, or several in a list or tuple.

    Raises:
        InputError: If one is of a type from which no recording can be read.
    """
    listed = as_source_list(sources)
    for source in listed:
        if not is_recording_source(source):
            kind = type(source).__name__
            raise InputError(f"{argument}: a recording cannot be read from an object of type {kind}: {TAKES}")
    return listed


def one_source(sources: Any, argument: str) -> Any:
    """Return the only recording of an argument.

    Args:
        sources: The recording, or a sequence with one.
        argument: Name of the argument in messages.

    Raises:
        InputError: If there are several or none.
    """
    listed = recording_sources(argument, sources)
    if len(listed) != 1:
        raise InputError(f"{argument}: one recording is needed, {len(listed)} were given")
    return listed[0]
