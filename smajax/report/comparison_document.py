"""``compare.json``: the result of ``smajax compare`` as a JSON document; its model is ``documents.compare``."""

from collections.abc import Sequence
from typing import Any

from smajax import __version__
from smajax.comparison.model_result import ModelResult
from smajax.comparison.ranking import RankedModel, rank_models
from smajax.files.documents import finite_or_none
from smajax.files.rig_file import Rig
from smajax.recordings.recording import Recording
from smajax.report.comparison import summary
from smajax.report.document_entries import difference_unit, recording_entry
from smajax.report.documents.compare import CompareDocument


def comparison_document(
    rig: Rig, results: Sequence[ModelResult], recordings: Sequence[Recording], seed: int
) -> dict[str, Any]:
    """Build ``compare.json``: the models ranked by their error on the holdout, best first.

    Args:
        rig: The rig.
        results: The results of all models.
        recordings: The training recording and the holdout.
        seed: Seed of the random start values.
    """
    channel = rig.fit.observe[0]
    unit, scale = difference_unit(recordings[0], channel)
    models = [_model_entry(ranked, scale) for ranked in rank_models(results, recordings, channel)]
    document = {
        "schema": CompareDocument.SCHEMA,
        "rig": rig.name,
        "channel": channel,
        "not_compared": list(rig.fit.observe[1:]),
        "unit": unit,
        "summary": "",
        "models": models,
        "recordings": [recording_entry(r, role) for r, role in zip(recordings, ("train", "holdout"), strict=True)],
        "seed": seed,
        "smajax": __version__,
    }
    return CompareDocument.check(document | {"summary": summary(document)})


def _model_entry(ranked: RankedModel, scale: float) -> dict[str, Any]:
    """Entry of one model; ``scale`` converts from SI to the unit of the document."""
    result, scores = ranked
    rmse, percent, bic = [None, None], [None, None], None
    if scores is not None:
        rmse, percent = [finite_or_none(e, scale) for e in scores.rmse], [finite_or_none(p) for p in scores.fit_percent]
        bic = finite_or_none(scores.bic)
    return {
        "name": result.name,
        "kind": result.kind,
        "why": result.reason,
        "note": result.note,
        "at_bound": list(result.at_bound),
        "undetermined": list(result.undetermined),
        "parameters": result.parameters,
        "rmse_train": rmse[0],
        "rmse_holdout": rmse[1],
        "bic": bic,
        "fitted": dict(result.fitted),
        "fit_percent_train": percent[0],
        "fit_percent_holdout": percent[1],
        "wall_s": round(result.wall_time, 2),
    }
