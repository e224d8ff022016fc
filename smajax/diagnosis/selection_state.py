"""The state of a forward selection: what was fitted, accepted, rejected and found equivalent so far."""

import dataclasses
import math

import numpy as np

from smajax.diagnosis.candidates import AT_NOISE, CandidateFit
from smajax.diagnosis.detectability import Detectability, NominalScore

# Significance level of the score test over the whole catalogue: in the prototype study of the diagnosis it gave no
# false alarm in 128 recordings without a hidden effect, and 0.05 gave 4.7 %.
SIGNIFICANCE = 0.01
# The threshold of chi-squared: so many of its standard deviations, with so many independent samples a sample. Both from
# the prototype study, where the threshold flagged 15 of 15 causes outside of the catalogue.
_STANDARD_DEVIATIONS = 4.0
_INDEPENDENT_SHARE = 0.8


@dataclasses.dataclass(frozen=True)
class CandidateSummary:
    """What the first round says of one effect; strengths in SI, ``None`` where it was not fitted."""

    detectability: Detectability
    strength: float | None = None
    lower95: float | None = None
    upper95: float | None = None
    gain: float | None = None
    p_value: float | None = None
    refit_rmse_select: float | None = None


@dataclasses.dataclass
class SelectionState:
    """The state of a forward selection, from the base fit to the current one.

    Attributes:
        detectability: What the training input can show of each effect.
        noise: Standard deviation of each channel, SI, and its source.
        base_fit: The fit without further effects.
        current: The fit with the effects that are accepted.
        chi2_limit: Reduced chi-squared above which more than noise is left. nominal_scores: Scores at the rig's nominal
        values: a large effect has biased the base fit so far that scores there mislead. base_fit_converged: Whether the
        base fit is stationary; a large effect may keep it from that. accepted_fits: The fits that were accepted one
        after the other. alternatives: For each accepted effect, the best fits with another one in its place.
        equivalent: For each accepted effect, those that explain both recordings as well. rejected: Effects that were
        not accepted, and why. ranking: Summary of every effect after the first round. stage_shares: Share of the base
        fit's residual that can live in each stage.
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
    rejected: list[tuple[str, str]] = dataclasses.field(default_factory=list)
    ranking: dict[str, CandidateSummary] = dataclasses.field(default_factory=dict)
    stage_shares: dict[str, float] = dataclasses.field(default_factory=dict)

    @property
    def accepted(self) -> tuple[str, ...]:
        """Keys of the accepted effects, in order."""
        return self.current.keys

    @property
    def acceptable_chi2(self) -> float:
        """Reduced chi-squared that a fit with the right effects may leave."""
        return max(self.chi2_limit, AT_NOISE)

    @property
    def base_residual_may_be_noise(self) -> bool:
        """Whether no effect is significant at the base fit: its residual may be noise that is autocorrelated."""
        p_values = (r.p_value for r in self.ranking.values() if r.p_value is not None)
        return min(p_values, default=1.0) > SIGNIFICANCE

    @property
    def explained(self) -> float:
        """Share of the base fit's excess over the noise, on both recordings, that the current fit explains."""
        return self.explained_by(self.current)

    def explained_by(self, fit: CandidateFit) -> float:
        """Return the share that a fit explains; of the training split where the base fit cannot predict the other."""
        pairs = [(fit.train_chi2, self.base_fit.train_chi2), (fit.select_chi2, self.base_fit.select_chi2)]
        excess = [np.maximum(np.array(pair) - 1.0, 0.0) for pair in pairs if math.isfinite(pair[1])]
        after, before = np.sum(excess, axis=0)
        return float(1.0 - after / max(before, 1e-9))

    def explained_in_training_by(self, fit: CandidateFit) -> float:
        """Return the share that a fit explains of the training split alone.

        An effect that is not the cause may mend a prediction that a biased base fit spoilt, and fit no better.
        """
        after, before = (max(f.train_chi2 - 1.0, 0.0) for f in (fit, self.base_fit))
        return float(1.0 - after / max(before, 1e-9))


def chi2_threshold(samples: int) -> float:
    """Return the reduced chi-squared above which more than noise is left.

    1 plus four standard deviations of the reduced chi-squared of 0.8 independent values a sample, each sqrt(2 / (0.8
    samples)).

    Args:
        samples: Scored samples of the training split.
    """
    return 1.0 + _STANDARD_DEVIATIONS * math.sqrt(2.0 / (_INDEPENDENT_SHARE * samples))
