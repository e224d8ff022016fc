"""Series of a diagnosis: measured and modelled channels before and after the effects were added."""

from collections.abc import Sequence

from smajax.diagnosis.data_split import SPLIT_NAMES
from smajax.diagnosis.result import Diagnosis
from smajax.recordings.recording import Recording
from smajax.report.prediction import Series, make_series, variant_label


def prediction_series(recordings: Sequence[Recording], diagnosis: Diagnosis) -> list[Series]:
    """Return measured and modelled channels of each recording, before and after the effects were added.

    Args:
        recordings: Recordings for training, selection and holdout.
        diagnosis: The result.
    """
    series = []
    for k, (recording, role) in enumerate(zip(recordings, SPLIT_NAMES, strict=True)):
        for stage, residuals in diagnosis.predictions.items():
            model = {c: recording.channels[c] - v for c, v in residuals[k].items()}
            columns = (recording.time, recording.channels, model, recording.units)
            series.append(
                make_series(variant_label(recording.name, stage), role, *columns, has_clock=recording.has_clock)
            )
    return series
