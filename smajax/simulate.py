"""The plants' door to diffrax: their response to recorded inputs, in time or along a path without a clock.

The steps are those of ``Plant.advance``, given to diffrax as a solver of our own. They end at every sample, so that each jump of a held
input falls between two steps, and samples further apart than ``step`` are subdivided evenly. Fixed steps keep a fit's objective free of
the noise of step-size control, cost the same for every design in a batch, and let the material's relative update cross its bands without
error; what remains is the second-order error of the heat balance, which ``discretisation_error`` measures by halving.
"""

import dataclasses
import enum
import functools
import itertools
from collections.abc import Callable, Sequence
from typing import Any, cast

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from smajax import parameters
from smajax.errors import NumericsError
from smajax.hysteresis.bouc_wen import PLACES, BoucWen
from smajax.hysteresis.operator import AbstractOperator
from smajax.plant.effect import SecondNode
from smajax.plant.plant import Plant, State
from smajax.plant.step import end_tangent, push
from smajax.recording import Recording

_HOTTEST = 1300.0
_SWING = 40
_JUMP = 0.05  # of a held input's range
_BLOCK = 64


class Code(enum.IntEnum):
    """What became of a simulation; ``cure`` says what to do about it."""

    done = 0
    unsolved = 1
    diverged = 2
    overheated = 3

    @property
    def cure(self) -> str:
        """One sentence: the meaning and the cure."""
        return {
            Code.done: "done",
            Code.unsolved: "a step's balance of heat and forces was not met: make the step smaller, or check stiffness and stress",
            Code.diverged: "the state is no longer a number: h(T) is negative somewhere, or an input or a parameter is out of scale",
            Code.overheated: f"the wire passed {_HOTTEST:.0f} degC, where it melts: check the input's unit, the wire's diameter and h(T)",
        }[self]


class Inputs(eqx.Module):
    """Recorded inputs laid on a grid of steps: ``g`` grid points, ``n`` samples, ``k`` signals.

    ``before`` and ``after``, shape ``(g - 1, k)``, are the signals at the two ends of each step, which differ from one step's end to the
    next one's start where a held input jumps; ``rows``, shape ``(n,)``, says at which grid points the samples lie; ``sampled``, shape
    ``(n, k)``, are the signals there.
    """

    time: jax.Array
    before: jax.Array
    after: jax.Array
    rows: jax.Array
    sampled: jax.Array

    def padded(self, grid: int, samples: int) -> "Inputs":
        """The same inputs on a longer grid: steps of no duration follow, which lead nowhere, and the last sample is repeated."""
        time, before, after, rows, sampled = map(np.asarray, (self.time, self.before, self.after, self.rows, self.sampled))
        more, later = grid - len(time), samples - len(rows)
        last = after[-1:]
        return _inputs(
            np.append(time, np.full(more, time[-1])),
            np.concatenate([before, np.repeat(last, more, axis=0)]),
            np.concatenate([after, np.repeat(last, more, axis=0)]),
            np.append(rows, np.full(later, rows[-1])),
            np.concatenate([sampled, np.repeat(sampled[-1:], later, axis=0)]),
        )

    def merged(self, stride: int, *, held: bool, pieces: int = 1) -> "Inputs":
        """The same inputs at every ``stride``-th sample, on steps each of which stands for up to ``pieces`` times as many.

        Inputs that are ``held`` keep their mean square, others go straight. Where one of them jumps, heating turns to cooling, and no step
        leads over that.
        """
        time, before, after, rows, sampled = map(np.asarray, (self.time, self.before, self.after, self.rows, self.sampled))
        kept = rows[::stride]
        jumps = 1 + np.flatnonzero(np.any(np.abs(before[1:] - after[:-1]) > _JUMP * np.ptp(before, axis=0), axis=1))
        cuts = np.union1d(kept, jumps[jumps < kept[-1]])
        # Where an input swings there are more steps than usual, which place its turn.
        usual = pieces * stride
        ends = [np.append(np.arange(a, b, usual if b - a <= usual else stride), b)[1:] for a, b in itertools.pairwise(cuts)]
        ends = np.concatenate(ends)
        starts = np.append(kept[0], ends[:-1])
        first, last = before[starts], after[ends - 1]
        if held:
            weight = np.diff(time)[:, None]
            total, size = (np.add.reduceat(v[: ends[-1]], starts) for v in (weight * before**2, weight))
            first = last = np.where(first == last, first, np.sign(first + last) * np.sqrt(total / size))
        grid = np.append(starts, ends[-1])
        return _inputs(time[grid], first, last, np.searchsorted(grid, kept), sampled[::stride])

    def halved(self) -> tuple["Inputs", int]:
        """The same inputs on steps half as long, as far as they go on a grid of this length; and at how many samples that is.

        The samples after these stay where they end.
        """
        time, before, after, rows, sampled = map(np.asarray, (self.time, self.before, self.after, self.rows, self.sampled))
        steps = (len(time) - 1) // 2
        middle = 0.5 * (before + after)[:steps]
        first, last = (np.stack(pair, axis=1).reshape(2 * steps, -1) for pair in ((before[:steps], middle), (middle, after[:steps])))
        clock = np.stack([time[:steps], 0.5 * (time[:steps] + time[1 : steps + 1])], axis=1).ravel()
        found = _inputs(np.append(clock, time[steps]), first, last, np.minimum(2 * rows, 2 * steps), sampled).padded(len(time), len(rows))
        return found, int(np.sum(rows <= steps))


