"""Who does the work: this process, processes of this machine, or the workers of a Dask scheduler."""

from __future__ import annotations

import contextlib
import functools
import itertools
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from multiprocessing import connection, get_context, parent_process, resource_tracker
from typing import Any

import cv2

from tracker.checks import optional
from tracker.errors import TrackerError
from tracker.processes import environment
from tracker.warm_up import warm_up

Engine = Callable[[Callable[[Any], Any], Iterable[Any]], Iterator[tuple[Any, Any]]]
"""Applies a function to tasks, which do not depend on each other and are taken as they are needed; gives each
task with what came of it, or the Exception, as they are finished."""

AHEAD = 2
"""Tasks handed out for each worker: none waits, and a scheduler stays small."""

ATTEMPTS = 4
"""How often a task is given to a process of which each before was ended from outside."""

CONNECT_SECONDS = 20.0
"""For so long a scheduler may not answer [s]."""

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment of a worker."""

_ENDED = "its worker was ended from outside again and again, for want of memory?"


class WorkerError(TrackerError):
    """A worker process was ended from outside, and others too that took its task."""


def here(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
    """An Engine: this process."""
    for task in tasks:
        try:
            result = function(task)
        except Exception as error:
            result = error
        yield task, result


@contextmanager
def processes(count: int) -> Iterator[Engine]:
    """So many processes of this machine, each with one thread, for compiled code, too.

    One that is ended from outside is replaced, and its task is done again. Where the `with` block ends with
    an error, an interrupt for instance, they are killed: they would finish their recordings first.
    """
    warm_up()  # once, not in each of them
    # It would let interrupts through again in the thread that needs it first.
    resource_tracker.ensure_running()
    workers = [_Process() for _ in range(count)]
    idle = list(workers)

    def apply(*task: Any) -> Any:
        worker = idle.pop()  # there are as many as threads
        try:
            return worker.apply(*task)
        finally:
            idle.append(worker)

    with environment(ONE_THREAD), ThreadPoolExecutor(count, initializer=_hold_interrupts) as threads:
        try:
            yield functools.partial(_each, functools.partial(threads.submit, apply), lambda: count)
        except BaseException:
            threads.shutdown(wait=False, cancel_futures=True)
            for worker in workers:
                worker.kill()
            raise
        finally:
            for worker in workers:
                worker.close()


@contextmanager
def dask_workers(address: str) -> Iterator[Engine]:
    """The workers of a Dask scheduler, e.g. tcp://10.0.0.1:8786; they should have one thread each.

    Raises:
        TrackerError: the package distributed is missing, or the scheduler does not answer.
    """
    # This module reports killed workers itself. Dask's own messages are off from the import on: threads may
    # report the end after it.
    with optional("dask.config", "cluster", "--scheduler").set({"logging.distributed": "critical"}):
        distributed = optional("distributed", "cluster", "--scheduler")
    try:
        client = distributed.Client(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise TrackerError(f"scheduler {address}: does not answer: {error}") from error

    def each(function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[tuple[Any, Any]]:
        submit = client.get_executor(pure=False).submit
        for task, result in _each(submit, lambda: sum(client.nthreads().values()), function, tasks):
            lost = isinstance(result, distributed.KilledWorker)
            yield task, WorkerError(_ENDED) if lost else result

    with client:
        yield each


def engine(jobs: int) -> AbstractContextManager[Engine]:
    """This process where one job is enough, else processes."""
    return contextlib.nullcontext(here) if jobs == 1 else processes(jobs)


def cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def alone(function: Callable[[Any], Any], task: Any) -> Any:
    """Apply a function to a task, with one thread for OpenCV, which no variable tells."""
    cv2.setNumThreads(1)  # the workers share the cores, more threads would only wait for each other
    return function(task)


def _each(
    submit: Callable[..., Future[Any]],
    count: Callable[[], int],
    function: Callable[[Any], Any],
    tasks: Iterable[Any],
) -> Iterator[tuple[Any, Any]]:
    """See Engine; `submit` is that of an executor which has `count` workers."""
    todo = iter(tasks)
    handed: dict[Future[Any], Any] = {}

    def hand_out() -> None:
        for task in itertools.islice(todo, max(0, AHEAD * max(1, count()) - len(handed))):
            handed[submit(alone, function, task)] = task

    hand_out()
    while handed:
        for future in wait(handed, return_when=FIRST_COMPLETED).done:
            task, error = handed.pop(future), future.exception()
            hand_out()
            if error is not None and not isinstance(error, Exception):
                raise error
            yield task, future.result() if error is None else error


class _Process:
    """A process that does one task after the other, and another one where it is gone.

    An executor of several would not tell whose task it was that ended one of them.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._number: int | None = None
        self._over = False
        self._lock = threading.Lock()  # of the number, which must be that of a process of ours

    def apply(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a function gives; WorkerError where each process that had to do it was ended."""
        for _ in range(ATTEMPTS):
            try:
                return self._begun().submit(function, *arguments).result()
            except BrokenProcessPool:
                self.close()
        raise WorkerError(_ENDED)

    def kill(self) -> None:
        """End the process, whatever it is doing, and begin no other."""
        with self._lock:
            self._over = True
            self._end()

    def close(self) -> None:
        """Let the process end when it is idle."""
        with self._lock:
            pool, self._pool, self._number = self._pool, None, None
        if pool is not None:
            pool.shutdown()

    def _begun(self) -> ProcessPoolExecutor:
        if self._pool is None:
            pool = ProcessPoolExecutor(1, get_context("spawn"), initializer=_end_with_parent)
            number = pool.submit(os.getpid).result()
            with self._lock:
                self._pool, self._number = pool, number
                if self._over:
                    self._end()
        if self._over:
            raise WorkerError("the run is over")
        return self._pool

    def _end(self) -> None:
        if self._number is not None:
            with contextlib.suppress(OSError):
                os.kill(self._number, signal.SIGKILL)


def _hold_interrupts() -> None:
    """Let no process that this thread begins see Ctrl-C, which a terminal sends to all: we end them."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})


def _end_with_parent() -> None:
    """End this process, also in the middle of a task, when the one that began it is gone."""
    parent = parent_process()
    assert parent is not None

    def watch() -> None:
        connection.wait([parent.sentinel])
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
