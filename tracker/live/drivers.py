"""Camera drivers: Basler cameras via pypylon (the extra `pylon`), others via OpenCV."""

import contextlib
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tracker.checks import naming, optional
from tracker.errors import LiveError, LogError
from tracker.live.cameras import CameraLost, CameraUnfit, Grabbed, Settings
from tracker.live.moment import SourceEnded
from tracker.logs.pictures import check_container

KEPT = (
    "DeviceSerialNumber", "PixelFormat", "ExposureTime", "ExposureAuto", "Gain", "GainAuto", "Gamma",
    "BlackLevel", "BalanceWhiteAuto",
)  # fmt: skip
"""Features reported for every camera that has them; so are the white balance ratios of the colours."""

_FORMATS = {"BayerRG8": None, "BGR8Packed": 1, "BGR8": 1, "RGB8Packed": -1, "RGB8": -1}
"""Supported pixel formats, with the step by which their channels are BGR; None: raw pixels."""

_TRIGGER = ("TriggerSelector", "FrameStart"), ("TriggerMode", "On"), ("TriggerSource", "Software")


class PylonCamera:
    """A Basler camera with a given serial number, triggered by software.

    The timestamp is the middle of the exposure: the time of the trigger plus half the exposure time. Settings
    are applied in the given order, and each is read back.

    Raises:
        LiveError: there is no such camera, or it is in use.
        CameraUnfit: it rejects a setting, or its pixel format is not supported.
    """

    triggered = True

    def __init__(self, serial: str, settings: Settings | None = None) -> None:
        pylon, settings = _pylon(), settings or {}
        self._pylon, self.serial, self._names = pylon, serial, tuple(settings)
        info = pylon.DeviceInfo()
        info.SetSerialNumber(serial)
        try:
            self._camera = pylon.InstantCamera(pylon.TlFactory.GetInstance().CreateFirstDevice(info))
            self._camera.Open()
        except Exception as error:
            raise self._fault("cannot be opened", error) from error
        try:
            for name, value in (*settings.items(), *_TRIGGER):
                self._set(name, value)
            self.format = str(self._camera.PixelFormat.Value)
            if self.format not in _FORMATS:
                raise CameraUnfit(
                    f"pylon: {serial}: found the PixelFormat {self.format}, expected one of "
                    f"{', '.join(_FORMATS)}: give it in the settings"
                )
            self._exposure()  # if it cannot be read, no image could be stamped
            self._camera.StartGrabbing(pylon.GrabStrategy_LatestImageOnly)
        except Exception as error:
            self._camera.Close()
            if isinstance(error, LiveError):
                raise
            raise self._fault("cannot be made ready", error) from error

    def grab(self, timeout: float) -> Grabbed:
        """See `LiveCamera`."""
        pylon, wait = self._pylon, max(1, round(1000 * timeout))
        try:
            # An image that came after its own grab gave up would be taken for this one, and so on.
            self._camera.RetrieveResult(0, pylon.TimeoutHandling_Return).Release()
            self._camera.WaitForFrameTriggerReady(wait, pylon.TimeoutHandling_ThrowException)
            exposure = self._exposure()
            stamp = time.time() + exposure / 2
            self._camera.TriggerSoftware.Execute()
            result = self._camera.RetrieveResult(wait, pylon.TimeoutHandling_ThrowException)
        except Exception as error:
            if isinstance(error, pylon.TimeoutException) and not self._camera.IsCameraDeviceRemoved():
                raise LiveError(f"pylon: {self.serial}: no image within {timeout:g} s") from error
            raise self._fault("is lost", error, CameraLost) from error
        try:
            if not result.GrabSucceeded():
                raise LiveError(f"pylon: {self.serial}: {result.GetErrorDescription()}")
            array = np.array(result.Array, dtype=np.uint8)
        finally:
            result.Release()
        step = _FORMATS[self.format]
        return Grabbed(array if step is None else np.ascontiguousarray(array[:, :, ::step]), stamp)

    def settings(self) -> dict[str, str | int | float | bool]:
        """See `LiveCamera`; the values of KEPT and of all features that were set, by GenICam name."""
        found: dict[str, str | int | float | bool] = {}
        for name in dict.fromkeys((*KEPT, *self._names)):
            with contextlib.suppress(Exception):  # the feature is missing or not readable
                found[name] = getattr(self._camera, name).Value
        for color in ("Red", "Green", "Blue"):
            with contextlib.suppress(Exception):
                self._camera.BalanceRatioSelector.Value = color
                found[f"BalanceRatio[{color}]"] = self._camera.BalanceRatio.Value
        return found

    def close(self) -> None:
        """See `LiveCamera`."""
        self._camera.Close()

    def _exposure(self) -> float:
        """Return the present exposure time [s], which ExposureAuto changes."""
        return float(self._camera.ExposureTime.Value) * 1e-6

    def _set(self, name: str, value: str | int | float | bool) -> None:
        try:
            feature = getattr(self._camera, name)
            feature.Value = value
            found = feature.Value
        except Exception as error:
            kind = LiveError if self._camera.IsCameraDeviceRemoved() else CameraUnfit
            raise self._fault(f"does not take {name} = {value!r}", error, kind) from error
        # Cameras round times and gains to their own steps.
        near = isinstance(found, float) and abs(found - float(value)) <= 0.02 * abs(float(value)) + 1e-3
        if found != value and not near:
            raise CameraUnfit(f"pylon: {self.serial}: {name}: found {found!r} after setting {value!r}")

    def _fault(self, what: str, error: Exception, kind: type[LiveError] = LiveError) -> LiveError:
        # Of pylon's message only the first line, without locations in its code.
        text = str(error).splitlines()[0].split(" : ")[0] if str(error) else type(error).__name__
        return kind(f"pylon: {self.serial} {what}: {text}")


