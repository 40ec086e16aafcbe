"""Estimates the pose of a coloured object from images of calibrated cameras, with a confidence.

Each name is imported on first use, so that quick commands such as `tracker --help` start at once.
"""

from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tracker import conventions as conventions
    from tracker import errors as errors
    from tracker import geometry as geometry
    from tracker import live as live
    from tracker import noise as noise
    from tracker import recordings as recordings
    from tracker import tasks as tasks
    from tracker import viz as viz
    from tracker.calibration.rig import CameraRig as CameraRig
    from tracker.errors import TrackerError as TrackerError
    from tracker.geometry.arena import Arena as Arena
    from tracker.geometry.camera import Camera as Camera
    from tracker.logs import Log as Log
    from tracker.logs import open_log as open_log
    from tracker.objects.model import CuboidModel as CuboidModel
    from tracker.objects.model import load_object as load_object
    from tracker.pipeline import ObjectTracker as ObjectTracker
    from tracker.pose.result import CameraUse as CameraUse
    from tracker.pose.result import Forecast as Forecast
    from tracker.pose.result import MotionEstimate as MotionEstimate
    from tracker.pose.result import Observation as Observation
    from tracker.pose.result import PoseEstimate as PoseEstimate
    from tracker.pose.result import Status as Status
    from tracker.poses.file import read_poses as read_poses
    from tracker.poses.poses import Poses as Poses
    from tracker.recordings.track import track as track
    from tracker.segmentation import ColorModel as ColorModel
    from tracker.segmentation import load_colors as load_colors
    from tracker.segmentation import segment as segment
    from tracker.tracking.belief import TrackingOptions as TrackingOptions

    __version__: str
else:  # hidden from type checkers, which would otherwise accept any attribute name
    _NAMES = {
        "calibration.rig": "CameraRig",
        "errors": "TrackerError",
        "geometry.arena": "Arena",
        "geometry.camera": "Camera",
        "logs": "Log open_log",
        "logs.hdf5_writer": "",
        "objects.model": "CuboidModel load_object",
        "pipeline": "ObjectTracker",
        "pose.result": "CameraUse Forecast MotionEstimate Observation PoseEstimate Status",
        "poses.exports": "",
        "poses.file": "read_poses",
        "poses.poses": "Poses",
        "recordings.track": "track",
        "segmentation": "ColorModel load_colors segment",
        "tracking.belief": "TrackingOptions",
    }
    _HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}
    _MODULES = ("conventions", "errors", "geometry", "live", "noise", "recordings", "tasks", "viz")

    __all__ = sorted(_HOMES)

    def __getattr__(name):
        if name == "__version__":
            return import_module("tracker.version").version()
        if name in _HOMES:
            value = globals()[name] = getattr(import_module(f"tracker.{_HOMES[name]}"), name)
            return value
        if name.startswith("_") or find_spec(f"tracker.{name}") is None:
            raise AttributeError(f"module 'tracker' has no attribute {name!r}")
        # Load all public names, so that submodules such as `tracker.geometry.so3` are available, too.
        for home in _NAMES:
            import_module(f"tracker.{home}")
        return import_module(f"tracker.{name}")

    def __dir__():
        return sorted({*__all__, *_MODULES, "__version__", "__doc__", "__file__", "__name__", "__path__"})
