"""Peak memory of a command, measured by the operating system."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from typing import NamedTuple

# Runs a command and prints its exit code and peak. A small process does it, since a peak counts the memory of the
# process that started the command, too; Linux gives it in KiB.
_WATCHER = """
import json, resource, subprocess, sys
code = subprocess.run(sys.argv[1:], stdout=sys.stderr).returncode
print(json.dumps([code, 1024 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss]))
"""


class Peak(NamedTuple):
    """A command that has ended.

    Attributes:
        code: Exit code.
        memory: Largest resident set, bytes.
        seconds: Wall time.
        output: What it printed.
    """

    code: int
    memory: int
    seconds: float
    output: str


def measure_peak(command: Sequence[str], variables: Mapping[str, str] = {}) -> Peak:
    """Run a command with an empty cache of compiled programs, so that the peak of compiling is included.

    Args:
        command: The command and its arguments.
        variables: Further environment variables.
    """
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "JAX_COMPILATION_CACHE_DIR": cache, **variables}
        began = time.perf_counter()
        watcher = [sys.executable, "-c", _WATCHER, *command]
        run = subprocess.run(watcher, capture_output=True, text=True, env=environment, check=True)
    code, memory = json.loads(run.stdout)
    return Peak(code, memory, time.perf_counter() - began, run.stderr)
