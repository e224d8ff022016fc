"""Selection of effects on measured recordings: which the residual calls for, and what they do to the held-out error.

The effects are searched for on a training part and accepted by a selection part. Then the rig, without and with them,
is fitted to both parts together and predicts the held-out part, which nothing else uses.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from experiments.common.base import Row
from experiments.common.charts import Chart, Curve, write_panels

import numpy as np

from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import DataSplit
from smajax.diagnosis.forward_selection import select_effects
from smajax.diagnosis.plausibility import implausible_estimates
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.selection_state import SelectionState
from smajax.files.plausible_ranges import ImplausibleValue
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording
from smajax.report.diagnosis_wording import rejection_text


@dataclass(frozen=True)
class TraceResult:
    """The selected effects, and the fits without and with them.

    Attributes:
        state: State at the end of the forward selection.
        before: Residuals of the fit without effects by channel, measurement minus model, SI: fitted part, held-out
            part.
        after: Those of the fit with effects.
        refit: The fit with effects.
        growing: Those of the fits with one more of the accepted effects each, in their order, up to ``after``.
        implausible: Estimates outside of what an alloy can have, of the fit without and of that with effects.
    """

    state: SelectionState
    before: tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
    after: tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
    refit: Refit
    growing: tuple[tuple[dict[str, np.ndarray], dict[str, np.ndarray]], ...]
    implausible: tuple[tuple[ImplausibleValue, ...], tuple[ImplausibleValue, ...]]

    def rmse(self, channel: str) -> tuple[float, float, float, float]:
        """Return the RMSE of a channel: fitted and held out without effects, fitted and held out with them."""
        values = (self.before[0], self.before[1], self.after[0], self.after[1])
        fitted, held_out, fitted_after, held_out_after = (float(np.sqrt(np.mean(v[channel] ** 2))) for v in values)
        return fitted, held_out, fitted_after, held_out_after


def trace_effects(
    rig: Rig,
    parts: Sequence[DataSplit],
    whole: DataSplit,
    say: Callable[[str], None],
    *,
    starts: int,
    step: float | None = None,
    seed: int = 0,
    candidates: Collection[str] | None = None,
) -> TraceResult:
    """Select effects, fit without and with them, and predict the held-out part.

    Args:
        rig: The rig.
        parts: Training part, selection part and held-out part.
        whole: Training and selection part together, for the last fits.
        say: Reports progress.
        starts: Start points of the base fit.
        step: Largest time step, s.
        seed: Seed of the diagnosis.
        candidates: Keys of the effects that are tried; by default all that the rig could have.
    """
    layout: dict[str, Any] = {"interpolation": rig.interpolation, "step": step}
    problem = DiagnosisProblem(rig.plant, parts, rig.fit, **layout, candidates=candidates)
    # The residual of a measured recording stays far above its noise, so that only the selection part decides.
    options = {"min_explained_fraction": 0.0, "min_score_gain": 0.0, "report_progress": say}
    _, state = select_effects(problem, seed=seed, starts=starts, **options)
    say("fitting to the training and the selection part together")
    final_problem = DiagnosisProblem(rig.plant, [whole, parts[2]], rig.fit, **layout, candidates=candidates)
    final_problem.set_noise(problem.noise)

    def refit_best(effect_set: EffectSet, base: np.ndarray) -> Refit:
        starts = [
            np.append(base[: final_problem.shared_count], final_problem.nominal[final_problem.shared_count :]),
            final_problem.nominal,
        ]
        return min((final_problem.fit(effect_set, p, max_steps=100, rtol=1e-8) for p in starts), key=lambda r: r.chi2)

    def residuals(refit: Refit) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        predicted = final_problem.predict(refit.effect_set, refit.base, 1)
        fitted = final_problem.series(refit.residual)
        held_out = final_problem.series(predicted, 1)
        return {c: v * final_problem.noise[c] for c, v in fitted.items()}, {
            c: v * final_problem.noise[c] for c, v in held_out.items()
        }

    before = refit_best(EffectSet(), state.base_fit.refit.base)
    after = refit_best(state.current.refit.effect_set, state.current.refit.base)
    growing, effect_set = [residuals(after)] if state.accepted else [], after.effect_set
    for key in reversed(state.accepted[1:]):
        effect_set = effect_set.without(key)
        growing.insert(0, residuals(refit_best(effect_set, after.base)))
    implausible = implausible_estimates(final_problem, before), implausible_estimates(final_problem, after)
    return TraceResult(state, residuals(before), residuals(after), after, tuple(growing), implausible)


def effect_rows(result: TraceResult, prefix: str = "") -> list[Row]:
    """Return what the selection found, as rows without a target."""
    state, rows = result.state, []
    for key in state.accepted:
        values = ", ".join(
            f"{n.split('.')[2]} {v:.4g}" for n, v in result.refit.values.items() if n.split(".")[1] == key
        )
        equivalents = ", ".join(state.equivalent.get(key, ())) or "none"
        rows.append(Row(f"{prefix}effect accepted: {key}", "-", f"{values}; as good: {equivalents}", None))
    for rejection in state.rejected:
        rows.append(Row(f"{prefix}left out: {rejection.key}", "-", rejection_text(rejection), None))
    summaries = sorted(
        (r for r in state.ranking.values() if r.refit_rmse_select is not None), key=lambda r: r.refit_rmse_select or 0.0
    )
    errors = ", ".join(f"{r.detectability.key} {r.refit_rmse_select:.3g}" for r in summaries[:6])
    rows.append(
        Row(
            f"{prefix}one effect, error on the selection part (SI)",
            "-",
            f"without {state.base_fit.rmse_select:.3g}; {errors}",
            None,
        )
    )
    for what, values in zip(("without effects", "with effects"), result.implausible, strict=True):
        text = " ".join(v.sentence for v in values) or "none"
        rows.append(Row(f"{prefix}{what}: estimates outside of what an alloy can have", "-", text, None))
    return rows


def draw_before_and_after(recording: Recording, result: TraceResult, title: str, path: Path) -> None:
    """Draw the strain of a held-out thermal cycle, and its residual without and with the effects.

    Args:
        recording: The recording, with temperature and strain.
        result: The fits without and with effects.
        title: Title of the picture.
        path: Its SVG file.
    """
    temperature, measured = recording.channels["temperature"], 100 * recording.channels["strain"]
    residuals = [100 * part[1]["strain"] for part in (result.before, result.after)]
    names = ("fitted model", f"with {' and '.join(result.refit.effect_set.keys) or 'no effect'}")
    models = [Curve(n, temperature, measured - r, dashed=True) for n, r in zip(names, residuals, strict=True)]
    # The first curve is the same in both charts, so that equal colours have equal names.
    zero = Curve("measured", temperature, np.zeros(len(temperature)))
    lines = [zero, *(Curve(n, temperature, r) for n, r in zip(names, residuals, strict=True))]
    strain = Chart(title, "temperature [degC]", "strain [%]", [Curve("measured", temperature, measured), *models])
    residual = Chart("Residual before and after", "temperature [degC]", "measured - model [% strain]", lines)
    write_panels([strain, residual], path)
