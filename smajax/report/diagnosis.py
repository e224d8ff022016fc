"""``diagnosis.json``: the result of ``smajax diagnose`` as a JSON document.

Its model is ``documents.diagnosis.DiagnosisDocument``.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax import __version__
from smajax.diagnosis.acceptance import RejectionCode
from smajax.diagnosis.auxiliary_channels import ChannelFault
from smajax.diagnosis.data_split import SPLIT_NAMES
from smajax.diagnosis.detectability import Detectability
from smajax.diagnosis.error_budget import BudgetEntry
from smajax.diagnosis.nonparametric import FreeHeat, FreeShift, FreeStrain
from smajax.diagnosis.nonparametric_fit import NonparametricFit
from smajax.diagnosis.other_laws import LawComparison
from smajax.diagnosis.residual_checks import ResidualStatistics
from smajax.diagnosis.result import Diagnosis, EffectEstimate
from smajax.diagnosis.selection_state import Support
from smajax.files.documents import finite_or_none
from smajax.recordings.recording import Recording
from smajax.report.diagnosis_summary import sentences
from smajax.report.diagnosis_wording import blind_text, experiment_text, rejection_text
from smajax.report.document_entries import difference_unit, implausible_entry, recording_entry
from smajax.report.documents.diagnosis import DiagnosisDocument

NEXT_INPUT = "next_input.csv"
# Rig with the better material law.
RIG_WITH_LAW = "rig-law.toml"
_NONPARAMETRIC_WORDS = {FreeHeat.key: "heat", FreeShift.key: "shift", FreeStrain.key: "strain"}


def diagnosis_document(
    diagnosis: Diagnosis,
    recordings: Sequence[Recording],
    *,
    evidence: Sequence[str],
    left_out: Mapping[str, ChannelFault],
    misplaced: Mapping[str, str],
    simulations: int,
    wall_time: float,
    seed: int,
    bench: Sequence[Mapping[str, Any]] = (),
) -> dict[str, Any]:
    """Build the document of a diagnosis.

    Args:
        diagnosis: The result.
        recordings: The recordings for training, selection and holdout; the first one gives the units.
        evidence: Auxiliary channels: recorded, but not observed.
        left_out: Reason by channel that was not used.
        misplaced: Reason by effect of the rig file that the rig cannot have.
        simulations: Number of simulations.
        wall_time: Duration, s.
        seed: Seed of all random numbers.
        bench: Entries of what the recordings show about their bench.
    """
    rmse, noise_floor = _errors(diagnosis, recordings[0])
    document = {
        "schema": DiagnosisDocument.SCHEMA,
        "bench": list(bench),
        "verdict": diagnosis.verdict,
        "effects": list(diagnosis.effects),
        "equivalent": {key: list(keys) for key, keys in diagnosis.equivalent.items()},
        **_structure_and_support(diagnosis),
        "unresolved_stage": diagnosis.unresolved_stage,
        "interrupted": diagnosis.interrupted,
        "summary": "",
        "rmse": rmse,
        "error_budget": [_budget_entry(entry, recordings[0]) for entry in diagnosis.error_budget],
        "holdout": _holdout_entry(diagnosis),
        "effect_parameters": [_estimate_entry(estimate) for estimate in diagnosis.estimates],
        "failures": _failure_entries(diagnosis, recordings),
        "implausible": [implausible_entry(value) for value in diagnosis.implausible],
        "evidence": list(evidence),
        "recordings": [recording_entry(r, name) for r, name in zip(recordings, SPLIT_NAMES, strict=True)],
        "left_out": _left_out_entries(left_out, misplaced),
        "noise_floor": noise_floor,
        **_base_fit(diagnosis),
        "goodness_of_fit": _goodness_of_fit(diagnosis),
        "stages": {stage: finite_or_none(share) for stage, share in diagnosis.stage_shares.items()},
        **_effect_tables(diagnosis, recordings[0]),
        "residual": _residuals(diagnosis, recordings[0]),
        "free_form": _nonparametric_entry(diagnosis.nonparametric_fit),
        "next_experiment": _next_experiment_entry(diagnosis),
        "simulations": simulations,
        "wall_s": round(wall_time, 2),
        "seed": seed,
        "smajax": __version__,
    }
    document["summary"] = " ".join(sentences(document))
    return DiagnosisDocument.check(document)


def _effect_tables(diagnosis: Diagnosis, recording: Recording) -> dict[str, Any]:
    """Tables of all effects: ranking, rejected and excluded ones, and what the training input can show."""
    return {
        "ranking": _ranking(diagnosis, recording),
        "rejected": [{"key": r.key, "code": str(r.code), "why": rejection_text(r)} for r in diagnosis.rejected],
        "excluded": [_excluded_entry(detectability) for detectability in diagnosis.excluded],
        "preflight": [_detectability_entry(detectability) for detectability in diagnosis.detectability],
    }


def _base_fit(diagnosis: Diagnosis) -> dict[str, Any]:
    """How the fit without effects ended."""
    return {"base_fit_at_rest": diagnosis.base_fit_converged, "rising_convection": list(diagnosis.rising_convection)}


def _structure_and_support(diagnosis: Diagnosis) -> dict[str, Any]:
    """The structure of the wire, the evidence for effects and candidates, and the comparison with other laws."""
    structure, by_fact = diagnosis.structure, {True: [], False: []}
    for support in diagnosis.supports:
        by_fact[support.key in diagnosis.effects].append(_support_entry(support))
    entry = {
        "variant": structure.variant,
        "cells": structure.cells,
        "grains": structure.grains,
        "select_error_over_noise": {variant: finite_or_none(error) for variant, error in structure.errors.items()},
        "jointly": structure.jointly,
    }
    law = None if diagnosis.law is None else _law_entry(diagnosis.law)
    return {"structure": entry, "support": by_fact[True], "candidates": by_fact[False], "law": law}


def _law_entry(law: LawComparison) -> dict[str, Any]:
    return {
        "own": law.own,
        "better": law.better,
        "cause": law.cause,
        "select_error_over_noise": {name: finite_or_none(error) for name, error in law.errors.items()},
        "error_with_effects_over_noise": finite_or_none(law.error_with_effects),
        "cut_95_over_noise": None if law.better is None else [finite_or_none(end) for end in law.cut],
        "skipped": law.skipped,
    }


def _support_entry(support: Support) -> dict[str, Any]:
    ends = [finite_or_none(end) for end in support.cut]
    return {"key": support.key, "explains": finite_or_none(support.share), "cut_95_over_noise": ends}


def _failure_entries(diagnosis: Diagnosis, recordings: Sequence[Recording]) -> list[dict[str, str]]:
    """Predictions that failed, or that no wire has."""
    names: dict[str, str] = {split: r.name for split, r in zip(SPLIT_NAMES, recordings, strict=True)}
    return [
        {"recording": names[f.split], "when": f.when, "code": f.status.name, "text": f.status.hint}
        for f in diagnosis.failures
    ]


def _left_out_entries(channels: Mapping[str, ChannelFault], effects: Mapping[str, str]) -> list[dict[str, str]]:
    return [
        *({"channel": channel, "why": fault.text} for channel, fault in channels.items()),
        *({"effect": key, "why": why} for key, why in effects.items()),
    ]


def _errors(diagnosis: Diagnosis, recording: Recording) -> tuple[dict[str, Any], dict[str, Any]]:
    """RMSE and noise by channel."""
    rmse, noise_floor = {}, {}
    for channel, values in diagnosis.rmse.items():
        unit, factor = difference_unit(recording, channel)
        rmse[channel] = {"unit": unit} | {key: finite_or_none(value, factor) for key, value in values.items()}
        rmse[channel]["holdout_cut_95"] = [finite_or_none(end, factor) for end in diagnosis.cut95[channel]]
        value, source = diagnosis.noise[channel]
        noise_floor[channel] = {"value": finite_or_none(value, factor), "unit": unit, "from": source}
    return rmse, noise_floor


def _budget_entry(entry: BudgetEntry, recording: Recording) -> dict[str, Any]:
    channels = {}
    for channel, errors in entry.errors.items():
        unit, factor = difference_unit(recording, channel)
        cut, last = entry.cut95.get(channel), entry.cut_if_last.get(channel)
        channels[channel] = {
            "unit": unit,
            **{split: finite_or_none(error, factor) for split, error in errors.items()},
            "holdout_cut_95": None if cut is None else [finite_or_none(end, factor) for end in cut],
            "cut_if_last": None if last is None else {s: finite_or_none(v, factor) for s, v in last.items()},
        }
    return {"added": entry.added, "channels": channels}


def _goodness_of_fit(diagnosis: Diagnosis) -> dict[str, Any]:
    before, after, limit = (finite_or_none(value) for value in diagnosis.reduced_chi2)
    return {"before": before, "after": after, "critical": limit}


def _holdout_entry(diagnosis: Diagnosis) -> dict[str, Any]:
    """Whether the holdout had a part in the choice of the effects, and which of them it removed."""
    removed = [r.key for r in diagnosis.rejected if r.code is RejectionCode.holdout]
    decided = diagnosis.holdout_decided
    halves = {"decided_by": "first half" if decided else None, "interval_of": "second half" if decided else "all rows"}
    return {"decided": decided, "removed": removed} | halves


def _estimate_entry(estimate: EffectEstimate) -> dict[str, Any]:
    low, high = estimate.interval or (None, None)
    return {
        "name": estimate.name,
        "value": finite_or_none(estimate.value),
        "unit": estimate.unit,
        "meaning": estimate.meaning,
        "lower95": finite_or_none(low),
        "upper95": finite_or_none(high),
        "plausible": [finite_or_none(end) for end in estimate.plausible],
    }


def _ranking(diagnosis: Diagnosis, recording: Recording) -> list[dict[str, Any]]:
    """Entries of all effects: accepted effects first, then by the gain of the first round."""
    scale = difference_unit(recording, next(iter(diagnosis.rmse)))[1]
    ranking = []
    for summary in diagnosis.ranking:
        key, strength, low, high = summary.detectability.key, summary.strength, summary.lower95, summary.upper95
        name = f"effects.{key}.strength"
        if name in diagnosis.after.values:
            strength = diagnosis.after.values[name]
            low, high = diagnosis.intervals.get(name, (None, None))
        entry = {
            "strength": finite_or_none(strength),
            "lower95": finite_or_none(low),
            "upper95": finite_or_none(high),
            "statistic": finite_or_none(summary.gain),
            "p_value": finite_or_none(summary.p_value),
            "refit_rmse_select": finite_or_none(summary.refit_rmse_select, scale),
        }
        ranking.append(_detectability_entry(summary.detectability) | entry)
    return sorted(ranking, key=lambda r: (r["key"] not in diagnosis.effects, -(r["statistic"] or -1.0)))


def _residuals(diagnosis: Diagnosis, recording: Recording) -> dict[str, Any]:
    return {
        channel: {
            when: _statistics_entry(statistics[channel], difference_unit(recording, channel)[1])
            for when, statistics in diagnosis.residual_statistics.items()
        }
        for channel in diagnosis.rmse
    }


def _detectability_entry(detectability: Detectability) -> dict[str, Any]:
    return {
        "key": detectability.key,
        "stage": detectability.stage,
        "status": detectability.status,
        "smallest_detectable": finite_or_none(detectability.minimum_detectable_strength),
        "unit": detectability.unit,
        "absorbed_by": list(detectability.absorbed_by),
        "why": blind_text(detectability),
    }


def _excluded_entry(detectability: Detectability) -> dict[str, Any]:
    limit = finite_or_none(detectability.minimum_detectable_strength)
    return {"key": detectability.key, "above": limit, "unit": detectability.unit}


def _statistics_entry(statistics: ResidualStatistics, factor: float) -> dict[str, Any]:
    return {
        "rms": finite_or_none(statistics.rms, factor),
        "band_99": finite_or_none(statistics.band),
        "autocorrelation": [finite_or_none(float(v)) for v in statistics.autocorrelation],
        "cross_correlation": {
            name: [finite_or_none(float(v)) for v in values] for name, values in statistics.cross.items()
        },
        "outside": {name: finite_or_none(share) for name, share in statistics.outside.items()},
    }


def _nonparametric_entry(fit: NonparametricFit | None) -> dict[str, Any] | None:
    if fit is None:
        return None
    explained = 1.0 - max(fit.train_chi2 - 1.0, 0.0) / max(fit.base_chi2 - 1.0, 1e-9)
    return {
        "stage": fit.stage,
        "adds": _NONPARAMETRIC_WORDS[fit.kind],
        "unit": fit.unit,
        "against": fit.variable,
        "at": [finite_or_none(float(v)) for v in fit.positions],
        "term": [finite_or_none(float(v)) for v in fit.values],
        "explains": finite_or_none(max(0.0, explained)),
        "select_error_over_noise": finite_or_none(fit.select_chi2**0.5),
        "note": "a description of what is missing, not its cause",
    }


def _next_experiment_entry(diagnosis: Diagnosis) -> dict[str, Any] | None:
    experiment = diagnosis.next_experiment
    if experiment is None:
        return None
    return {
        "file": NEXT_INPUT if experiment.recording else None,
        "separates": list(experiment.separates),
        "sigma": finite_or_none(experiment.sigma),
        "advice": experiment_text(experiment),
    }
