"""Simulation of chunks on a Dask cluster, existing or local. Needs the extra ``cluster``."""

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
from smajax.errors import InputError, first_line
from smajax.numerics.process import count_cores, prepare_jax

if TYPE_CHECKING:
    from smajax.sweeps.chunks import Chunk, FinishedChunks, Submit

# Address that means a cluster of this computer's cores.
LOCAL = "local"
# Time in s within which a scheduler must answer, and must have a worker; chosen by trial.
_TIMEOUT = 20
# Largest number of dead workers in a sweep; the chunk of a dead worker is sent to another one. Chosen so that only a
# chunk that kills every worker stops a run; experiments/speed/sweep_interruptions.py kills workers.
_MAX_DEATHS = 100
# Evaluates to the version of smajax, or to None if it is not installed.
_VERSION = (
    "(lambda spec: spec and __import__('smajax').__version__)(__import__('importlib.util').util.find_spec('smajax'))"
)


@contextlib.contextmanager
def connected(address: str) -> Iterator[Any]:
    """Connect to a Dask scheduler, or start a cluster of this computer's cores.

    Args:
        address: Address of the scheduler, such as ``tcp://host:8786``, or ``local``.

    Yields:
        A ``distributed.Client``.

    Raises:
        InputError: If Dask is not installed, no scheduler answers, it has no workers, or one of these has no smajax or
            another version of it.
    """
    if not address.strip():
        raise InputError(
            f"--scheduler is empty: give a Dask scheduler's address, like tcp://host:8786, or {LOCAL}, or leave it out"
        )
    try:
        import distributed
    except ImportError:
        raise InputError(
            '--scheduler needs Dask: run pip install "smajax[cluster]", or leave --scheduler out'
        ) from None
    import dask

    settings = {"distributed.scheduler.allowed-failures": _MAX_DEATHS, "distributed.admin.log-format": "%(message)s"}
    dask.config.set(settings)
    with contextlib.ExitStack() as stack:
        # The error messages of smajax replace Dask's log of lost connections.
        stack.enter_context(_silenced("distributed", "distributed.client", "tornado.application", "asyncio"))
        if address == LOCAL:
            yield _start_local_cluster(stack, distributed)
            return
        try:
            _open_connection(address)
            _check_identity(address)
            client = distributed.Client(address, timeout=_TIMEOUT, set_as_default=False)
        except (OSError, ValueError, MemoryError) as error:
            hint = "check its address, or leave --scheduler out to use this computer"
            raise InputError(
                f"--scheduler {address}: no Dask scheduler answers there ({first_line(error)}): {hint}"
            ) from None
        stack.enter_context(client)
        _check_workers(client, address)
        yield client


def _start_local_cluster(stack: contextlib.ExitStack, distributed: Any) -> Any:
    """Client of a new cluster with one process per core; the stack closes both."""
    settings: Any = {"dashboard_address": None, "silence_logs": "ERROR"}
    try:
        cluster: Any = distributed.LocalCluster(
            n_workers=count_cores(), threads_per_worker=1, processes=True, **settings
        )
    except RuntimeError as error:
        hint = "run again, with --resume if chunks are there, or leave --scheduler out to use this process"
        raise InputError(f"--scheduler {LOCAL}: the worker processes did not start ({error}): {hint}") from None
    address = stack.enter_context(cluster).scheduler_address
    return stack.enter_context(distributed.Client(address, set_as_default=False))


def _open_connection(address: str) -> None:
    """Opens and closes a connection; raises OSError or ValueError if that fails, while Dask's client would retry."""
    from distributed.comm import get_address_host_port

    scheme, _, place = address.rpartition("://")
    if scheme not in ("", "tcp", "tls"):
        raise ValueError(f"an address begins with tcp:// or tls://, not with {scheme}://")
    host, port = get_address_host_port(f"tcp://{place}", strict=True)
    socket.create_connection((host, port), timeout=_TIMEOUT).close()


def _check_identity(address: str) -> None:
    """Raises OSError or ValueError if the server at an address is not a scheduler, or does not answer in time.

    Dask's own client would retry for a long time. The request runs in a thread, which is abandoned if it does not end.
    """
    answers: list[Any] = []

    def ask() -> None:
        try:
            answers.append(asyncio.run(asyncio.wait_for(_identity(address), _TIMEOUT)))
        except Exception as error:  # data of another protocol is read as lengths and types, which can fail in any way
            answers.append(error)

    thread = threading.Thread(target=ask, daemon=True, name="smajax-handshake")
    thread.start()
    thread.join(_TIMEOUT + 1)
    answer = answers[0] if answers else TimeoutError()
    if isinstance(answer, TimeoutError):
        raise TimeoutError(f"it sends nothing for {_TIMEOUT} s")
    if isinstance(answer, OSError):
        raise answer
    if isinstance(answer, Exception):
        raise ValueError("the server there does not use Dask's protocol")
    if answer != "Scheduler":
        raise ValueError(f"it is the address of a {str(answer).lower()}")


