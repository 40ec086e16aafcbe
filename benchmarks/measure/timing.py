"""Processor time of work, relative to reference work on the same images in the same process."""

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
    """Let OpenCV use one thread in the block; nothing else of the tracker uses more."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def reference_work(images: Sequence[Image | None]) -> None:
    """Blur each image by a median of 5 and convert it to HSV, as the segmentation once began."""
    for image in images:
        if image is not None:
            cv2.cvtColor(cv2.medianBlur(image, 5), cv2.COLOR_BGR2HSV)


def in_turn(
    work: Callable[[], T], images: Sequence[Image | None], rounds: int = 1
) -> tuple[T, dict[str, float]]:
    """Return the result of some work, and its time beside that of the reference work right after it.

    Processor time of the process is measured: on a shared machine wall-clock time doubles at random. The
    smallest times over several rounds and the first result are returned.

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
