"""Runs tasks in several processes and yields each result as soon as it is ready."""

import multiprocessing
import queue
import signal
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

import cv2

from tracker.errors import TrackerError
from tracker.processes import end_with_parent


class WorkerError(TrackerError):
    """A worker process failed."""


Factory = Callable[[], Callable[[Any], Iterator[Any]]]
"""Makes, in the process that does the tasks, the function from a task to its results; can be pickled."""

_POLL_SECONDS = 1.0
_RESULT, _FAILURE, _END = range(3)


def run_tasks(factory: Factory, tasks: Sequence[Any], workers: int) -> Generator[Any, None, None]:
    """Yield the results of all tasks, in order of completion; with 1 worker in this process.

    Raises:
        WorkerError: a worker process ended unexpectedly, or raised anything but a TrackerError or OSError.
        TrackerError: a worker raised it.
    """
    if not tasks:
        return
    if workers <= 1:
        work = factory()
        for task in tasks:
            yield from work(task)
        return
    # Spawned processes: neither OpenGL nor compiled threads survive a fork.
    context = multiprocessing.get_context("spawn")
    todo: Any = context.Queue()
    results: Any = context.Queue(maxsize=64)
    count = min(workers, len(tasks))
    for task in [*tasks, *[None] * count]:
        todo.put(task)
    processes = [
        context.Process(target=_work, args=(factory, todo, results), daemon=True) for _ in range(count)
    ]
    for process in processes:
        process.start()
    try:
        yield from _collect(processes, results)
    finally:
        for process in processes:
            if process.is_alive():
                process.terminate()
            process.join()
        todo.cancel_join_thread()


def _collect(processes: Sequence[Any], results: Any) -> Iterator[Any]:
    running = len(processes)
    while running:
        try:
            kind, value = results.get(timeout=_POLL_SECONDS)
        except queue.Empty:
            dead = [process for process in processes if process.exitcode not in (None, 0)]
            if dead:
                raise WorkerError(f"a worker process ended with code {dead[0].exitcode}") from None
            continue
        if kind == _END:
            running -= 1
        elif kind == _FAILURE:
            raise value
        else:
            yield value


def _work(factory: Factory, todo: Any, results: Any) -> None:
    # An interrupt also reaches the parent process, which ends its workers.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    end_with_parent()
    cv2.setNumThreads(1)  # the workers already share the machine
    try:
        work = factory()
        while (task := todo.get()) is not None:
            for result in work(task):
                results.put((_RESULT, result))
        results.put((_END, None))
    except (TrackerError, OSError) as error:
        results.put((_FAILURE, error))
    except Exception as error:
        results.put((_FAILURE, WorkerError(f"a worker failed: {type(error).__name__}: {error}")))
