"""Tracks a whole recording and writes its file of poses, with a fingerprint of what it was made from.

The fingerprint shows whether poses of an earlier run can be reused. Of the recording and the calibration
beside it, it covers names, sizes and modification times: reading the content would take as long as tracking.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
import os
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numba
import numpy as np
import scipy

from tracker.calibration.rig import CameraRig
from tracker.checks import is_whole, naming, path_of
from tracker.errors import LogError, TrackerError, shown
from tracker.files import claimed, reading
from tracker.files.hdf5 import text_of
from tracker.inputs import PathLike, colors_of, object_of, rig_of
from tracker.logs import Log, LogFrame, open_log
from tracker.logs.log import Progress, by_episode
from tracker.logs.opening import calibration_files, fitted_to, recording_files
from tracker.objects.model import CuboidModel, load_object, object_names
from tracker.pipeline import ObjectTracker
from tracker.pose.result import Observation
from tracker.poses.file import PosesBuilder, read_poses, refuse_other_file, refuse_other_object, write_poses
from tracker.poses.poses import About, Poses
from tracker.segmentation.color_model import ColorModel, color_model_names, load_colors
from tracker.version import version

_OTHERS = "batch/", "cli/", "color_learning/", "calibration/board/", "calibration/by_object/", "live/", "viz/"
"""Parts of the package that affect neither poses nor what is summed up of them."""


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
    make_tracker: Callable[[CuboidModel, CameraRig, ColorModel], Any] = ObjectTracker
    """Makes a tracker with `update` and `reset` like ObjectTracker's; must be picklable by name."""

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

        def path(name: str, known: Sequence[str], there: Callable[[str], bool] = os.path.isfile) -> str:
            return os.path.abspath(name) if name not in known and there(name) else name

        return dataclasses.replace(
            self,
            object=path(self.object, object_names()),
            colors=path(self.colors, color_model_names()) if self.colors else self.colors,
            calibration=tuple(path(name, (), os.path.exists) for name in self.calibration),
        )

    def plain(self) -> dict[str, Any]:
        """Return the options for JSON, without `make_tracker`."""
        return {name: value for name, value in vars(self).items() if name != "make_tracker"}

    @classmethod
    def of_plain(cls, values: dict[str, Any]) -> Options:
        """Make options from what `plain` returns; TypeError for other fields."""
        values = {**values, "calibration": tuple(values.get("calibration", ()))}
        return cls(make_tracker=ObjectTracker, **values)


@dataclass(frozen=True, eq=False)
class Recipe(Reading):
    """Options with all files loaded."""

    model: CuboidModel
    colors: ColorModel
    rig: CameraRig | None = None
    """The cameras; None: the calibration of each recording."""

    @classmethod
    def of(cls, options: Options) -> Recipe:
        """Load the files that the options name; TrackerError for unknown names and malformed files."""
        model = load_object(options.object)
        rig = None
        if options.calibration:
            rig = CameraRig.load(
                options.calibration,
                pattern=options.pattern,
                correct_halved_principal_point=options.correct_halved_principal_point,
            )
        settings = {field.name: getattr(options, field.name) for field in dataclasses.fields(Reading)}
        return cls(model, load_colors(options.colors or model.colors), rig, **settings)

    @functools.cached_property
    def digest(self) -> str:
        """Hash of all fields, code and libraries, on which the poses depend."""
        make = self.make_tracker
        name = f"{make.__module__}.{getattr(make, '__qualname__', make)}"
        parts = (self.correct_halved_principal_point, self.resize_calibration, self.recover)
        digest = hashlib.sha256(repr((code(), *parts, self.start, self.stop, name)).encode())
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
    output: Path
    recipe: Recipe


