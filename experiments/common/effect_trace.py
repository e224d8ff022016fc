"""Closes the loop on measured recordings: which effects the residual asks for, and what they do to the error held out.
 The effects are traced on a training part and accepted by a selection part; then the rig, without and with them, is
fitted to both parts together and predicts the held-out part, which nothing else has looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from experiments.common.base import Row

import numpy as np

from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import DataSplit
from smajax.diagnosis.forward_selection import select_effects
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.selection_state import SelectionState
from smajax.files.rig_file import Rig


@dataclass(frozen=True)
class Closed:
    """The diagnosis, and the residuals (model minus measurement, SI, by channel) of the last fits by part."""

    story: SelectionState
    before: tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
    after: tuple[dict[str, np.ndarray], dict[str, np.ndarray]]
    refit: Refit

    def rmse(self, channel: str) -> tuple[float, float, float, float]:
        """Fitted and held out before, fitted and held out after."""
        values = (self.before[0], self.before[1], self.after[0], self.after[1])
        fitted, held, fitted_after, held_after = (float(np.sqrt(np.mean(v[channel] ** 2))) for v in values)
        return fitted, held, fitted_after, held_after


def close_loop(
    rig: Rig,
    parts: Sequence[DataSplit],
    whole: DataSplit,
    say: Callable[[str], None],
    *,
    starts: int,
    step: float | None = None,
    seed: int = 0,
) -> Closed:
    """Traces on the first of ``parts`` with the second selecting, fits again to ``whole``, and predicts the third."""
    layout: dict[str, Any] = {"interpolation": rig.interpolation, "step": step}
    bench = DiagnosisProblem(rig.plant, parts, rig.fit, **layout)
    # A measured recording lies far above its noise whatever is added: what predicts the selection part better is taken.
    options = {"min_explained_fraction": 0.0, "min_score_gain": 0.0, "report_progress": say}
    _, story = select_effects(bench, seed=seed, starts=starts, **options)
    say("fitting to the training and the selection part together")
    final = DiagnosisProblem(rig.plant, [whole, parts[2]], rig.fit, **layout)
    final.set_noise(bench.noise)

    def last(effect_set: EffectSet, near: np.ndarray) -> Refit:
        starts = [np.append(near[: final.shared_count], final.nominal[final.shared_count :]), final.nominal]
        return min((final.fit(effect_set, p, max_steps=100, rtol=1e-8) for p in starts), key=lambda r: r.chi2)

    def residuals(refit: Refit) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
        predicted = final.predict(refit.effect_set, refit.base, 1)
        fitted, held = final.series(refit.residual), final.series(predicted, 1)
        return {c: v * final.noise[c] for c, v in fitted.items()}, {c: v * final.noise[c] for c, v in held.items()}

    before = last(EffectSet(), story.base_fit.refit.base)
    after = last(story.current.refit.effect_set, story.current.refit.base)
    return Closed(story, residuals(before), residuals(after), after)


def effect_rows(closed: Closed, prefix: str = "") -> list[Row]:
    """What the trace says, as rows without a target."""
    story, rows = closed.story, []
    for key in story.accepted:
        own = ", ".join(f"{n.split('.')[2]} {v:.4g}" for n, v in closed.refit.values.items() if n.split(".")[1] == key)
        same = ", ".join(story.equivalent.get(key, ())) or "none"
        rows.append(Row(f"{prefix}effect accepted: {key}", "-", f"{own}; as good: {same}", None))
    for key, why in story.rejected:
        rows.append(Row(f"{prefix}left out: {key}", "-", why, None))
    tried = sorted(
        (r for r in story.ranking.values() if r.refit_rmse_select is not None), key=lambda r: r.refit_rmse_select or 0.0
    )
    told = ", ".join(f"{r.detectability.key} {r.refit_rmse_select:.3g}" for r in tried[:6])
    rows.append(
        Row(
            f"{prefix}one effect, error on the selection part (SI)",
            "-",
            f"without {story.base_fit.rmse_select:.3g}; {told}",
            None,
        )
    )
    return rows
