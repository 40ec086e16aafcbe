"""What is wrong with cameras: looked at for some seconds, without looking for any object."""

from __future__ import annotations

import contextlib
import time
from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.live.moment import ImageSet, ImageSource, SourceEnded
from tracker.summaries.remarks import PictureLook

MOST_MISSING = 0.01
"""Share of the pictures that may be missing."""

MOST_SKEW = 0.02
"""How much older than the latest of its set a camera's picture may be [s]; the platform's reach 0.01."""

MOST_AGE = 0.1
"""How old the latest picture of a set may be when it is handed over [s]."""

MOST_FROZEN = 0.02
"""Share of the pictures that may be the same to the bit as those before."""

LOOK_EVERY = 0.5
"""How often brightness, clipping and blur are looked at [s]; it takes longer than the next picture."""


@dataclass
class CameraLooks:
    """What was seen of one camera."""

    name: str
    size: tuple[int, int]
    """Width and height for which it is calibrated [px]."""
    pictures: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    """Counts of the reasons for missing pictures."""
    frozen: int = 0
    skews: list[float] = field(default_factory=list)
    """How much older each picture was than the latest of its set [s]."""
    looks: list[PictureLook] = field(default_factory=list)
    """Of some of the pictures."""
    other_sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    _before: Image | None = None
    _next_look: float = 0.0

    def see(self, image: Image | None, fault: str | None, skew: float) -> None:
        """Take in a picture."""
        if image is None:
            self.missing[fault or "no image"] += 1
            return
        self.pictures += 1
        height, width = image.shape[:2]
        if (width, height) != self.size:
            self.other_sizes[width, height] += 1
        self.frozen += self._before is not None and np.array_equal(image, self._before)
        self._before = image
        self.skews.append(skew)
        if time.monotonic() >= self._next_look:
            self._next_look = time.monotonic() + LOOK_EVERY
            self.looks.append(PictureLook.of(image))

    @property
    def look(self) -> PictureLook:
        """Medians of the looks; NaN without a picture."""
        return PictureLook(*(np.nanmedian(self.looks, axis=0) if self.looks else np.full(3, np.nan)))

    @property
    def skew(self) -> float:
        """Median [s], NaN without a picture."""
        return float(np.median(self.skews)) if self.skews else float("nan")

    def faults(self) -> list[str]:
        """What is wrong, and what may help."""
        found, missing = [], sum(self.missing.values())
        total = self.pictures + missing
        if missing > MOST_MISSING * total:
            ((why, count),) = self.missing.most_common(1)
            found.append(f"{missing} of {total} pictures are missing; {count} ×: {why}")
        for (width, height), count in self.other_sizes.items():
            expected = f"{self.size[0]}x{self.size[1]}"
            found.append(f"{count} pictures have {width}x{height} px, but the calibration is of {expected}")
        if not self.pictures:
            return found
        if self.frozen > MOST_FROZEN * self.pictures:
            found.append(f"{self.frozen} of {self.pictures} pictures are the same as before: it hangs")
        if self.skew > MOST_SKEW:
            found.append(f"its pictures are {1e3 * self.skew:.0f} ms older than the latest: trigger together")
        return found + self.look.faults()


@dataclass
class SetLooks:
    """What was seen of all cameras together."""

    cameras: list[CameraLooks]
    seconds: float = 0.0
    """From the first set to the last."""
    sets: int = 0
    ages: list[float] = field(default_factory=list)
    """Of the latest picture of each set, when it was handed over [s]."""

    @property
    def rate(self) -> float:
        """Sets per second [Hz]."""
        return (self.sets - 1) / self.seconds if self.seconds > 0 else float("nan")

    def see(self, taken: ImageSet) -> None:
        """Take in a set of pictures."""
        self.sets += 1
        if any(image is not None for image in taken.images):
            self.ages.append(taken.age)
        for camera, image, fault, stamp in zip(
            self.cameras, taken.images, taken.faults, taken.stamps, strict=True
        ):
            camera.see(image, fault, taken.timestamp - stamp)

    def faults(self) -> list[str]:
        """What is wrong, camera by camera."""
        if not self.sets:
            return ["no pictures came at all"]
        found = [f"{camera.name}: {fault}" for camera in self.cameras for fault in camera.faults()]
        if self.ages and np.median(self.ages) > MOST_AGE:
            found.append(f"pictures are {1e3 * np.median(self.ages):.0f} ms old when they arrive")
        return found


def look_at(source: ImageSource, rig: CameraRig, seconds: float) -> SetLooks:
    """Look at what a source gives for some seconds, or to its end; TrackerError where it breaks."""
    looks = SetLooks([CameraLooks(camera.name, (camera.width, camera.height)) for camera in rig])
    end, first = time.monotonic() + seconds, 0.0
    with contextlib.suppress(SourceEnded):
        while (left := end - time.monotonic()) > 0:
            taken = source.next(min(left, 0.5))
            if taken is not None:
                now = time.monotonic()
                first = first or now
                looks.see(taken)
                looks.seconds = now - first
    return looks
