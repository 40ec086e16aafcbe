"""What every format offers: frames by number, and what is known of the recording as a whole."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.errors import LogError
from tracker.logs.frame import LogFrame

DEFAULT_NAMES = ("camera60", "camera180", "camera300")
"""The platform's cameras, in the order in which it records them."""

MIN_SIDE, MAX_SIDE = 8, 4096
"""Least and largest width and height [px] of an image that is believed."""


Settings = Mapping[str, str | int | float | bool]
"""Values of exposure, gain, white balance and others, by the names that the camera's maker gives them."""


class Source(ABC):
    """Reads frames of one recording. Every fault of the recording is a LogError."""

    format: str
    """The format in words."""
    camera_names: tuple[str, ...] = DEFAULT_NAMES
    """Names of the cameras, in order."""
    image_sizes: tuple[tuple[int, int], ...] = ()
    """(width, height) [px] of each camera's images; empty where there is no frame."""
    count: int
    """Number of frames, as far as the file can be believed."""
    sequential: bool = False
    """Whether a frame can be had only by reading all those before it."""
    gaps: bool = False
    """Whether any time may pass between two frames."""
    episode_starts: tuple[int, ...] = (0,)
    """Numbers of the frames at which something new starts, so that what was before tells nothing."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.opening_fault: str | None = None

    @abstractmethod
    def read(self, index: int) -> LogFrame:
        """The frame of this number, 0 ≤ index < count; LogError where it is damaged."""

    def check_end(self) -> None:  # noqa: B027 - most formats have no end to check
        """Called after the last frame; LogError if what follows it is not as it should be."""

    def rig(self) -> CameraRig | None:
        """The cameras' calibration, or None where the recording has none; TrackerError if it is malformed."""
        return rig_beside(self.path.parent, self.camera_names)

    def settings(self) -> dict[str, Settings]:
        """What cameras were set to, by their names, where the recording tells it; LogError if malformed."""
        return {}

    def close(self) -> None:  # noqa: B027 - folders have nothing open
        """Free what is open."""

    def error(self, index: int, text: str) -> LogError:
        """An error of one frame."""
        return LogError(f"{self.where(index)}: {text}")

    def where(self, index: int) -> str:
        """Names a frame in errors."""
        return f"{self.path}: frame {index}"


def rig_beside(folder: Path, names: tuple[str, ...]) -> CameraRig | None:
    """The calibration in the folder, one file per camera, or None where there is none.

    A camera's file is camera60.yml, or camera_calib_60.yml.

    Raises:
        TrackerError: a file is malformed or of another camera, or only some of the cameras have one.
    """
    files, missing = [], []
    for name in names:
        number = name.removeprefix("camera").lstrip("_")
        stems = (name, f"camera_calib_{number}")
        options = [folder / f"{stem}{suffix}" for stem in stems for suffix in (".yml", ".yaml")]
        found = next((file for file in options if file.is_file()), None)
        if found is None:
            missing.append(name)
        else:
            files.append(found)
    if not files:
        return None
    if missing:
        there = ", ".join(file.name for file in files)
        raise LogError(
            f"{folder}: found {there}, but no calibration of {', '.join(missing)}; "
            f"expected {missing[0]}.yml, too"
        )
    rig = CameraRig.load(files)
    for file, name, camera in zip(files, names, rig, strict=True):
        if camera.name != name:
            raise LogError(f"{file}: camera_name: found {camera.name}, expected {name}")
    return rig
