"""Tasks that run two at a time."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any


def map_in_pairs(function: Callable[[Any], Any], tasks: Sequence) -> list:
    """Apply a function to tasks, two at a time: one simulation keeps one core busy.

    Args:
        function: What is called with each task.
        tasks: Its arguments.

    Returns:
        The results in the order of the tasks.
    """
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(function, tasks))
