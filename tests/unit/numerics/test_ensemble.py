"""Members of an ensemble in batches that are shared among the cores."""

import threading
import time

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.numerics.ensemble import evaluate_members, share_among_cores


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
