"""Processes that track parts of recordings."""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import wait as wait_for_end
from types import TracebackType
from typing import Any

import cv2

from tracker.errors import TrackerError
from tracker.recordings.job import Job
from tracker.recordings.parts import Part
from tracker.recordings.run import PartTracker

Progress = Callable[[int], None]
"""Told now and then how many more frames are tracked."""

_POLL = 0.2  # s between two looks at how far the workers are


class WorkerError(TrackerError):
    """A worker process ended by itself."""


class _Stopped(Exception):
    """The work is not wanted any more."""


class Workers:
    """Processes that live as long as the `with` block; with a count of 1 there is none but this one.

    Args:
        count: number of processes.
    """

    def __init__(self, count: int = 1) -> None:
        self.count = count
        self._pool: ProcessPoolExecutor | None = None
        if count > 1:
            # Spawned: compiled threads do not survive a fork.
            self._context = multiprocessing.get_context("spawn")
            self._stop, self._done = self._context.Event(), self._context.Value("q", 0)
            self._pool = self._new_pool()

    def __enter__(self) -> Workers:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._stop.set()
            self._pool.shutdown(cancel_futures=True)

    def track(self, job: Job, runs: Sequence[Sequence[Part]], progress: Progress) -> None:
        """Track and store parts; whatever ends it early, no worker is at work afterwards.

        Raises:
            WorkerError: a worker was ended from outside.
            TrackerError: see `PartTracker`.
        """
        if self._pool is None or len(runs) < 2:
            _track_here(job, runs, progress)
            return
        self._done.value = 0
        pending: set[Future[None]] = set()
        try:
            self._share(self._pool, pickle.dumps(job), runs, pending, progress)
        except BrokenProcessPool as error:
            self._pool = self._new_pool()
            raise WorkerError(
                "a worker process was ended from outside, perhaps for want of memory"
            ) from error
        finally:
            self._stop.set()
            for future in pending:
                future.cancel()
            wait(pending)
            self._stop.clear()

    def _new_pool(self) -> ProcessPoolExecutor:
        return ProcessPoolExecutor(self.count, self._context, _begin, (self._stop, self._done))

    def _share(
        self,
        pool: ProcessPoolExecutor,
        job: bytes,
        runs: Sequence[Sequence[Part]],
        pending: set[Future[None]],
        progress: Progress,
    ) -> None:
        todo, told = iter(runs), 0
        while True:
            # Twice as many as workers: none waits, and what is handed out stays small.
            with _interrupts_later():
                while len(pending) < 2 * self.count and (run := next(todo, None)) is not None:
                    pending.add(pool.submit(_work, job, list(run)))
            if not pending:
                break
            finished, _ = wait(pending, timeout=_POLL, return_when=FIRST_COMPLETED)
            for future in finished:
                future.result()
                pending.remove(future)
            done = self._done.value
            progress(done - told)
            told = done


def _track_here(job: Job, runs: Sequence[Sequence[Part]], progress: Progress) -> None:
    if not runs:
        return
    tracker = PartTracker(job)
    try:
        for run in runs:
            tracker.track(run, lambda: progress(1))
    finally:
        tracker.close()


@contextmanager
def _interrupts_later() -> Iterator[None]:
    """Processes started within never see Ctrl-C, which a terminal sends to all: this one ends them."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Worker:
    """The state of a worker process."""

    stop: Any
    done: Any
    job: bytes = b""
    tracker: PartTracker | None = None

    @classmethod
    def tick(cls) -> None:
        """Count a frame."""
        with cls.done.get_lock():
            cls.done.value += 1
        if cls.stop.is_set():
            raise _Stopped


def _begin(stop: Any, done: Any) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # where signals cannot be blocked
    _Worker.stop, _Worker.done = stop, done
    cv2.setNumThreads(1)  # the processes share the cores, more threads would only wait for each other
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()


def _end_with(sentinel: Any) -> None:
    """End this process when its parent has; a killed one cannot say so."""
    wait_for_end([sentinel])
    os._exit(1)


def _work(job: bytes, run: Sequence[Part]) -> None:
    if _Worker.stop.is_set():
        return
    if _Worker.tracker is None or _Worker.job != job:
        if _Worker.tracker is not None:
            _Worker.tracker.close()
        _Worker.tracker, _Worker.job = PartTracker(pickle.loads(job)), job
    try:
        _Worker.tracker.track(run, _Worker.tick)
    except _Stopped:
        return
