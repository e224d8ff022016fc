"""Greedy forward search for effects on recordings by others: fitted on one part, chosen on another, scored on a third.

Each round adds each effect of the catalogue in turn to the rig, as ``[effects.KEY]``. All free parameters are fitted
to the training part, together with the effect's strength and shapes, from the optimum without it; then the selection
part is scored. The best effect is accepted if it cuts the RMSE there by more than 5 %. The held-out part is scored
only afterwards, with the models refitted to training and selection part together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from experiments.common.base import Row, fit_from_starts, say

import numpy as np

from smajax import parameters
from smajax.diagnosis.data_split import DataSplit
from smajax.errors import NumericsError
from smajax.files.rig_file import Rig, parse_rig
from smajax.fitting.fit import fit
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import FitResult
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording

MIN_CUT = 0.05  # relative cut of the selection part's RMSE that an effect must reach
FIRST_STRENGTH = 0.2  # start value of a fit, in typical strengths


@dataclass(frozen=True)
class Candidate:
    """An effect, and the shapes that are fitted with its strength.

    Attributes:
        key: Key of the effect.
        shapes: Names of its shapes that are fitted.
        starts: Start values of these shapes.
    """

    key: str
    shapes: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...]

    @property
    def label(self) -> str:
        """The effect's key, with the shapes that are free in addition to the usual ones."""
        standard = tuple(name for name, _ in catalogue()[self.key].shapes)
        return (
            self.key if self.shapes == standard else f"{self.key} ({', '.join(set(self.shapes) - set(standard))} free)"
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that a fit with the effect frees in addition to the rig's own."""
        return tuple(f"effects.{self.key}.{field}" for field in ("strength", *self.shapes))


@dataclass(frozen=True)
class Trial:
    """A set of effects.

    Attributes:
        effects: The effects.
        result: The fit to the training part.
        error: RMSE of the selection part, SI.
    """

    effects: tuple[Candidate, ...]
    result: FitResult
    error: float


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes:
        before: The set of effects that the round starts from.
        trials: The sets with one more effect, best first.
    """

    before: Trial
    trials: list[Trial]

    @property
    def accepted(self) -> bool:
        """Whether the best effect cuts the RMSE of the selection part by more than 5 %."""
        return bool(self.trials) and self.trials[0].error < (1.0 - MIN_CUT) * self.before.error

    @property
    def equivalents(self) -> list[Trial]:
        """The other trials whose RMSE on the selection part is within 5 % of the best one's."""
        return [t for t in self.trials[1:] if t.error <= self.trials[0].error / (1.0 - MIN_CUT)]


@dataclass(frozen=True)
class Search:
    """The data and settings of a search.

    Attributes:
        text: Text of the base rig file.
        channel: The channel that is fitted.
        train: Training part.
        select: Selection part.
        max_steps: Largest number of steps of a fit.
    """

    text: str
    channel: str
    train: DataSplit
    select: DataSplit
    max_steps: int = 60

    def rig(self, effects: Sequence[Candidate] = ()) -> Rig:
        """Return the base rig with some effects, their strengths and shapes free."""
        rig = parse_rig(self.text + "".join(f"\n[effects.{c.key}]\n" for c in effects))
        names = tuple(name for c in effects for name in c.names)
        return dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=(*rig.fit.free, *names)))

    def candidates(self, excluded: Mapping[str, str]) -> list[Candidate]:
        """Return the effects of the catalogue that this rig can have.

        Effects of drive and heat and those of ``excluded`` are left out. Shapes that the diagnosis keeps fixed are free
        in a
        second candidate.
        """
        capabilities = self.rig().plant.capabilities((self.channel,))
        candidates = []
        for key, kind in catalogue().items():
            if kind.stage in ("drive", "heat") or kind.unavailable_reason(capabilities) or key in excluded:
                continue
            standard = tuple(name for name, _ in kind.shapes)
            grid = tuple({name: value} for name, values in kind.shapes[:1] for value in values) or ({},)
            candidates.append(Candidate(key, standard, grid))
            held_shapes = tuple(name for name in declarations(kind) if name != "strength" and name not in standard)
            if held_shapes:
                middles = {n: 0.5 * float(declarations(kind)[n].default or 1.0) for n in held_shapes}
                candidates.append(
                    Candidate(key, (*standard, *held_shapes), tuple({**start, **middles} for start in grid))
                )
        return candidates

    def refit(self, part: DataSplit, effects: Sequence[Candidate], values: Mapping[str, float]) -> FitResult | None:
        """Fit a set of effects to a part, from ``values`` and each start of the last effect's shapes.

        Args:
            part: The part that is fitted.
            effects: The effects.
            values: Start values by name; other parameters start at the rig's values.

        Returns:
            The best fit, ``None`` if the simulation fails at all starts.
        """
        rig, fits = self.rig(effects), []
        last = effects[-1] if effects else None
        is_new = last is not None and f"effects.{last.key}.strength" not in values
        for start in last.starts if last and is_new else ({},):
            start_values = dict(values)
            if last and is_new:
                start_values[f"effects.{last.key}.strength"] = FIRST_STRENGTH * catalogue()[last.key].typical
                start_values |= {f"effects.{last.key}.{name}": value for name, value in start.items()}
            try:
                settings = dataclasses.replace(rig.fit, starts=1)
                fits.append(
                    fit(
                        parameters.replace(rig.plant, start_values),
                        list(part.recordings),
                        settings,
                        max_steps=self.max_steps,
                    )
                )
            except NumericsError as error:
                say(f"{last.label if last else 'base'}: {error}")
        return min(fits, key=lambda f: f.cost) if fits else None

    def error(self, plant: Plant, part: DataSplit) -> float:
        """Return the RMSE of a part, SI."""
        return rms(residual(plant, part, self.channel))

    def rounds(self, base: FitResult, candidates: Sequence[Candidate], limit: int) -> list[Round]:
        """Run the rounds of the search.

        Args:
            base: Fit of the base model to the training part.
            candidates: The effects that are tried.
            limit: Largest number of rounds.

        Returns:
            The rounds; the last one may have accepted nothing.
        """
        current = Trial((), base, self.error(base.plant, self.select))
        rounds = []
        say(f"base: selection part {current.error:.5g}")
        while len(rounds) < limit:
            keys = {c.key for c in current.effects}
            trials = []
            for candidate in candidates:
                if candidate.key in keys:
                    continue
                effects = (*current.effects, candidate)
                result = self.refit(self.train, effects, estimates(current.result))
                if result is not None:
                    trials.append(Trial(effects, result, self.error(result.plant, self.select)))
                    say(f"{' + '.join(c.label for c in effects)}: selection part {trials[-1].error:.5g}")
            rounds.append(Round(current, sorted(trials, key=lambda t: t.error if np.isfinite(t.error) else np.inf)))
            if not rounds[-1].accepted:
                break
            current = rounds[-1].trials[0]
        return rounds


