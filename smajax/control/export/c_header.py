"""A tuned controller as a C header for a microcontroller.

The header contains one controller: its gains as constants, its state as a structure, and two functions,
``smajax_reset`` and ``smajax_step``, which are equivalent to ``reset`` and ``step`` in Python, operation by operation.
It uses no heap, and no library except the ``atanh`` of a feedforward and the ``pow`` of a nonlinear observer;
``smajax_step`` is called once a period. A measurement that is NaN is replaced by the last finite one for
``DROPOUT_TIMEOUT``; then the command is 0, and with the next finite value the controller is reset.

- For two wires, ``smajax_allocate`` gives each wire its command.
- With a temperature limiter, ``smajax_guard`` limits a wire's command according to its temperature, to 0 if the
  temperature has been NaN for ``DROPOUT_TIMEOUT``; ``smajax_step_guarded``, which takes these limits, replaces
  ``smajax_step``.
- With a thermal observer, ``smajax_observe`` estimates the temperature from the wire's power.
"""

from typing import NamedTuple

from smajax.control.controllers.adaptive_pid import AdaptivePID
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.bpid import BPID
from smajax.control.controllers.feedforward_pid import FeedforwardPID
from smajax.control.controllers.pid import PID
from smajax.control.controllers.ppid import PPID
from smajax.control.export import c_templates
from smajax.control.export.json_document import (
    estimator_document,
    feedforward_inverse,
    fixed_constants,
    inverse_document,
    limiter_document,
)
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gain, gains
from smajax.control.sensors.dropout_hold import DROPOUT_TIMEOUT
from smajax.errors import InputError
from smajax.laws.prandtl_ishlinskii import EDGE
from smajax.laws.prandtl_ishlinskii_inverse import InversePrandtlIshlinskii


class _Controller(NamedTuple):
    """C texts of a controller.

    Attributes:
        kind: Name of the kind.
        step: Body of the step function.
        constants: Constants in addition to the gains, by name.
        state: Members of the state in addition to those of a PID.
        reset: Statements that reset these members.
    """

    kind: str
    step: str
    constants: dict[str, float]
    state: str = ""
    reset: str = ""


class _Limiter(NamedTuple):
    """C texts of temperature limiter and thermal observer: functions, instructions for use, and included headers."""

    functions: str
    use: str
    include: str


def c_header(owner: AbstractController | ClosedLoop, units: tuple[str, str], version: str) -> str:
    """Return the C header of a controller, or of a loop's controller, allocation, limiter and observer.

    Args:
        owner: The controller, or the loop.
        units: Units of command and channel.
        version: Version of smajax.

    Raises:
        InputError: for a kind of controller that has no C text, or an estimator other than a thermal observer.
    """
    controller = owner.controller if isinstance(owner, ClosedLoop) else owner
    inverse = feedforward_inverse(controller)
    limiter = _limiter(owner) if isinstance(owner, ClosedLoop) else _Limiter("", "", "")
    texts, pid = _controller(controller, inverse), controller.inner
    values = {name: float(gain(owner, name)) for name in gains(owner)} | texts.constants
    functions, include, state, reset, plays = "", "", texts.state, texts.reset, []
    if inverse is not None:
        numbers = inverse_document(inverse)
        values |= numbers["envelope"] | {"direct": numbers["direct"], "edge": EDGE}
        lists = {k: ", ".join(f"(smajax_real){v!r}" for v in numbers[k]) for k in ("thresholds", "densities")}
        functions = c_templates.INVERSE.format(**lists)
        include = c_templates.MATH.format(name="ATANH", function="atanh")
        state += "\n    smajax_real plays[SMAJAX_PLAYS];"
        reset += c_templates.RESET_PLAYS
        plays = [f"#define SMAJAX_PLAYS {len(inverse.thresholds)}"]
    constants = [f"#define SMAJAX_{name.upper()} ((smajax_real){value!r})" for name, value in values.items()]
    error = "return reference - value;"
    return c_templates.HEADER.format(
        kind=texts.kind,
        version=version,
        command_unit=units[0],
        channel_unit=units[1],
        period=pid.period,
        lower=float(pid.lower),
        upper=float(pid.upper),
        blind=DROPOUT_TIMEOUT,
        constants="\n".join(constants + plays),
        seen=error if pid.derivative_on == "error" else "(void)reference; return -value;",
        step=texts.step,
        pair=_pair(owner),
        guard=limiter.functions,
        use=limiter.use or (c_templates.PAIR_USE if _has_two_wires(owner) else c_templates.USE),
        more=state,
        reset=reset,
        functions=functions,
        include=include + limiter.include,
    )


