"""Acceptance of an effect by its fit of the training split and its prediction of the selection split."""

import math

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


def rejection_reason(current: CandidateFit, best: CandidateFit, samples: int) -> str:
    """Return why a fit with one more effect is not accepted.

    Accepted is an effect that lowers chi-squared of the training split by at least 25 times the reduced chi-squared,
    and the RMSE of the selection split by at least 5 %. A further effect must also lower the selection split's reduced
    chi-squared by at least 1, and explain nearly all of a small excess.

    Args:
        current: The fit without the effect.
        best: The fit with it.
        samples: Number of scored samples of the training split.

    Returns:
        The reason, for the report; empty if the effect is accepted.
    """
    if (current.train_chi2 - best.train_chi2) * samples < MIN_CHI2_FALL * max(1.0, best.train_chi2):
        return "fits the training recording no better than chance would"
    cut = 1.0 - math.sqrt(best.select_chi2 / current.select_chi2)
    if cut < MIN_SELECT_CUT:
        return (
            f"cuts the error on the selection recording by {100 * cut:.1f} %; "
            f"a cause has to cut it by {100 * MIN_SELECT_CUT:.0f} %"
        )
    if not current.keys:
        return ""
    accepted = " and ".join(current.keys)
    if current.select_chi2 - best.select_chi2 < _MIN_SELECT_FALL:
        return (
            f"moves the selection recording's prediction by less than the noise, in addition to {accepted}: "
            "perhaps a surrogate"
        )
    before, after = (max(fit.total_chi2 - 2.0, 0.0) for fit in (current, best))
    if before < _SMALL_EXCESS and after > _MAX_REMAINING * before:
        return (
            f"explains {100 * (1.0 - after / before):.0f} % of the small excess that {accepted} does not explain: "
            "a cause would explain nearly all of it, a surrogate of slightly wrong kinetics does not"
        )
    return ""
