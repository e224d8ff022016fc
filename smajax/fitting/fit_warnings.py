"""Notices and warnings of a fit.

No transformation, noisy inputs, stresses beyond the law's range, and a holdout that is a copy.
"""

from collections.abc import Sequence

from smajax.fitting.input_noise import input_noise_warnings
from smajax.fitting.partial_loops import spread_warnings
from smajax.fitting.result import FitResult
from smajax.fitting.unknowns import Settings
from smajax.plant.materials.dissipation import check_dissipation
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.recordings.shared_rows import has_same_content


def fit_warnings(result: FitResult, plant: Plant, recordings: Sequence[Recording], settings: Settings) -> list[str]:
    """Return the warnings of a fit: noisy inputs, stresses beyond the law's range, and a holdout that is a copy.

    Args:
        result: The fit.
        plant: The plant with the start values of the fit.
        recordings: The training recordings.
        settings: The settings of the fit.

    Returns:
        Sentences; none where there is nothing to warn of.
    """
    holdout = [response.recording for response in result.responses if response.role == "holdout"]
    train = [response.model for response in result.responses if response.role == "train"]
    strains = [values for model in train for name, values in model.items() if name.partition("_")[0] == "strain"]
    return [
        *copied_holdout_warnings(recordings, holdout),
        *input_noise_warnings(result, plant, recordings, settings),
        *spread_warnings(strains, settings.free),
        *check_dissipation(result.plant, [{**r.recording.channels, **r.model} for r in result.responses]),
    ]


def transformation_notices(result: FitResult) -> list[str]:
    """Return sentences on start values and on estimates at which the wire does not transform.

    Args:
        result: The fit.

    Returns:
        Sentences; none where no parameter of the transformations is free, or the wire transforms.
    """
    recordings = [response.recording for response in result.responses if response.role == "train"]
    sentences = []
    if result.start_gap is not None:
        sentences.append(result.start_gap.sentence(recordings, "the start values"))
        if result.end_gap is None:
            sentences.append(
                f"The fit therefore began at {result.starts - 1} further points at which it does, and the wire "
                "transforms at the estimates."
            )
    if result.end_gap is not None:
        sentences.append(
            result.end_gap.sentence(recordings, "the estimates")
            + " The parameters of its transformations are not determined by this fit."
        )
    return sentences


def copied_holdout_warnings(train: Sequence[Recording], holdout: Sequence[Recording]) -> list[str]:
    """Return a sentence for each holdout recording with the content of a training recording.

    Args:
        train: The training recordings.
        holdout: The holdout recordings.
    """
    copies = [(h, next((t for t in train if has_same_content(h, t)), None)) for h in holdout]
    return [
        f"{recording.name} has the same content as {original.name}: it is not an independent test."
        for recording, original in copies
        if original is not None
    ]
