"""Process moments in separate threads, so that tracking never waits."""

import math
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.errors import LiveError, LogError, TrackerError, message
from tracker.live.moment import Moment
from tracker.logs.frame import WentBack
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.log import Settings
from tracker.objects.model import CuboidModel
from tracker.viz.rerun_viewer import open_scene

WAITING = 30
"""Number of image sets that may wait for the disk: three seconds at 10 Hz."""

FLUSH = 0.7
"""Interval between flushes to the disk [s]; with the flush and the wait for the next set, it is a second."""


class Listener:
    """Processes moments in a thread of its own; if more than `waiting` are queued, the oldest is dropped.

    After a failure it processes no more moments; tracking continues.
    """

    def __init__(self, waiting: int) -> None:
        self._changed = threading.Condition()
        self._waiting: deque[Moment] = deque(maxlen=waiting)
        self._closing = False
        self.left_out = 0  # number of moments dropped
        self.fault: str | None = None  # why the listener stopped early; None if it did not
        name = f"tracker.{type(self).__name__}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def __call__(self, moment: Moment) -> None:
        """Queue a moment."""
        with self._changed:
            if self.fault is None:
                self.left_out += len(self._waiting) == self._waiting.maxlen
                self._waiting.append(moment)
                self._changed.notify_all()

    def close(self) -> None:
        """Process the queued moments, then end."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _take_in(self, moment: Moment) -> None:
        raise NotImplementedError

    def _finish(self) -> None:
        """Release resources; called in the thread."""

    def _run(self) -> None:
        try:
            while True:
                with self._changed:
                    self._changed.wait_for(lambda: bool(self._waiting) or self._closing)
                    if not self._waiting:
                        break
                    moment = self._waiting.popleft()
                self._take_in(moment)
        except Exception as error:
            self.fault = message(error)
        try:
            self._finish()
        except TrackerError as error:
            self.fault = self.fault or str(error)


class Recorder(Listener):
    """Records each moment in the platform's HDF5 format, 2.1.

    Raw pixels are recorded as the cameras gave them, with the calibration scaled to their size. Colour images
    are reduced to a Bayer pattern: each pixel keeps the one colour that such a sensor measures there.
    Measured poses are recorded, too. Moments that the disk cannot store in time are dropped and counted, and
    so are those after the clock was set back by up to a minute, until it is where it was; if it was set back
    by more, or forward by more than an hour, or if writing fails, the recording ends.

    Args:
        path: a file that does not exist yet, in an existing folder.
        rig: the cameras.
        settings: returns each camera's settings, which are stored when the recording begins.

    Raises:
        LiveError: the file exists, or the cameras differ in image size, which the format does not support.
    """

    def __init__(
        self, path: Path, rig: CameraRig, settings: Callable[[], Sequence[Settings]] = tuple
    ) -> None:
        if os.path.lexists(path):
            raise LiveError(f"record {path}: there is such a file, expected a new one")
        self._size, *others = {(camera.width, camera.height) for camera in rig}
        if others:
            found = ", ".join(f"{camera.name} {camera.width}×{camera.height}" for camera in rig)
            raise LiveError(f"record {path}: found {found} px, expected cameras of one size")
        self.path, self._rig, self._settings = path, rig, settings
        self._writer: Hdf5LogWriter | None = None
        self._flushed, self._safe, self.recorded = -math.inf, 0, 0  # flush the first: the file can be read
        self.went_back = 0  # number of moments dropped because their timestamps are before recorded ones
        super().__init__(WAITING)

    def _take_in(self, moment: Moment) -> None:
        taken = moment.taken
        pictures = taken.raw or taken.images
        if self._writer is None:
            size = next((one.shape[1::-1] for one in pictures if one is not None), None)
            if size is None:
                return  # the size of the images is not known yet
            rig = self._rig if size == self._size else self._rig.resized(*size)
            settings = self._settings()
            self._writer = Hdf5LogWriter(self.path, rig, poses=True, flush_every=0, settings=settings)
        stamps = [math.nan if one is None else t for one, t in zip(pictures, taken.stamps, strict=True)]
        shown = any(one is not None for one in pictures)  # if not, NaN for all would mean a driver error
        try:
            self._writer.append(pictures, moment.timestamp, stamps if shown else None, moment.object_pose)
        except WentBack:
            self.went_back += 1
            return
        self.recorded += 1
        if time.monotonic() - self._flushed > FLUSH:
            self._writer.flush()
            self._flushed, self._safe = time.monotonic(), self.recorded

    def _finish(self) -> None:
        if self._writer is not None:
            try:
                self._writer.close()
            except LogError:  # what was written since the last flush cannot be read
                self.recorded = self._safe
                raise


class RerunView(Listener):
    """Shows the newest moment in the viewer Rerun or writes it to a file (.rrd); drops moments if too slow.

    Raises:
        TrackerError: the package is missing, or the viewer or the file cannot be opened.
    """

    def __init__(self, path: Path | None, rig: CameraRig, model: CuboidModel) -> None:
        self._stack = ExitStack()
        self._scene = self._stack.enter_context(open_scene(path, rig, model))
        super().__init__(1)

    def _take_in(self, moment: Moment) -> None:
        self._scene.show(moment.sequence, moment.timestamp, moment.observation, moment.taken.images)

    def _finish(self) -> None:
        self._stack.close()
