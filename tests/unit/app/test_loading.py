"""The end of a process whose result nobody waits for any more."""

import subprocess
import sys

import pytest

from tests.conftest import ROOT

PROGRAM = """
import threading, time
from smajax.app.loading import end_process
from smajax.numerics.process import COMPILATION

threading.Thread(target=time.sleep, args=({seconds},), name=COMPILATION).start()
print("text")
end_process({code})
"""


@pytest.mark.parametrize(("code", "number"), [(130, 130), (None, 0)])
def test_a_process_ends_while_a_thread_compiles(code, number):
    program = PROGRAM.format(seconds=600, code=code)
    result = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert (result.returncode, result.stdout, result.stderr) == (number, "text\n", "")
