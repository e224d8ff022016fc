"""Arguments of the public functions: rigs and recordings as objects, as paths, or in memory."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx

from smajax.errors import InputError
from smajax.files.rig_file import Rig, parse_rig, read_rig
from smajax.files.warm_start import warm_start_plant


def as_rig(rig: Rig | str | Path, **options: bool) -> Rig:
    """Return a rig, read from its file where a path is given.

    Args:
        rig: The rig, or its file.
        **options: Options of ``read_rig``.

    Raises:
        InputError: If the file is missing or invalid.
    """
    return rig if isinstance(rig, Rig) else read_rig(rig, **options)


def rig_text(rig: Rig) -> str:
    """Return the text of a rig file: that of its own file where the rig is unchanged since it was read.

    Args:
        rig: The rig.
    """
    if rig.text is None:
        return rig.to_toml()
    folder = rig.path.parent if rig.path is not None else None
    same = parse_rig(rig.text, rig.name, folder, drop_misplaced=True)
    unchanged = bool(eqx.tree_equal(same.plant, rig.plant)) and same.fit == rig.fit and same.channels == rig.channels
    return rig.text if unchanged else rig.to_toml()


def with_start(rig: Rig, start: str | Path | None) -> Rig:
    """Return the rig with the start values of a parameter set.

    Args:
        rig: The rig.
        start: File of the parameter set; ``None`` for the rig's own values.
    """
    return rig if start is None else dataclasses.replace(rig, plant=warm_start_plant(rig, Path(start)))


def as_list(sources: Any) -> list[Any]:
    """Return recordings as a list: a list or tuple has several, anything else is one.

    Args:
        sources: A recording or a sequence of them; ``None`` for none.
    """
    if sources is None:
        return []
    listed = sources if isinstance(sources, list | tuple) else [sources]
    return [Path(source) if isinstance(source, str) else source for source in listed]


def one_source(sources: Any, argument: str) -> Any:
    """Return the only recording of an argument.

    Args:
        sources: The recording, or a sequence with one.
        argument: Name of the argument in messages.

    Raises:
        InputError: If there are several or none.
    """
    listed: Sequence[Any] = as_list(sources)
    if len(listed) != 1:
        raise InputError(f"{argument}: one recording is needed, {len(listed)} were given")
    return listed[0]
