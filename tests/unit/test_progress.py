"""Callbacks of long work: what they return, and how they stop it."""

import pytest

from smajax.errors import Cancelled
from smajax.progress import CallbackStop, ProgressEvent, Reporter, stoppable

STOP_SIGNALS = (KeyboardInterrupt, StopIteration)


def raise_at(error, *texts):
    """A callback that raises an error at the events with these texts."""

    def callback(event: ProgressEvent) -> bool:
        if event.text in texts:
            raise error
        return True

    return callback


def test_what_a_callback_returns_is_ignored():
    events = []
    reporter = Reporter(lambda event: events.append(event) or "stop")
    reporter.phase("reading", can_stop=True)
    reporter.step("row 1", 1, 2)
    reporter.finish("writing")
    assert [event.text for event in events] == ["reading", "row 1", "writing"] and not reporter.stopped
    assert stoppable(lambda step, cost: False)(1, 2.0) is None


@pytest.mark.parametrize("signal", [*STOP_SIGNALS, CallbackStop])
def test_a_stop_of_a_callback_is_told_from_faults(signal):
    def callback():
        raise signal

    with pytest.raises(CallbackStop):
        stoppable(stoppable(callback))()


def test_a_fault_of_a_callback_is_not_a_stop():
    with pytest.raises(ZeroDivisionError):
        stoppable(lambda: 1 / 0)()
    reporter = Reporter(lambda event: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        reporter.phase("reading", can_stop=True)
    assert not reporter.stopped


@pytest.mark.parametrize("signal", STOP_SIGNALS)
def test_a_stop_where_the_work_can(signal):
    reporter = Reporter(raise_at(signal, "step 2"))
    reporter.phase("fitting", can_stop=True)
    reporter.step("step 1", 1)
    with pytest.raises(KeyboardInterrupt):
        reporter.step("step 2", 2)
    assert reporter.stopped


@pytest.mark.parametrize(("signal", "error"), [(StopIteration, Cancelled), (KeyboardInterrupt, KeyboardInterrupt)])
def test_a_stop_where_there_is_no_result(signal, error):
    with pytest.raises(error, match="cancelled while reading" if error is Cancelled else None):
        Reporter(raise_at(signal, "reading")).phase("reading")


@pytest.mark.parametrize("signal", STOP_SIGNALS)
def test_a_stop_after_the_result_is_ignored(signal):
    reporter = Reporter(raise_at(signal, "step 1", "writing"))
    reporter.phase("fitting", can_stop=True)
    with pytest.raises(KeyboardInterrupt):
        reporter.step("step 1", 1)
    reporter.finish("writing")
    assert reporter.stopped
