"""How long work takes, next to reference work on the same pictures in the same process."""

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
    """OpenCV uses one thread meanwhile; nothing else of the tracker uses more."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def reference_work(images: Sequence[Image | None]) -> None:
    """Median blur 5 and conversion to HSV of every image: what the segmentation of old began with."""
    for image in images:
        if image is not None:
            cv2.cvtColor(cv2.medianBlur(image, 5), cv2.COLOR_BGR2HSV)


def in_turn(
    work: Callable[[], T], images: Sequence[Image | None], rounds: int = 1
) -> tuple[T, dict[str, float]]:
    """What some work gives, and its time beside that of the reference work on the same images after it.

    Processor time of the whole process: on a shared machine wall-clock time doubles at random. Of several
    rounds the least of each counts, and the first result.

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
