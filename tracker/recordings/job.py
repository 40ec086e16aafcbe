"""What is to be done with one recording."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from tracker.calibration.rig import CameraRig
from tracker.conventions import Image
from tracker.logs.poses import About
from tracker.logs.poses_builder import Answer
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.segmentation.color_model import ColorModel
from tracker.version import version


class MovingTracker(Protocol):
    """What of ObjectTracker is needed here."""

    def update(self, images: Sequence[Image | None], timestamp: float) -> Answer:
        """The poses at a time [s], with memory of those before."""

    def reset(self) -> None:
        """Forget everything."""


@dataclass(frozen=True, eq=False)
class Job:
    """A recording, what to look for in it, and where the poses go. Goes to other processes."""

    log: Path
    """The recording."""
    output: Path
    """The file of poses."""
    model: CuboidModel
    """The object."""
    rig: CameraRig
    """The cameras, in the order of the recording's."""
    colors: ColorModel
    """The object's colours."""
    first: int = 0
    """Number of the first frame that is tracked."""
    last: int | None = None
    """Number after that of the last one; None: the recording's end."""
    recover: bool = False
    """Whether to leave out what is damaged of the recording."""
    make_tracker: Callable[[CuboidModel, CameraRig, ColorModel], Any] = ObjectTracker
    """Makes a MovingTracker; can be pickled by its name."""

    @property
    def about(self) -> About:
        """What the file of poses says of them."""
        # A file's name can be no Unicode, which the file of poses cannot hold.
        name = os.fsencode(self.log.name or self.log.resolve().name).decode("utf-8", "replace")
        return About(self.model.name, name, version(), self.rig)

    @property
    def parts_folder(self) -> Path:
        """Where finished parts wait until the file of poses is written."""
        return self.output.with_name(f".{self.output.name}.parts")
