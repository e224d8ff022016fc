"""Equivalence of effects: which of them the recordings cannot distinguish.

Before a refit, effects whose projected sensitivities are nearly collinear form a class (``equivalence_classes``). After
a refit, two effects are equivalent if both fits explain the recordings as well (``is_equivalent``).
"""

from collections.abc import Mapping

import numpy as np

from smajax.diagnosis.candidates import CandidateFit

# Cosine between two projected sensitivities above which the effects are hard to distinguish. Chosen by trial;
# experiments/diagnosis/hidden_effects.py prints what one refit for each class would name.
_CLASS_COSINE = 0.9
# Difference of chi-squared below which two fits are equivalent, as a multiple of the reduced chi-squared: 10 is a
# likelihood ratio of exp(5) = 150. Chosen by trial.
_EQUIVALENT_CHI2 = 10.0
# Difference of the reduced chi-squared of the selection split below which two fits always predict it equally well: a
# hundredth of the noise. Chosen by trial.
_EQUIVALENT_SELECT = 0.01


def equivalence_classes(sensitivities: Mapping[str, np.ndarray], threshold: float = _CLASS_COSINE) -> list[set[str]]:
    """Group effects that are hard to distinguish, by single linkage on the cosine between their sensitivities.

    With the projected sensitivities a and b, two effects are linked if ``|a^T b| / (|a| |b|)`` exceeds the threshold; a
    group is everything that is linked directly or through others. Effects without a sensitivity are left out.

    Args:
        sensitivities: Projected sensitivities of the effects by key, each of shape ``(m,)``.
        threshold: Absolute cosine above which two effects are linked.

    Returns:
        The keys of each group.
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
    """Return whether a fit explains training and selection split as well as the best fit.

    With the reduced chi-squared c of the best fit and n samples, the difference of the training split's chi-squared is
    below 10 max(1, c), and that of the selection split's reduced chi-squared below max(0.01, 10 max(1, c) / n).

    Args:
        fit: A fit with another effect.
        best: The best fit.
        samples: Number of scored samples of the training split.
    """
    fits_as_well = (fit.train_chi2 - best.train_chi2) * samples < _EQUIVALENT_CHI2 * max(1.0, best.train_chi2)
    margin = max(_EQUIVALENT_SELECT, _EQUIVALENT_CHI2 * max(1.0, best.select_chi2) / samples)
    return fits_as_well and fit.select_chi2 < best.select_chi2 + margin
