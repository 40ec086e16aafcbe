"""What is done with moments in threads of its own, without ever holding up the tracking."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.errors import LiveError, TrackerError
from tracker.live.moment import Moment
from tracker.logs.hdf5_writer import Hdf5LogWriter
from tracker.logs.log import Settings
from tracker.objects.model import CuboidModel
from tracker.viz.rerun_viewer import open_scene

WAITING = 30
"""Sets of images that may wait for the disk: three seconds of cameras at 10 Hz."""

FLUSH = 0.7
"""How often what was recorded is handed to the operating system [s]; with the time that it takes, and until
the next set comes, a second."""


class Listener:
    """Takes in moments in a thread of its own; of more than `waiting` the oldest is left out.

    Where it fails it takes in no more, and the tracking goes on.
    """

    def __init__(self, waiting: int) -> None:
        self._changed = threading.Condition()
        self._waiting: deque[Moment] = deque(maxlen=waiting)
        self._closing = False
        self.left_out = 0
        """Moments that did not get their turn in time."""
        self.fault: str | None = None
        """Why it has ended early."""
        name = f"tracker.{type(self).__name__}"
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def __call__(self, moment: Moment) -> None:
        """Take in a moment, some time later."""
        with self._changed:
            if self.fault is None:
                self.left_out += len(self._waiting) == self._waiting.maxlen
                self._waiting.append(moment)
                self._changed.notify_all()

    def close(self) -> None:
        """Take in what waits, and end."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()

    def _take_in(self, moment: Moment) -> None:
        raise NotImplementedError

    def _finish(self) -> None:
        """Free what was opened, in the thread."""

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
            self.fault = " ".join(str(error).split())
        try:
            self._finish()
        except TrackerError as error:
            self.fault = self.fault or str(error)


class Recorder(Listener):
    """Records each moment in the platform's HDF5 format, 2.1.

    Raw pixels are recorded as the cameras gave them, and the calibration is then that of their size. Of
    images that come in colour each pixel keeps the colour that such a sensor measures there. The measured
    poses are recorded too. What the disk does not take in time is left out, and counted; when it takes no
    more, the recording ends.

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
        self._writer: Hdf5LogWriter | None = None
        self._flushed = time.monotonic()
        self.recorded = 0
        super().__init__(WAITING)

    def _take_in(self, moment: Moment) -> None:
        taken = moment.taken
        pictures = taken.raw or taken.images
        if self._writer is None:
            sizes = [one.shape[1::-1] for one in pictures if one is not None]
            if not sizes:
                return  # how large they are is not known yet
            one_size = sizes[0] == (self._rig[0].width, self._rig[0].height)
            rig = self._rig if one_size else self._rig.resized(*sizes[0])
            settings = () if self._settings is None else self._settings()
            self._writer = Hdf5LogWriter(self.path, rig, poses=True, flush_every=0, settings=settings)
        self._writer.append(pictures, moment.timestamp, taken.stamps, moment.object_pose)
        self.recorded += 1
        if time.monotonic() - self._flushed > FLUSH:
            self._writer.flush()
            self._flushed = time.monotonic()

    def _finish(self) -> None:
        if self._writer is not None:
            self._writer.close()


class RerunView(Listener):
    """Shows moments in the viewer Rerun, or a file (.rrd), the newest; one that is too slow misses some.

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
