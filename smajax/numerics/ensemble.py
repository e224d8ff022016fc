"""Evaluation of a compiled program for many members: batches of one size, shared among the processor's cores.

A batch fills the vector units of one core, so that members are shared among cores by batches, each in a thread of its
own: a compiled program holds no lock of Python. What a batch contains follows from the members alone, so that the
results are the same with any number of cores.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from typing import Any, TypeVar

import jax
import numpy as np

from smajax.numerics.process import count_cores

Task = TypeVar("Task")
Result = TypeVar("Result")


def share_among_cores(
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    *,
    workers: int | None = None,
    new_program: bool = False,
) -> list[Result]:
    """Apply a function that runs compiled programs to tasks, in one thread per core.

    Args:
        function: Called with each task, in a thread.
        tasks: The tasks.
        workers: Number of threads; one per core by default, and one on an accelerator.
        new_program: Whether the program is not compiled yet; the first task then runs alone, so that only one thread
            compiles it.

    Returns:
        The results in the order of the tasks.
    """
    workers = parallel_batches() if workers is None else workers
    alone = 1 if new_program else 0
    if min(workers, len(tasks) - alone) <= 1:
        return [function(task) for task in tasks]
    results = [function(task) for task in tasks[:alone]]
    pool = ThreadPoolExecutor(min(workers, len(tasks) - alone))
    try:
        return results + list(pool.map(function, tasks[alone:]))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # after an error or Ctrl-C, tasks that run are not waited for


def call_groups_on_cores(
    groups: Iterable[Sequence[Callable[[], Result]]], *, workers: int | None = None
) -> Iterator[list[Result]]:
    """Call functions that run compiled programs, in one thread per core, group by group.

    The functions of a group begin while the last ones of the group before it run, so that no core waits between groups.

    Args:
        groups: The functions; one group is taken ahead of that whose results are yielded next.
        workers: Number of threads, as in ``share_among_cores``.

    Yields:
        The results of each group, in the order of its functions.
    """
    pool = ThreadPoolExecutor(parallel_batches() if workers is None else workers)
    try:
        waiting: deque[list[Future[Result]]] = deque()
        for group in groups:
            waiting.append([pool.submit(function) for function in group])
            if len(waiting) > 1:
                yield [future.result() for future in waiting.popleft()]
        for futures in waiting:
            yield [future.result() for future in futures]
    finally:
        pool.shutdown(wait=False, cancel_futures=True)


def parallel_batches() -> int:
    """Return how many batches run at once: one per core, or a single one on an accelerator."""
    return count_cores() if jax.default_backend() == "cpu" else 1


def member_batches(program: Callable[[Any], Any], members: Any, size: int) -> list[Callable[[], Any]]:
    """Return functions that evaluate a program for the batches of an ensemble.

    Args:
        program: Function of a batch of members that returns arrays, each with a leading axis of ``size``.
        members: Arrays, a pytree, each with a leading axis of the number of members.
        size: Number of members of a batch. The last batch is filled up with copies of the last member, so that all
            batches use one compiled program.

    Returns:
        A function for each batch, which returns NumPy arrays for ``join_batches``.
    """
    count = len(jax.tree.leaves(members)[0])

    def run_batch(first: int) -> Any:
        rows = np.minimum(np.arange(first, first + size), count - 1)
        results = program(jax.tree.map(lambda leaf: np.asarray(leaf)[rows], members))
        return jax.tree.map(lambda leaf: np.asarray(leaf)[: count - first], results)

    return [partial(run_batch, first) for first in range(0, count, size)]


def join_batches(parts: Sequence[Any]) -> Any:
    """Return the results of all batches of an ensemble as arrays with a leading axis of the number of members."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def evaluate_members(
    program: Callable[[Any], Any], members: Any, size: int, *, workers: int | None = None, new_program: bool = False
) -> Any:
    """Evaluate a program for all members of an ensemble, in batches that are shared among the cores.

    Args:
        program: The program, as in ``member_batches``.
        members: The members, as in ``member_batches``.
        size: Number of members of a batch.
        workers: Number of threads, as in ``share_among_cores``.
        new_program: Whether the program is not compiled yet.

    Returns:
        What the program returns, as NumPy arrays with a leading axis of the number of members.
    """
    batches = member_batches(program, members, size)
    parts = share_among_cores(lambda batch: batch(), batches, workers=workers, new_program=new_program)
    return join_batches(parts)
