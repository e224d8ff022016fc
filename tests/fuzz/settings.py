"""One try on a TOML file: rigs of all kinds, controllers, sweeps, actuators, parameter sets."""

import dataclasses
import functools
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from random import Random
from typing import Any

from smajax.actuators.registry import ACTUATORS
from smajax.control.controller_file.read import read_controller
from smajax.errors import InputError
from smajax.files.actuator_file import read_actuator
from smajax.files.parameter_sets import read_parameters, shipped_sets
from smajax.files.rig_file import read_rig
from smajax.files.templates import write_actuator_example, write_example
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.recordings.datasets import data_path
from smajax.sweeps.sweep_file import read_sweep
from tests.fuzz.attempts import check_sentence, limited
from tests.fuzz.mutations import mutate_text

# Sections that the templates do not have, added to a rig in some tries.
_SECTIONS = b"""
[channels]
current = { column = "I", unit = "mA", scale = 2, offset = "1 mA", lower = 0, upper = 5 }
ignore = ["note"]
[recording]
skip_rows = 3
units_row = true
delimiter = ";"
decimal = ","
columns = ["time [s]", "current [A]"]
sample_period = "20 ms"
sheet = ["a"]
on_bad_rows = "drop"
[effects.backlash]
strength = "0.1 mm"
[effects.time-skew]
strength = "1 ms"
[wire]
cells = 3
[material]
grains = 2
"""


@dataclasses.dataclass(frozen=True)
class Setting:
    """A kind of TOML file.

    Attributes:
        files: Valid files.
        read: Function that reads one.
    """

    files: tuple[bytes, ...]
    read: Callable[[Path], Any]


@functools.cache
def example() -> Path:
    """Return a folder with an example rig, its recordings, a controller and a sweep."""
    folder = Path(tempfile.mkdtemp(prefix="smajax-fuzz-"))
    write_example("dead-weight", folder)
    return folder


@functools.cache
def settings() -> Mapping[str, Setting]:
    """Return all kinds of TOML files with valid ones."""
    folder = example()
    rigs = []
    for kind in MECHANISMS:
        with tempfile.TemporaryDirectory() as place:
            rigs += [path.read_bytes() for path in write_example(kind, Path(place))[:2]]
    actuators, sweeps = [], [(folder / "sweep.toml").read_bytes()]
    for kind in ACTUATORS:
        with tempfile.TemporaryDirectory() as place:
            rig, _ = write_actuator_example(kind, Path(place))
            actuators.append(rig.read_bytes())
    rig = read_rig(folder / "example.toml")
    sets = tuple(data_path("parameters", f"{name}.toml").read_bytes() for name in shipped_sets())
    return {
        "rig": Setting((*rigs, rigs[0] + _SECTIONS), read_rig),
        "controller": Setting(((folder / "controller.toml").read_bytes(),), lambda path: read_controller(path, rig)),
        "sweep": Setting(tuple(sweeps), read_sweep),
        "actuator": Setting(tuple(actuators), read_actuator),
        "parameters": Setting(sets, read_parameters),
    }


KINDS = ("rig", "controller", "sweep", "actuator", "parameters")


def mutated_setting(kind: str, seed: int) -> bytes:
    """Return the text of a try.

    Args:
        kind: Kind of file, one of ``KINDS``.
        seed: Number of the try.
    """
    random = Random(f"{kind} {seed}")
    return mutate_text(random.choice(settings()[kind].files), random)


def try_settings(kind: str, seed: int, folder: Path) -> str:
    """Read a mutated file next to the example; return what came of it.

    Args:
        kind: Kind of file, one of ``KINDS``.
        seed: Number of the try.
        folder: Not used: sweeps name files of the example.
    """
    del folder
    path = example() / f"{kind}-mutated.toml"
    path.write_bytes(mutated_setting(kind, seed))
    with limited():
        try:
            settings()[kind].read(path)
        except InputError as error:
            check_sentence(str(error))
            return "refused"
    return "read"
