"""The state of a forward selection: the fits and the accepted, rejected and equivalent effects so far."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from smajax.diagnosis.acceptance import Rejection
from smajax.diagnosis.candidates import AT_NOISE, CandidateFit
from smajax.diagnosis.detectability import Detectability, NominalScore
from smajax.fitting.residual_offsets import ResidualOffset

# Significance level of the score test over the whole catalogue. experiments/diagnosis/hidden_effects.py prints the
# false alarms where nothing is hidden.
SIGNIFICANCE = 0.01
# The threshold of the reduced chi-squared in its standard deviations, and the number of independent values for each
# sample. Both chosen by trial; experiments/diagnosis/hidden_effects.py prints how many causes outside of the catalogue
# are recognised as such.
_STANDARD_DEVIATIONS = 4.0
_INDEPENDENT_SHARE = 0.8


@dataclasses.dataclass(frozen=True)
class CandidateSummary:
    """Summary of one effect after the first round; a field is ``None`` where it was not computed.

    Attributes:
        detectability: What the training input can show of the effect.
        strength: Expected strength at the base fit, SI.
        lower95: Lower end of the strength's 95 % interval, SI.
        upper95: Upper end of the strength's 95 % interval, SI.
        gain: Fall of chi-squared that the score predicts.
        p_value: Probability that noise gives any effect so large a gain.
        refit_rmse_select: RMSE of the first observed channel on the selection split after a refit, SI.
    """

    detectability: Detectability
    strength: float | None = None
    lower95: float | None = None
    upper95: float | None = None
    gain: float | None = None
    p_value: float | None = None
    refit_rmse_select: float | None = None


class Support(NamedTuple):
    """Evidence for an effect on the selection split.

    Attributes:
        key: Key of the effect.
        share: Share of the excess mean square over the noise, without the effect, that it explains.
        cut: 95 % interval of the fall of the RMSE, over the noise, by a bootstrap; NaN if the prediction without it
            fails.
        is_fact: Whether the rig is said to have it; otherwise it is a candidate.
    """

    key: str
    share: float
    cut: tuple[float, float]
    is_fact: bool


@dataclasses.dataclass
class SelectionState:
    """The state of a forward selection, from the base fit to the current one.

    Attributes:
        detectability: What the training input can show of each effect.
        noise: Standard deviation of each channel, SI, and its source.
        base_fit: The fit without further effects.
        current: The fit with the accepted effects.
        chi2_limit: Reduced chi-squared above which a residual is more than noise.
        nominal_scores: Scores at the rig's nominal values. A large effect biases the base fit so much that the scores
            there mislead.
        base_fit_converged: Whether the base fit is stationary; a large effect can prevent that.
        accepted_fits: The accepted fits, one for each round.
        alternatives: For each accepted effect, the best fits with another effect instead.
        equivalent: For each accepted effect, those that explain both recordings as well.
        rejected: Effects that were not accepted, and why.
        ranking: Summary of every effect after the first round.
        stage_shares: Share of the base fit's residual that each stage can explain.
        interrupted: Whether the progress callback stopped the search.
        supports: Evidence for the accepted effects, facts, and for those that are candidates (``support``).
        offsets: Offsets of sensors that explain the base fit's residual above the noise, without any effect.
        rising_convection: Coefficients of h(T) that were bounded at 0 (module ``rising_convection``).
    """

    detectability: dict[str, Detectability]
    noise: dict[str, tuple[float, str]]
    base_fit: CandidateFit
    current: CandidateFit
    chi2_limit: float
    nominal_scores: dict[str, NominalScore]
    base_fit_converged: bool = True
    accepted_fits: list[CandidateFit] = dataclasses.field(default_factory=list)
    alternatives: dict[str, list[CandidateFit]] = dataclasses.field(default_factory=dict)
    equivalent: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    rejected: list[Rejection] = dataclasses.field(default_factory=list)
    ranking: dict[str, CandidateSummary] = dataclasses.field(default_factory=dict)
    stage_shares: dict[str, float] = dataclasses.field(default_factory=dict)
    interrupted: bool = False
    supports: tuple[Support, ...] = ()
    offsets: tuple[ResidualOffset, ...] = ()
    rising_convection: tuple[str, ...] = ()

    @property
    def accepted(self) -> tuple[str, ...]:
        """Keys of the accepted effects, in order."""
        return self.current.keys

    @property
    def acceptable_chi2(self) -> float:
        """Reduced chi-squared of the training split up to which a fit with the right effects is at the noise."""
        return max(self.chi2_limit, AT_NOISE)

    @property
    def base_residual_may_be_noise(self) -> bool:
        """Whether no effect is significant at the base fit, so that its residual may be autocorrelated noise."""
        p_values = (r.p_value for r in self.ranking.values() if r.p_value is not None)
        return min(p_values, default=1.0) > SIGNIFICANCE

    @property
    def explained(self) -> float:
        """Share of the base fit's excess over the noise that the current fit explains (``explained_by``)."""
        return self.explained_by(self.current)

    def explained_by(self, fit: CandidateFit) -> float:
        """Compute the share of the base fit's excess over the noise that a fit explains.

        The excess is that of training and selection split; of the training split alone if the base fit's prediction of
        the selection split is not finite.
        """
        pairs = [(fit.train_chi2, self.base_fit.train_chi2), (fit.select_chi2, self.base_fit.select_chi2)]
        excess = [np.maximum(np.array(pair) - 1.0, 0.0) for pair in pairs if math.isfinite(pair[1])]
        after, before = np.sum(excess, axis=0)
        return float(1.0 - after / max(before, 1e-9))

    def explained_in_training_by(self, fit: CandidateFit) -> float:
        """Compute the share of the base fit's excess over the noise that a fit explains on the training split alone.

        An effect that is not the cause may improve the prediction of a biased base fit without fitting better.
        """
        after, before = (max(f.train_chi2 - 1.0, 0.0) for f in (fit, self.base_fit))
        return float(1.0 - after / max(before, 1e-9))


def chi2_threshold(samples: int) -> float:
    """Return the reduced chi-squared above which a residual is more than noise.

    With n samples, of which 0.8 n count as independent, it is 1 + 4 sqrt(2 / (0.8 n)): four standard deviations of the
    reduced chi-squared above its mean.

    Args:
        samples: Number n of scored samples of the training split.
    """
    return 1.0 + _STANDARD_DEVIATIONS * math.sqrt(2.0 / (_INDEPENDENT_SHARE * samples))