def pylon_serials(names: Sequence[str]) -> list[str]:
    """Return the serial numbers of the cameras with these DeviceUserIDs; LiveError if one is missing."""
    devices = _pylon().TlFactory.GetInstance().EnumerateDevices()
    found = {device.GetUserDefinedName(): device.GetSerialNumber() for device in devices}
    missing = [name for name in names if name not in found]
    if missing:
        there = ", ".join(f"{device.GetSerialNumber()} {device.GetUserDefinedName()!r}" for device in devices)
        raise LiveError(
            f"pylon: found no camera that calls itself {', '.join(missing)}; there are {there or 'none'}; "
            "name them by their serial numbers, pylon:SERIAL,…"
        )
    return [found[name] for name in names]


def _pylon() -> Any:
    # Importing it emits warnings about its own types, and crashes if warnings are errors.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return optional("pypylon.pylon", "pylon", "pylon", LiveError)


_KEPT = {
    "exposure": cv2.CAP_PROP_EXPOSURE,
    "auto_exposure": cv2.CAP_PROP_AUTO_EXPOSURE,
    "gain": cv2.CAP_PROP_GAIN,
    "gamma": cv2.CAP_PROP_GAMMA,
    "auto_white_balance": cv2.CAP_PROP_AUTO_WB,
    "white_balance_temperature": cv2.CAP_PROP_WB_TEMPERATURE,
}


class OpenCvCamera:
    """A camera given by its number, a film by its file, or a stream by its address.

    The timestamp is the time at which the image arrived, since OpenCV provides no other. A film gives one
    image per request until it ends. A camera given by its number is asked for images of `size` (width,
    height) [px], but may deliver another size.

    Raises:
        LiveError: it cannot be opened, or a file is not a film.
    """

    def __init__(self, what: str, size: tuple[int, int] | None = None) -> None:
        self._what = what
        self.triggered = self.film = not what.isdigit() and Path(what).is_file()
        if self.film:
            with naming("opencv", LiveError, LogError):
                check_container(Path(what))  # a playlist would open what it names
        self._capture = cv2.VideoCapture(int(what) if what.isdigit() else what)
        if not self._capture.isOpened():
            raise LiveError(f"opencv: {what} cannot be opened")
        self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # only the newest counts
        if what.isdigit() and size is not None:
            # Many cameras default to 640x480, whatever they support.
            self._capture.set(cv2.CAP_PROP_FRAME_WIDTH, size[0])
            self._capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size[1])

    def grab(self, timeout: float) -> Grabbed:
        """See `LiveCamera`; OpenCV's own time limit applies instead of `timeout`."""
        given: tuple[bool, Any] = self._capture.read()
        there, image = given
        stamp = time.time()
        if not there:
            if self.film:
                raise SourceEnded(f"opencv: {self._what} has ended")
            raise CameraLost(f"opencv: {self._what} gives no image")
        if image.ndim == 2:
            image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        return Grabbed(image, stamp)

    def settings(self) -> dict[str, str | int | float | bool]:
        """See `LiveCamera`; the values that OpenCV reports, in the driver's units. A film has none."""
        if self.film:
            return {}
        return {name: self._capture.get(number) for name, number in _KEPT.items()}

    def close(self) -> None:
        """See `LiveCamera`."""
        self._capture.release()
