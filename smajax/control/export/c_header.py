"""A tuned controller as a C header for a microcontroller.

The header contains one controller: its gains as constants, its state as a structure, and two functions,
``smajax_reset`` and ``smajax_step``. They are written from traces of ``reset`` and ``step`` in Python, operation by
operation, so that an own controller is exported like those of smajax. The header uses no heap, and no library except
the functions of math.h that the controller needs; ``smajax_step`` is called once a period. A measurement that is NaN is
replaced by the last finite one for ``DROPOUT_TIMEOUT``; then the command is 0, and with the next finite value the
controller is reset.

- For two wires, ``smajax_allocate`` gives each wire its command.
- With a temperature limiter, ``smajax_guard`` limits a wire's command according to its temperature, to 0 if the
  temperature has been NaN for ``DROPOUT_TIMEOUT``; ``smajax_step_guarded``, which takes these limits, replaces
  ``smajax_step``.
- With a thermal observer, ``smajax_observe`` estimates the temperature from the wire's power.
"""

import re
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controllers.base import AbstractController, require_controller
from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.export import c_templates
from smajax.control.export.c_functions import (
    Constants,
    StateType,
    definition,
    pure_function,
    scalar_inputs,
    state_function,
    state_type,
    vector_input,
    with_needed_leaves,
)
from smajax.control.export.c_source import CProgram
from smajax.control.export.c_values import CValue
from smajax.control.export.json_document import estimator_document, limiter_document
from smajax.control.export.named_leaves import leaf_names
from smajax.control.export.static_numbers import static_numbers
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.dropouts import ReferenceHold, step_with_dropouts
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sensors.dropout_hold import DROPOUT_TIMEOUT, DropoutHold

# The time after which a missing measurement counts as lost.
_BLIND = (jnp.zeros(()), [CValue("SMAJAX_BLIND", (), "real")])

# What Python raises where it needs the value of a traced number.
_NEEDS_VALUE = (TypeError, ValueError)


class _State(NamedTuple):
    """State of an exported controller: that of the controller, and the holds of measurement and reference."""

    controller: Any
    hold: DropoutHold
    reference: ReferenceHold


def c_header(
    owner: AbstractController | ClosedLoop, units: tuple[str, str], version: str, start: float | None = None
) -> str:
    """Return the C header of a controller, or of a loop's controller, allocation, limiter and observer.

    Args:
        owner: The controller, or the loop.
        units: Units of command and channel.
        version: Version of smajax.
        start: Reference before the first sample, in the channel's unit, for the example of the header's comment;
            without it, the example begins with the first reference.

    Raises:
        InputError: for what is no controller; for an operation of the controller that cannot be written in C, with its
            name; for an estimator other than a thermal observer; or for a temperature limiter with another timeout than
            ``DROPOUT_TIMEOUT``.
    """
    require_controller(owner.controller if isinstance(owner, ClosedLoop) else owner)
    loop = owner if isinstance(owner, ClosedLoop) else ClosedLoop(owner, channel="value")
    if loop.estimator is not None:
        estimator_document(loop.estimator)
    if loop.temperature_limiter is not None:
        limiter_document(loop.temperature_limiter)
    program, parts = _program(loop)
    return _header(loop, units, version, program, parts, start)


def _program(loop: ClosedLoop) -> tuple[CProgram, tuple[list[str], list[str]]]:
    """The program of a loop, with its definitions and functions; its static numbers have names where they can."""
    static: dict[str, float] = {}
    for part in (loop.controller, loop.allocation, loop.temperature_limiter, loop.estimator):
        static = static_numbers(part) | static
    try:
        program = CProgram(static)
        return program, _definitions_and_functions(program, loop)
    except _NEEDS_VALUE:  # of one of the numbers, or another fault, which then occurs again
        program = CProgram({name: value for name, value in static.items() if _can_have_name(loop, {name: value})})
        return program, _definitions_and_functions(program, loop)


