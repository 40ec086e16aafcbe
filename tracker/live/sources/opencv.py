"""Cameras, films and streams that OpenCV opens."""

from __future__ import annotations

import time
from pathlib import Path

import cv2
import numpy as np

from tracker.errors import LiveError, LogError
from tracker.live.sources.cameras import CameraEnded, CameraLost, Grabbed
from tracker.logs.films import check_container

_KEPT = {
    "exposure": cv2.CAP_PROP_EXPOSURE,
    "auto_exposure": cv2.CAP_PROP_AUTO_EXPOSURE,
    "gain": cv2.CAP_PROP_GAIN,
    "gamma": cv2.CAP_PROP_GAMMA,
    "auto_white_balance": cv2.CAP_PROP_AUTO_WB,
    "white_balance_temperature": cv2.CAP_PROP_WB_TEMPERATURE,
}


class OpenCvCamera:
    """A camera by its number, a film by its file, or a stream by its address.

    The stamp is the moment at which the picture arrived, since OpenCV tells no other. A film gives one
    picture each time it is asked, and ends. A camera by its number is asked for a size (width, height) [px],
    and gives what it can.

    Raises:
        LiveError: it cannot be opened, or a file is no film.
    """

    def __init__(self, what: str, size: tuple[int, int] | None = None) -> None:
        self._what = what
        self.triggered = not what.isdigit() and Path(what).is_file()
        if self.triggered:
            try:
                check_container(Path(what))  # a playlist would open what it names
            except LogError as error:
                raise LiveError(f"opencv: {error}") from error
        self._capture = cv2.VideoCapture(int(what)) if what.isdigit() else cv2.VideoCapture(what)
        if not self._capture.isOpened():
            raise LiveError(f"opencv: {what} cannot be opened")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # only the newest counts
        if what.isdigit() and size is not None:
            # By themselves many give 640x480, whatever they could.
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])

    def grab(self, timeout: float) -> Grabbed:
        """See `LiveCamera`; OpenCV has a time limit of its own."""
        there, image = self._capture.read()
        stamp = time.time()
        if not there:
            if self.triggered:
                raise CameraEnded(f"opencv: {self._what} has ended")
            raise CameraLost(f"opencv: {self._what} gives no picture")
        if image.ndim == 2:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        return Grabbed(np.asarray(image, np.uint8), stamp)

    def settings(self) -> dict[str, str | int | float | bool]:
        """See `LiveCamera`; what OpenCV tells of it, in the units of its driver. A film has none."""
        if self.triggered:
            return {}
        return {name: self._capture.get(number) for name, number in _KEPT.items()}

    def close(self) -> None:
        """See `LiveCamera`."""
        self._capture.release()
