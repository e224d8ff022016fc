"""Chunks handed to a Dask cluster: an existing one by its address, or one of this machine's cores. Needs the extra ``cluster``."""

import contextlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from smajax.console import cores, prepare_jax
from smajax.errors import InputError

if TYPE_CHECKING:
    from smajax.sweep.chunks import Chunk

LOCAL = "local"
_PATIENCE = 20
# A chunk whose worker died is given to another one, so often.
_DEATHS = 100


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client of the scheduler at ``address``; of a cluster of this machine's cores for ``local``. InputError if there is none."""
    try:
        import distributed
    except ImportError:
        raise InputError('--scheduler needs Dask: run pip install "smajax[cluster]", or leave --scheduler out') from None
    import dask

    dask.config.set({"distributed.scheduler.allowed-failures": _DEATHS, "distributed.admin.log-format": "%(message)s"})
    with contextlib.ExitStack() as held:
        if address == LOCAL:
            settings: Any = {"dashboard_address": None, "silence_logs": "ERROR"}
            try:
                cluster: Any = distributed.LocalCluster(n_workers=cores(), threads_per_worker=1, processes=True, **settings)
            except RuntimeError as error:
                cure = "run again, with --resume if chunks are there, or leave --scheduler out to use this process"
                raise InputError(f"--scheduler {LOCAL}: the worker processes did not start ({error}): {cure}") from None
            address = held.enter_context(cluster).scheduler_address
        try:
            client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            words = (str(error).splitlines() or [type(error).__name__])[0][:160]
            cure = "check its address, or leave --scheduler out to use this machine"
            raise InputError(f"--scheduler {address}: no Dask scheduler answers there ({words}): {cure}") from None
        yield held.enter_context(client)


def across(client: Any, header: Mapping[str, Any], gradients: bool) -> "Callable[[Sequence[Chunk]], Iterator[tuple[Chunk, dict]]]":
    """Works on chunks on a cluster; each worker builds the study of a sweep's ``header`` once.

    A worker that dies costs what it was at: its chunk is given to another one. Raises InputError if the scheduler is gone.
    """
    text = json.dumps(header)

    def submit(chunks: "Sequence[Chunk]") -> "Iterator[tuple[Chunk, dict]]":
        import distributed

        def hand(chunk: "Chunk") -> Any:
            return client.submit(work, text, chunk.designs, chunk.steps, gradients, pure=False)

        told = {hand(chunk): chunk for chunk in chunks}
        deaths = 0
        coming = distributed.as_completed(list(told), loop=client.loop)
        for future in coming:
            chunk = told.pop(future)
            try:
                found = future.result()
            except distributed.KilledWorker:
                deaths += 1
                if deaths > _DEATHS:
                    raise InputError(f"workers died {deaths} times: give them more memory, or a smaller sweep.chunk") from None
                again = hand(chunk)
                told[again] = chunk
                coming.add(again)
                continue
            except (distributed.CancelledError, OSError):
                raise InputError("the Dask scheduler is gone: start it again, and run the sweep again with --resume") from None
            future.release()
            yield chunk, found

    return submit


def work(text: str, designs: np.ndarray, steps: int, gradients: bool) -> dict[str, np.ndarray]:
    """What a worker does with a chunk of the sweep whose header is ``text`` (JSON)."""
    with contextlib.suppress(RuntimeError):  # a worker that has worked before has it behind it
        prepare_jax()
    from smajax.sweep.chunks import evaluate

    return evaluate(_study(text), designs, steps, gradients=gradients)


@lru_cache(maxsize=4)
def _study(text: str) -> Any:
    from smajax.sweep_file import from_header

    return from_header(json.loads(text)).study()