def _inputs(*arrays: np.ndarray) -> Inputs:
    return Inputs(*map(jax.device_put, arrays))  # jnp.asarray would compile a program for each shape


class Track(eqx.Module):
    """Where a plant went: its states at the ``g`` grid points as rows of numbers, shape ``(g, s)``, and the result code."""

    rows: jax.Array
    code: jax.Array


class Simulation(eqx.Module):
    """A plant's response: ``channels`` by name, shape ``(n,)``, in SI and degC; the states behind them; and a result code."""

    time: jax.Array
    channels: dict[str, jax.Array]
    state: State
    code: jax.Array


def time_constant(plant: Plant) -> jax.Array:
    """Time constant in s of the wire's cooling at 80 degC, a scalar: C d / (4 h)."""
    capacity = plant.heat.capacity(jnp.asarray(0.5))
    return capacity * plant.wire.diameter / (4.0 * jnp.maximum(plant.heat.convection(jnp.asarray(80.0)), 1.0))


def modes(plant: Plant) -> tuple[jax.Array, jax.Array]:
    """Time constants in s, scalars, of what is fastest and of what is slowest when the wire cools: bounds of both.

    A second thermal node of strength s and time constant tau, see ``SecondNode``, makes the wire 1 + s times as fast while it is cold
    itself; the sum of the two modes' time constants is at most that of the wire and (1 + s) tau.
    """
    wire = time_constant(plant)
    nodes = [term for term in plant.terms if isinstance(term, SecondNode)]
    takes = sum((node.strength for node in nodes), jnp.zeros(()))
    return wire / (1.0 + takes), wire + (1.0 + takes) * sum((node.time_constant for node in nodes), jnp.zeros(()))


def resolving_step(plant: Plant) -> jax.Array:
    """A step in s, a scalar of at most 50 ms, that resolves warming and cooling, a thirtieth of the time constant, and what swings."""
    return jnp.minimum(jnp.minimum(0.05, time_constant(plant) / 30.0), plant.longest_step)  # a number, also while a batch is traced


def default_step(plant: Plant) -> float:
    """A step in s that resolves what the plant does: see ``resolving_step``."""
    return float(resolving_step(plant))


def lay_out(plant: Plant, recording: Recording, *, interpolation: str = "hold", step: float | None = None) -> Inputs:
    """Lays a recording's inputs on a grid of steps no longer than ``step`` s (default: ``default_step``).

    Electrical inputs are held or linear between samples as ``interpolation`` says; prescribed strain, stress and temperature are linear.
    A recording without a clock takes one step a row, since only the order of its rows matters.
    """
    time = recording.time
    gaps = np.diff(time)
    pieces = np.ones(len(gaps), int)
    if recording.has_clock:
        pieces = np.maximum(1, np.ceil(gaps / (step or default_step(plant)) - 1e-9).astype(int))
    if interpolation == "linear" and recording.has_clock:
        # Where the input swings within one sample, heating turns to cooling somewhere inside: small steps place that reversal.
        for name in plant.signals[: plant.mechanism.wires if plant.drive.control else 0]:
            signal = recording.channels[name]
            swing = np.abs(np.diff(signal)) / max(float(np.ptp(signal)), 1e-300)
            pieces = np.maximum(pieces, np.ceil(_SWING * swing).astype(int))
    rows = np.concatenate([[0], np.cumsum(pieces)])
    part = np.arange(rows[-1]) - np.repeat(rows[:-1], pieces)
    start = np.repeat(time[:-1], pieces) + part * np.repeat(gaps / pieces, pieces)
    grid = np.append(start, time[-1])
    sampled = np.column_stack([recording.channels[name] for name in plant.signals]) if plant.signals else np.zeros((len(time), 0))
    before, after = np.empty((2, rows[-1], len(plant.signals)))
    for i, name in enumerate(plant.signals):
        if name.startswith(plant.drive.control or "\0") and interpolation == "hold":
            before[:, i] = after[:, i] = np.repeat(sampled[:-1, i], pieces)
        else:
            at_grid = np.interp(grid, time, sampled[:, i])
            before[:, i], after[:, i] = at_grid[:-1], at_grid[1:]
    return _inputs(grid, before, after, rows, sampled)


