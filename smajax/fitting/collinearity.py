"""Groups of parameters whose effects the data cannot distinguish.

Source: brun2001 (collinearity index).
"""

import dataclasses
import math

import numpy as np
from jaxtyping import Float

# Response of a normalised direction below which its parameters are collinear: the inverse of the collinearity index of
# brun2001, so an index of 10. Chosen by trial; tests/unit/fitting/test_fit.py holds it.
_COLLINEAR_RESPONSE = 0.1
# Share of the direction's largest entry from which a parameter belongs to the group; chosen by trial, held by the same
# tests.
_GROUP_SHARE = 0.1


@dataclasses.dataclass(frozen=True)
class CollinearGroup:
    """Parameters whose effects the data cannot distinguish.

    Attributes:
        parameters: Names.
        direction: Joint change, each over the parameter's size, that hardly changes the model; of length 1.
        shrink: Response to that change over the response to independent changes of the same size; 0 for a single
            parameter without any effect.
    """

    parameters: tuple[str, ...]
    direction: tuple[float, ...]
    shrink: float


def find_collinear_groups(
    jacobian: Float[np.ndarray, "m p"],
    names: list[str],
    sizes: Float[np.ndarray, " p"],
    threshold: float = _COLLINEAR_RESPONSE,
) -> list[CollinearGroup]:
    """Find groups of parameters whose joint change along some direction hardly changes the model.

    The columns of the Jacobian are scaled to length 1; the response along an eigenvector of their Gram matrix is the
    root of its eigenvalue, the inverse of the collinearity index of brun2001.

    Args:
        jacobian: Jacobian (m, p) of the weighted residual.
        names: Names of the parameters (p,).
        sizes: Sizes of the parameters (p,), over which directions are given.
        threshold: Response below which a group is reported.

    Returns:
        The groups: first parameters without any effect, then collinear ones from the smallest response on.

    Source: brun2001.
    """
    length = np.linalg.norm(jacobian, axis=0)
    groups = [CollinearGroup((names[i],), (1.0,), 0.0) for i in np.flatnonzero(length == 0)]
    effective = np.flatnonzero(length > 0)
    if len(effective) < 2:
        return groups
    unit = jacobian[:, effective] / length[effective]
    values, vectors = np.linalg.eigh(unit.T @ unit)
    for value, vector in zip(values, vectors.T, strict=True):
        response = math.sqrt(max(value, 0.0))
        if response > threshold:
            break
        members = np.abs(vector) > _GROUP_SHARE * np.max(np.abs(vector))
        direction = vector[members] / (length[effective] * sizes[effective])[members]
        direction /= np.linalg.norm(direction) * (np.sign(direction[np.argmax(np.abs(direction))]) or 1.0)
        group = tuple(names[i] for i in effective[members])
        groups.append(CollinearGroup(group, tuple(float(d) for d in direction), response))
    return groups
