"""Acceptance of an effect by its fit of the training split and its prediction of the selection split."""

import enum
import math
from typing import NamedTuple

from smajax.diagnosis.candidates import CandidateFit

# Least fall of chi-squared on the training split as a multiple of the reduced chi-squared: five standard deviations of
# one parameter, squared.
MIN_CHI2_FALL = 25.0
# Least relative fall of the selection split's RMSE: effects that only compensate for slightly wrong kinetics lower it
# by less. Chosen by trial; experiments/diagnosis/hidden_effects.py prints the rates (two effects, kinetics off).
MIN_SELECT_CUT = 0.05
# Least fall of the selection split's reduced chi-squared for a further effect: the noise itself. Chosen by trial;
# tests/unit/diagnosis holds it.
_MIN_SELECT_FALL = 1.0
# Excess of the two reduced chi-squared over the noise below which slightly wrong kinetics can be the reason, which many
# effects fit in part; and the largest share of it that remains with a real cause. Chosen by trial; tests/unit/diagnosis
# holds both.
_SMALL_EXCESS = 10.0
_MAX_REMAINING = 0.15


class RejectionCode(enum.StrEnum):
    """Why an effect is not accepted, or not any more."""

    chance = "chance"  # fits the training split no better than chance would
    selection = "selection"  # reduces the error on the selection split too little
    noise = "noise"  # changes the selection split's prediction by less than the noise
    part_of_excess = "part-of-excess"  # explains too little of a small excess
    implausible = "implausible"  # brings parameters outside of what an alloy can have
    zero = "zero"  # has a strength of 0
    unneeded = "unneeded"  # the other effects explain the recordings as well
    swapped = "swapped"  # another effect explains more together with the others
    little_explained = "little-explained"  # explains too little: a candidate
    law = "law"  # another material law explains more
    holdout = "holdout"  # the accepted effects do not reduce the error on the holdout


class Rejection(NamedTuple):
    """An effect that is not accepted.

    Attributes:
        key: Key of the effect.
        code: Why it is not accepted.
        share: Relative fall of the selection split's RMSE ("selection"), or explained share of the excess over the
            noise ("part-of-excess", "little-explained"); else ``None``.
        others: Keys of the effects next to which it was tried ("noise", "part-of-excess"), or of the effect that
            replaces it ("swapped"); names of the parameters ("implausible").
    """

    key: str
    code: RejectionCode
    share: float | None = None
    others: tuple[str, ...] = ()


def rejection(current: CandidateFit, best: CandidateFit, samples: int) -> Rejection | None:
    """Decide whether a fit with one more effect is accepted.

    Accepted is an effect that lowers chi-squared of the training split by at least 25 times the reduced chi-squared,
    and the RMSE of the selection split by at least 5 %. A further effect must also lower the selection split's reduced
    chi-squared by at least 1, and explain nearly all of a small excess.

    Args:
        current: The fit without the effect.
        best: The fit with it.
        samples: Number of scored samples of the training split.

    Returns:
        Why it is not accepted; ``None`` if it is.
    """
    key, accepted = next((k for k in best.keys if k not in current.keys), best.key), current.keys
    if (current.train_chi2 - best.train_chi2) * samples < MIN_CHI2_FALL * max(1.0, best.train_chi2):
        return Rejection(key, RejectionCode.chance)
    cut = 1.0 - math.sqrt(best.select_chi2 / current.select_chi2)
    if cut < MIN_SELECT_CUT:
        return Rejection(key, RejectionCode.selection, cut)
    if not accepted:
        return None
    if current.select_chi2 - best.select_chi2 < _MIN_SELECT_FALL:
        return Rejection(key, RejectionCode.noise, others=accepted)
    before, after = (max(fit.total_chi2 - 2.0, 0.0) for fit in (current, best))
    if before < _SMALL_EXCESS and after > _MAX_REMAINING * before:
        return Rejection(key, RejectionCode.part_of_excess, 1.0 - after / before, accepted)
    return None
