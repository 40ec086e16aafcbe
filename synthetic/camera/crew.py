"""Everything about the cameras that stays for a scene or a film."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from synthetic.camera.compression import GROUP, Compression
from synthetic.camera.miscalibration import Calibrated, exactly, miscalibrated
from synthetic.camera.sensor import Sensor, mosaicked
from synthetic.camera.timing import Timing
from synthetic.camera.units import Unit, units_of
from synthetic.effects import Effects, stream
from tracker.calibration.rig import CameraRig
from tracker.conventions import Image


@dataclass(frozen=True, eq=False)
class Crew:
    """The cameras of a scene or film."""

    units: tuple[Unit, ...]
    """Each camera, in the simulation's world."""
    calibrated: Calibrated
    """The same in the calibrated world, and what is said of them."""
    timing: Timing | None = None
    """When their pictures are taken; None: all at once and in no time."""
    compression: Compression | None = None
    """What recording does to them; None: nothing."""

    @property
    def group(self) -> int:
        """Number of pictures of a film from one that needs none of those before to the next."""
        return GROUP if self.compression is not None and self.compression.kind == "h264" else 1

    def recorded(self, taken: Sequence[tuple[Image, ...]], *, raw: bool) -> tuple[Image, ...]:
        """The last of the pictures of all cameras as a recording gives them back.

        Args:
            taken: (H, W, 3) BGR of each camera, from the beginning of the last one's group on.
            raw: they are recorded and given back as mosaics (H, W).
        """
        images = taken[-1]
        if self.compression is not None:
            own = self.compression
            if raw and own.kind == "jpeg":
                own = replace(own, kind="mosaic")
            images = tuple(own.applied(pictures) for pictures in zip(*taken, strict=True))
        return tuple(mosaicked(image) for image in images) if raw else images


def crew_of(
    rig: CameraRig,
    sensor: Sensor,
    rng: np.random.Generator,
    effects: Effects,
    seed: int,
    number: int,
    *,
    film: bool,
) -> Crew:
    """The cameras of scene or film `number`; arguments as of `units_of`. Only films take time."""
    return Crew(
        units_of(rig, sensor, rng, effects, seed, number),
        miscalibrated(rig, stream("calibration", seed, number)) if effects.calibration else exactly(rig),
        Timing.sample(stream("timing", seed, number), len(rig)) if effects.timing and film else None,
        Compression.sample(stream("compression", seed, number)) if effects.compression else None,
    )
