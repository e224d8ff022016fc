"""Equivalence of effects: which of them the recordings cannot distinguish."""

from collections.abc import Mapping

import numpy as np

from smajax.diagnosis.candidates import CandidateFit

# Cosine between two projected sensitivities from which the effects are hard to distinguish: in the prototype study of
# the diagnosis classes of this threshold had 1.0 to 1.1 members on average.
_CLASS_COSINE = 0.9
# Difference of chi-squared up to which two fits of different effects are equivalent, as a multiple of the reduced
# chi-squared: 10 is a likelihood ratio of 150. From the prototype study of the diagnosis, whose equivalence sets had
# 1.03 members on average.
_EQUIVALENT_CHI2 = 10.0
# Difference of the reduced chi-squared of the selection split that never counts: a hundredth of what noise gives.
# Chosen by trial.
_EQUIVALENT_SELECT = 0.01


def equivalence_classes(sensitivities: Mapping[str, np.ndarray], threshold: float = _CLASS_COSINE) -> list[set[str]]:
    """Group effects that are hard to distinguish, by single linkage on the cosine between their sensitivities.

    Args:
        sensitivities: Projected sensitivities of the effects.
        threshold: Absolute cosine from which two effects are linked.
    """
    groups: list[set[str]] = []
    unit = {
        key: sensitivity / np.linalg.norm(sensitivity)
        for key, sensitivity in sensitivities.items()
        if np.linalg.norm(sensitivity) > 0
    }
    for key, sensitivity in unit.items():
        near = [g for g in groups if any(abs(float(sensitivity @ unit[other])) > threshold for other in g)]
        groups = [g for g in groups if g not in near]
        groups.append({key}.union(*near))
    return groups


def is_equivalent(fit: CandidateFit, best: CandidateFit, samples: int) -> bool:
    """Say whether a fit explains both recordings as well as the best one.

    Args:
        fit: A fit with another effect.
        best: The best fit.
        samples: Scored samples of the training split.
    """
    close = (fit.train_chi2 - best.train_chi2) * samples < _EQUIVALENT_CHI2 * max(1.0, best.train_chi2)
    margin = max(_EQUIVALENT_SELECT, _EQUIVALENT_CHI2 * max(1.0, best.select_chi2) / samples)
    return close and fit.select_chi2 < best.select_chi2 + margin
