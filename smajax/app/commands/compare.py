"""Job of ``smajax compare``: fit several models to one recording and rank them by their prediction of another."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from smajax.app.run_record import Clock, Outcome, read_rig_text, run_record
from smajax.comparison.compare import compare_models
from smajax.comparison.models import select_models
from smajax.files.documents import to_json
from smajax.files.result_folder import check_output_folder, write_folder
from smajax.files.rig_file import read_rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.progress import Progress
from smajax.recordings.shared_rows import refuse_copies
from smajax.report import prediction
from smajax.report.comparison import comparison_page
from smajax.report.comparison_document import comparison_document


class CompareJob(NamedTuple):
    """Files and options of a comparison.

    Attributes:
        rig: The rig file.
        train: The recording to fit.
        holdout: The recording to predict.
        models: Names of the models.
        out: The result folder.
        seed: Seed of the starting points, which replaces that of the rig file.
        drop_bad_rows: Whether to omit rows that cannot be read.
    """

    rig: Path
    train: Path
    holdout: Path
    models: Sequence[str]
    out: Path
    seed: int | None = None
    drop_bad_rows: bool = False


def run_compare(job: CompareJob, progress: Progress, argv: Sequence[str]) -> Outcome:
    """Fit each model, predict the holdout and write the result folder.

    Args:
        job: Files and options.
        progress: Display of the phases.
        argv: The command line, for the record of the run.

    Raises:
        InputError: If a file, a model name or the folder is not valid, or no model can be fitted to such input.
        NumericsError: If no model can be fitted.
    """
    out, clock = check_output_folder(job.out), Clock()
    names = select_models(job.models)
    progress.phase("reading")
    with clock.time("read"):
        rig, text = read_rig(job.rig), read_rig_text(job.rig)
        recordings = [r for r, _ in read_train_and_holdout(rig, [job.train], [job.holdout], job.drop_bad_rows)]
        refuse_copies(recordings)
    seed = rig.fit.seed if job.seed is None else job.seed
    with clock.time("fit"):
        results = compare_models(
            rig, names, recordings, seed=seed, progress=lambda model: progress.phase(f"fitting {model}")
        )
    document = comparison_document(rig, results, recordings, seed)
    run = run_record("compare", rig, argv, clock, seed, 0) | {"inputs": list(rig.plant.signals)}
    channel = rig.fit.observe[0]
    series = [
        prediction.make_series(
            f"{recording.name} ({result.name})",
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
    progress.phase("writing the report")

    def fill(folder: Path) -> None:
        (folder / "rig.toml").write_text(text, "utf-8", newline="")
        (folder / "compare.json").write_text(to_json(document), "utf-8")
        prediction.write_predictions(folder / "prediction.csv", series)
        page = comparison_page(document, prediction.read_predictions(folder / "prediction.csv"), run, text)
        (folder / "report.html").write_text(page, "utf-8")

    write_folder(out, run, fill)
    return Outcome(out, document, 0)
