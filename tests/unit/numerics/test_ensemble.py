"""Members of an ensemble in batches that are shared among the cores."""

import threading
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics.ensemble import call_groups_on_cores, evaluate_members, share_among_cores


@pytest.mark.parametrize("workers", [1, 3, None])
@pytest.mark.parametrize("count", [1, 4, 9, 12])
def test_all_members_are_evaluated_in_their_order_by_one_program(count, workers):
    traced = []

    @jax.jit
    def program(batch):
        traced.append(batch["a"].shape)
        return {"sum": batch["a"] + batch["b"].sum(axis=1), "code": jnp.zeros(batch["a"].shape, int)}

    members = {"a": np.arange(count, dtype=float), "b": np.arange(2.0 * count).reshape(count, 2)}
    result = evaluate_members(program, members, 4, workers=workers, new_program=True)
    np.testing.assert_array_equal(result["sum"], members["a"] + members["b"].sum(axis=1))
    assert result["code"].shape == (count,) and result["code"].dtype == np.int64
    assert traced == [(4,)]


def test_the_first_task_runs_alone_where_its_program_is_new():
    running, most = 0, []
    lock = threading.Lock()

    def task(number):
        nonlocal running
        with lock:
            running += 1
        time.sleep(0.02)
        with lock:
            most.append((number, running))
            running -= 1
        return number

    assert share_among_cores(task, range(7), workers=3, new_program=True) == list(range(7))
    assert most[0] == (0, 1) and max(together for _, together in most[1:]) > 1


def test_an_error_of_a_task_is_raised():
    def task(number):
        if number == 2:
            raise ValueError("third")
        return number

    with pytest.raises(ValueError, match="third"):
        share_among_cores(task, range(4), workers=2)


@pytest.mark.parametrize("workers", [1, 3, None])
def test_groups_have_their_results_in_order(workers):
    groups = [[partial(pow, base, power) for power in range(count)] for base, count in ((2, 5), (3, 0), (5, 2))]
    results = list(call_groups_on_cores(groups, workers=workers))
    assert results == [[1, 2, 4, 8, 16], [], [1, 5]]


def test_a_group_begins_while_the_one_before_it_runs_and_no_further_one():
    taken, begun = [], threading.Event()

    def groups():
        for number in range(4):
            taken.append(number)
            yield [begun.set] if number else [lambda: begun.wait(10.0)]

    results = call_groups_on_cores(groups(), workers=2)
    assert next(results) == [True], "the first group ends once the second one has begun"
    assert taken == [0, 1]
    results.close()


def test_an_error_of_a_group_is_raised_and_later_functions_are_not_called():
    called, go_on = [], threading.Event()

    def fail():
        raise ValueError("wrong")

    groups = [[fail], [lambda: go_on.wait(10.0), lambda: called.append(1)]]
    with pytest.raises(ValueError, match="wrong"):
        list(call_groups_on_cores(groups, workers=1))
    go_on.set()
    time.sleep(0.1)
    assert called == []
