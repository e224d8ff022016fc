"""Processes that a test or an experiment monitors and kills."""

import contextlib

import psutil


def workers_of(parent: int) -> list[psutil.Process]:
    """Return the worker processes of a run with a local cluster, by the process number of the run."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return [
            p
            for p in psutil.Process(parent).children(recursive=True)
            if any("spawn_main" in word for word in p.cmdline())
        ]
    return []
