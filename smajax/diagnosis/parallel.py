"""Tasks that run two at a time."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def map_in_pairs(function: Callable[[Any], Any], tasks: Sequence[Any]) -> list[Any]:
    """Apply a function to tasks, two at a time, since a simulation uses one core.

    Args:
        function: Called with each task, in a thread.
        tasks: The tasks.

    Returns:
        The results in the order of the tasks.
    """
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(function, tasks))
