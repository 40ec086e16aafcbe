"""Who does the work: this process, or the workers of a Dask cluster on this machine or elsewhere."""

from __future__ import annotations

import contextlib
import itertools
import logging
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from importlib import import_module
from multiprocessing import resource_tracker
from types import TracebackType
from typing import Any, Protocol, TypeVar

import cv2

from tracker.errors import TrackerError, install
from tracker.warm_up import warm_up

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")

AHEAD = 2
"""Tasks handed out for each thread of a worker: none waits, and the scheduler stays small."""

BEGINNINGS = 3
"""How often workers are begun of which one was ended from outside before it was ready."""

CONNECT_SECONDS = 20.0
"""For so long a scheduler may not answer [s]."""

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""Environment of a worker."""

QUIET = {"logging.distributed": "critical"}
"""What Dask says of workers that are killed is said here in other words."""


class WorkerError(TrackerError):
    """A worker process was ended from outside, and another one too that took its task."""


class Engine(Protocol):
    """Applies a function to tasks, which do not depend on each other."""

    def each(
        self, function: Callable[[_Task], _Result], tasks: Iterable[_Task]
    ) -> Iterator[tuple[_Task, _Result | Exception]]:
        """The tasks with what came of them, as they are finished; tasks are taken as they are needed."""


class Here:
    """This process."""

    def each(
        self, function: Callable[[_Task], _Result], tasks: Iterable[_Task]
    ) -> Iterator[tuple[_Task, _Result | Exception]]:
        """See Engine."""
        for task in tasks:
            try:
                result: _Result | Exception = function(task)
            except Exception as error:
                result = error
            yield task, result


class Cluster:
    """Workers of Dask, as long as the `with` block lasts.

    On this machine each worker is a process with one thread, for compiled code, too. Workers of others should
    be such as well: `dask worker --nthreads 1`.

    Args:
        workers: number of processes on this machine; ignored where there is a scheduler.
        scheduler: address of another scheduler, e.g. tcp://10.0.0.1:8786.

    Raises:
        TrackerError: the package distributed is missing, the scheduler does not answer, or no worker begins.
    """

    def __init__(self, workers: int, scheduler: str | None = None) -> None:
        try:
            dask: Any = import_module("dask")
            with dask.config.set(QUIET):  # kept from the import on: threads may tell of the end after it
                distributed: Any = import_module("distributed")
        except ImportError as error:
            raise TrackerError(
                f"several processes need the package distributed: {install('cluster')}"
            ) from error
        self._distributed: Any = distributed
        self._local: Any = None
        if scheduler is not None:
            try:
                self._client = distributed.Client(scheduler, timeout=CONNECT_SECONDS, set_as_default=False)
            except (OSError, ValueError) as error:
                raise TrackerError(f"scheduler {scheduler}: does not answer: {error}") from error
            return
        warm_up()  # once, not in each worker
        with (
            dask.config.set(QUIET | {"distributed.nanny.pre-spawn-environ": ONE_THREAD}),
            _environment({"DASK_LOGGING__DISTRIBUTED": "critical"}),
            _no_interrupts(),
        ):
            self._local = _begun(distributed, workers)
            self._client = distributed.Client(self._local, set_as_default=False)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._local is not None and kind is not None:
            self._kill()  # they would finish their recordings first
        self._client.close()
        if self._local is not None:
            self._local.close()

    def each(
        self, function: Callable[[_Task], _Result], tasks: Iterable[_Task]
    ) -> Iterator[tuple[_Task, _Result | Exception]]:
        """See Engine."""
        todo = iter(tasks)
        handed: dict[str, _Task] = {}
        finished = self._distributed.as_completed(loop=self._client.loop)

        def hand_out() -> None:
            wanted = AHEAD * max(1, sum(self._client.nthreads().values())) - len(handed)
            for task in itertools.islice(todo, max(0, wanted)):
                future = self._client.submit(alone, function, task, pure=False)
                handed[future.key] = task
                finished.add(future)

        hand_out()
        for future in finished:
            error = future.exception()
            if isinstance(error, self._distributed.KilledWorker):
                error = WorkerError("its worker was ended from outside again and again, for want of memory?")
            result: _Result | Exception = future.result() if error is None else error
            task = handed.pop(future.key)
            del future  # so that the scheduler forgets it
            hand_out()
            yield task, result

    def _kill(self) -> None:
        for nanny in self._local.workers.values():
            nanny.auto_restart = False
            if nanny.pid is not None:
                with contextlib.suppress(OSError):
                    os.kill(nanny.pid, signal.SIGTERM if os.name == "nt" else signal.SIGKILL)


def _begun(distributed: Any, workers: int) -> Any:
    """Workers on this machine; TrackerError where they are ended from outside again and again."""
    failure: RuntimeError | None = None
    for _ in range(BEGINNINGS):
        try:
            return distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=None,
                silence_logs=logging.CRITICAL,
            )
        except RuntimeError as error:  # Dask has closed all of it
            failure = error
    raise TrackerError(f"workers cannot be begun: {failure}") from failure


def engine(workers: int, scheduler: str | None = None) -> contextlib.AbstractContextManager[Engine]:
    """This process where one is enough, else a Cluster."""
    return (
        contextlib.nullcontext(Here()) if workers == 1 and scheduler is None else Cluster(workers, scheduler)
    )


def cores() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def alone(function: Callable[[_Task], _Result], task: _Task) -> _Result:
    """Apply a function to a task, with one thread for OpenCV, which no variable tells."""
    cv2.setNumThreads(1)  # the workers share the cores, more threads would only wait for each other
    return function(task)


@contextmanager
def _environment(values: dict[str, str]) -> Iterator[None]:
    """Variables that processes begun within see."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def _no_interrupts() -> Iterator[None]:
    """What is begun within never sees Ctrl-C, which a terminal sends to all: this process ends it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # It would let interrupts through again, for what its thread begins next, when it begins by itself.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
