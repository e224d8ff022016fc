"""Numbers of time steps with which the designs of a sweep are simulated; each number takes a compiled program.

Designs need different numbers of steps, and a compiled program has a fixed one. Simulating all designs with the largest
number wastes steps; a program for each number wastes compilation. ``group_steps`` adds a program only if it saves more
simulated steps than its compilation costs.
"""

import numpy as np
from jaxtyping import Int

# Steps, summed over designs, that another program must save: simulating them takes about as long as its compilation.
# Chosen by trial; experiments/speed/sweep_throughput.py prints both.
_MIN_SAVED_STEPS = 3_000_000


def group_steps(needed: Int[np.ndarray, " designs"]) -> Int[np.ndarray, " designs"]:
    """Return the number of steps with which each design is simulated, with few different numbers.

    Args:
        needed: Number of steps that resolves each design, shape ``(designs,)``.

    Returns:
        Number of steps of each design, at least ``needed``, shape ``(designs,)``.
    """
    levels = sorted({next_power_of_two(int(n)) for n in needed}, reverse=True)
    chosen = levels[:1]
    for level in levels[1:]:
        if np.sum(needed <= level) * (chosen[-1] - level) > _MIN_SAVED_STEPS:
            chosen.append(level)
    steps = np.empty_like(needed)
    for level in chosen:
        inside = needed <= level
        steps[inside] = needed[inside].max()
    return steps


def next_power_of_two(steps: int) -> int:
    """Return the smallest power of two that is at least ``steps``."""
    return 1 << (steps - 1).bit_length()
