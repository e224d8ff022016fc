"""Error budgets of measured recordings: a naive forecast, the base model, with cells and grains, with effects."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass

from experiments.common.base import Row, say
from experiments.common.effect_trace import TraceResult, trace_effects

import numpy as np

from smajax.diagnosis.data_split import DataSplit
from smajax.diagnosis.structure import APPROXIMATIONS, SPREADS, with_structure
from smajax.files.rig_file import Rig
from smajax.plant.effects import catalogue

# Cells along a wire and grains in each: fewer than in a diagnosis, since fits start from several points.
CELLS, GRAINS = 7, 5


@dataclass(frozen=True)
class Entry:
    """One entry of an error budget.

    Attributes:
        model: What is predicted with.
        fitted: RMSE of the fitted part, in the unit of the budget; NaN where nothing is fitted.
        held_out: RMSE of the held-out part.
    """

    model: str
    fitted: float
    held_out: float


@dataclass(frozen=True)
class Budget:
    """The error budget of a channel of a recording.

    Attributes:
        recording: Name of the recording, with the part that is held out.
        channel: The channel.
        unit: Unit of the errors.
        entries: Entries in the order in which they are added.
        best: Name of the entry that the target holds for.
        target: Largest error of the held-out part that a small model by others reached; ``None`` for no target.
        noise: Noise of the channel, where it is known.
    """

    recording: str
    channel: str
    unit: str
    entries: tuple[Entry, ...]
    best: str
    target: float | None = None
    noise: float | None = None

    def rows(self) -> list[Row]:
        """Return a row for each entry, and one for the noise."""
        rows = []
        for entry in self.entries:
            fitted = "-" if np.isnan(entry.fitted) else f"{entry.fitted:.3g}"
            target, met = "-", None
            if entry.model == self.best and self.target is not None:
                target, met = f"<= {self.target:.3g} {self.unit}", entry.held_out <= self.target
            measured = f"{fitted} / {entry.held_out:.3g} {self.unit}"
            numbers = {"fitted": entry.fitted, "held_out": entry.held_out, "unit": self.unit}
            rows.append(Row(f"{self.recording}, {self.channel}: {entry.model}", target, measured, met, numbers))
        noise = "not known" if self.noise is None else f"{self.noise:.3g} {self.unit}"
        return [*rows, Row(f"{self.recording}, {self.channel}: noise", "-", noise, None, {"noise": self.noise})]


@dataclass(frozen=True)
class Subject:
    """A recording on a path, whose temperature is prescribed, as it is diagnosed.

    Attributes:
        name: Name of the recording, with the part that is held out.
        rig: The rig.
        parts: Training part, selection part and held-out part.
        fitted: Training and selection part together.
        channel: The observed channel.
        unit: Unit of the errors.
        factor: That unit over the internal one.
        naive: The naive forecast in words, and its error in that unit.
        target: Largest error of the held-out part that a small model by others reached.
        excluded: Keys of effects that the recording cannot show.
    """

    name: str
    rig: Rig
    parts: Sequence[DataSplit]
    fitted: DataSplit
    channel: str
    unit: str
    factor: float
    naive: tuple[str, float]
    target: float
    excluded: Collection[str] = ()


def with_grains(rig: Rig) -> Rig:
    """Return a rig with grains, the spreads of whose transformation temperatures are free."""
    free = (*rig.fit.free, *SPREADS)
    plant = with_structure(rig.plant, CELLS, GRAINS)
    return dataclasses.replace(rig, plant=plant, fit=dataclasses.replace(rig.fit, free=free))


def path_budget(subject: Subject, starts: int) -> tuple[Budget, list[Row]]:
    """Select effects on a wire without and with grains, and predict the held-out part by all these models.

    A wire whose temperature is prescribed has one temperature, and so no cells. Of the two sets of effects that counts
    whose model predicts the selection part better.

    Args:
        subject: The recording.
        starts: Start points of each fit of a base model.

    Returns:
        The budget, and rows on what was selected.
    """
    tried = set(catalogue()) - set(subject.excluded)
    traces: dict[str, TraceResult] = {}
    for structure, rig, keys in (
        ("one grain", subject.rig, tried),
        ("grains", with_grains(subject.rig), tried - set(APPROXIMATIONS)),
    ):
        say(f"{subject.name}: {structure}")
        traces[structure] = trace_effects(rig, subject.parts, subject.fitted, say, starts=starts, candidates=keys)
    entries = [Entry(f"naive, {subject.naive[0]}", np.nan, subject.naive[1])]
    names = {"one grain": "base model", "grains": "with grains"}
    entries += [_entry(subject, names[structure], trace.before) for structure, trace in traces.items()]
    chosen = min(traces, key=lambda k: traces[k].state.current.select_chi2)
    name = names[chosen]
    for key, residuals in zip(traces[chosen].state.accepted, traces[chosen].growing, strict=True):
        name = f"{name} and {key}"
        entries.append(_entry(subject, name, residuals))
    rows = []
    for structure, trace in traces.items():
        selected = " + ".join(trace.state.accepted) or "no effect"
        *_, fitted, held_out = (v * subject.factor for v in trace.rmse(subject.channel))
        error = trace.state.current.select_chi2**0.5 / trace.state.base_fit.select_chi2**0.5
        text = f"{selected}: {error:.2f} of the selection error without; {fitted:.3g} / {held_out:.3g} {subject.unit}"
        rows.append(Row(f"{subject.name}: selected with {structure}", "-", text, None))
        outside = " ".join(value.sentence for value in trace.implausible[1]) or "none"
        rows.append(
            Row(f"{subject.name}: with {structure}, estimates outside of what an alloy can have", "-", outside, None)
        )
    return (
        Budget(subject.name, subject.channel, subject.unit, tuple(entries), entries[-1].model, subject.target),
        rows,
    )


def _entry(subject: Subject, model: str, residuals: tuple[dict[str, np.ndarray], dict[str, np.ndarray]]) -> Entry:
    fitted, held_out = (subject.factor * float(np.sqrt(np.mean(part[subject.channel] ** 2))) for part in residuals)
    return Entry(model, fitted, held_out)
