"""How all recordings of a run are tracked, and the fingerprint of a recording's poses.

The fingerprint shows whether poses of an earlier run can be reused. Of the recording and the calibration
beside it, it covers names, sizes and modification times: reading the content would take as long as tracking.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from tracker.calibration.rig import CameraRig
from tracker.checks import is_whole
from tracker.errors import LogError, shown
from tracker.logs.opening import calibration_files, recording_files
from tracker.objects.model import CuboidModel, load_object
from tracker.pipeline import ObjectTracker
from tracker.segmentation.color_model import ColorModel, load_colors

_OTHERS = (
    *("batch", "cli", "color_learning", "calibration/board", "calibration/by_object", "live"),
    *("summaries", "tasks", "viz"),
)
"""Parts of the package that do not affect poses."""

MakeTracker = Callable[[CuboidModel, CameraRig, ColorModel], Any]
"""Makes a tracker with `update` and `reset` like ObjectTracker's; must be picklable by name."""


@dataclass(frozen=True, kw_only=True)
class Reading:
    """How recordings are read, and by which tracker; LogError for invalid numbers of frames."""

    correct_halved_principal_point: bool = False
    """Whether the calibration was halved without the quarter pixel."""
    resize_calibration: bool = False
    """Whether a calibration for another image size is scaled to that of the images."""
    start: int = 0
    """Number of the first frame to track."""
    stop: int | None = None
    """Number of the frame after the last one to track; None: the recording's end."""
    recover: bool = False
    """Whether to skip damaged parts of a recording."""
    make_tracker: MakeTracker = ObjectTracker

    def __post_init__(self) -> None:
        for name, number in (("start", self.start), ("stop", 0 if self.stop is None else self.stop)):
            if not is_whole(number) or not 0 <= number < 2**63:
                raise LogError(f"{name}: found {shown(number)}, expected the number of a frame, from 0 on")


@dataclass(frozen=True)
class Options(Reading):
    """A user's options, as plain values that any process on any machine understands."""

    object: str
    """The object, or its TOML file."""
    colors: str | None = None
    """The colour model, or its file; None: the object's."""
    calibration: tuple[str, ...] = ()
    """A folder of calibration files, or one file per camera; empty: the calibration of each recording."""
    pattern: str | None = None
    """Pattern of the files in that folder."""

    def absolute(self) -> Options:
        """Return the options with absolute paths, which do not depend on the working folder."""

        def path(name: str, there: Callable[[str], bool] = os.path.isfile) -> str:
            return os.path.abspath(name) if there(name) else name

        return dataclasses.replace(
            self,
            object=path(self.object),
            colors=path(self.colors) if self.colors else self.colors,
            calibration=tuple(path(name, os.path.exists) for name in self.calibration),
        )

    def plain(self) -> dict[str, Any]:
        """Return the options for JSON, without `make_tracker`."""
        values = {**vars(self), "calibration": list(self.calibration)}
        del values["make_tracker"]
        return values

    @classmethod
    def of_plain(cls, values: dict[str, Any]) -> Options:
        """Make options from what `plain` returns."""
        return cls(**{**values, "calibration": tuple(values.get("calibration", ()))})


@dataclass(frozen=True, eq=False)
class Recipe(Reading):
    """Options with all files loaded."""

    model: CuboidModel
    """The object."""
    colors: ColorModel
    """Its colours."""
    rig: CameraRig | None = None
    """The cameras; None: the calibration of each recording."""

    @classmethod
    def of(cls, options: Options) -> Recipe:
        """Load the files that the options name; TrackerError for unknown names and malformed files."""
        model = load_object(options.object)
        rig, given = None, options.calibration
        if given:
            rig = CameraRig.load(
                given[0] if len(given) == 1 else given,
                pattern=options.pattern,
                correct_halved_principal_point=options.correct_halved_principal_point,
            )
        reading = {field.name: getattr(options, field.name) for field in dataclasses.fields(Reading)}
        return cls(model, load_colors(options.colors or model.colors), rig, **reading)

    @functools.cached_property
    def digest(self) -> str:
        """Hash of all fields, on which the poses depend."""
        make = self.make_tracker
        name = f"{make.__module__}.{getattr(make, '__qualname__', make)}"
        reading = (self.correct_halved_principal_point, self.resize_calibration, self.recover)
        digest = hashlib.sha256(repr((*reading, self.start, self.stop, name)).encode())
        cameras = () if self.rig is None else (*self.rig, self.rig.arena)
        for part in (self.model, self.colors, *cameras):
            for field in dataclasses.fields(part):
                value = getattr(part, field.name)
                content = value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
                digest.update(hashlib.sha256(content).digest())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Job:
    """A recording to track, how to track it, and where to write the poses."""

    log: Path
    """The recording."""
    output: Path
    """The file of poses."""
    recipe: Recipe
    """How to track it."""


def fingerprint(job: Job) -> str:
    """Return a hexadecimal hash that differs whenever the poses might differ."""
    recipe = job.recipe
    digest = hashlib.sha256(f"{code()}\0{recipe.digest}\0".encode())
    digest.update(os.fsencode(os.path.abspath(job.log)))
    files = list(recording_files(job.log))
    if recipe.rig is None:
        files += calibration_files(job.log)
    for path in files:
        about, name = path.stat(), os.fsencode(os.path.relpath(path, job.log))
        digest.update(name + f"\0{about.st_size}\0{about.st_mtime_ns}\0".encode())
    return digest.hexdigest()


@functools.cache
def code() -> str:
    """Return a hash of the code that computes poses: this package's sources and its libraries' versions."""
    versions = [module.__version__ for module in (np, scipy, cv2, numba)]
    digest = hashlib.sha256(repr(versions).encode())
    root = Path(__file__).parents[1]
    others = tuple(f"{name}/" for name in _OTHERS)
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not name.startswith(others):
            digest.update(f"\0{name}\0".encode() + path.read_bytes())
    return digest.hexdigest()
