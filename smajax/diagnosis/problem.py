"""The diagnosis problem: the plant with every effect that its rig could have, and the recordings on grids of one shape.

Fits, scores, refits and predictions all run on the same compiled programs (``compiled_model``).
"""

import dataclasses
import math
import threading
from collections.abc import Collection, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.diagnosis.candidates import EffectSet, NonparametricTerm, Refit, RefitSearch
from smajax.diagnosis.compiled_model import SLOTS, simulate, slot_count
from smajax.diagnosis.data_split import TRAIN, DataSplit, changing_surroundings, check_complete
from smajax.diagnosis.effect_parameters import EffectParameters, effect_kinds, possible_effects
from smajax.diagnosis.nonparametric import zero_terms
from smajax.diagnosis.problem_layout import GriddedSplits, with_weights
from smajax.diagnosis.screening import Score, score_test
from smajax.diagnosis.slotted_programs import SlottedPrograms
from smajax.errors import InputError
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartResult
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.unknowns import Settings
from smajax.numerics.stored_programs import stored
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import Inputs
from smajax.simulation.run import simulate_states
from smajax.simulation.status import SimulationStatus

# Largest number of steps on all samples after a search on some of them, which has come near the optimum. Chosen by
# trial.
_STEPS_ON_ALL_SAMPLES = 8
# Largest number of steps for the own parameters of recordings outside of the training split; these are few and start at
# the rig's values. Chosen by trial.
_ANCHOR_STEPS = 15

_states = stored(simulate_states)


