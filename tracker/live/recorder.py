"""Records what is tracked, without ever holding up the tracking."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.errors import LiveError, TrackerError
from tracker.live.camera import Settings
from tracker.live.moment import Moment
from tracker.logs.hdf5_writer import Hdf5LogWriter

WAITING = 30
"""Sets of images that may wait for the disk: three seconds of cameras at 10 Hz."""

FLUSH = 0.7
"""How often what was recorded is handed to the operating system [s]; with the time that it takes, and until
the next set comes, a second."""


class Recorder:
    """Records each moment in the platform's HDF5 format, 2.1; a listener of `Live`.

    Raw pixels are recorded as the cameras gave them, and the calibration is then that of their size. Of
    images that come in colour each pixel keeps the colour that such a sensor measures there. The measured
    poses are recorded too. What the disk does not take in time is left out, and counted; when it takes no
    more, the recording ends, and the tracking goes on.

    Args:
        path: a file that does not exist yet.
        rig: the cameras.
        settings: tells what each camera is set to when the recording begins, which is kept with it.

    Raises:
        LiveError: there is such a file, no folder for it, or the cameras differ in size, for which the
            format has no place.
    """

    def __init__(
        self, path: Path, rig: CameraRig, settings: Callable[[], Sequence[Settings]] | None = None
    ) -> None:
        if path.exists():
            raise LiveError(f"record {path}: there is such a file, expected a new one")
        if not path.parent.is_dir():
            raise LiveError(f"record {path}: there is no folder {path.parent}")
        if len({(camera.width, camera.height) for camera in rig}) > 1:
            found = ", ".join(f"{camera.name} {camera.width}×{camera.height}" for camera in rig)
            raise LiveError(f"record {path}: found {found} px, expected cameras of one size")
        self.path, self._rig, self._settings = path, rig, settings
        self._queue: queue.Queue[Moment | None] = queue.Queue(WAITING)
        self.recorded, self.left_out = 0, 0
        self.fault: str | None = None
        """Why the recording has ended before its time."""
        self._thread = threading.Thread(target=self._run, name="tracker.recorder", daemon=True)
        self._thread.start()

    def __call__(self, moment: Moment) -> None:
        """Record a moment, some time later."""
        if self.fault is not None:
            return
        try:
            self._queue.put_nowait(moment)
        except queue.Full:
            self.left_out += 1

    def close(self) -> None:
        """Record what waits, and finish the file."""
        while self._thread.is_alive():
            try:
                self._queue.put(None, timeout=0.1)
                break
            except queue.Full:
                continue
        self._thread.join()

    def _run(self) -> None:
        writer: Hdf5LogWriter | None = None
        try:
            flushed = time.monotonic()
            while (moment := self._queue.get()) is not None:
                if writer is None:
                    if all(image is None for image in moment.shot.images):
                        continue  # how large they are nobody knows yet
                    writer = self._begun(moment)
                self._write(writer, moment)
                if time.monotonic() - flushed > FLUSH:
                    writer.flush()
                    flushed = time.monotonic()
        except TrackerError as error:
            self.fault = str(error)
        finally:
            try:
                if writer is not None:
                    writer.close()
            except TrackerError as error:
                self.fault = self.fault or str(error)

    def _begun(self, moment: Moment) -> Hdf5LogWriter:
        pictures = moment.shot.raw or moment.shot.images
        height, width = next(one.shape[:2] for one in pictures if one is not None)
        rig = self._rig
        if any((camera.width, camera.height) != (width, height) for camera in rig):
            rig = rig.resized(width, height)
        settings = () if self._settings is None else self._settings()
        return Hdf5LogWriter(self.path, rig, poses=True, flush_every=0, settings=settings)

    def _write(self, writer: Hdf5LogWriter, moment: Moment) -> None:
        shot = moment.shot
        writer.append(shot.raw or shot.images, moment.timestamp, shot.stamps, moment.object_pose)
        self.recorded += 1