def fingerprint(job: Job) -> str:
    """Return a hexadecimal hash that differs whenever the poses might differ."""
    recipe = job.recipe
    digest = hashlib.sha256(recipe.digest.encode())
    digest.update(os.fsencode(os.path.abspath(job.log)))
    files = list(recording_files(job.log))
    if recipe.rig is None:
        files += calibration_files(job.log)
    for path in files:
        about = path.stat(follow_symlinks=path.exists())  # a link may lead nowhere: reading it reports that
        name = os.fsencode(os.path.relpath(path, job.log))
        digest.update(name + f"\0{about.st_size}\0{about.st_mtime_ns}\0".encode())
    return digest.hexdigest()


@functools.cache
def code() -> str:
    """Return a hash of the code that computes poses and rows of them, and of its libraries' versions."""
    versions = [module.__version__ for module in (np, scipy, cv2, numba)]
    digest = hashlib.sha256(repr(versions).encode())
    root = Path(__file__).parents[1]
    for path in sorted(root.rglob("[!.]*.py")):
        name = path.relative_to(root).as_posix()
        if not name.startswith(_OTHERS):
            digest.update(f"\0{name}\0".encode() + path.read_bytes())
    return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Tracked:
    """A tracked recording."""

    poses: Poses
    """Poses of all frames, as in the file."""
    expected: int
    """Number of frames to track; a damaged recording gives fewer poses."""
    fault: str | None
    """Fault of the recording; None: no fault."""
    new: int
    """Number of frames tracked by this call; 0 if the file of an earlier run was reused."""
    seconds: float
    """Duration of tracking these frames [s]."""
    episode_starts: tuple[int, ...] = (0,)
    """Numbers of the frames that start an episode, see `Log.episode_starts`."""


def track(
    path: str | os.PathLike[str],
    model: CuboidModel | PathLike,
    *,
    output: str | os.PathLike[str] | None = None,
    rig: CameraRig | PathLike | Iterable[PathLike] | None = None,
    colors: ColorModel | PathLike | None = None,
    start: int = 0,
    stop: int | None = None,
    recover: bool = False,
    progress: Progress | None = None,
) -> Tracked:
    """Track the object in every frame of a recording, as a loop over `ObjectTracker.update` does.

    Args:
        path: the recording, as for `open_log`.
        model: the object, or its name or TOML file.
        output: the file of poses to write. If it exists, made from the same recording, object, colours,
            cameras, frames and code, it is read instead. None: nothing is written.
        rig: the cameras, their calibration files, or the folder of these; None: the calibration in or
            beside the recording.
        colors: a colour model, or its name or file; None: the object's own.
        start: number of the first frame to track.
        stop: number of the frame after the last one to track; None: the recording's end.
        recover: skip damaged frames.
        progress: callback that takes the number of frames done since the last call.

    Raises:
        LogError: the recording is missing, damaged (without `recover`) or changed while it was read, or the
            file cannot be written, or is the recording, its calibration, or another without poses of the
            object.
        TrackerError: a name is unknown, or a calibration is missing or does not fit.
        OSError: a file cannot be read or written; BlockingIOError: another run is writing the file.
    """
    log = path_of(path, "path of a recording", LogError)
    target = path_of(os.devnull if output is None else output, "output", LogError)
    with reading(log):
        log.stat()
    found = object_of(model)
    cameras = None if rig is None else rig_of(rig)
    recipe = Recipe(found, colors_of(colors, found), cameras, start=start, stop=stop, recover=recover)
    job = Job(log, target, recipe)
    if output is None:
        return _tracked(job, progress)
    refuse_other_object(target, f"output {target}", found.name)
    return run(job, progress)


def run(job: Job, progress: Progress | None = None) -> Tracked:
    """Track a recording and write its file of poses, whole or not at all; errors as for `track`.

    An existing file that is undamaged and has the same fingerprint is reused instead.
    """
    if job.output.is_file() and job.log.exists():
        for path in (*recording_files(job.log), *calibration_files(job.log)):
            if path.exists() and job.output.samefile(path):
                found = "that is the recording or its calibration"
                raise LogError(f"output {job.output}: {found}, expected another file")
    refuse_other_file(job.output, f"output {job.output}")
    with claimed(job.output):
        kept = _kept(job)
        if kept is not None:
            if progress is not None:
                progress(kept.expected)
            return kept
        tracked = _tracked(job, progress)
        write_poses(job.output, tracked.poses)
        return tracked


