"""The two compiled programs of a diagnosis, on which every set of effects and every split runs.

Compiling one set of effects takes longer than a whole search with it, so each program is compiled once:

- Slots: the plant has every effect that its rig could have, those of the rig file with their values and all others at
  strength 0. A vector holds the rig's free parameters, then ``SLOTS`` slots. Which effect parameter a slot moves is
  data (a matrix), so that no set of effects needs its own compilation.
- More slots: a set of effects with more parameters than ``SLOTS`` runs on programs with a multiple of as many slots
  (``slot_count``). They are compiled when such a set is first fitted with all its parameters free; the searches among
  candidates free the first ``SLOTS`` parameters of each set.
- Padding: grids and samples are padded to a common length (``pad_together``), and all splits to the same number of
  recordings, with weight 0 (``problem_layout``). Training, selection, holdout and proposed inputs run on one program.
- Two programs: simulation, and simulation with derivatives. Derivatives cost several simulations, so a search computes
  them only where it accepts a step.
- Background: both compile in threads while the small program of the rig without effects is fitted
  (``start_compilation``).
"""

import dataclasses
import math
import threading
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax import parameters
from smajax.diagnosis.candidates import EffectSet, NonparametricTerm
from smajax.diagnosis.nonparametric import KINDS, KNOTS, VARIABLES, set_terms
from smajax.fitting.compilation import LARGE_PROGRAM_OPTIONS
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem
from smajax.numerics.process import COMPILATION
from smajax.numerics.stored_programs import stored
from smajax.simulation.sensitivities import Trajectory

# Number of effect parameters that the usual programs can free: three effects with a strength and a shape each. More
# slots make every derivative more expensive.
SLOTS = 6
# Relative fall of the cost at which a search ends by default. Chosen by trial.
RTOL = 1e-7


class Simulated(NamedTuple):
    """The result of a simulation of all recordings.

    Attributes:
        trajectories: Trajectory of the plant in each recording.
        residual: Measurement minus model over the noise.
    """

    trajectories: Trajectory
    residual: Float[Array, " residuals"]


class SlottedModel(eqx.Module):
    """The data of the compiled programs in addition to the vector.

    With the slots s, the values of the effect parameters, followed by the knots of the nonparametric terms, are
    ``fixed + slot_matrix @ s``.

    Attributes:
        problem: The problem of a split.
        fixed: Values of the entries that no slot moves, SI; 0 for the others.
        slot_matrix: Change of each entry by a unit of each slot, SI.
        term: ``selection``, ``low`` and ``high`` of ``NonparametricEffect``.
        names: Names of the effect parameters.
    """

    problem: Problem
    fixed: Float[Array, " entries"]
    slot_matrix: Float[Array, "entries slots"]
    term: tuple[Float[Array, " variables"], Float[Array, " variables"], Float[Array, " variables"]]
    names: tuple[str, ...] = eqx.field(static=True)

    def residual(self, vector: Float[Array, " p"], trajectories: Trajectory) -> Float[Array, " residuals"]:
        """Compute measurement minus model over the noise.

        Args:
            vector: Base parameters, then slots.
            trajectories: The trajectories of this vector.
        """
        problem, base = self._fill(vector)
        return problem.residual(base, trajectories)

    def trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Simulate the plant in each recording."""
        problem, base = self._fill(vector)
        return problem.trajectories(base)

    def statuses(self, vector: Float[Array, " p"], trajectories: Trajectory) -> Int[Array, " r"]:
        """Return the status code of each recording, with the limits of a wire.

        Args:
            vector: Base parameters, then slots.
            trajectories: The trajectories of this vector.
        """
        problem, base = self._fill(vector)
        return problem.statuses(base, trajectories)

    def blank_trajectories(self, vector: Float[Array, " p"]) -> Trajectory:
        """Return trajectories of the right shapes without a simulation."""
        problem, base = self._fill(vector)
        return problem.blank_trajectories(base)

    def _fill(self, vector: Float[Array, " p"]) -> tuple[Problem, Float[Array, " base"]]:
        """The problem with the slots' values in its plant, and the base parameters."""
        base_size = len(self.problem.unknowns)
        values = self.fixed + self.slot_matrix @ vector[base_size:]
        plant = parameters.replace(self.problem.plant, {name: values[i] for i, name in enumerate(self.names)})
        plant = set_terms(plant, values[len(self.names) :].reshape(len(KINDS), KNOTS), *self.term)
        return dataclasses.replace(self.problem, plant=plant), vector[:base_size]


