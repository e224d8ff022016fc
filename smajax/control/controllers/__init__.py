"""Controllers of one channel, sampled once a period.

``AbstractController`` is their interface. ``PID`` has the parallel form, a filtered derivative, saturation, and
anti-windup by conditional integration; around it are built ``BPID``, which adds a bilinear compensator, ``PPID``, which
switches between PD and feedforward plus PI, ``AdaptivePID``, which adapts the gains, and ``FeedforwardPID``, which adds
an inverse hysteresis operator. ``register_controller`` makes an own class known by name.
"""

from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.bpid import BPID
from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.controllers.ppid import PPID
from smajax.control.controllers.registry import controller_class, register_controller

__all__ = [
    "BPID",
    "PID",
    "PPID",
    "AbstractController",
    "AdaptivePID",
    "FeedforwardPID",
    "controller_class",
    "register_controller",
]