class DiagnosisProblem(GriddedSplits):
    """A rig's plant with all possible effects, and its recordings on grids of one shape.

    A *base vector* holds the rig's free parameters, then the own parameters of each training recording, shape ``(p,)``.
    A *residual* is measurement minus model over the noise at all samples of a split, shape ``(m,)``.

    Attributes:
        base_problem: Fit problem of the rig as its file describes it, on the training split.
        effects: All effects that the rig has or could have, by key. Candidates are those that are not in
            ``modelled_effects``.
        modelled_effects: Keys of the effects of the rig file, which stay in the model and are fitted where free.
        effect_kinds: Classes of all effects of the catalogue and of the plant, by key.
        capabilities: What the rig can have and show (``Plant.capabilities``).
        duration: Length of the longest training recording, s.
        simulations: Number of simulations so far.

    Args:
        plant: The plant of the rig file.
        splits: Training, selection and holdout split, in this order; a recording alone is a split.
        settings: The fit settings of the rig file.
        interpolation: How inputs are interpolated (``discretise``); as in the plant by default.
        step: Length of the steps, s; ``None`` for the default.
        candidates: Keys of the effects that are candidates; by default all that the rig could have.

    Raises:
        InputError: If start values are free, or a recording has rows without a value of an observed channel.
    """

    def __init__(
        self,
        plant: Plant,
        splits: Sequence[DataSplit | Recording],
        settings: Settings,
        *,
        interpolation: str | None = None,
        step: float | None = None,
        candidates: Collection[str] | None = None,
    ):
        if settings.initial:
            raise InputError("a diagnosis takes no free start values: leave out fit.initial")
        splits = [DataSplit((s,)) if isinstance(s, Recording) else s for s in splits]
        check_complete(splits, settings.observe)
        train = splits[TRAIN].recordings
        without_clock = set() if all(r.has_clock for r in train) else {"clock"}
        recorded = (*settings.observe, *changing_surroundings(splits))
        self.capabilities: frozenset[str] = plant.capabilities(recorded) - without_clock
        self.duration: float = max(float(r.time[-1] - r.time[0]) for r in train)
        self.effect_kinds: dict[str, type[AbstractEffect]] = effect_kinds(plant)
        modelled, effects = possible_effects(plant, settings.free, train, self.capabilities, candidates)
        self.modelled_effects: tuple[str, ...] = modelled
        self.effects: dict[str, AbstractEffect] = effects
        augmented = dataclasses.replace(plant, effects=(*self.effects.values(), *zero_terms()))
        self.effect_parameters: EffectParameters = EffectParameters(self.effects, augmented, self.duration)
        super().__init__(augmented, splits, settings, {"interpolation": interpolation, "step": step})
        base = build_problem(plant, train, settings, interpolation=interpolation, step=step)
        self.base_problem: Problem = with_weights(base, splits[TRAIN].rows(), self.noise)
        self.simulations: int = 0
        self._counting = threading.Lock()
        self._programs = SlottedPrograms(self.effect_parameters)
        self._programs.start_compilation(self.problems[TRAIN], self.nominal)

    def wait_for_compilation(self) -> None:
        """Wait until the large programs are compiled."""
        self._programs.wait_for_compilation()

    def count_simulations(self, count: int) -> None:
        """Add to the number of simulations; safe in threads."""
        with self._counting:  # searches run two at a time
            self.simulations += count

    @property
    def size(self) -> int:
        """Length of the base vector."""
        return len(self.nominal)

    def padded(self, point: np.ndarray) -> np.ndarray:
        """Return the base vector of a point of ``base_problem``, which has no entries for padding recordings."""
        return np.append(point, self.nominal[len(point) :])

    def plausible_range(self, key: str) -> tuple[float, float]:
        """Return the lowest and highest plausible strength of an effect in units of the typical strength."""
        return self.effect_parameters.plausible_range(key)

    def shape_grid(self, key: str) -> list[tuple[tuple[str, float], ...]]:
        """Return the shapes at which an effect is tried: names and values of its shape parameters, SI."""
        return self.effect_parameters.shape_grid(key)

    def free_effect_parameters(self, effect_set: EffectSet) -> list[str]:
        """Return the names of the parameters that a fit frees: all strengths, then all shapes."""
        return self.effect_parameters.free(effect_set)

    def holds_parameters(self, refit: Refit) -> bool:
        """Return whether a refit has held some of its effects' parameters, as a search among candidates may."""
        return refit.jacobian.shape[1] - self.size < len(self.free_effect_parameters(refit.effect_set))

    def vector_bounds(self, free: Sequence[str], *, jointly: bool = False) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper bounds of the base vector followed by effect parameters in units of their scales.

        Args:
            free: Names of the effect parameters.
            jointly: Whether the fit is one to training and selection split together.
        """
        (lower, upper), base = self.effect_parameters.bounds(free), self.joint_bounds if jointly else self.bounds
        return np.append(base[0], lower), np.append(base[1], upper)

    def score_effect(self, key: str, basis: np.ndarray, residual: np.ndarray, sensitivity: np.ndarray) -> Score:
        """Run the score test of one effect (``screening.score_test``).

        Args:
            key: Key of the effect.
            basis: Orthonormal basis of the free parameters' Jacobian, shape ``(m, rank)``.
            residual: Projected residual, shape ``(m,)``.
            sensitivity: Sensitivity of the effect, shape ``(m,)``, not projected.
        """
        return score_test(basis, residual, sensitivity, self.plausible_range(key), self.effects[key].absorbed_from)

    def fitted_plant(self, refit: Refit) -> Plant:
        """Return the plant with a refit's parameters and effects, without each recording's own parameters."""
        shared, _ = self.problems[TRAIN].values(jnp.asarray(refit.base))
        keys = refit.effect_set.keys
        effects = tuple(self.effects[key] for key in (*self.modelled_effects, *keys))
        plant = dataclasses.replace(self.base_problem.plant, effects=effects)
        values = {name: value for name, value in refit.values.items() if name.split(".")[1] in keys}
        return parameters.replace(plant, {**shared, **values}, ordered=False)

    def states(self, refit: Refit, inputs: Inputs) -> Any:
        """Simulate the plant without effects at a refit's parameters.

        Args:
            refit: The refit.
            inputs: Inputs of one recording, of the problem's shapes.

        Returns:
            The states at all samples.
        """
        return _states(dataclasses.replace(self.fitted_plant(refit), effects=()), inputs)[0]

    def fit(
        self,
        effect_set: EffectSet,
        base: np.ndarray,
        *,
        max_steps: int = 25,
        rtol: float = 1e-5,
        term: NonparametricTerm | None = None,
        stride: int = 1,
    ) -> Refit:
        """Fit a set of effects to the training split, from a base vector and the set's own values.

        All parameters of the effects are free.

        Args:
            effect_set: The effects, with start values of their parameters.
            base: Start of the base vector, shape ``(p,)``.
            max_steps: Largest number of steps.
            rtol: Relative fall of the cost at which the search ends.
            term: A nonparametric term that is fitted as well.
            stride: Distance of the samples that are used (``strided_problem``).
        """
        free = tuple(self.free_effect_parameters(effect_set))
        search = self.start_search(effect_set, base, free=free, rtol=rtol, term=term, stride=stride)
        return self.refit_from(search.advance(max_steps))

    def start_search(
        self,
        effect_set: EffectSet,
        base: np.ndarray,
        *,
        free: tuple[str, ...] | None = None,
        rtol: float = 1e-6,
        term: NonparametricTerm | None = None,
        near_nominal: bool = False,
        hold_shapes: bool = False,
        stride: int = 1,
    ) -> RefitSearch:
        """Set up the search of ``fit`` without a step.

        Args:
            effect_set: The effects, with start values of their parameters.
            base: Start of the base vector, shape ``(p,)``.
            free: Names of the effect parameters that the search moves; by default the first of
                ``free_effect_parameters``, as many as the usual program has slots.
            rtol: Relative fall of the cost at which the search ends.
            term: A nonparametric term that is fitted as well.
            near_nominal: Bound the base parameters to the search box around the rig's own values.
            hold_shapes: Hold the effects' shapes at their start values.
            stride: Distance of the samples that are used (``strided_problem``).
        """
        names, own = self.free_effect_parameters(effect_set), self.effect_parameters
        effect_set = effect_set.with_values({n: own.value(n) for n in names} | dict(effect_set.values))
        free = tuple(names[:SLOTS]) if free is None else free
        nodes = term.matrix.shape[1] if term else 0
        padding = np.zeros(slot_count(len(free) + nodes) - len(free))
        lower, upper = (np.append(side, padding) for side in self.vector_bounds(free))
        if near_nominal:
            lower[: self.size], upper[: self.size] = map(self.padded, self.base_problem.search_bounds())
        first_node = self.size + len(free)
        lower[first_node:][:nodes], upper[first_node:][:nodes] = -math.inf, math.inf
        problem = self.strided_problem(stride)
        stride = 1 if problem is self.problems[TRAIN] else stride
        model = self._programs.model(problem, effect_set, free, term)
        start = self._programs.vector(effect_set, base, free, term)
        if hold_shapes:
            shapes = slice(self.size + len(effect_set.keys), self.size + len(free))
            lower[shapes] = upper[shapes] = start[shapes]
        solver = self._programs.start_solver(model, start, lower, upper, rtol=rtol)
        return RefitSearch(solver, effect_set, free, term, stride, near_nominal, rtol, self.count_simulations)

    def continue_on_all_samples(self, search: RefitSearch, steps: int = _STEPS_ON_ALL_SAMPLES) -> RefitSearch:
        """Continue a search that uses some of the samples with all of them.

        Args:
            search: The search; one that uses all samples is returned as it is.
            steps: Largest number of steps.
        """
        if search.stride == 1:
            return search
        effect_set, base, _ = self._end_of(search)
        options = {"near_nominal": search.near_nominal, "rtol": search.rtol}
        return self.start_search(effect_set, base, free=search.free, **options).advance(steps)

    def refit_from(self, search: RefitSearch) -> Refit:
        """Return the refit at the end of a search, with residual and Jacobian of all samples."""
        effect_set, base, result = self._end_of(search)
        columns = self.size + len(search.free)
        nodes = result.points[0][columns:][: search.term.matrix.shape[1] if search.term else 0]
        if search.stride == 1 and result.updates[0] == 0:
            residual, jacobian = result.residuals[0], result.jacobians[0]
        else:
            residual, jacobian = self.evaluate(effect_set, base, TRAIN, search.free, search.term, nodes)
        status = result.statuses[0] if np.all(np.isfinite(residual)) else SolverStatus.failed
        return Refit(effect_set, base, residual, jacobian[:, :columns], status, nodes)

    def _end_of(self, search: RefitSearch) -> tuple[EffectSet, np.ndarray, MultiStartResult]:
        """The effects and the base vector at the current point of a search, and the solver's result."""
        result = search.solver.result()
        point, scale = result.points[0], self.effect_parameters.scale
        values = {name: float(point[self.size + j] * scale(name)) for j, name in enumerate(search.free)}
        return search.effect_set.with_values(values), point[: self.size], result

    def evaluate(
        self,
        effect_set: EffectSet,
        base: np.ndarray,
        split: int,
        free: Sequence[str] = (),
        term: NonparametricTerm | None = None,
        nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute residual and Jacobian on a split.

        Args:
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.
            split: Position of the split.
            free: Names of the effect parameters to differentiate with respect to.
            term: A nonparametric term that is added.
            nodes: Values of its nodes; 0 by default.

        Returns:
            The residual, shape ``(m,)``, NaN if the simulation fails, and its derivatives with respect to the base
            vector, the parameters ``free`` in units of their scales, and the nodes, shape ``(m, columns)``.
        """
        base, problem = self._base_on(effect_set, base, split), self.problems[split]
        return self.evaluate_on(problem, effect_set, base, free, term, nodes)

    def evaluate_on(
        self,
        problem: Problem,
        effect_set: EffectSet,
        base: np.ndarray,
        free: Sequence[str] = (),
        term: NonparametricTerm | None = None,
        nodes: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute residual and Jacobian as ``evaluate`` does, on a problem of the same shapes.

        Args:
            problem: The problem, such as a strided one.
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.
            free: Names of the effect parameters to differentiate with respect to.
            term: A nonparametric term that is added.
            nodes: Values of its nodes; 0 by default.
        """
        columns = self.size + len(free) + (term.matrix.shape[1] if term else 0)
        start = self._programs.vector(effect_set, base, free, term, nodes)
        unbounded = np.full(len(start), math.inf)
        model = self._programs.model(problem, effect_set, free, term)
        result = self._programs.start_solver(model, start, -unbounded, unbounded).advance(1).result()
        self.count_simulations(result.simulations)
        failed = result.statuses[0] is SolverStatus.failed
        return np.where(failed, math.nan, result.residuals[0]), result.jacobians[0][:, :columns]

    def predict(self, effect_set: EffectSet, base: np.ndarray, split: int) -> np.ndarray:
        """Compute the residual on a split without derivatives, shape ``(m,)``; all NaN if the simulation fails.

        Args:
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.
            split: Position of the split.
        """
        return self.predict_on(self.problems[split], effect_set, self._base_on(effect_set, base, split))

    def report(self, refit: Refit, split: int) -> tuple[np.ndarray, SimulationStatus]:
        """Compute the residual of a refit on a split for tables and figures, which have no impossible numbers.

        Returns:
            The residual, shape ``(m,)``, all NaN if a simulation fails, and the largest status code.
        """
        base = self._base_on(refit.effect_set, refit.base, split)
        residual, codes = self._programs.report(self.problems[split], refit.effect_set, base)
        self.count_simulations(1)
        status = SimulationStatus(int(np.max(codes)))
        return residual if status is SimulationStatus.done else np.full(len(residual), math.nan), status

    def predict_on(
        self,
        problem: Problem,
        effect_set: EffectSet,
        base: np.ndarray,
        free: Sequence[str] = (),
        term: NonparametricTerm | None = None,
        nodes: np.ndarray | None = None,
    ) -> np.ndarray:
        """Compute the residual as ``predict`` does, on a problem of the same shapes.

        Args:
            problem: The problem, such as a strided one.
            effect_set: The effects with their values.
            base: The base vector, shape ``(p,)``.
            free: Names of the effect parameters that slots hold, where there is a term.
            term: A nonparametric term that is added.
            nodes: Values of its nodes; 0 by default.
        """
        start = jnp.asarray(self._programs.vector(effect_set, base, free, term, nodes))
        residual = np.asarray(simulate(start, self._programs.model(problem, effect_set, free, term)).residual)
        self.count_simulations(1)
        return residual if math.isfinite(float(residual @ residual)) else np.full(len(residual), math.nan)

    def _base_on(self, effect_set: EffectSet, base: np.ndarray, split: int) -> np.ndarray:
        """The base vector on a split: shared parameters of ``base``, own ones fitted to the anchor rows."""
        if split == TRAIN or not self.own_count:
            return base
        start, lower, upper = (
            np.concatenate([base[: self.shared_count], own[self.shared_count :], np.zeros(SLOTS)])
            for own in self._vector_bounds[split]
        )
        problem = with_weights(self.problems[split], self.splits[split].anchor_rows(), self.noise)
        model = self._programs.model(problem, effect_set)
        result = self._programs.start_solver(model, start, lower, upper).advance(_ANCHOR_STEPS).result()
        self.count_simulations(result.simulations)
        return result.points[0][: self.size]
