"""The second Ctrl-C during a call that Python cannot interrupt."""

import subprocess
import sys

import pytest

# numpy's solution of a large system is one call of another library; the handler of a signal runs after it.
CALL = """
import os, signal, threading, time
import numpy as np
from smajax.app.interrupt_watch import InterruptWatch
watch = InterruptWatch((signal.SIGINT,), lambda: os._exit(130))
signal.signal(signal.SIGINT, lambda *_: None)
watch.start()
def press():
    for _ in range({count}):
        time.sleep(0.3)
        os.kill(os.getpid(), signal.SIGINT)
threading.Thread(target=press, daemon=True).start()
if {stopped}:
    watch.stop()
matrix, end = np.random.default_rng(0).normal(size=(3500, 3500)), time.perf_counter() + 3.0
while time.perf_counter() < end:
    np.linalg.eigvalsh(matrix)
os._exit(0)
"""


def code_of(presses: int, stopped: bool = False) -> int:
    return subprocess.run([sys.executable, "-c", CALL.format(count=presses, stopped=stopped)], timeout=120).returncode


@pytest.mark.slow
def test_the_second_ctrl_c_ends_a_process_in_a_call_of_another_library():
    assert code_of(2) == 130
    assert code_of(1) == 0, "a first Ctrl-C only ends nothing"
    assert code_of(2, stopped=True) == 0, "what is not watched goes on"