def _can_have_name(loop: ClosedLoop, static: dict[str, float]) -> bool:
    """Whether the functions can be traced without the value of a static number."""
    try:
        _definitions_and_functions(CProgram(static), loop)
    except _NEEDS_VALUE:
        return False
    return True


def _definitions_and_functions(program: CProgram, loop: ClosedLoop) -> tuple[list[str], list[str]]:
    """Definitions of the constants, and the functions."""
    numbers = Constants(program, loop.controller)
    functions = _step_functions(program, numbers)
    allocation, limiter, defines = loop.allocation, loop.temperature_limiter, [*numbers.defines]
    wires = None
    if allocation is not None and allocation.wires > 1:
        wires = Constants(program, allocation, renamed=_ALLOCATION_NAMES)
        defines += wires.defines
        functions.append(_allocate(program, wires))
    if limiter is not None:
        guard = Constants(program, limiter, "guard_", literal=lambda name, number: number == 0.0)
        defines += guard.defines
        functions += _guard_functions(program, guard, loop)
        functions.append(_step_guarded(program, loop, numbers, wires))
        if isinstance(loop.estimator, ThermalObserver):
            observer = Constants(program, loop.estimator, "observer_", literal=lambda name, number: "exponent" in name)
            defines += observer.defines
            functions += _observer_functions(program, observer)
    return defines, functions


def _header(
    loop: ClosedLoop,
    units: tuple[str, str],
    version: str,
    program: CProgram,
    parts: tuple[list[str], list[str]],
    start: float | None,
) -> str:
    """The text of the header; ``parts`` are the definitions of the constants, and the functions."""
    defines, functions = parts
    body = "\n".join(functions)
    static = {"period": float(loop.period), **program.static}
    limits = [
        f"#define SMAJAX_{name.upper()} ((smajax_real){number!r})"
        for name, number in static.items()
        if name == "period" or f"SMAJAX_{name.upper()}" in body
    ]
    blind = f"#define SMAJAX_BLIND ((smajax_real){DROPOUT_TIMEOUT!r})"
    limits.append(f"{blind} /* s without a measurement after which the command is 0 */")
    if start is not None:
        limits.append(c_templates.START.format(start=start, unit=c_templates.comment_text(units[1])))
    texts = "\n".join([body, *defines])
    helpers = {name: text for name, text in c_templates.HELPERS.items() if f"{name}(" in texts}
    math = [c_templates.MATH.format(name=name.upper(), function=name) for name in sorted(program.math)]
    used = [text for name, text in zip(sorted(program.math), math, strict=True) if f"SMAJAX_{name.upper()}(" in body]
    return c_templates.HEADER.format(
        kind=c_templates.comment_text(type(loop.controller).__name__),
        version=version,
        command_unit=c_templates.comment_text(units[0]),
        channel_unit=c_templates.comment_text(units[1]),
        start="reference" if start is None else "SMAJAX_START",
        use=_instructions(loop),
        include="".join(["#include <math.h>\n"] * bool(used) + used),
        constants="\n".join([*limits, *defines, *program.definitions]),
        helpers="\n\n".join(helpers.values()),
        functions=body,
    )


def _instructions(loop: ClosedLoop) -> str:
    """The lines of the header's comment that say what to call in each period."""
    pair = loop.wires > 1
    if loop.temperature_limiter is None:
        return c_templates.PAIR_USE if pair else c_templates.USE
    use = c_templates.LIMITED_PAIR_USE if pair else c_templates.LIMITER_USE
    return use + c_templates.OBSERVER_USE * isinstance(loop.estimator, ThermalObserver)


