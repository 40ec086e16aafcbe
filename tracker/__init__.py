"""Finds the pose of a coloured object in the images of calibrated cameras, and says how sure it is."""

from tracker.calibration.rig import CameraRig
from tracker.errors import TrackerError
from tracker.geometry.arena import Arena
from tracker.logs import open_log
from tracker.objects.model import CuboidModel, load_object
from tracker.pipeline import ObjectTracker
from tracker.pose.result import CameraUse, MotionEstimate, Observation, PoseEstimate, Status
from tracker.segmentation import ColorModel, load_colors, segment
from tracker.tracking.belief import TrackingOptions

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