def _has_two_wires(owner: AbstractController | ClosedLoop) -> bool:
    return isinstance(owner, ClosedLoop) and owner.allocation.wires > 1


def _controller(controller: AbstractController, inverse: InversePrandtlIshlinskii | None) -> _Controller:
    """The texts of a controller by its kind."""
    if isinstance(controller, PID):
        return _Controller("PID", c_templates.STEP_PID, {})
    if isinstance(controller, BPID):
        return _Controller("BPID", c_templates.STEP_BPID, fixed_constants(controller))
    if isinstance(controller, FeedforwardPID):
        return _Controller("PID with feedforward", c_templates.STEP_FEEDFORWARD, {})
    if isinstance(controller, PPID):
        ahead = "0" if inverse is None else "smajax_ahead(s, reference, lower, upper)"
        size = "(reference - value < 0 ? value - reference : reference - value)"
        return _Controller(
            "PPID" + " with feedforward" * (inverse is not None),
            c_templates.STEP_PPID.format(ahead=ahead),
            fixed_constants(controller),
            "\n    int rested;",
            f"\n    s->rested = {size} <= SMAJAX_BAND;",
        )
    if isinstance(controller, AdaptivePID):
        return _adaptive_pid(controller)
    raise InputError(f"a {type(controller).__name__} cannot be written in C yet: PID, BPID, PPID and adaptive PID can")


def _adaptive_pid(controller: AdaptivePID) -> _Controller:
    p, i, d = ("1", "s->ki", "s->kd") if controller.law == "printed" else ("error", "error", "error")
    start_gains = "".join(f"\n    s->{name} = SMAJAX_{name.upper()};" for name in ("kp", "ki", "kd"))
    return _Controller(
        f"adaptive PID ({controller.law} law)",
        c_templates.STEP_ADAPTIVE.format(p=p, i=i, d=d),
        {"growth": controller.growth},
        "\n    smajax_real summed, kp, ki, kd;",
        "\n    s->summed = 0;" + start_gains,
    )


def _pair(owner: AbstractController | ClosedLoop) -> str:
    """The text of the allocation to two wires; empty for one wire."""
    if not isinstance(owner, ClosedLoop) or not _has_two_wires(owner):
        return ""
    first, second = (float(command) for command in owner.allocation.max_commands)
    return c_templates.PAIR.format(first=first, second=second)


def _limiter(loop: ClosedLoop) -> _Limiter:
    """The texts of a loop's temperature limiter and thermal observer; empty without a limiter."""
    observer = estimator_document(loop.estimator) if loop.estimator is not None else None
    if loop.temperature_limiter is None:
        return _Limiter("", "", "")
    two = _has_two_wires(loop)
    functions = c_templates.LIMITER.format(**limiter_document(loop.temperature_limiter))
    functions += c_templates.LIMITED_PAIR if two else c_templates.LIMITED
    use = c_templates.LIMITED_PAIR_USE if two else c_templates.LIMITER_USE
    if observer is None:
        return _Limiter(functions, use, "")
    linear = observer["exponent"] == 1.0
    loss = "excess" if linear else c_templates.SIGNED_POWER.format(**observer)
    include = "" if linear else c_templates.MATH.format(name="POW", function="pow")
    return _Limiter(
        functions + c_templates.OBSERVER.format(**observer, lost=loss), use + c_templates.OBSERVER_USE, include
    )
