"""Finds the pose of a coloured object in the images of calibrated cameras, and says how sure it is.

A name is loaded when it is first used, so that what needs few of them, such as `tracker --help`, answers at
once.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tracker.calibration.rig import CameraRig
    from tracker.errors import TrackerError
    from tracker.geometry.arena import Arena
    from tracker.logs import open_log
    from tracker.objects.model import CuboidModel, load_object
    from tracker.pipeline import ObjectTracker
    from tracker.pose.result import CameraUse, MotionEstimate, Observation, PoseEstimate, Status
    from tracker.segmentation import ColorModel, load_colors, segment
    from tracker.tracking.belief import TrackingOptions
else:  # not seen by type checkers, which would take any name for one that exists
    _HOMES = {
        "Arena": "geometry.arena",
        "CameraRig": "calibration.rig",
        "CameraUse": "pose.result",
        "ColorModel": "segmentation",
        "CuboidModel": "objects.model",
        "MotionEstimate": "pose.result",
        "ObjectTracker": "pipeline",
        "Observation": "pose.result",
        "PoseEstimate": "pose.result",
        "Status": "pose.result",
        "TrackerError": "errors",
        "TrackingOptions": "tracking.belief",
        "load_colors": "segmentation",
        "load_object": "objects.model",
        "open_log": "logs",
        "segment": "segmentation",
    }

    def __getattr__(name):
        if name in _HOMES:
            value = globals()[name] = getattr(import_module(f"tracker.{_HOMES[name]}"), name)
            return value
        if name.startswith("_") or find_spec(f"tracker.{name}") is None:
            raise AttributeError(f"module 'tracker' has no attribute {name!r}")
        # A room by its own name, `tracker.geometry.so3`: there once any name is.
        for home in _HOMES.values():
            import_module(f"tracker.{home}")
        return import_module(f"tracker.{name}")

    def __dir__():
        return sorted({*globals(), *__all__})


__all__ = [
    "Arena",
    "CameraRig",
    "CameraUse",
    "ColorModel",
    "CuboidModel",
    "MotionEstimate",
    "ObjectTracker",
    "Observation",
    "PoseEstimate",
    "Status",
    "TrackerError",
    "TrackingOptions",
    "load_colors",
    "load_object",
    "open_log",
    "segment",
]