# Traced once for all programs: their step is the same, and tracing it takes longer than compiling some of them.
_advance = eqx.filter_jit(lambda plant, *step: plant.advance(*step))
_arrive = eqx.filter_jit(lambda plant, *step: plant.arrive(*step))


class _Nothing(dfx.AbstractTerm):
    """A term without content: the plant comes as ``args``, and its increments are the solver's own."""

    def vf(self, t: Any, y: Any, args: Any) -> Any:
        return y

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        return t1 - t0

    def prod(self, vf: Any, control: Any) -> Any:
        return vf


class _PlantSteps(dfx.AbstractSolver):
    """``Plant.advance`` as a diffrax solver, ``_BLOCK`` steps of the grid at a time: diffrax's own work on a step costs more than ours.

    Its ``y`` is what ``keep`` makes of the states of the last block; its own state counts the blocks, and carries the plant's state, the
    steps that could not be solved and the hottest temperature so far (not a number as soon as any temperature is none).
    """

    keep: Callable[[Plant, State, jax.Array], Any] = eqx.field(static=True)
    term_structure = _Nothing
    interpolation_cls = dfx.LocalLinearInterpolation

    def order(self, terms: Any) -> int:
        return 2

    def init(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any) -> Any:
        _, _, start = args
        return jnp.asarray(0), (start, jnp.asarray(0), jnp.max(start.temperature))

    def step(self, terms: Any, t0: Any, t1: Any, y0: Any, args: Any, solver_state: Any, made_jump: Any) -> tuple:
        plant, rows, _ = args
        block, carry = solver_state

        def single(carry: tuple, row: tuple) -> tuple:
            state, unsolved, hottest = carry
            before, after, signal, duration = row
            state, failed = _advance(plant, state, before, after, duration)
            return (state, unsolved + failed, jnp.maximum(hottest, jnp.max(state.temperature))), self.keep(plant, state, signal)

        carry, y1 = jax.lax.scan(single, carry, jax.tree.map(lambda leaf: leaf[block], rows))
        return y1, None, dict(y0=y0, y1=y1), (block + 1, carry), dfx.RESULTS.successful

    def func(self, terms: Any, t0: Any, y0: Any, args: Any) -> Any:
        return y0


def _blocked(rows: jax.Array, filling: jax.Array) -> jax.Array:
    """Rows of steps in blocks, shape ``(b, _BLOCK, ...)``, the last one filled up."""
    count = rows.shape[0]
    filled = jnp.concatenate([rows, jnp.broadcast_to(filling, (-count % _BLOCK, *rows.shape[1:]))])
    return filled.reshape(-1, _BLOCK, *rows.shape[1:])