def _step_functions(program: CProgram, numbers: Constants) -> list[str]:
    """State of the controller, and its functions."""

    def reset(values: Any, blind: jax.Array, reference: jax.Array, value: jax.Array) -> _State:
        """Start as if reference and value had been constant."""
        held = ReferenceHold.init(reference)
        hold = DropoutHold.init(value, held.begun, blind)
        return _State(numbers.module(values).reset(held.reference, hold.value), hold, held)

    def step(values: Any, state: _State, blind: jax.Array, *inputs: jax.Array) -> tuple[_State, jax.Array]:
        """Take one sample: the state after it and the command; the inputs are reference, value and both limits."""
        reference, value, lower, upper = inputs
        controller = numbers.module(values).with_limits(lower, upper)
        held = state.reference.update(reference)
        hold = state.hold.update(value, controller.period, held.begun)
        timed_out = (state.hold.has_timed_out(blind), hold.has_timed_out(blind))
        after, command = step_with_dropouts(controller, state.controller, timed_out, held.reference, hold.value)
        return _State(after, hold, held), command

    first = [numbers.argument, _BLIND, *scalar_inputs("reference", "value")]
    each = [*first, *scalar_inputs("lower", "upper")]
    state = state_type("smajax_state", "s", reset, [example for example, _ in first], _member_names)
    state = with_needed_leaves(program, state, step, each)
    meaning = type(numbers.others).__doc__ or "Controller."
    parameters = ["smajax_state *s", "smajax_real reference", "smajax_real value"]
    return [
        state.definition(f"State of the controller. {_first_sentence(meaning)}"),
        definition(
            "Starts the controller, as if reference and value had been constant.",
            "void",
            "smajax_reset",
            parameters,
            state_function(program, state, reset, first, takes_state=False),
        ),
        definition(
            "One sample within other limits of the command: the command until the next one.",
            "smajax_real",
            "smajax_step_within",
            [*parameters, "smajax_real lower", "smajax_real upper"],
            state_function(program, state, step, each, output="command"),
        ),
        c_templates.STEP,
    ]


def _first_sentence(text: str) -> str:
    """The first sentence of a docstring, for a comment."""
    return c_templates.comment_text(re.split(r"(?<=[.])\s|\n\n", text.strip())[0])


def _member_names(state: _State) -> list[str]:
    """Names of the members: those of the controller's own state, which may not be those of the holds."""
    holds = leaf_names((state.hold, state.reference))
    return [*(f"{name}_" if name in holds else name for name in leaf_names(state.controller)), *holds]


_ALLOCATION_NAMES = {"upper": "max_command_1", "second_upper": "max_command_2"}


def _allocate(program: CProgram, wires: Constants) -> str:
    """The allocation of a command to two wires."""
    lines, (each,) = pure_function(
        program,
        lambda values, command: wires.module(values)(command),
        [wires.argument, *scalar_inputs("command")],
        ["commands"],
    )
    body = [*lines, *(f"    each[{i}] = {each.element(i)};" for i in range(each.size))]
    return definition(
        "The commands of two wires that pull against each other: a command above 0 heats the first, one below 0 the "
        "second.",
        "void",
        "smajax_allocate",
        ["smajax_real command", f"smajax_real each[{each.size}]"],
        body,
    )


def _guard_functions(program: CProgram, guard: Constants, loop: ClosedLoop) -> list[str]:
    """State and functions of the temperature limiter of a wire."""

    def limiter(values: Any, blind: jax.Array) -> TemperatureLimiter:
        return eqx.tree_at(lambda part: part.timeout, guard.module(values), blind)

    def reset(values: Any, blind: jax.Array, temperature: jax.Array) -> Any:
        return limiter(values, blind).reset(temperature)

    def step(values: Any, state: Any, blind: jax.Array, temperature: jax.Array, command: jax.Array) -> Any:
        return limiter(values, blind).step(state, temperature, command)

    first = [guard.argument, _BLIND, *scalar_inputs("temperature")]
    each = [*first, *scalar_inputs("command")]
    state = state_type("smajax_guard_state", "g", reset, [example for example, _ in first], leaf_names)
    state = with_needed_leaves(program, state, step, each)
    parameters = ["smajax_guard_state *g", "smajax_real temperature"]
    limit = float(loop.temperature_limiter.limit) if loop.temperature_limiter is not None else 0.0
    return [
        state.definition(f"Temperature limiter, which keeps a wire below {limit:.6g} degC: a state for each wire."),
        definition(
            "Starts the limiter at a temperature in degC.",
            "void",
            "smajax_guard_reset",
            parameters,
            state_function(program, state, reset, first, takes_state=False),
        ),
        definition(
            "One sample: the command of the wire, at most what its temperature in degC allows.",
            "smajax_real",
            "smajax_guard",
            [*parameters, "smajax_real command"],
            state_function(program, state, step, each, output="allowed"),
        ),
    ]