def slot_count(parameter_count: int) -> int:
    """Return the number of slots of the program that can free a number of parameters: a multiple of ``SLOTS``."""
    return SLOTS * max(1, math.ceil(parameter_count / SLOTS))


def slotted_model(
    problem: Problem,
    effect_parameters: tuple[Sequence[str], np.ndarray],
    effect_set: EffectSet,
    free: Sequence[tuple[str, float]],
    term: NonparametricTerm | None = None,
) -> SlottedModel:
    """Assemble the data of the compiled programs for a set of effects on a problem.

    Args:
        problem: The problem of a split.
        effect_parameters: Names of all effect parameters and the rig's own values, SI, shape ``(names,)``.
        effect_set: The effects with their values.
        free: Names and scales, SI, of the parameters that the first slots move.
        term: A nonparametric term, whose nodes are in the following slots.
    """
    all_names, values = effect_parameters
    names = tuple(all_names)
    knots, slots = len(KINDS) * KNOTS, slot_count(len(free) + (term.matrix.shape[1] if term else 0))
    fixed, matrix = np.append(values, np.zeros(knots)), np.zeros((len(names) + knots, slots))
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
    fixed, matrix, ranges = jax.device_put((fixed, matrix, (selection, low, high)))
    return SlottedModel(problem, fixed, matrix, ranges, names)


def residual(vector: Float[Array, " p"], args: tuple[SlottedModel, Simulated]) -> Float[Array, " residuals"]:
    """Return ``SlottedModel.residual`` with the signature that the solver needs.

    Args:
        vector: Base parameters, then slots.
        args: The model, and the result of its simulation.
    """
    model, simulated = args
    return model.residual(vector, simulated.trajectories)


def _simulate(vector: Float[Array, " p"], model: SlottedModel) -> Simulated:
    trajectories = model.trajectories(vector)
    return Simulated(trajectories, model.residual(vector, trajectories))


# The program without derivatives.
simulate: Callable[[jax.Array, SlottedModel], Simulated] = stored(
    _simulate,
    compiler_options=LARGE_PROGRAM_OPTIONS,
)


# The program that checks what is reported.
statuses: Callable[[jax.Array, SlottedModel, Trajectory], Int[Array, " r"]] = stored(
    lambda vector, model, trajectories: model.statuses(vector, trajectories)
)


def start_solver(
    model: SlottedModel,
    start: Float[np.ndarray, " p"],
    lower: Float[np.ndarray, " p"],
    upper: Float[np.ndarray, " p"],
    rtol: float = RTOL,
    primal_fn: Callable[[jax.Array, SlottedModel], Simulated] = simulate,
    *,
    secant_updates: bool = False,
) -> MultiStartSolver:
    """Set up a search for the vector, without a step.

    Args:
        model: The data of the compiled programs.
        start: Start vector, shape ``(p,)``.
        lower: Lower bounds, shape ``(p,)``.
        upper: Upper bounds, shape ``(p,)``.
        rtol: Relative fall of the cost at which the search ends.
        primal_fn: The program that simulates before each step.
        secant_updates: Update the Jacobian from residuals where that is enough.
    """
    options = {"rtol": rtol, "primal_fn": primal_fn, "secant_updates": secant_updates}
    return MultiStartSolver(residual, model, start[None], lower, upper, size=model.problem.size, **options)


def start_compilation(
    model: SlottedModel, vector: Float[np.ndarray, " p"], *, secant_updates: bool = False
) -> list[threading.Thread]:
    """Compile both programs in the background.

    Tracing holds Python's global lock and compiling does not. The program that takes longer to compile is therefore
    traced here, before the threads start.

    Args:
        model: The data of the compiled programs, of the shapes that all later calls have.
        vector: A vector of the right shape, ``(p,)``.
        secant_updates: That of the searches.

    Returns:
        The threads; the programs are compiled when they have ended.
    """
    point, unbounded = jax.device_put(vector), np.full(len(vector), np.inf)
    shapes = jax.eval_shape(lambda: Simulated(model.blank_trajectories(point), jnp.zeros(model.problem.size)))
    blank = jax.tree.map(lambda leaf: jax.device_put(np.zeros(leaf.shape, leaf.dtype)), shapes)
    options = {"primal_fn": lambda *_: blank, "secant_updates": secant_updates}
    derivatives = start_solver(model, vector, -unbounded, unbounded, **options)
    derivatives.trace_program()
    threads = [
        threading.Thread(target=task, name=COMPILATION)
        for task in ((lambda: derivatives.advance(1)), (lambda: simulate(point, model)))
    ]
    for thread in threads:
        thread.start()
    return threads
