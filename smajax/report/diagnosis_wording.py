"""Sentences for the codes of a diagnosis: rejected effects, blind effects, and the next experiment."""

from smajax.diagnosis.acceptance import MIN_SELECT_CUT, Rejection, RejectionCode
from smajax.diagnosis.detectability import BlindCode, Detectability
from smajax.diagnosis.next_experiment import NextExperiment

_FURTHER_CHANNELS = {"motion": "a second sensor of the motion"}


def rejection_text(rejection: Rejection) -> str:
    """Say why an effect is not accepted, to follow its key."""
    percent, others = 100.0 * (rejection.share or 0.0), " and ".join(rejection.others)
    return {
        RejectionCode.chance: "fits the training recording no better than chance would",
        RejectionCode.selection: (
            f"cuts the error on the selection recording by {percent:.1f} %; "
            f"a cause has to cut it by {100 * MIN_SELECT_CUT:.0f} %"
        ),
        RejectionCode.noise: (
            f"changes the prediction of the selection recording by less than the noise, in addition to {others}: "
            "it may only compensate for another error of the model"
        ),
        RejectionCode.part_of_excess: (
            f"explains {percent:.0f} % of the small excess that {others} does not explain: "
            "a cause would explain nearly all of it, an effect that compensates for slightly wrong kinetics does not"
        ),
        RejectionCode.implausible: f"brings {others} outside of the plausible range",
        RejectionCode.zero: "has a fitted strength of 0",
        RejectionCode.unneeded: "is no longer needed next to the other effects",
        RejectionCode.swapped: f"together with the other effects it explains less than {others}",
        RejectionCode.little_explained: (
            f"explains {percent:.0f} % of the excess over the noise on the selection recording, too little for a cause"
        ),
        RejectionCode.law: f"explains less than the law {others} without it",
        RejectionCode.holdout: "does not reduce the error on the holdout",
    }[rejection.code]


def blind_text(detectability: Detectability) -> str:
    """Say why an effect is blind; empty if it is not."""
    if detectability.blind_code is None:
        return ""
    return {
        BlindCode.input: "this input does not show it at any plausible strength",
        BlindCode.modelled: "the rig file has it",
        BlindCode.needs: f"this rig cannot show it: it needs {', '.join(detectability.missing)}"
        if detectability.missing
        else f"a rig with {', '.join(detectability.excluding)} cannot have it",
        BlindCode.no_mean_effect: detectability.explanation,
    }[detectability.blind_code]


def experiment_text(experiment: NextExperiment) -> str:
    """Say which input to run next, or what else may distinguish the effects."""
    names = " and ".join(experiment.separates)
    if experiment.recording is not None:
        return (
            f"{experiment.recording.name}; it sets {names} {experiment.sigma:.0f} standard deviations apart, "
            f"the training input {experiment.training_sigma:.0f}"
        )
    channels = " or ".join(_FURTHER_CHANNELS.get(channel, channel) for channel in experiment.further_channels)
    record = f"record {channels} as well, or " if channels else ""
    return (
        f"no input within these limits distinguishes {names}: {record}repeat the recording under another load or with "
        "another wire"
    )
