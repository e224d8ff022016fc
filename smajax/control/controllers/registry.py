"""Controllers by name: those of smajax and own ones.

A registered class is known to controller.toml (``kind = "NAME"``), to the tuning, and to the exports.
"""

from collections.abc import Mapping
from typing import Any

from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.controllers.base import AbstractController, check_controller_class
from smajax.control.controllers.bpid import BPID
from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.controllers.ppid import PPID
from smajax.errors import InputError, suggestion
from smajax.plant.registry import Registry

_SHIPPED: dict[str, type[AbstractController]] = {
    "pid": PID,
    "bpid": BPID,
    "ppid": PPID,
    "adaptive-pid": AdaptivePID,
    "pid-feedforward": FeedforwardPID,
}
# A pid becomes this kind by the section [feedforward] of a controller file, whose operator has to be fitted first.
_NOT_IN_FILES = ("pid-feedforward",)


class ControllerRegistry(Registry[AbstractController]):
    """Registry of the controllers, whose classes have limits and a period."""

    def _class_problem(self, cls: Any) -> str:
        try:
            check_controller_class(cls)
        except InputError as error:
            return str(error)
        return ""


CONTROLLERS = ControllerRegistry("controller", AbstractController, lambda: _SHIPPED)


def register_controller(name: Any, cls: Any) -> None:
    """Make an own controller known under a name.

    Args:
        name: Name in controller.toml and in documents, such as ``dead-band-pi``.
        cls: The class, derived from ``AbstractController``. A class of the same module and name replaces the one that
            it was defined as before, as when a notebook's cell runs again.

    Raises:
        InputError: if the name has other characters than a-z, 0-9 and single hyphens, or is that of another class; or
            if the class is not a complete controller.
    """
    CONTROLLERS.register(name, cls)


def controller_class(name: str) -> type[AbstractController]:
    """Return the class of a registered controller.

    Args:
        name: Its name.

    Raises:
        InputError: if there is no controller of that name.
    """
    if name not in CONTROLLERS:
        hint = suggestion(name, CONTROLLERS)
        raise InputError(f"there is no controller '{name}'{hint}: register it, or use {', '.join(CONTROLLERS)}")
    return CONTROLLERS[name]


def file_kinds() -> Mapping[str, type[AbstractController]]:
    """Return the classes that a controller file may name, by name."""
    return {name: cls for name, cls in CONTROLLERS.items() if name not in _NOT_IN_FILES}


def kind_of(controller: AbstractController) -> str:
    """Return the registered name of a controller's class, or the name of the class.

    Args:
        controller: The controller.
    """
    names = (name for name, cls in CONTROLLERS.loaded.items() if cls is type(controller))
    return next(names, type(controller).__name__)
