"""Greedy forward search for effects on recordings by others.

Fitted on one part, chosen on another, and shown on a third.

Each round adds each effect of the catalogue in turn to the rig, as ``[effects.KEY]``, fits all free parameters
together with its strength and its shapes to the training part, starting from the optimum without it, and scores the
selection part. The best one is accepted if it cuts the RMSE there by more than 5 %. The held-out part is scored
afterwards only, with the models refitted to training and selection part together.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from experiments.common.base import Row, from_elsewhere, say

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

CUT = 0.05  # share of the selection part's RMSE that an effect has to take away
FIRST_STRENGTH = 0.2  # of the typical one, at which a fit with an effect starts


@dataclass(frozen=True)
class Candidate:
    """An effect with the shapes that are fitted with its strength; ``starts`` are the shapes' values to start from."""

    key: str
    shapes: tuple[str, ...]
    starts: tuple[Mapping[str, float], ...]

    @property
    def label(self) -> str:
        """The effect's key, with its shapes where not all of them are usually free."""
        usual = tuple(name for name, _ in catalogue()[self.key].shapes)
        return self.key if self.shapes == usual else f"{self.key} ({', '.join(set(self.shapes) - set(usual))} free)"

    @property
    def names(self) -> tuple[str, ...]:
        """The parameters that a fit with it frees in addition to the rig's own."""
        return tuple(f"effects.{self.key}.{field}" for field in ("strength", *self.shapes))


@dataclass(frozen=True)
class Trial:
    """A set of effects, its fit to the training part, and the RMSE (SI) of the selection part."""

    effects: tuple[Candidate, ...]
    result: FitResult
    error: float


@dataclass(frozen=True)
class Round:
    """All effects that were tried on top of ``before``, best first.

    The first of them was ``accepted`` or nothing was.
    """

    before: Trial
    tried: list[Trial]

    @property
    def accepted(self) -> bool:
        """Whether the best effect cuts the RMSE of the selection part by more than 5 %."""
        return bool(self.tried) and self.tried[0].error < (1.0 - CUT) * self.before.error

    @property
    def equivalents(self) -> list[Trial]:
        """The others whose RMSE on the selection part is within 5 % of the best one's."""
        return [t for t in self.tried[1:] if t.error <= self.tried[0].error / (1.0 - CUT)]


@dataclass(frozen=True)
class Search:
    """What the search runs on.

    The base rig's text, the channel that is fitted, the parts, and the number of steps of a fit.
    """

    text: str
    channel: str
    train: DataSplit
    select: DataSplit
    max_steps: int = 60

    def rig(self, effects: Sequence[Candidate] = ()) -> Rig:
        """The base rig with these effects, their strengths and shapes free."""
        rig = parse_rig(self.text + "".join(f"\n[effects.{c.key}]\n" for c in effects))
        names = tuple(name for c in effects for name in c.names)
        return dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=(*rig.fit.free, *names)))

    def candidates(self, without: Mapping[str, str]) -> list[Candidate]:
        """Effects of the catalogue that this rig can have, without those of drive and heat and without ``without``.

        A shape that the diagnosis holds is free in a second candidate.
        """
        traits = self.rig().plant.capabilities((self.channel,))
        found = []
        for key, kind in catalogue().items():
            if kind.stage in ("drive", "heat") or kind.unavailable_reason(traits) or key in without:
                continue
            usual = tuple(name for name, _ in kind.shapes)
            grid = tuple({name: value} for name, values in kind.shapes[:1] for value in values) or ({},)
            found.append(Candidate(key, usual, grid))
            held = tuple(name for name in declarations(kind) if name != "strength" and name not in usual)
            if held:
                middle = {n: 0.5 * float(declarations(kind)[n].default or 1.0) for n in held}
                found.append(Candidate(key, (*usual, *held), tuple({**start, **middle} for start in grid)))
        return found

    def refit(self, part: DataSplit, effects: Sequence[Candidate], values: Mapping[str, float]) -> FitResult | None:
        """Best fit of a set of effects to a part, from ``values`` and from each start of the last effect's shapes.

        Parameters that ``values`` lacks start at the rig's values. ``None`` if the simulation fails at all starts.
        """
        rig, fits = self.rig(effects), []
        last = effects[-1] if effects else None
        new = last is not None and f"effects.{last.key}.strength" not in values
        for start in last.starts if last and new else ({},):
            begin = dict(values)
            if last and new:
                begin[f"effects.{last.key}.strength"] = FIRST_STRENGTH * catalogue()[last.key].typical
                begin |= {f"effects.{last.key}.{name}": value for name, value in start.items()}
            try:
                settings = dataclasses.replace(rig.fit, starts=1)
                fits.append(
                    fit(parameters.replace(rig.plant, begin), list(part.recordings), settings, max_steps=self.max_steps)
                )
            except NumericsError as error:
                say(f"{last.label if last else 'base'}: {error}")
        return min(fits, key=lambda f: f.cost) if fits else None

    def error(self, plant: Plant, part: DataSplit) -> float:
        """RMSE of a part in SI."""
        return rms(residual(plant, part, self.channel))

    def rounds(self, base: FitResult, candidates: Sequence[Candidate], limit: int) -> list[Round]:
        """The rounds of the search from a base model that is fitted to the training part.

        The last one may have accepted nothing.
        """
        now, rounds = Trial((), base, self.error(base.plant, self.select)), []
        say(f"base: selection part {now.error:.5g}")
        while len(rounds) < limit:
            there = {c.key for c in now.effects}
            tried = []
            for candidate in candidates:
                if candidate.key in there:
                    continue
                effects = (*now.effects, candidate)
                result = self.refit(self.train, effects, estimates(now.result))
                if result is not None:
                    tried.append(Trial(effects, result, self.error(result.plant, self.select)))
                    say(f"{' + '.join(c.label for c in effects)}: selection part {tried[-1].error:.5g}")
            rounds.append(Round(now, sorted(tried, key=lambda t: t.error if np.isfinite(t.error) else np.inf)))
            if not rounds[-1].accepted:
                break
            now = rounds[-1].tried[0]
        return rounds


