"""Shows what is tracked in the viewer Rerun (the extra `rerun`), without ever holding up the tracking."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path

from tracker.calibration.rig import CameraRig
from tracker.errors import TrackerError
from tracker.live.moment import Moment
from tracker.objects.model import CuboidModel
from tracker.viz.rerun_viewer import open_scene


class RerunView:
    """Shows moments in a thread of its own, the newest; a listener of `Live`.

    A viewer that is too slow misses moments; one that is closed ends the showing, and the tracking goes on.

    Args:
        path: a file (.rrd), which is there when this is closed; None: a viewer is opened.
        rig: the cameras.
        model: the object.

    Raises:
        TrackerError: the package is missing, or the viewer or the file cannot be opened.
    """

    def __init__(self, path: Path | None, rig: CameraRig, model: CuboidModel) -> None:
        self._stack = ExitStack()
        self._scene = self._stack.enter_context(open_scene(path, rig, model))
        self._changed = threading.Condition()
        self._waiting: Moment | None = None
        self._closing = False
        self.fault: str | None = None
        """Why nothing is shown any more."""
        self._thread = threading.Thread(target=self._run, name="tracker.rerun_view", daemon=True)
        self._thread.start()

    def __call__(self, moment: Moment) -> None:
        """Show a moment, as soon as the one before is shown."""
        with self._changed:
            self._waiting = moment
            self._changed.notify_all()

    def close(self) -> None:
        """Show what waits, and finish the file."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        try:
            self._stack.close()
        except TrackerError as error:
            self.fault = self.fault or str(error)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting is not None or self._closing)
                moment, self._waiting = self._waiting, None
            if moment is None:
                return
            try:
                self._scene.show(moment.sequence, moment.timestamp, moment.observation, moment.shot.images)
            except Exception as error:
                self.fault = " ".join(str(error).split())
                return
