"""The period of the samples, which all parts of a loop have in common."""

import math

from smajax.errors import InputError

# Relative difference of two periods that counts as rounding: double precision rounds a quotient to 1e-16.
_ROUNDING = 1e-9


def check_same_period(name: str, period: float, other_name: str, other_period: float) -> None:
    """Check that two parts have the same period.

    Args:
        name: Name of the first part.
        period: Its period, s.
        other_name: Name of the second part.
        other_period: Its period, s.

    Raises:
        InputError: if the periods differ.
    """
    if not math.isclose(period, other_period, rel_tol=_ROUNDING):
        raise InputError(
            f"the {name} has a period of {period:g} s, and the {other_name} one of {other_period:g} s: "
            "build both with the same period"
        )