@dataclass(frozen=True)
class Outcome:
    """Rounds, fits of the base model from several starts, and fits of the growing sets with holdout residuals."""

    rounds: list[Round]
    bases: list[FitResult]
    fits: list[FitResult]
    left: list[np.ndarray]

    def labels(self) -> list[str]:
        """What each fit adds."""
        return ["base model", *(f"and {c[-1].label}" for c in chosen(self.rounds))][: len(self.fits)]


def close_loop(
    search: Search,
    fitted: DataSplit,
    held: DataSplit,
    candidates: Sequence[Candidate],
    *,
    rounds: int,
    starts: int,
    times: int,
) -> Outcome:
    """Choose effects in ``rounds``, fit the base model and the chosen sets to ``fitted``, and predict ``held``.

    Base models are fitted from ``starts`` points each; that to ``fitted`` so many ``times`` from elsewhere.
    """
    rig = search.rig()
    settings = dataclasses.replace(rig.fit, starts=starts)
    say("fitting the base model to the training part")
    base = from_elsewhere(rig, search.train.recordings, settings, 1, max_steps=search.max_steps)[0]
    tried = search.rounds(base, candidates, rounds)
    say("fitting the base model to training and selection part")
    bases = from_elsewhere(rig, fitted.recordings, settings, times, max_steps=search.max_steps)
    fits = chain(search, fitted, bases[0], chosen(tried))
    return Outcome(tried, bases, fits, [residual(f.plant, held, search.channel) for f in fits])


def path_of(name: str, rows: np.ndarray, channels: Mapping[str, np.ndarray]) -> Recording:
    """Rows of a recording without a clock as a path whose time is the row number.

    Temperature in degC, stress in Pa, strain.
    """
    path = Recording.from_arrays(name, None, channels, {"temperature": "degC", "stress": "MPa", "strain": "%"})
    return dataclasses.replace(path, time=rows.astype(float))


def scored(part: DataSplit) -> int:
    """Number of rows that count."""
    return sum(map(len, part.rows()))


def estimates(result: FitResult) -> dict[str, float]:
    """A fit's shared parameters by name."""
    return {e.name: e.estimate for e in result.estimates if "@" not in e.name}


def residual(plant: Plant, part: DataSplit, channel: str) -> np.ndarray:
    """Measured minus modelled in the rows of a part that count, SI, one recording after the other."""
    count = len(part.recordings)
    responses, _ = simulate_responses(
        [plant] * count, list(part.recordings), ["holdout"] * count, (channel,), "hold", None
    )
    return np.concatenate([r.residual(channel)[rows] for r, rows in zip(responses, part.rows(), strict=True)])


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(values**2)))


def chosen(rounds: Sequence[Round]) -> list[tuple[Candidate, ...]]:
    """The sets of effects that were accepted, one after the other."""
    return [r.tried[0].effects for r in rounds if r.accepted]


def chain(search: Search, fitted: DataSplit, base: FitResult, sets: Sequence[tuple[Candidate, ...]]) -> list[FitResult]:
    """Fits of the base model and of the growing sets of effects, each from the optimum of the one before."""
    fits = [base]
    for effects in sets:
        result = search.refit(fitted, effects, estimates(fits[-1]))
        if result is None:
            break
        fits.append(result)
        say(f"refitted with {' + '.join(c.label for c in effects)}: cost {result.cost:.6g}")
    return fits


def round_rows(rounds: Sequence[Round], show: Callable[[float], str]) -> list[Row]:
    """One line for each round: what was tried, and how each effect did on the selection part."""
    rows = []
    for k, each in enumerate(rounds, 1):
        tried = ", ".join(f"{t.effects[-1].label} {show(t.error)}" for t in each.tried)
        numbers = {"before": each.before.error, "after": {t.effects[-1].label: t.error for t in each.tried}}
        rows.append(Row(f"round {k}: selection part from {show(each.before.error)} to", "-", tried, None, numbers))
        if each.accepted:
            same = ", ".join(t.effects[-1].label for t in each.equivalents) or "none"
            rows.append(
                Row(f"round {k}: accepted is {each.tried[0].effects[-1].label}; as good within 5 %", "-", same, None)
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
