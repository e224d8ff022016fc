"""Controllers of one channel, sampled once a period.

All are built around a ``PID`` (parallel form, filtered derivative, saturation, anti-windup by conditional
integration): ``BPID`` adds a bilinear compensator, ``PPID`` switches between PD and feedforward plus PI,
``AdaptivePID`` adapts the gains, ``FeedforwardPID`` adds an inverse hysteresis operator.
"""

from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.bpid import BPID
from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.controllers.ppid import PPID

__all__ = ["BPID", "PID", "PPID", "AbstractController", "AdaptivePID", "FeedforwardPID"]
