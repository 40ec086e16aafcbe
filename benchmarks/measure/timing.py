"""Processor time of some work, relative to reference work on the same images in the same process."""

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

import cv2

from tracker.conventions import Image

T = TypeVar("T")

ROUNDS = 3
"""Number of times that work is timed. The shortest time counts: on a shared machine times double at random,
and the first call in a process loads or compiles kernels."""

Times = dict[str, float]
"""`ms` of the work, `reference_ms` and their `ratio`."""


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit OpenCV to one thread in the `with` block; nothing else in the tracker uses more."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def reference_work(images: Sequence[Image | None]) -> None:
    """Blur each image with a 5×5 median and convert it to HSV, as the segmentation once did first."""
    for image in images:
        if image is not None:
            cv2.cvtColor(cv2.medianBlur(image, 5), cv2.COLOR_BGR2HSV)


def in_turn(work: Callable[[], T], images: Sequence[Image | None]) -> tuple[T, Times]:
    """Return the result of some work, its processor time, and that of the reference work right after it."""
    clock = time.process_time
    start = clock()
    result = work()
    middle = clock()
    reference_work(images)
    return result, _times(1e3 * (middle - start), 1e3 * (clock() - middle))


def repeated(work: Callable[[], T], images: Sequence[Image | None]) -> tuple[T, Times]:
    """Return the fastest round's result of work that always gives the same one, and the shortest times."""
    rounds = [in_turn(work, images) for _ in range(ROUNDS)]
    result, _ = min(rounds, key=lambda one: one[1]["ms"])
    return result, shortest([times for _, times in rounds])


def shortest(rounds: Sequence[Mapping[str, float]]) -> Times:
    """Return the shortest times of several rounds of the same work."""
    return _times(*(min(times[key] for times in rounds) for key in ("ms", "reference_ms")))


def _times(own: float, reference: float) -> Times:
    return {"ms": own, "reference_ms": reference, "ratio": own / max(reference, 1e-9)}
