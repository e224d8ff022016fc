"""A controller as a JSON document, with its feedforward, temperature limiter and thermal observer."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.controllers.base import AbstractController, require_controller
from smajax.control.controllers.registry import kind_of
from smajax.control.estimators.base import AbstractTemperatureEstimator
from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.export.named_leaves import leaf_names
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gain, gains
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sensors.dropout_hold import DROPOUT_TIMEOUT
from smajax.errors import InputError
from smajax.laws.prandtl_ishlinskii_inverse import InversePrandtlIshlinskii

# With schema 2 the kinds of Kalman filters changed: ExtendedKalmanFilter was ExtendedFilter. The keys are those of
# schema 1.
SCHEMA = "smajax.controller/2"
# Constants that are keys of the document itself; those of own controllers are below ``constants``.
_TOP_LEVEL_CONSTANTS = ("derivative_on", "law", "growth", "leave", "least")


def feedforward_inverse(controller: AbstractController) -> InversePrandtlIshlinskii | None:
    """Return the inverse operator of a controller's feedforward; ``None`` without a feedforward.

    Raises:
        InputError: if the operator is not the inverse of a Prandtl-Ishlinskii operator with one envelope.
    """
    inverse = getattr(controller, "inverse", None)
    if inverse is not None and not isinstance(inverse, InversePrandtlIshlinskii):
        raise InputError(
            "only the inverse of a Prandtl-Ishlinskii operator with one envelope can be written as a feedforward"
        )
    return inverse


def controller_document(owner: AbstractController | ClosedLoop, units: Mapping[str, str]) -> dict[str, Any]:
    """Return a controller as a JSON document.

    Its keys: ``kind`` (the registered name, or the name of the class), ``period_s``, ``output`` (limits of the
    command), ``gains`` with their units, ``state`` (names of the numbers of the state, as in the C header). ``law`` and
    ``growth`` are those of an adaptive PID; ``leave`` is the ``exit_factor`` of a PPID; ``least`` the smallest value
    of 1 + kb y of a BPID; ``blind_s`` the time in s for which the channel, or a temperature, may be NaN before the
    command is 0. ``wires`` are the largest commands of two wires, ``guard`` the temperature limiter and ``observer``
    the estimator, if there are any; ``steers`` is true if the controller uses the estimate. ``constants`` are other
    constants of an own controller.

    Args:
        owner: The controller, or a loop.
        units: Unit of each gain by name.

    Raises:
        InputError: for what is no controller, a feedforward other than the inverse of a Prandtl-Ishlinskii operator
            with one envelope, a gain without a unit, or a temperature limiter with another timeout.
    """
    controller = owner.controller if isinstance(owner, ClosedLoop) else owner
    require_controller(controller)
    inverse, constants, lone = feedforward_inverse(controller), controller.constants(), jnp.zeros(())
    for name in gains(owner):
        if name not in units:
            raise InputError(f"the gain '{name}' has no unit: give a unit for each of {', '.join(gains(owner))}")
    state = jax.eval_shape(controller.reset, lone, lone)
    document = {
        "schema": SCHEMA,
        "kind": kind_of(controller),
        "period_s": controller.period,
        "output": [float(end) for end in controller.limits],
        "blind_s": DROPOUT_TIMEOUT,
        "gains": {name: {"value": float(gain(owner, name)), "unit": units[name]} for name in gains(owner)},
        **{name: value for name, value in constants.items() if name in _TOP_LEVEL_CONSTANTS},
        "state": leaf_names(state),
    }
    others = {name: value for name, value in constants.items() if name not in _TOP_LEVEL_CONSTANTS} | _other_numbers(
        controller
    )
    if others:
        document["constants"] = others
    if inverse is not None:
        document["feedforward"] = inverse_document(inverse)
    if isinstance(owner, ClosedLoop) and owner.wires > 1:
        document["wires"] = [float(command) for command in owner.max_commands]
    if isinstance(owner, ClosedLoop) and owner.temperature_limiter is not None:
        document["guard"] = limiter_document(owner.temperature_limiter)
    if isinstance(owner, ClosedLoop) and owner.estimator is not None:
        thermal = isinstance(owner.estimator, ThermalObserver)
        document["observer"] = (
            estimator_document(owner.estimator) if thermal else {"kind": type(owner.estimator).__name__}
        )
        document["observer"] |= {"steers": True} if owner.use_estimate else {}
    return document


def _other_numbers(controller: AbstractController) -> dict[str, Any]:
    """Numbers of a controller that are neither gains, limits nor those of a feedforward, by name."""
    numbers = eqx.filter(controller, eqx.is_inexact_array)
    if getattr(numbers, "inverse", None) is not None:
        numbers = eqx.tree_at(lambda part: part.inverse, numbers, None)
    named = zip(leaf_names(numbers), jax.tree.leaves(numbers), strict=True)
    return {n: np.asarray(v).tolist() for n, v in named if n not in (*gains(controller), "lower", "upper")}


def limiter_document(limiter: TemperatureLimiter) -> dict[str, float]:
    """Return the numbers of a temperature limiter: largest temperature (degC), gains, and largest command, SI.

    Raises:
        InputError: for another timeout than that of the controlled channel.
    """
    if float(limiter.timeout) != DROPOUT_TIMEOUT:
        raise InputError(
            f"a temperature limiter with a timeout of {float(limiter.timeout):g} s cannot be exported: an exported "
            f"controller has one timeout, {DROPOUT_TIMEOUT:g} s, so leave timeout out"
        )
    return {
        "limit": float(limiter.limit),
        "kp": float(limiter.pid.kp),
        "ki": float(limiter.pid.ki),
        "upper": float(limiter.pid.upper),
    }


def estimator_document(estimator: AbstractTemperatureEstimator) -> dict[str, float]:
    """Return the numbers of a thermal observer in SI units, with the ambient temperature in degC.

    Raises:
        InputError: for another kind of estimator.
    """
    if not isinstance(estimator, ThermalObserver):
        raise InputError(f"an {type(estimator).__name__} cannot be exported yet: a ThermalObserver can")
    return {n: float(getattr(estimator, n)) for n in ("a1", "a2", "exponent", "ambient", "gain")}


def inverse_document(inverse: InversePrandtlIshlinskii) -> dict[str, Any]:
    """Return the numbers of an inverse operator, in the internal units of channel and command.

    ``direct`` and ``densities`` are dimensionless; ``thresholds`` and the envelope's ``height`` and ``middle`` are in
    the channel's unit; its ``steepness`` is per unit of the command, and its ``shift`` is dimensionless.
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
