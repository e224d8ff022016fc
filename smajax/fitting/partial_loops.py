"""Partial loops in recordings; without them the spread of grains and their width are not distinguishable."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

# Shares of the range of the strain between which a turning point counts as that of a partial loop; also the smallest
# movement between turning points. Chosen so that noise and incomplete ends of full cycles do not count.
_INSIDE = 0.1


def has_partial_loop(strain: Float[np.ndarray, " rows"]) -> bool:
    """Return whether a strain turns round inside its range.

    Args:
        strain: Strain of the model at the rows.
    """
    share = (strain - np.min(strain)) / max(float(np.ptp(strain)), np.finfo(float).tiny)
    extreme, direction = float(share[0]), 0
    for value in share[1:]:
        if direction * (value - extreme) >= 0.0 and (direction or abs(value - extreme) > _INSIDE):
            direction = direction or (1 if value > extreme else -1)
            extreme = float(value)
        elif direction and abs(value - extreme) > _INSIDE:
            if _INSIDE < extreme < 1.0 - _INSIDE:
                return True
            extreme, direction = float(value), -direction
    return False


def spread_warnings(strains: Sequence[Float[np.ndarray, " _rows"]], free: Sequence[str]) -> list[str]:
    """Return a sentence if spreads of grains are free and no training recording has a partial loop.

    Args:
        strains: Strains of the model on the training recordings.
        free: Names of the free parameters.
    """
    spreads = [name for name in free if name.startswith("grains.") and name.endswith("_spread")]
    if not spreads or any(has_partial_loop(strain) for strain in strains if np.all(np.isfinite(strain))):
        return []
    return [
        f"{' and '.join(spreads)}: no training recording has a partial loop, which turns round inside a "
        "transformation, so a spread of the grains and a wide transformation of each are not distinguishable: record "
        "partial loops, or leave the spread fixed."
    ]