async def _identity(address: str) -> str:
    """Type of the server at an address, as Dask names it: ``Scheduler`` or ``Worker``."""
    from distributed import Security
    from distributed.comm import connect

    comm = await connect(address, timeout=_TIMEOUT, **Security().get_connection_args("client"))
    try:
        await comm.write({"op": "identity", "reply": True})
        return str((await comm.read())["type"])
    finally:
        comm.abort()


def _check_workers(client: Any, address: str) -> None:
    """Raises InputError unless there are workers, and they and the scheduler have this version of smajax."""
    place = f"--scheduler {address}"
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT)
    except TimeoutError:
        raise InputError(
            f"{place}: it has no workers: start some (dask worker {address}), then run this again"
        ) from None
    # ``eval`` exists on any worker, while a function of smajax does not.
    versions = {f"worker {name}": v for name, v in client.run(eval, _VERSION, on_error="return").items()}
    with contextlib.suppress(Exception):  # a scheduler may forbid it; only the workers need smajax
        versions["the scheduler"] = client.run_on_scheduler(eval, _VERSION)
    for name, version in versions.items():
        if version is None or isinstance(version, BaseException):
            raise InputError(f'{place}: {name} has no smajax: run pip install "smajax[cluster]=={__version__}" there')
        if version != __version__:
            raise InputError(
                f"{place}: {name} has smajax {version}, and this is {__version__}: install the same version everywhere"
            )


@contextlib.contextmanager
def _silenced(*names: str) -> Iterator[None]:
    loggers = [logging.getLogger(name) for name in names]
    before = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.CRITICAL + 1)
    try:
        yield
    finally:
        for logger, level in zip(loggers, before, strict=True):
            logger.setLevel(level)


def submit_to_cluster(client: Any, header: Mapping[str, Any], gradients: bool) -> "Submit":
    """Return a function that simulates chunks on a cluster; each worker builds the problem from the header once.

    The chunk of a worker that dies is sent to another one.

    Args:
        client: A ``distributed.Client``.
        header: ``SweepFile.header`` of the sweep.
        gradients: Whether derivatives are computed.

    Returns:
        The function. It raises InputError if too many workers die, or if the connection to the scheduler is lost.
    """
    text = json.dumps(header)

    def submit(chunks: "Sequence[Chunk]") -> "Iterator[FinishedChunks]":
        import distributed

        def send(chunk: "Chunk") -> Any:
            return client.submit(simulate_chunk, text, chunk.designs, chunk.steps, gradients, pure=False)

        pending = {send(chunk): chunk for chunk in chunks}
        deaths = 0
        completed = distributed.as_completed(list(pending), loop=client.loop)
        for future in completed:
            chunk = pending.pop(future)
            try:
                results = future.result()
            except distributed.KilledWorker:
                deaths += 1
                if deaths > _MAX_DEATHS:
                    raise InputError(
                        f"workers died {deaths} times: give them more memory, or a smaller sweep.chunk"
                    ) from None
                repeated = send(chunk)
                pending[repeated] = chunk
                completed.add(repeated)
                continue
            except (distributed.CancelledError, OSError):
                raise InputError(
                    "the connection to the Dask scheduler is lost: start it again, and repeat the run with --resume"
                ) from None
            future.release()
            yield [(chunk, results)]

    return submit


def simulate_chunk(text: str, designs: np.ndarray, steps: int, gradients: bool) -> dict[str, np.ndarray]:
    """Simulate a chunk on a worker.

    Args:
        text: Header of the sweep as JSON.
        designs: Designs of the chunk in internal units, shape ``(m, axes)``.
        steps: Number of steps of each design.
        gradients: Whether derivatives are computed.

    Returns:
        Columns by name, shape ``(m,)`` each, as ``chunks.evaluate_designs`` returns them.

    Raises:
        InputError: If the sweep belongs to another version of smajax.
    """
    prepare_jax(accelerator=True)
    from smajax.sweeps.chunks import evaluate_designs

    return evaluate_designs(_problem(text), designs, steps, gradients=gradients)


@lru_cache(maxsize=4)
def _problem(text: str) -> Any:
    from smajax.sweeps.sweep_file import from_header

    header = json.loads(text)
    if header["smajax"] != __version__:
        raise InputError(
            f"a worker has smajax {__version__}, and the sweep belongs to {header['smajax']}: "
            "install the same version everywhere"
        )
    return from_header(header).problem()
