"""Compare several models on one recording, and rank them by their prediction of another."""

import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from smajax.api.run_record import Clock, run_record
from smajax.api.sources import RigSource, as_rig, one_source, rig_text
from smajax.api.split import refuse_others, split_in_two
from smajax.api.study import Study
from smajax.arguments import as_names, seed_or_default
from smajax.comparison.compare import compare_models
from smajax.comparison.model_result import ModelResult
from smajax.comparison.models import model_names, select_models
from smajax.errors import Cancelled
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.progress import ProgressCallback, Reporter
from smajax.recordings.recording import Recording
from smajax.recordings.shared_rows import refuse_copies
from smajax.report.comparison_document import comparison_document
from smajax.report.prediction import Series, make_series, variant_label


@dataclasses.dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class ComparisonStudy(Study):
    """Ranking of models.

    Attributes:
        results: Predictions and parameters of each model as arrays; empty for a loaded study.
    """

    command = "compare"
    document_name = "compare.json"

    results: tuple[ModelResult, ...] = ()

    @property
    def ranking(self) -> tuple[Mapping[str, Any], ...]:
        """Entries of the models, the best prediction of the holdout first."""
        return tuple(self.document["models"])


def compare(
    rig: RigSource,
    train: Any,
    *,
    holdout: Any = None,
    models: Sequence[str] | None = None,
    seed: int | None = None,
    split: bool = False,
    drop_bad_rows: bool = False,
    progress: ProgressCallback | None = None,
) -> ComparisonStudy:
    """Fit material laws and input-output models to one recording, and rank them by their prediction of another.

    Args:
        rig: The rig, its file, or a dictionary with the sections of one; its first observed channel is compared.
        train: The recording to fit: a path, a table in memory, or a ``Recording``.
        holdout: The recording to predict, given likewise.
        models: Names of the models; all of them by default.
        seed: Seed of the starting points; that of the rig by default.
        split: Whether the last quarter of the only recording is its holdout, cut where the wire is at rest.
        drop_bad_rows: Whether to omit rows that cannot be read.
        progress: Function that gets a ``ProgressEvent`` for each model.

    Raises:
        InputError: If a file or a name is not valid, or no model can be fitted to such input.
        NumericsError: If no model can be fitted.
        Cancelled: If the callback stopped the comparison before a model was fitted; later, the study has the models
            before.
    """
    clock, reporter = Clock(), Reporter(progress)
    names = select_models(model_names() if models is None else as_names("compare", "models", models))
    refuse_others("compare", split, holdout=holdout)
    reporter.phase("reading")
    with clock.time("read"):
        rig = as_rig(rig)
        if split:
            train, holdout = split_in_two(rig, train, drop_bad_rows)
        seed = seed_or_default("compare", seed, rig.fit.seed)
        text = rig_text(rig)
        sources = one_source(train, "train"), one_source(holdout, "holdout")
        recordings = [r for r, _ in read_train_and_holdout(rig, *sources, drop_bad_rows)]
        refuse_copies(recordings)
    inputs = list(rig.plant.driving_channels(*(recording.channels for recording in recordings)))
    with clock.time("fit"):
        report = partial(_report, reporter)
        results = compare_models(rig, names, recordings, seed=seed, progress=report)
    missing = [name for name in names if name not in {result.name for result in results}]
    code = Cancelled.exit_code if missing else 0
    reporter.finish("writing the report")
    return ComparisonStudy(
        document=comparison_document(rig, results, recordings, seed),
        series=tuple(_series(rig.fit.observe[0], results, recordings)),
        run=run_record("compare", rig.name, clock, seed, code) | {"inputs": inputs},
        files={"rig.toml": text.encode()},
        reason=f"interrupted: {', '.join(missing)} not compared" if missing else "",
        results=tuple(results),
    )


def _report(reporter: Reporter, model: str) -> None:
    reporter.phase(f"fitting {model}", can_stop=True)


def _series(channel: str, results: Sequence[ModelResult], recordings: Sequence[Recording]) -> list[Series]:
    """Return the compared channel of training and holdout recording by each model that could be fitted."""
    return [
        make_series(
            variant_label(recording.name, result.name),
            role,
            recording.time,
            {channel: recording.channels[channel]},
            {channel: values},
            recording.units,
            has_clock=recording.has_clock,
        )
        for result in results
        if not result.reason
        for recording, role, values in zip(recordings, ("train", "holdout"), result.predictions, strict=True)
    ]
