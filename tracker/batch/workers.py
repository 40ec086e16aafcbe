"""Engines that do the work: this process, other processes on this machine, or workers of Dask."""

import contextlib
import functools
import itertools
import os
import pickle
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, CancelledError, Future, wait
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import Pipe, get_context, resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.connection import wait as wait_for
from multiprocessing.process import BaseProcess
from typing import Any, cast

import cv2

from tracker.checks import naming, optional
from tracker.errors import TrackerError
from tracker.processes import end_with_parent, environment
from tracker.warm_up import warm_up

Engine = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[tuple[Any, Any]]]
"""Applies a function to independent tasks, which are taken lazily; yields each task with its result or
Exception as they finish."""

AHEAD = 2
"""Tasks submitted per worker of a scheduler, so that no worker waits and the queue stays small."""

ATTEMPTS = 4
"""Number of times a task is tried if its process is killed from outside."""

CONNECT_SECONDS = 20.0
"""Timeout for connecting to a scheduler [s]."""

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment variables of a worker."""

_ENDED = "its worker was ended from outside again and again, for want of memory?"


class WorkerError(TrackerError):
    """A task's worker process was repeatedly killed from outside, or its result cannot be sent."""


def here(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """Do the tasks in this process; an Engine."""
    for task in tasks:
        try:
            result = function(task)
        except Exception as error:
            result = error
        yield task, result


@contextmanager
def processes(count: int) -> Iterator[Engine]:
    """Yield an Engine of `count` processes on this machine, each with one thread, even in compiled code.

    A process that is killed from outside is replaced, and its task is repeated. If the `with` block ends
    with an error, such as an interrupt, the processes are killed: they would finish their recordings first.
    """
    warm_up()  # once, not in each process
    # Start it now: started later, it would unblock interrupts in the thread that first needs it.
    resource_tracker.ensure_running()
    begun: dict[Connection, BaseProcess] = {}
    with environment(ONE_THREAD):
        try:
            yield functools.partial(_by_processes, begun, count)
        except BaseException:
            for process in begun.values():
                process.kill()
            raise
        finally:
            for connection, process in begun.items():
                connection.close()
                process.join()


def _by_processes(
    begun: dict[Connection, BaseProcess], count: int, function: Callable[[Any], Any], tasks: Iterable[Any]
) -> Iterator[tuple[Any, Any]]:
    """See Engine; `begun` holds the running processes."""
    todo, idle = iter(tasks), list(begun)
    at_work: dict[Connection, tuple[Any, int]] = {}

    def hand_out(task: Any, attempt: int = 1) -> None:
        connection = idle.pop() if idle else _begin(begun)
        at_work[connection] = task, attempt
        with contextlib.suppress(OSError):  # the process is gone; waiting for it reveals that
            connection.send((function, task))

    for task in itertools.islice(todo, count):
        hand_out(task)
    while at_work:
        for connection in cast("list[Connection]", wait_for(list(at_work))):
            task, attempt = at_work.pop(connection)
            try:
                result = connection.recv()
                idle.append(connection)
            except (EOFError, OSError):
                begun.pop(connection).join()
                connection.close()
                if attempt < ATTEMPTS:
                    hand_out(task, attempt + 1)
                    continue
                result = WorkerError(_ENDED)
            for following in itertools.islice(todo, 1):
                hand_out(following)
            yield task, result


def _begin(begun: dict[Connection, BaseProcess]) -> Connection:
    """Start a process with SIGINT blocked: a terminal sends Ctrl-C to all, but the parent ends them."""
    ours, theirs = Pipe()
    process = get_context("spawn").Process(target=_work, args=(theirs,))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        process.start()
        begun[ours] = process
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    theirs.close()
    return ours


def _work(connection: Connection) -> None:
    """Do tasks in a worker process, one after another, until the connection is closed."""
    end_with_parent()
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, task = connection.recv()
            for _, result in here(functools.partial(alone, function), [task]):
                try:
                    connection.send(result)
                except (AttributeError, TypeError, pickle.PicklingError) as error:
                    connection.send(WorkerError(f"what came of it cannot be sent: {error}"))


@contextmanager
def dask_workers(address: str) -> Iterator[Engine]:
    """Yield an Engine of a Dask scheduler's workers, each with one thread; address: tcp://10.0.0.1:8786.

    TrackerError if the package distributed is missing, or the scheduler does not answer.
    """
    # This module reports killed workers itself. Dask's messages stay off, since its threads may still log
    # after the end.
    with optional("dask.config", "cluster", "--scheduler").set({"logging.distributed": "critical"}):
        distributed = optional("distributed", "cluster", "--scheduler")
    with naming(f"scheduler {address}: does not answer", TrackerError, OSError, ValueError):
        distributed.comm.get_address_host_port(address)  # a client with an invalid address cannot be closed
        secure = distributed.Security().get_connection_args("client").get("ssl_context")
        if address.startswith("tls:") and secure is None:
            raise ValueError("found no certificates in Dask's configuration, expected them for tls")
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)

    def each(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        todo = iter(tasks)
        submit = client.get_executor(pure=False).submit
        handed: dict[Future[Any], Any] = {}

        def hand_out() -> None:
            most = AHEAD * max(1, sum(client.nthreads().values()))
            for task in itertools.islice(todo, max(0, most - len(handed))):
                handed[submit(alone, function, task)] = task

        hand_out()
        while handed:
            for future in wait(handed, return_when=FIRST_COMPLETED).done:
                try:
                    task, error = handed.pop(future), future.exception()
                    hand_out()
                except (CancelledError, OSError) as lost:
                    raise TrackerError(f"scheduler {address}: was lost, expected it to the end") from lost
                if error is not None and not isinstance(error, Exception):
                    raise error
                ended = isinstance(error, distributed.KilledWorker)
                yield task, WorkerError(_ENDED) if ended else error or future.result()

    with client:
        yield each


def engine(jobs: int) -> AbstractContextManager[Engine]:
    """Return an Engine: this process if there is one job, else `processes`."""
    return contextlib.nullcontext(here) if jobs == 1 else processes(jobs)


def cores() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def alone(function: Callable[[Any], Any], task: Any) -> Any:
    """Apply a function to a task with one thread for OpenCV, which no environment variable sets."""
    cv2.setNumThreads(1)  # the workers share the cores, so more threads would only wait for each other
    return function(task)
