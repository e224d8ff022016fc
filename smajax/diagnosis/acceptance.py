"""When an effect is accepted: by its fit of the training split, and by its prediction of the selection split."""

import math

from smajax.diagnosis.candidates import CandidateFit

# Least fall of chi-squared on the training split, as a multiple of the reduced chi-squared: five standard deviations of
# one parameter, squared. From the prototype study of the diagnosis.
MIN_CHI2_FALL = 25.0
# Least cut of the selection split's RMSE: in the prototype study of the diagnosis it accepted 16 of 16 real second
# effects (13.6 % and more) and none of 23 surrogates of unmodelled kinetics (2.9 % and less).
MIN_SELECT_CUT = 0.05
# Least fall of the selection split's reduced chi-squared next to other effects: that of the noise. Chosen by trial;
# tests/unit/diagnosis holds it.
_MIN_SELECT_FALL = 1.0
# Excess of chi-squared over the noise, on both recordings, below which the kinetics may be a little off, which many an
# effect fits in part; and the share of it that a cause may leave then. Chosen by trial; tests/unit/diagnosis holds it.
_SMALL_EXCESS = 10.0
_MAX_REMAINING = 0.15


def rejection_reason(current: CandidateFit, best: CandidateFit, samples: int) -> str:
    """Say why a fit with one effect more is not accepted; empty if it is.

    Args:
        current: The fit without the effect.
        best: The fit with it.
        samples: Scored samples of the training split.
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
    others = " and ".join(current.keys)
    if current.select_chi2 - best.select_chi2 < _MIN_SELECT_FALL:
        return (
            f"moves the selection recording's prediction by less than the noise, in addition to {others}: "
            "perhaps a surrogate"
        )
    before, after = (max(fit.total_chi2 - 2.0, 0.0) for fit in (current, best))
    if before < _SMALL_EXCESS and after > _MAX_REMAINING * before:
        return (
            f"explains {100 * (1.0 - after / before):.0f} % of the little that {others} left: a cause would explain "
            "nearly all of it, a surrogate of kinetics that are a little off does not"
        )
    return ""
