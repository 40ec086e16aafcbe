"""Check cameras for faults by watching their images for a few seconds, without searching for an object."""

import contextlib
import math
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.live.moment import ImageSet, ImageSource, SourceEnded
from tracker.summaries.remarks import PictureLook

MOST_MISSING = 0.01
"""Largest share of missing images."""

MOST_FROZEN = 0.02
"""Largest share of images that are bit-identical to the previous image."""

MOST_SKEW = 0.02
"""Largest age of a camera's image relative to the latest in its set [s]; the platform's reach 0.01."""

MOST_AGE = 0.1
"""Largest age of the latest image of a set when it is delivered [s]."""

LOOK_EVERY = 0.5
"""Interval between measurements of brightness, clipping and blur [s], which take longer than a frame."""


def _median(values: Sequence[float]) -> float:
    """Return the median of what is known; NaN if nothing is."""
    known = [value for value in values if not math.isnan(value)]
    return float(np.median(known)) if known else math.nan


@dataclass
class CameraLooks:
    """Statistics of one camera's images."""

    name: str
    size: tuple[int, int]
    """Width and height for which it is calibrated [px]."""
    pictures: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    """Number of missing images by reason."""
    frozen: int = 0
    skews: list[float] = field(default_factory=list)
    """Age of each image relative to the latest in its set [s]."""
    looks: list[PictureLook] = field(default_factory=list)
    """Brightness, clipping and blur of some of the images."""
    other_sizes: Counter[tuple[int, int]] = field(default_factory=Counter)
    _before: Image | None = None
    _next_look: float = 0.0

    def see(self, image: Image | None, fault: str | None, skew: float) -> None:
        """Count an image."""
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
        """Medians of `looks`; NaN without an image."""
        columns = zip(*self.looks, strict=True) if self.looks else [()] * 3
        return PictureLook(*map(_median, columns))

    @property
    def skew(self) -> float:
        """Median of `skews` [s]; NaN without an image."""
        return _median(self.skews)

    def faults(self) -> list[str]:
        """Return what is wrong, with hints on what may help."""
        found, missing = [], sum(self.missing.values())
        total = self.pictures + missing
        if missing > MOST_MISSING * total:
            ((why, count),) = self.missing.most_common(1)
            found.append(f"{missing} of {total} images are missing; {count} ×: {why}")
        expected = "{}x{}".format(*self.size)
        for (width, height), count in self.other_sizes.items():
            found.append(f"{count} images have {width}x{height} px, but the calibration is for {expected}")
        if not self.pictures:
            return found
        if self.frozen > MOST_FROZEN * self.pictures:
            found.append(f"{self.frozen} of {self.pictures} images are the same as before: it hangs")
        if self.skew > MOST_SKEW:
            found.append(f"its images are {1e3 * self.skew:.0f} ms older than the latest: trigger together")
        return found + self.look.faults()


@dataclass
class SetLooks:
    """Statistics of all cameras' images."""

    cameras: list[CameraLooks]
    seconds: float = 0.0
    """Time from the first set to the last [s]."""
    sets: int = 0
    ages: list[float] = field(default_factory=list)
    """Age of the latest image of each set when it was delivered [s]."""

    @property
    def rate(self) -> float:
        """Sets per second [Hz]."""
        return (self.sets - 1) / self.seconds if self.seconds > 0 else float("nan")

    def see(self, taken: ImageSet) -> None:
        """Count a set of images."""
        self.sets += 1
        if any(image is not None for image in taken.images):
            self.ages.append(taken.age)
        columns = self.cameras, taken.images, taken.faults, taken.stamps
        for camera, image, fault, stamp in zip(*columns, strict=True):
            camera.see(image, fault, taken.timestamp - stamp)

    def faults(self) -> list[str]:
        """Return what is wrong, camera by camera."""
        if not self.sets:
            return ["no images came at all"]
        found = [f"{camera.name}: {fault}" for camera in self.cameras for fault in camera.faults()]
        if self.ages and np.median(self.ages) > MOST_AGE:
            found.append(f"images are {1e3 * np.median(self.ages):.0f} ms old when they arrive")
        return found


def look_at(source: ImageSource, rig: CameraRig, seconds: float) -> SetLooks:
    """Measure the images of a source for `seconds` [s] or until it ends; TrackerError if the source fails."""
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
