"""The compiled programs of a diagnosis, and all that is done only so that they need to be compiled once.

- Slots: the plant has every effect that its rig could have, those of the rig file as they are and all others at
  strength 0. A vector holds the rig's free parameters, then ``SLOTS`` slots; which effect parameter a slot moves is
  data (a matrix), so that no set of effects needs a compilation of its own. Compiling one set takes longer than a whole
  search with it.
- Padding: grids and samples are filled up to a multiple of ``PADDING_MULTIPLE``, and all splits have as many
  recordings, those that fill up without weight (``problem_layout``), so that training, selection, holdout and proposed
  inputs run on one program.
- Two programs: simulation, and simulation with derivatives. They compile at the same time, and a search asks for
  derivatives only where a step is taken: they cost several simulations.
- Background: both compile in threads while the small program of the rig without effects is fitted
  (``start_compilation``).
"""

import dataclasses
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax import parameters
from smajax.diagnosis.candidates import EffectSet, NonparametricTerm
from smajax.diagnosis.nonparametric import KINDS, KNOTS, VARIABLES, set_terms
from smajax.fitting.compilation import LARGE_PROGRAM_OPTIONS
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem
from smajax.simulation.sensitivities import Trajectory

# Effect parameters that a fit can free at once: three effects with a strength and a shape each. More make every
# derivative dearer.
SLOTS = 6
# Grids and samples are padded to a multiple of this: recordings of nearly one length, and proposed inputs, fit the same
# program.
PADDING_MULTIPLE = 512
# Relative fall of the cost at which a search ends where nothing else is asked for.
_RTOL = 1e-7


class Simulated(NamedTuple):
    """The trajectory of the plant in each recording, and the residual."""

    trajectories: Trajectory
    residual: Float[Array, " residuals"]


class SlottedModel(eqx.Module):
    """What the compiled programs take in addition to the vector.

    ``problem`` is that of a split. ``fixed`` and the rows of ``slot_matrix`` hold the named effect parameters and then
    the knots of the nonparametric terms. ``term`` says of which variable these are a function: selection, low and high
    as in ``NonparametricEffect``.
    """

    problem: Problem
    fixed: Float[Array, " entries"]
    slot_matrix: Float[Array, "entries slots"]
    term: tuple[Float[Array, " variables"], Float[Array, " variables"], Float[Array, " variables"]]
    names: tuple[str, ...] = eqx.field(static=True)

    def residual(self, vector: Float[Array, " p"], trajectories: Trajectory) -> Float[Array, " residuals"]:
        """Return model minus measurement over the noise; ``trajectories`` are those of this vector."""
        problem, base = self._fill(vector)
        return problem.residual(base, trajectories)

    def trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Simulate the plant in each recording."""
        problem, base = self._fill(vector)
        return problem.trajectories(base)

    def blank_trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Return trajectories of the right shapes without a simulation."""
        problem, base = self._fill(vector)
        return problem.blank_trajectories(base)

    def _fill(self, vector: Float[Array, " p"]) -> tuple[Problem, Float[Array, " base"]]:
        """The problem with the slots' values in its plant, and the base parameters."""
        base = len(self.problem.unknowns)
        values = self.fixed + self.slot_matrix @ vector[base:]
        plant = parameters.replace(self.problem.plant, {name: values[i] for i, name in enumerate(self.names)})
        plant = set_terms(plant, values[len(self.names) :].reshape(len(KINDS), KNOTS), *self.term)
        return dataclasses.replace(self.problem, plant=plant), vector[:base]


def slotted_model(
    problem: Problem,
    effect_parameters: tuple[Sequence[str], np.ndarray],
    effect_set: EffectSet,
    free: Sequence[tuple[str, float]],
    term: NonparametricTerm | None = None,
) -> SlottedModel:
    """Assemble the programs' data for a set of effects on a problem.

    Args:
        problem: The problem of a split.
        effect_parameters: Names and own values of all effect parameters.
        effect_set: The effects with their values.
        free: Names and scales of the parameters that the first slots move.
        term: A nonparametric term, whose nodes are the slots after these.
    """
    all_names, values = effect_parameters
    names = tuple(all_names)
    knots = len(KINDS) * KNOTS
    fixed, matrix = np.append(values, np.zeros(knots)), np.zeros((len(names) + knots, SLOTS))
    for name, value in effect_set.values:
        fixed[names.index(name)] = value
    for slot, (name, scale) in enumerate(free):
        i = names.index(name)
        matrix[i, slot] = scale
        fixed[i] = 0.0
    selection, low, high = (np.zeros(len(VARIABLES)), np.zeros(len(VARIABLES)), np.ones(len(VARIABLES)))
    if term is not None:
        first = len(names) + term.kind * KNOTS
        matrix[first : first + KNOTS, len(free) : len(free) + term.matrix.shape[1]] = term.matrix
        variable = VARIABLES.index(term.variable)
        selection[variable], low[variable], high[variable] = 1.0, term.low, term.high
    term_arrays = (jnp.asarray(selection), jnp.asarray(low), jnp.asarray(high))
    return SlottedModel(problem, jnp.asarray(fixed), jnp.asarray(matrix), term_arrays, names)


def residual(vector: Float[Array, " p"], args: tuple[SlottedModel, Simulated]) -> Float[Array, " residuals"]:
    """Return ``SlottedModel.residual`` in the form in which a search calls it."""
    model, simulated = args
    return model.residual(vector, simulated.trajectories)


def _simulate(vector: jax.Array, model: SlottedModel) -> Simulated:
    trajectories = model.trajectories(vector)
    return Simulated(trajectories, model.residual(vector, trajectories))


# The program without derivatives.
simulate: Callable[[jax.Array, SlottedModel], Simulated] = eqx.filter_jit(
    _simulate,
    compiler_options=LARGE_PROGRAM_OPTIONS,  # pyright: ignore[reportCallIssue]
)


def start_solver(
    model: SlottedModel,
    start: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    rtol: float = _RTOL,
    primal_fn: Callable[[jax.Array, SlottedModel], Simulated] = simulate,
) -> MultiStartSolver:
    """Set up a search for the vector, without a step.

    Args:
        model: The programs' data.
        start: Start vector, shape ``(p,)``.
        lower: Lower bounds, shape ``(p,)``.
        upper: Upper bounds, shape ``(p,)``.
        rtol: Relative fall of the cost at which the search ends.
        primal_fn: The program that simulates before each step.
    """
    return MultiStartSolver(
        residual, model, start[None], lower, upper, size=model.problem.size, rtol=rtol, primal_fn=primal_fn
    )


def start_compilation(model: SlottedModel, vector: np.ndarray) -> list[threading.Thread]:
    """Compile both programs in the background; they are compiled when the threads have ended.

    Tracing holds Python's lock and compiling does not: the program that takes longer to compile is traced first, before
    this returns.
    """
    point, unbounded = jnp.asarray(vector), np.full(len(vector), np.inf)
    blank = Simulated(model.blank_trajectories(point), jnp.zeros(model.problem.size))
    derivatives = start_solver(model, vector, -unbounded, unbounded, primal_fn=lambda *_: blank)
    derivatives.trace_program()
    threads = [
        threading.Thread(target=task, daemon=True)
        for task in ((lambda: derivatives.advance(1)), (lambda: simulate(point, model)))
    ]
    for thread in threads:
        thread.start()
    return threads