def _step_guarded(program: CProgram, loop: ClosedLoop, numbers: Constants, wires: Constants | None) -> str:
    """The sample of a controller within what the limiters of the wires allow."""

    def with_numbers(values: Any, allocation: Any) -> ClosedLoop:
        other: Allocation | None = None if wires is None else wires.module(allocation)
        return eqx.tree_at(
            lambda part: (part.controller, part.allocation),
            loop,
            (numbers.module(values), other),
            is_leaf=lambda part: part is None,
        )

    pair = loop.wires > 1
    constants = [numbers.argument, ((), []) if wires is None else wires.argument]
    most = vector_input("most", loop.wires)
    limits, (lower, upper) = pure_function(
        program,
        lambda values, allocation, most: with_numbers(values, allocation).command_limits(most),
        [*constants, most],
        ["lower", "upper"],
    )
    call = f"smajax_step_within(s, reference, value, {lower.element(0)}, {upper.element(0)})"
    if not pair:
        body = [*limits, f"    return smajax_min({call}, most);"]
    else:
        body = [*limits, f"    smajax_allocate({call}, each);"]
        body += [f"    each[{i}] = smajax_min(each[{i}], most[{i}]);" for i in range(loop.wires)]
    parameters = ["smajax_state *s", "smajax_real reference", "smajax_real value"]
    parameters += [f"const smajax_real most[{loop.wires}]", f"smajax_real each[{loop.wires}]"] if pair else []
    return definition(
        "One sample: the command of each wire, at most what smajax_guard allows; nothing winds up meanwhile.",
        "void" if pair else "smajax_real",
        "smajax_step_guarded",
        parameters if pair else [*parameters, "smajax_real most"],
        body,
    )


def _observer_functions(program: CProgram, observer: Constants) -> list[str]:
    """State and functions of the thermal observer of a wire."""

    def reset(values: Any, temperature: jax.Array) -> Any:
        return observer.module(values).init({"temperature": temperature})

    def step(values: Any, state: Any, power: jax.Array, thermocouple: jax.Array) -> tuple[Any, jax.Array]:
        state, (temperature,) = observer.module(values).update(state, {"power": power, "temperature": thermocouple})
        return state, temperature

    first = [observer.argument, *scalar_inputs("temperature")]
    each = [observer.argument, *scalar_inputs("power", "thermocouple")]
    state: StateType = state_type("smajax_observer_state", "o", reset, [e for e, _ in first], leaf_names)
    state = with_needed_leaves(program, state, step, each)
    return [
        state.definition("Thermal observer: a wire's temperature by its electrical power, a state for each wire."),
        definition(
            "At rest at a temperature in degC; NaN: at that of the surroundings.",
            "void",
            "smajax_observer_reset",
            ["smajax_observer_state *o", "smajax_real temperature"],
            state_function(program, state, reset, first, takes_state=False),
        ),
        definition(
            "The temperature now, in degC. power: the mean over the last period, in W. thermocouple: its reading; NaN: "
            "none.\n * A power that is NaN is replaced by the last finite one, and the result is NaN: smajax_guard "
            "then allows nothing\n * after SMAJAX_BLIND s.",
            "smajax_real",
            "smajax_observe",
            ["smajax_observer_state *o", "smajax_real power", "smajax_real thermocouple"],
            state_function(program, state, step, each, output="measured"),
        ),
    ]
