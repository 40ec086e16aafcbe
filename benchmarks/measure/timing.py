"""Processor time of some work, relative to reference work on the same images in the same process."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

import cv2

from tracker.conventions import Image

T = TypeVar("T")


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


def in_turn(
    work: Callable[[], T], images: Sequence[Image | None], rounds: int = 1
) -> tuple[T, dict[str, float]]:
    """Return the result of some work, its time, and the time of the reference work right after it.

    The process's processor time is measured: on a shared machine, wall-clock time may double at random. The
    shortest times over several rounds are returned, and the first result.

    Returns:
        The result; `ms`, `reference_ms` and their `ratio`.
    """
    clock, results, spent = time.process_time, [], []
    for _ in range(rounds):
        start = clock()
        results.append(work())
        middle = clock()
        reference_work(images)
        spent.append((middle - start, clock() - middle))
    own, reference = (1e3 * min(times) for times in zip(*spent, strict=True))
    return results[0], {"ms": own, "reference_ms": reference, "ratio": own / max(reference, 1e-9)}