@dataclass(frozen=True)
class Outcome:
    """The result of a search.

    Attributes:
        rounds: The rounds.
        bases: Fits of the base model from several starts, the best first.
        fits: Fits of the base model and of the growing sets of effects.
        residuals: Residuals of these fits in the held-out part, SI.
    """

    rounds: list[Round]
    bases: list[FitResult]
    fits: list[FitResult]
    residuals: list[np.ndarray]

    def labels(self) -> list[str]:
        """Return what each fit adds."""
        return ["base model", *(f"and {c[-1].label}" for c in accepted_sets(self.rounds))][: len(self.fits)]


def search_and_predict(
    search: Search,
    fitted: DataSplit,
    held_out: DataSplit,
    candidates: Sequence[Candidate],
    *,
    rounds: int,
    starts: int,
    times: int,
) -> Outcome:
    """Select effects, fit the base model and the selected sets, and predict the held-out part.

    Args:
        search: Data and settings of the search.
        fitted: Training and selection part together.
        held_out: Held-out part.
        candidates: The effects that are tried.
        rounds: Largest number of rounds.
        starts: Start points of each fit of a base model.
        times: Number of such fits to ``fitted``, from points drawn over the search box.
    """
    rig = search.rig()
    settings = dataclasses.replace(rig.fit, starts=starts)
    say("fitting the base model to the training part")
    base = fit_from_starts(rig, search.train.recordings, settings, 1, max_steps=search.max_steps)[0]
    search_rounds = search.rounds(base, candidates, rounds)
    say("fitting the base model to training and selection part")
    bases = fit_from_starts(rig, fitted.recordings, settings, times, max_steps=search.max_steps)
    fits = refit_growing_sets(search, fitted, bases[0], accepted_sets(search_rounds))
    return Outcome(search_rounds, bases, fits, [residual(f.plant, held_out, search.channel) for f in fits])


