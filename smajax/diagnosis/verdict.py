"""The verdict of a diagnosis, from the errors on the three splits."""

from smajax.diagnosis.data_split import HOLDOUT
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.structure import UNIFORM, Structure

# Reduced chi-squared over its expectation up to which a prediction of the selection split is as good as noise. For the
# holdout, whose inputs may have a larger range, its square. Chosen by trial.
_MAX_MISS = 1.2
# Reduced chi-squared of the training split above which an effect is missing, where ``chi2_threshold`` is smaller.
# Chosen by trial.
_MIN_MISSING = 1.1


def classify_outcome(
    state: SelectionState,
    joint: tuple[float, ...],
    expected_chi2: tuple[float, float],
    structure: Structure = UNIFORM,
) -> str:
    """Return the verdict.

    - "nothing-missing": no effect is accepted, and all three splits are at the noise.
    - "unresolved": no effect is accepted, and a split is not at the noise.
    - "named": the accepted effects predict selection split and holdout as well as expected, or one fit to the first two
      splits is at the noise on all three. The latter is enough where the training split determines little, such as an
      onset at which nothing moves.
    - "named-up-to-class": the same, with effects that explain the recordings as well.
    - "partial": the accepted effects explain a part only.

    Args:
        state: The state at the end of the selection.
        joint: Reduced chi-squared of the fit to training and selection split on all three splits.
        expected_chi2: Reduced chi-squared by the noise and the uncertainty of the parameters: on the selection split,
            of the fit to the training split, and on the holdout, of the fit to both.
        structure: The structure of the wire, which counts as an accepted effect.
    """
    current, acceptable = state.current, state.acceptable_chi2
    select, holdout = current.select_chi2 / expected_chi2[0], joint[HOLDOUT] / expected_chi2[1]
    if not state.accepted and not structure.effects:
        limit = max(state.chi2_limit, _MIN_MISSING)
        missing = current.train_chi2 > limit or select > _MAX_MISS or holdout > _MAX_MISS**2
        return "unresolved" if missing else "nothing-missing"
    predicted = current.train_chi2 < acceptable and max(select, holdout) < _MAX_MISS**2
    if predicted or max(*joint[:HOLDOUT], holdout) < acceptable:
        return "named-up-to-class" if any(state.equivalent.get(key) for key in state.accepted) else "named"
    return "partial"