def chosen(path: Path, count: int, start: int, stop: int | None) -> range:
    """Return the numbers from `start` to before `stop` of a recording's `count` frames; LogError if none."""
    if start and start >= count:
        frames = f"frames 0 to {count - 1}" if count else "no frames"
        raise LogError(f"{path}: `--from {start}` (start={start}): the recording has {frames}")
    if stop is not None and start >= stop:
        raise LogError(f"{path}: found frames from {start} to {stop} asked for, expected some")
    return range(count)[start:stop]


def _expected(log: Log, job: Job) -> int:
    """Return the number of frames to track if the recording had all that it states."""
    return len(range(len(log) + log.missing)[job.recipe.start : job.recipe.stop])


def rig_for(job: Job, log: Log) -> CameraRig:
    """Return the cameras of a recording; see `fitted_to`."""
    correct, resize = job.recipe.correct_halved_principal_point, job.recipe.resize_calibration
    return fitted_to(job.log, log, job.recipe.rig, correct_halved_principal_point=correct, resize=resize)


def _kept(job: Job) -> Tracked | None:
    """Return the result of an earlier run if it is undamaged and has the same fingerprint, else None."""
    if not job.output.is_file() or text_of(job.output, "fingerprint") != fingerprint(job):
        return None
    try:
        poses = read_poses(job.output)
    except LogError:
        return None
    with open_log(job.log, recover=job.recipe.recover) as log:
        expected, fault = _expected(log, job), poses.about.fault or None
        return Tracked(poses, expected, fault, 0, 0.0, log.episode_starts)


def _tracked(job: Job, progress: Progress | None) -> Tracked:
    recipe, before = job.recipe, fingerprint(job)
    changed = f"{job.log}: changed while it was read, is it still being written?"
    try:
        with open_log(job.log, recover=recipe.recover) as log:
            frames = chosen(job.log, len(log), recipe.start, recipe.stop)
            rig = rig_for(job, log)
            tracker = recipe.make_tracker(recipe.model, rig, recipe.colors)
            began = time.perf_counter()
            name = unicode_text(job.log.name or job.log.resolve().name)
            builder = PosesBuilder(About(recipe.model.name, name, version(), rig))
            for frame, answer in answers(job.log, log[frames.start : frames.stop], tracker):
                builder.append(frame.index, frame.timestamp, answer, frame.recorded_pose)
                if progress is not None:
                    progress(1)
            poses, seconds, fault = builder.build(), time.perf_counter() - began, log.fault
            expected, starts = _expected(log, job), log.episode_starts
    except LogError as error:
        if fingerprint(job) != before:
            raise LogError(f"{changed} {error}") from error
        raise
    if fingerprint(job) != before:
        if not recipe.recover:
            raise LogError(changed)
        fault = changed
    about = dataclasses.replace(poses.about, fingerprint=before, fault=unicode_text(fault or ""))
    poses = dataclasses.replace(poses, about=about)
    return Tracked(poses, expected, fault, len(poses), seconds, starts)


def answers(path: Path, log: Log, tracker: Any) -> Iterator[tuple[LogFrame, Observation]]:
    """Yield each frame with the tracker's result; LogError if it is damaged or does not fit the tracker.

    The frame's timestamp is that of its newest image. The tracker is reset at the start of each episode.
    """
    for number, (frame, begins) in enumerate(by_episode(log)):
        if begins and number > 0:
            tracker.reset()
        given = frame.newest if (frame.stamps == frame.newest).all() else frame.stamps
        with naming(f"{path}: frame {frame.index}", LogError, TrackerError):
            answer = tracker.update(frame.images, given)
        yield dataclasses.replace(frame, timestamp=frame.newest), answer


def unicode_text(text: str) -> str:
    """Return a text that a file of poses can store: file names need not be valid Unicode."""
    return os.fsencode(text).decode("utf-8", "replace")