def path_recording(name: str, rows: np.ndarray, channels: Mapping[str, np.ndarray]) -> Recording:
    """Return rows of a recording without a clock as a path whose time is the row number.

    Args:
        name: Name of the recording.
        rows: Row numbers, shape ``(n,)``.
        channels: Temperature in degC, stress in Pa, and strain.
    """
    path = Recording.from_arrays(name, None, channels, {"temperature": "degC", "stress": "MPa", "strain": "%"})
    return dataclasses.replace(path, time=rows.astype(float))


def count_scored_rows(part: DataSplit) -> int:
    """Return the number of rows that are scored."""
    return sum(map(len, part.rows()))


def estimates(result: FitResult) -> dict[str, float]:
    """Return a fit's shared parameters by name."""
    return {e.name: e.estimate for e in result.estimates if "@" not in e.name}


def residual(plant: Plant, part: DataSplit, channel: str) -> np.ndarray:
    """Return measured minus modelled values in the scored rows of a part, SI, one recording after the other.

    Args:
        plant: The plant.
        part: The part.
        channel: The channel.
    """
    count = len(part.recordings)
    responses, _ = simulate_responses(
        [plant] * count, list(part.recordings), ["holdout"] * count, (channel,), "hold", None
    )
    return np.concatenate([r.residual(channel)[rows] for r, rows in zip(responses, part.rows(), strict=True)])


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def accepted_sets(rounds: Sequence[Round]) -> list[tuple[Candidate, ...]]:
    """Return the sets of effects that were accepted, in order."""
    return [r.trials[0].effects for r in rounds if r.accepted]


def refit_growing_sets(
    search: Search, fitted: DataSplit, base: FitResult, sets: Sequence[tuple[Candidate, ...]]
) -> list[FitResult]:
    """Fit the growing sets of effects, each from the optimum of the one before.

    Args:
        search: Data and settings of the search.
        fitted: The part that is fitted.
        base: Fit of the base model.
        sets: The sets of effects.

    Returns:
        The fit of the base model, and one for each set up to the first that fails.
    """
    fits = [base]
    for effects in sets:
        result = search.refit(fitted, effects, estimates(fits[-1]))
        if result is None:
            break
        fits.append(result)
        say(f"refitted with {' + '.join(c.label for c in effects)}: cost {result.cost:.6g}")
    return fits


def round_rows(rounds: Sequence[Round], format_error: Callable[[float], str]) -> list[Row]:
    """Return the rows of the rounds: the effects that were tried, and their errors on the selection part."""
    rows = []
    for k, search_round in enumerate(rounds, 1):
        trial_texts = ", ".join(f"{t.effects[-1].label} {format_error(t.error)}" for t in search_round.trials)
        numbers = {
            "before": search_round.before.error,
            "after": {t.effects[-1].label: t.error for t in search_round.trials},
        }
        rows.append(
            Row(
                f"round {k}: selection part from {format_error(search_round.before.error)} to",
                "-",
                trial_texts,
                None,
                numbers,
            )
        )
        if search_round.accepted:
            equivalents = ", ".join(t.effects[-1].label for t in search_round.equivalents) or "none"
            rows.append(
                Row(
                    f"round {k}: accepted is {search_round.trials[0].effects[-1].label}; as good within 5 %",
                    "-",
                    equivalents,
                    None,
                )
            )
        else:
            rows.append(
                Row(
                    f"round {k}: nothing is accepted",
                    "-",
                    "no effect cuts the selection part's RMSE by more than 5 %",
                    None,
                )
            )
    return rows