def _march(plant: Plant, inputs: Inputs, keep: Callable[[Plant, State, jax.Array], Any], until: Any = None) -> tuple[Any, jax.Array]:
    """What ``keep`` makes of the state and the signals at every grid point, leaves of shape ``(g, ...)``, and the result code.

    The last block is filled up with steps of no duration. What is after the block of the grid point ``until``, if there is one, is left out
    and infinite.
    """
    start = plant.start(inputs.sampled[0])
    count = inputs.time.shape[0] - 1
    blocks = -(-count // _BLOCK)
    last = inputs.after[-1]
    rows = (
        _blocked(inputs.before, last),
        _blocked(inputs.after, last),
        _blocked(_signals(inputs)[1:], last),
        _blocked(jnp.diff(inputs.time), jnp.zeros(())),
    )
    first, structure = jax.tree.flatten(keep(plant, start, inputs.sampled[0]))
    solution = dfx.diffeqsolve(
        _Nothing(),
        _PlantSteps(lambda *kept: jax.tree.leaves(keep(*kept))),  # diffrax takes no empty nodes
        0.0,
        float(blocks) if until is None else _blocks(until).astype(float),
        1.0,  # the solver's clock counts blocks
        [jnp.broadcast_to(leaf, (_BLOCK, *leaf.shape)) for leaf in first],
        args=(plant, rows, start),
        stepsize_controller=dfx.ConstantStepSize(),
        saveat=dfx.SaveAt(steps=True, solver_state=True),
        max_steps=blocks,
        adjoint=dfx.ForwardMode(),
        throw=False,
    )
    later, (_, (final, unsolved, hottest)) = cast(tuple, (solution.ys, solution.solver_state))
    joined = [jnp.concatenate([a[None], b.reshape(blocks * _BLOCK, *a.shape)[:count]]) for a, b in zip(first, later, strict=True)]
    code = jnp.where(unsolved > 0, Code.unsolved, Code.done)
    # What is no number in a fraction or a motion stays so to the end; in a temperature it stays in the hottest.
    finite = jnp.all(jnp.asarray([jnp.all(jnp.isfinite(leaf)) for leaf in jax.tree.leaves(final)])) & jnp.isfinite(hottest)
    code = jnp.where(finite, jnp.where(hottest > _HOTTEST, Code.overheated, code), Code.diverged)
    return jax.tree.unflatten(structure, joined), code


def _blocks(until: jax.Array) -> jax.Array:
    """The number of blocks up to a grid point, at least one."""
    return jnp.maximum(1, -(-until // _BLOCK))


def _signals(inputs: Inputs) -> jax.Array:
    """The signals at every grid point, shape ``(g, k)``: held ones jump there, and what follows counts."""
    return jnp.concatenate([inputs.sampled[:1], inputs.before[1:], inputs.sampled[-1:]])


def _row(plant: Plant, state: State, signal: jax.Array) -> jax.Array:
    """A state as one row of numbers: each of its many small arrays on its own would cost a step as much as some equations do."""
    return ravel_pytree(state)[0]


def _unflatten(plant: Plant, inputs: Inputs) -> Callable[[jax.Array], State]:
    """Makes a state of a row of numbers."""
    shape = jax.eval_shape(plant.start, inputs.sampled[0])
    return ravel_pytree(jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shape))[1]


@eqx.filter_custom_jvp
def _kept(plant: Plant, inputs: Inputs, until: Any, keep: Callable[[Plant, State, jax.Array], jax.Array]) -> tuple[jax.Array, jax.Array]:
    """What ``keep`` makes of the plant, the state and the signals at every grid point, a row of numbers each, and the result code."""
    return _march(plant, inputs, keep, until)


@_kept.def_jvp
def _kept_jvp(primals: tuple, tangents: tuple) -> tuple:
    """Pushes the tangent from step to step, the states being known by then."""
    plant, inputs, until, keep = primals
    track = Track(*_march(plant, inputs, _row, until))
    values, moved = _pushed(track, keep, until, (plant, inputs), tangents[:2])
    return (values, track.code), (moved, None)


@eqx.filter_custom_jvp
def _seen(plant: Plant, inputs: Inputs, until: Any, keep: Callable[[Plant, State, jax.Array], jax.Array], track: Track) -> jax.Array:
    """What ``keep`` makes of the plant, the states of ``track`` and the signals at every grid point, a row of numbers each."""
    unflatten = _unflatten(plant, inputs)
    return jax.vmap(lambda row, signal: keep(plant, unflatten(row), signal))(track.rows, _signals(inputs))


@_seen.def_jvp
def _seen_jvp(primals: tuple, tangents: tuple) -> tuple:
    """The plant's tangent moves the states, too: they are where the simulation of this plant leads."""
    plant, inputs, until, keep, track = primals
    return _pushed(track, keep, until, (plant, inputs), tangents[:2])


def _pushed(track: Track, keep: Callable[[Plant, State, jax.Array], jax.Array], until: Any, at: tuple, along: tuple) -> tuple:
    """What ``keep`` makes of known states at every grid point, and its tangent, pushed from step to step.

    What comes out is linear in the tangents, so that reverse mode comes with it; the states are its tape.
    """
    (plant, inputs), (moved, driven), flat = at, along, track.rows
    unflatten, signal = _unflatten(plant, inputs), _signals(inputs)

    def kept(plant: Plant, row: jax.Array, signal: jax.Array) -> jax.Array:
        return keep(plant, unflatten(row), signal)

    def recur(tangent: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
        """What the end moves by: see ``smajax.plant.step``."""
        start, known, step, along, signal, swayed = row
        end = unflatten(known)
        z = jnp.concatenate([end.temperature, end.unknown])

        def arrive(z: jax.Array, start: jax.Array, plant: Plant, step: tuple) -> tuple[jax.Array, jax.Array]:
            left, state = _arrive(plant, unflatten(start), *step, z)
            return left, ravel_pytree(state)[0]

        new = end_tangent(arrive, z, (start, plant, step), (tangent, moved, along))
        return new, push(kept, (plant, known, signal), (moved, new, swayed))

    begin = (plant, inputs.sampled[0]), (moved, None if driven.sampled is None else driven.sampled[0])
    first = push(lambda plant, signal: ravel_pytree(plant.start(signal))[0], *begin)
    step = (inputs.before, inputs.after, jnp.diff(inputs.time))
    along = (driven.before, driven.after, None if driven.time is None else jnp.diff(driven.time))
    swayed = None
    if driven.before is not None or driven.sampled is not None:
        swayed = push(_signals, (inputs,), (driven,))
    at_start = push(kept, (plant, flat[0], signal[0]), (moved, first, None if swayed is None else swayed[0]))
    rows = flat[:-1], flat[1:], step, along, signal[1:], None if swayed is None else swayed[1:]
    values = jax.vmap(lambda row, signal: kept(plant, row, signal))(flat, signal)
    if until is None:
        _, rest = jax.lax.scan(recur, first, rows)
        return values, jnp.concatenate([at_start[None], rest])
    # Filled up with steps that lead nowhere: what comes of them is left out.
    blocked = jax.tree.map(lambda leaf: _blocked(leaf, leaf[-1]), rows)

    def further(k: jax.Array, carry: tuple) -> tuple:
        tangent, rest = carry
        tangent, new = jax.lax.scan(recur, tangent, jax.tree.map(lambda leaf: leaf[k], blocked))
        return tangent, jax.lax.dynamic_update_slice(rest, new, (k * _BLOCK, 0))

    room = jnp.zeros((blocked[0].shape[0] * _BLOCK, len(at_start)))
    _, rest = jax.lax.fori_loop(0, _blocks(until), further, (first, room))
    return values, jnp.concatenate([at_start[None], rest[: len(flat) - 1]])


def run(plant: Plant, inputs: Inputs) -> tuple[State, jax.Array]:
    """The states at the samples, each leaf with a leading axis of ``n``, and the result code; to be compiled and batched by the caller.

    Differentiable in the plant's parameters and in the inputs, in forward and in reverse mode, once.
    """
    flat, code = _kept(plant, inputs, None, _row)
    return jax.vmap(_unflatten(plant, inputs))(flat[inputs.rows]), code


def observe(plant: Plant, states: State, inputs: Inputs, channels: Sequence[str]) -> dict[str, jax.Array]:
    """The named channels of states at the samples, each of shape ``(n,)``."""
    values = plant.read(jax.vmap(plant.outputs)(states, inputs.sampled), inputs.time[inputs.rows])
    return {c: values[c] for c in channels}


def track(plant: Plant, inputs: Inputs, until: jax.Array | None = None) -> Track:
    """Where a plant goes, for ``watch``: so simulation and derivatives can be two programs. Not differentiable."""
    return Track(*_march(plant, inputs, _row, until))


def blank_track(plant: Plant, inputs: Inputs) -> Track:
    """A track of the right shapes that leads nowhere."""
    size = jax.eval_shape(lambda: _row(plant, plant.start(inputs.sampled[0]), inputs.sampled[0])).shape[0]
    return Track(jnp.zeros((inputs.time.shape[0], size)), jnp.asarray(Code.unsolved.value))


def watch(
    plant: Plant, inputs: Inputs, channels: Sequence[str], until: jax.Array | None = None, known: Track | None = None
) -> tuple[dict[str, jax.Array], jax.Array]:
    """The named channels at the samples, each of shape ``(n,)``, and the result code; stores no states, for batches.

    Differentiable as ``run`` is. With ``until``, a whole number that is not batched, no sample may lie after that grid point, the
    simulation ends there, and there is no reverse mode. A ``known`` track has to be that of this plant.
    """
    names = list(dict.fromkeys([*channels, *(c for effect in plant.effects for c in effect.sees)]))

    def keep(plant: Plant, state: State, signal: jax.Array) -> jax.Array:
        values = plant.outputs(state, signal)
        return jnp.stack([values[c] for c in names])

    if known is None:
        values, code = _kept(plant, inputs, until, keep)
    else:
        values, code = _seen(plant, inputs, until, keep, known), known.code
    read = plant.read(dict(zip(names, values[inputs.rows].T, strict=True)), inputs.time[inputs.rows])
    return {c: read[c] for c in channels}, code


@eqx.filter_jit
def simulate_inputs(plant: Plant, inputs: Inputs) -> Simulation:
    """Simulates a plant under inputs that are laid out already; compiled once per length of grid and recording."""
    states, code = run(plant, inputs)
    return Simulation(inputs.time[inputs.rows], observe(plant, states, inputs, plant.observable), states, code)


def simulate(
    plant: Plant, recording: Recording, *, interpolation: str = "hold", step: float | None = None, throw: bool = True
) -> Simulation:
    """Simulates a plant under a recording's inputs. Raises ``NumericsError`` with the code's cure, unless ``throw`` is false.

    Effects of strength 0 are absent. A batch of plants (leaves with a leading axis) is simulated by ``simulate_batch``.
    """
    inputs = lay_out(plant, recording, interpolation=interpolation, step=step)
    result = simulate_inputs(dataclasses.replace(plant, effects=tuple(e for e in plant.effects if float(e.strength) != 0.0)), inputs)
    code = Code(int(result.code))
    if throw and code is not Code.done:
        raise NumericsError(f"{recording.name}: {code.name}: {code.cure}; parameters: {describe(plant)}")
    return result


# Wide vectors are what a batch is made of; single simulations are slower with them.
@functools.partial(eqx.filter_jit, compiler_options={"xla_cpu_prefer_vector_width": 512})  # pyright: ignore[reportCallIssue]
def simulate_batch(plant: Plant, values: dict[str, jax.Array], inputs: Inputs, channels: tuple[str, ...]) -> tuple[dict, jax.Array]:
    """Simulates ``m`` plants that differ in the named parameters (each of shape ``(m,)``) under the same inputs.

    Returns the channels, each of shape ``(m, n)``, and the result codes, shape ``(m,)``: one member's failure leaves the others alone.
    """

    def single(values: dict) -> tuple[dict, jax.Array]:
        return watch(parameters.replace(plant, values), inputs, channels)

    return jax.vmap(single)(values)


def respond(operator: AbstractOperator, time: jax.Array, values: jax.Array) -> jax.Array:
    """Outputs of an input-output law at all rows, shape ``(n,)``, for inputs of that shape at the times ``time``.

    A Bouc-Wen law's curve is integrated here, by diffrax's rule of fifth order: its slope depends on the place alone, so that all steps are
    taken at once.
    """
    if not isinstance(operator, BoucWen):
        return operator.respond(time, values)
    rule = dfx.Tsit5.tableau
    begun, size = jnp.asarray(PLACES[:-1, None]), jnp.asarray(np.diff(PLACES))
    stages = begun + jnp.asarray(np.append(0.0, rule.c))[None, :] * size[:, None]
    ways = jnp.cumsum(size * (jax.vmap(jax.vmap(operator.slowness))(stages) @ jnp.asarray(rule.b_sol)))
    return operator.follow(jnp.append(0.0, ways), values)


def discretisation_error(
    plant: Plant, recording: Recording, channel: str, *, interpolation: str = "hold", step: float | None = None
) -> float:
    """RMS change of a channel, in SI, when every step is halved: a third more than the error of the halved steps, as the order is 2."""
    step = step or default_step(plant)
    pieces = np.maximum(1, np.ceil(np.diff(recording.time) / step - 1e-9))
    gap = float(np.max(np.diff(recording.time) / pieces))
    coarse = simulate(plant, recording, interpolation=interpolation, step=step, throw=False)
    fine = simulate(plant, recording, interpolation=interpolation, step=gap / 2, throw=False)
    return float(jnp.sqrt(jnp.mean((coarse.channels[channel] - fine.channels[channel]) ** 2)))


def describe(plant: Plant) -> str:
    """All parameters of a plant as one line of text, in internal units."""
    values = {n: float(parameters.get(plant, n)) for n in parameters.declared(plant) if not n.startswith(("sensor.", "initial."))}
    ties = {m for t, ms in parameters.TIES.items() if t in values for m in ms}
    return ", ".join(f"{n} = {v:.6g} {parameters.declaration(plant, n).unit}" for n, v in values.items() if n not in ties)
