"""The numbers of time steps with which the designs of a sweep are simulated: each is a compiled program of its own.

Designs need different numbers of steps, and a program has one. Simulating all with the largest number wastes steps; a
program for each number wastes compilation. ``group_steps`` takes as few numbers as pay: a further program is compiled
only where it spares more simulated steps than its compilation is worth.
"""

import numpy as np

# Steps of designs that a further program has to spare: about as long as its compilation takes. Chosen by trial;
# experiments/speed/sweep_throughput.py prints both.
_WORTH_COMPILING = 3_000_000


def group_steps(needed: np.ndarray) -> np.ndarray:
    """Return the steps with which each design is simulated, shape ``(m,)``: as few different numbers as pay.

    Args:
        needed: Steps that resolve each design, whole numbers, shape ``(m,)``; no design gets fewer.
    """
    levels = sorted({next_power_of_two(n) for n in needed}, reverse=True)
    chosen = levels[:1]
    for level in levels[1:]:
        if np.sum(needed <= level) * (chosen[-1] - level) > _WORTH_COMPILING:
            chosen.append(level)
    steps = np.empty_like(needed)
    for level in chosen:
        inside = needed <= level
        steps[inside] = needed[inside].max()
    return steps


def next_power_of_two(steps: int) -> int:
    """Return the smallest power of two that is at least ``steps``."""
    return 1 << (int(steps) - 1).bit_length()
