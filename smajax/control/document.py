"""A controller as a JSON document, for programs of other kinds: its numbers, and those of its feedforward, guard and observer."""

from typing import Any

from smajax.control.adaptive import AdaptivePID
from smajax.control.bpid import BPID, LEAST
from smajax.control.controller import AbstractController
from smajax.control.feedforward import FeedforwardPID
from smajax.control.gains import gain, gains
from smajax.control.guard import TemperatureGuard
from smajax.control.last_known import BLIND
from smajax.control.observers import AbstractThermometer, ThermalObserver
from smajax.control.pid import PID
from smajax.control.ppid import PPID
from smajax.control.rollout import Loop
from smajax.errors import InputError
from smajax.hysteresis.prandtl_ishlinskii import InversePrandtlIshlinskii

_KINDS = {PID: "pid", BPID: "bpid", PPID: "ppid", AdaptivePID: "adaptive-pid", FeedforwardPID: "pid-feedforward"}


def inverse_of(controller: AbstractController) -> InversePrandtlIshlinskii | None:
    """The inverse operator of a controller's feedforward, if it has one. Raises ``InputError`` for an operator of another kind."""
    inverse = getattr(controller, "inverse", None)
    if inverse is not None and not isinstance(inverse, InversePrandtlIshlinskii):
        raise InputError("only the inverse of a Prandtl-Ishlinskii operator with one envelope can be written as a feedforward")
    return inverse


def fixed(controller: AbstractController) -> dict[str, Any]:
    """What a kind of controller has beside its gains, in C header and JSON."""
    if isinstance(controller, BPID):
        return {"least": LEAST}
    if isinstance(controller, PPID):
        return {"leave": controller.leave}
    if isinstance(controller, AdaptivePID):
        return {"law": controller.law, "growth": controller.growth}
    return {}


def as_document(owner: AbstractController | Loop, units: dict[str, str]) -> dict[str, Any]:
    """The controller (or a loop's) as a JSON document: kind, period, limits, gains with their units, and what it has of a feedforward.

    ``law`` and ``growth`` are those of an adaptive PID; ``leave`` is how many bands away a PPID that rests leaves its rest; ``least`` is
    the least 1 + kb y of a BPID; ``blind_s`` is how long the channel, or a temperature, may be no number before the command is 0.
    Of two wires ``wires`` is the largest command of each, and ``guard`` what keeps a wire below a temperature, if something does, by
    ``observer``, if it is by one; the controller, too, goes by one that ``steers``.
    """
    controller = owner.controller if isinstance(owner, Loop) else owner
    pid, inverse = controller.inner, inverse_of(controller)
    document = {
        "schema": "smajax.controller/1",
        "kind": _KINDS[type(controller)],
        "period_s": pid.period,
        "output": [float(pid.lower), float(pid.upper)],
        "blind_s": BLIND,
        "derivative_on": pid.derivative_on,
        "gains": {name: {"value": float(gain(owner, name)), "unit": units[name]} for name in gains(owner)},
        **fixed(controller),
    }
    if inverse is not None:
        document["feedforward"] = inverse_document(inverse)
    if isinstance(owner, Loop) and owner.allocation.wires > 1:
        document["wires"] = [float(most) for most in owner.allocation.most]
    if isinstance(owner, Loop) and owner.guard is not None:
        document["guard"] = guard_document(owner.guard)
    if isinstance(owner, Loop) and owner.observer is not None:
        thermal = isinstance(owner.observer, ThermalObserver)
        document["observer"] = observer_document(owner.observer) if thermal else {"kind": type(owner.observer).__name__}
        document["observer"] |= {"steers": True} if owner.believes else {}
    return document


def guard_document(guard: TemperatureGuard) -> dict[str, float]:
    """A guard's numbers: the temperature that it keeps (degC), its gains, and the largest command."""
    return {"limit": float(guard.limit), "kp": float(guard.pid.kp), "ki": float(guard.pid.ki), "upper": float(guard.pid.upper)}


def observer_document(observer: AbstractThermometer) -> dict[str, float]:
    """An observer's numbers in SI, with the surroundings' temperature in degC. Raises ``InputError`` for one that is not thermal."""
    if not isinstance(observer, ThermalObserver):
        raise InputError(f"an {type(observer).__name__} cannot leave for another program yet: a ThermalObserver can")
    return {n: float(getattr(observer, n)) for n in ("a1", "a2", "exponent", "ambient", "gain")}


def inverse_document(inverse: InversePrandtlIshlinskii) -> dict[str, Any]:
    """The numbers of an inverse operator, from the channel's internal unit to the command's: see ``smajax.hysteresis``.

    ``direct`` and ``densities`` are plain numbers, ``thresholds`` in the channel's unit; so are the envelope's height and middle, its
    steepness is per unit of the command.
    """
    envelope = inverse.envelope
    return {
        "kind": "inverse-prandtl-ishlinskii",
        "direct": float(inverse.direct),
        "thresholds": [float(v) for v in inverse.thresholds],
        "densities": [float(v) for v in inverse.densities],
        "envelope": {
            "height": float(envelope.height),
            "steepness": float(envelope.slope),
            "shift": float(envelope.shift),
            "middle": float(envelope.middle),
        },
    }
