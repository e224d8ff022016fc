"""Which effect parameters the slots of the compiled programs hold, and the programs with more slots."""

import importlib
import threading
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from smajax.diagnosis.candidates import EffectSet, NonparametricTerm
from smajax.diagnosis.compiled_model import (
    RTOL,
    SLOTS,
    SlottedModel,
    simulate,
    slot_count,
    slotted_model,
    start_compilation,
    start_solver,
    statuses,
)
from smajax.diagnosis.effect_parameters import EffectParameters
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.problem import Problem

# Modules that the refits and intervals of a diagnosis import where they use them.
_NEEDED_LATER = ("scipy.optimize", "scipy.stats")


class SlottedPrograms:
    """The compiled programs of a diagnosis with their data for a set of effects.

    Programs with more than ``SLOTS`` slots are compiled when a set of effects first needs them.

    Args:
        effect_parameters: The parameters of all effects.
    """

    def __init__(self, effect_parameters: EffectParameters):
        self._parameters = effect_parameters
        self._compiled, self._compiling = {SLOTS}, threading.Lock()
        self._threads: list[threading.Thread] = []

    def start_compilation(self, problem: Problem, base: Float[np.ndarray, " p"]) -> None:
        """Compile the usual programs in the background (``compiled_model.start_compilation``).

        Args:
            problem: The problem of a split.
            base: A base vector, shape ``(p,)``.
        """
        empty = EffectSet()
        model, vector = self.model(problem, empty), self.vector(empty, base, ())
        self._threads = start_compilation(model, vector, secant_updates=problem.has_structure)

    def wait_for_compilation(self) -> None:
        """Wait until the usual programs are compiled; what is slow to import and needed later is imported meanwhile."""
        for module in _NEEDED_LATER:
            importlib.import_module(module)
        for thread in self._threads:
            thread.join()

    def start_solver(
        self,
        model: SlottedModel,
        start: Float[np.ndarray, " p"],
        lower: Float[np.ndarray, " p"],
        upper: Float[np.ndarray, " p"],
        rtol: float = RTOL,
    ) -> MultiStartSolver:
        """Set up a search on the compiled programs, without a step (``compiled_model.start_solver``)."""
        return start_solver(model, start, lower, upper, rtol, secant_updates=model.problem.has_structure)

    def model(
        self,
        problem: Problem,
        effect_set: EffectSet,
        free: Sequence[str] = (),
        term: NonparametricTerm | None = None,
    ) -> SlottedModel:
        """Return the data of the compiled programs; waits for the compilation of programs with more slots.

        Args:
            problem: The problem of a split.
            effect_set: The effects with their values.
            free: Names of the effect parameters that the first slots move.
            term: A nonparametric term, whose nodes are in the following slots.
        """
        own = self._parameters
        scales = [(name, own.scale(name)) for name in free]
        model = slotted_model(problem, (own.names, own.values), effect_set, scales, term)
        slots = model.slot_matrix.shape[1]
        with self._compiling:  # searches run two at a time
            if slots not in self._compiled:
                vector = self.vector(effect_set, problem.nominal, free, term)
                for thread in start_compilation(model, vector, secant_updates=problem.has_structure):
                    thread.join()
                self._compiled.add(slots)
        return model

    def vector(
        self,
        effect_set: EffectSet,
        base: Float[np.ndarray, " p"],
        free: Sequence[str],
        term: NonparametricTerm | None = None,
        nodes: Float[np.ndarray, " nodes"] | None = None,
    ) -> Float[np.ndarray, " columns"]:
        """Return the vector of the compiled programs: the base vector, then the slots.

        Args:
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.
            free: Names of the effect parameters in the first slots.
            term: A nonparametric term, whose nodes are in the following slots.
            nodes: Values of its nodes; 0 by default.
        """
        values, own = dict(effect_set.values), self._parameters
        slots = [values.get(name, own.value(name)) / own.scale(name) for name in free]
        slots += [0.0] * (term.matrix.shape[1] if term else 0) if nodes is None else list(nodes)
        return np.concatenate([base, slots, np.zeros(slot_count(len(slots)) - len(slots))])

    def report(
        self, problem: Problem, effect_set: EffectSet, base: Float[np.ndarray, " p"]
    ) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " r"]]:
        """Simulate, and check the states of the simulation.

        Args:
            problem: The problem of a split.
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.

        Returns:
            The residual, and the status code of each recording with the limits of a wire (``physical_limits``).
        """
        vector, model = jnp.asarray(self.vector(effect_set, base, ())), self.model(problem, effect_set)
        simulated = simulate(vector, model)
        return np.asarray(simulated.residual), np.asarray(statuses(vector, model, simulated.trajectories))
