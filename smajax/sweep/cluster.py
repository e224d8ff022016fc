"""Chunks handed to a Dask cluster: an existing one by its address, or one of this machine's cores. Needs the extra ``cluster``."""

import asyncio
import contextlib
import json
import logging
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from smajax import __version__
from smajax.console import cores, prepare_jax
from smajax.errors import InputError

if TYPE_CHECKING:
    from smajax.sweep.chunks import Chunk, Done, Submit

LOCAL = "local"
_PATIENCE = 20
# A chunk whose worker died is given to another one, so often.
_DEATHS = 100
# Evaluates to the version of smajax, or to None where it is not installed.
_VERSION = "(lambda found: found and __import__('smajax').__version__)(__import__('importlib.util').util.find_spec('smajax'))"


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """A client of the scheduler at ``address``; of a cluster of this machine's cores for ``local``.

    InputError if there is none, if it has no workers, or if one of them has no smajax or another version of it.
    """
    if not address.strip():
        raise InputError(f"--scheduler is empty: give a Dask scheduler's address, like tcp://host:8786, or {LOCAL}, or leave it out")
    try:
        import distributed
    except ImportError:
        raise InputError('--scheduler needs Dask: run pip install "smajax[cluster]", or leave --scheduler out') from None
    import dask

    dask.config.set({"distributed.scheduler.allowed-failures": _DEATHS, "distributed.admin.log-format": "%(message)s"})
    with contextlib.ExitStack() as held:
        # What it says of lost connections is said in a sentence.
        held.enter_context(_quiet("distributed", "distributed.client", "tornado.application", "asyncio"))
        if address == LOCAL:
            settings: Any = {"dashboard_address": None, "silence_logs": "ERROR"}
            try:
                cluster: Any = distributed.LocalCluster(n_workers=cores(), threads_per_worker=1, processes=True, **settings)
            except RuntimeError as error:
                cure = "run again, with --resume if chunks are there, or leave --scheduler out to use this process"
                raise InputError(f"--scheduler {LOCAL}: the worker processes did not start ({error}): {cure}") from None
            yield held.enter_context(distributed.Client(held.enter_context(cluster).scheduler_address, set_as_default=False))
            return
        try:
            _reach(address)
            _shake_hands(address)
            client = distributed.Client(address, timeout=_PATIENCE, set_as_default=False)
        except (OSError, ValueError, MemoryError) as error:
            words = (str(error).splitlines() or [type(error).__name__])[0][:160]
            cure = "check its address, or leave --scheduler out to use this machine"
            raise InputError(f"--scheduler {address}: no Dask scheduler answers there ({words}): {cure}") from None
        held.enter_context(client)
        _check_workers(client, address)
        yield client


def _reach(address: str) -> None:
    """Opens a connection and closes it: what Dask's client would go on trying. OSError or ValueError if there is nothing there."""
    from distributed.comm import get_address_host_port

    scheme, _, place = address.rpartition("://")
    if scheme not in ("", "tcp", "tls"):
        raise ValueError(f"an address begins with tcp:// or tls://, not with {scheme}://")
    host, port = get_address_host_port(f"tcp://{place}", strict=True)
    socket.create_connection((host, port), timeout=_PATIENCE).close()


def _shake_hands(address: str) -> None:
    """Asks who is there. OSError or ValueError if that is no scheduler, whatever it sends, or if it says nothing for the time of patience.

    Dask's own client would go on asking. The question is put in a thread of its own, which is left behind if it does not come back.
    """
    told: list[Any] = []

    def ask() -> None:
        try:
            told.append(asyncio.run(asyncio.wait_for(_identity(address), _PATIENCE)))
        except Exception as error:  # a foreign greeting is read as lengths and types, which can go wrong in any way
            told.append(error)

    thread = threading.Thread(target=ask, daemon=True, name="smajax-handshake")
    thread.start()
    thread.join(_PATIENCE + 1)
    answer = told[0] if told else TimeoutError()
    if isinstance(answer, TimeoutError):
        raise TimeoutError(f"it says nothing for {_PATIENCE} s")
    if isinstance(answer, OSError):
        raise answer
    if isinstance(answer, Exception):
        raise ValueError("what answers speaks another language")
    if answer != "Scheduler":
        raise ValueError(f"it is the address of a {str(answer).lower()}")


async def _identity(address: str) -> str:
    """What answers at an address, in Dask's words: ``Scheduler``, ``Worker``."""
    from distributed import Security
    from distributed.comm import connect

    comm = await connect(address, timeout=_PATIENCE, **Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        return str((await comm.read())["type"])
    finally:
        comm.abort()


def _check_workers(client: Any, address: str) -> None:
    """InputError unless there are workers, and they and the scheduler have this version of smajax."""
    place = f"--scheduler {address}"
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise InputError(f"{place}: it has no workers: start some (dask worker {address}), then run this again") from None
    # ``eval`` is there whatever is installed, where a function of ours would not be.
    theirs = {f"worker {name}": told for name, told in client.run(eval, _VERSION, on_error="return").items()}
    with contextlib.suppress(Exception):  # a scheduler may forbid it; the workers do the work
        theirs["the scheduler"] = client.run_on_scheduler(eval, _VERSION)
    for name, told in theirs.items():
        if told is None or isinstance(told, BaseException):
            raise InputError(f'{place}: {name} has no smajax: run pip install "smajax[cluster]=={__version__}" there')
        if told != __version__:
            raise InputError(f"{place}: {name} has smajax {told}, and this is {__version__}: install the same version everywhere")


@contextlib.contextmanager
def _quiet(*names: str) -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def across(client: Any, header: Mapping[str, Any], gradients: bool) -> "Submit":
    """Works on chunks on a cluster; each worker builds the study of a sweep's ``header`` once.

    A worker that dies costs what it was at: its chunk is given to another one. Raises InputError if the scheduler is gone.
    """
    text = json.dumps(header)

    def submit(chunks: "Sequence[Chunk]") -> "Iterator[Done]":
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
            yield [(chunk, found)]

    return submit


def work(text: str, designs: np.ndarray, steps: int, gradients: bool) -> dict[str, np.ndarray]:
    """What a worker does with a chunk of the sweep whose header is ``text`` (JSON)."""
    with contextlib.suppress(RuntimeError):  # a worker that has worked before has it behind it
        prepare_jax(accelerator=True)
    from smajax.sweep.chunks import evaluate

    return evaluate(_study(text), designs, steps, gradients=gradients)


@lru_cache(maxsize=4)
def _study(text: str) -> Any:
    from smajax.sweep_file import from_header

    header = json.loads(text)
    if header["smajax"] != __version__:
        raise InputError(f"a worker has smajax {__version__}, and the sweep is of {header['smajax']}: install the same version everywhere")
    return from_header(header).study()
