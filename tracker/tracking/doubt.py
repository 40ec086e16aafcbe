"""Which cameras are believed: one that for long does not see what the others see is asked, but not used."""

from __future__ import annotations

from collections.abc import Sequence

from tracker.conventions import Image
from tracker.pose.fit import Fit
from tracker.pose.hypotheses import ENOUGH
from tracker.pose.judge import confidence, contradicting
from tracker.pose.result import CameraUse
from tracker.tracking.cameras import CameraMemory

DOUBTED, MOST_DOUBT = 3, 6
"""Doubt from which a camera is not used any more, and the most there is: it grows by one with each picture
that shows the object astray, and is halved by each that supports the others."""

ASTRAY = 0.5
"""Pixels in the object's colours where others are expected, as a share of those expected, from which a
picture shows the object astray: a finger before it hides much, but does not show it elsewhere."""

LIKELY = 0.5
"""Confidence of a pose from which a camera that does not see it there is doubted, and not the pose."""


def held_back(memories: Sequence[CameraMemory], images: Sequence[Image | None]) -> list[int]:
    """Cameras whose pictures are not to be used for now, as long as enough others gave one."""
    given = [c for c, image in enumerate(images) if image is not None]
    doubted = [c for c in given if memories[c].doubt >= DOUBTED]
    return doubted if len(given) - len(doubted) >= ENOUGH else []


def heard(memories: Sequence[CameraMemory], fit: Fit) -> tuple[CameraMemory, ...]:
    """The memories with what each camera said of a pose that was measured near where it was expected."""
    if confidence(fit) < LIKELY:
        return tuple(memories)
    seen, against = fit.cameras, contradicting(fit)
    astray = seen["wrong"] + seen["extra"] + seen["elsewhere"] > ASTRAY * seen["predicted"]
    result = []
    for c, memory in enumerate(memories):
        doubt = memory.doubt
        if fit.evidence.shows[c] > 0.5 and not astray[c]:
            doubt //= 2
        elif astray[c] and (against[c] or c in fit.left_out):
            doubt = min(doubt + 1, MOST_DOUBT)
        result.append(memory._replace(doubt=doubt))
    return tuple(result)


def after(uses: Sequence[CameraUse], fit: Fit, unused: Sequence[int] = ()) -> tuple[CameraUse, ...]:
    """What became of the usable pictures, after a pose was measured.

    Args:
        uses: what is known of the pictures themselves.
        fit: the pose.
        unused: cameras that were held back.
    """
    against = contradicting(fit)
    return tuple(
        CameraUse.CONTRADICTING
        if use is CameraUse.USED
        and (against[c] or c in fit.left_out or (c in unused and fit.evidence.shows[c] <= 0.5))
        else use
        for c, use in enumerate(uses)
    )
