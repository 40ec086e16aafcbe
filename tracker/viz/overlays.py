"""The views side by side, with the estimate's edges drawn through the lens."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TrackerError
from tracker.geometry import cuboid
from tracker.geometry.camera import Camera
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation, PoseEstimate
from tracker.viz import paint
from tracker.viz.footer import caption, footer
from tracker.viz.panels import panels

SAMPLES = 17
"""Points per edge: the lens bends edges, so each is drawn as this many short lines."""

_TINT = 0.15


def overlay(
    images: Sequence[Array | None],
    rig: CameraRig,
    model: CuboidModel,
    observation: Observation,
    *,
    title: str = "",
) -> Image:
    """The views with the estimate's visible edges in them, and a caption with its numbers below.

    Drawn is the pose measured in these images or, without one, the filtered pose. Edges that the object
    itself hides are left out; those behind a finger are not, since the tracker does not know of fingers.

    Args:
        images: (H, W, 3) uint8 BGR of each camera of the rig; None: the panel says that there is none.
        rig: the cameras.
        model: the object.
        observation: what the tracker found in the images.
        title: a line above the numbers, e.g. the time.

    Raises:
        ImageError: the images do not fit the rig.
    """
    of_kind(model, CuboidModel, "overlay: model", TrackerError, "tracker.load_object")
    of_kind(observation, Observation, "overlay: observation", TrackerError, "ObjectTracker.detect")
    of_kind(title, str, "overlay: title", TrackerError)
    pose = observation.object_pose
    if pose is None:
        pose = observation.filtered_object_pose

    def draw(_: int, panel: Image, view: Camera) -> None:
        if pose is not None:
            _draw_object(panel, view, model, pose)

    row = panels(images, rig, draw)
    return np.concatenate([row, footer(row.shape[1], caption(model.name, observation, title))])


def visible_edges(view: Camera, model: CuboidModel, pose: PoseEstimate) -> list[FloatArray]:
    """Lines (N, 2) [px] of the object's edges that it does not hide itself, bent by the lens."""
    seen = cuboid.visible_faces(model.size, pose.rotation.T @ (view.position - pose.position))
    corners = pose.position + cuboid.corners(model.size) @ pose.rotation.T
    edges = [_project_line(view, corners[a], corners[b]) for a, b, f, g in cuboid.EDGES if seen[f] or seen[g]]
    return [part for edge in edges for part in _finite_parts(edge)]


def _draw_object(panel: Image, view: Camera, model: CuboidModel, pose: PoseEstimate) -> None:
    """Tint the faces that the camera sees, and draw their edges and the object's centre."""
    seen = cuboid.visible_faces(model.size, pose.rotation.T @ (view.position - pose.position))
    corners = pose.position + cuboid.corners(model.size) @ pose.rotation.T
    for face in np.flatnonzero(seen):
        loop = corners[cuboid.FACE_CORNERS[face]]
        sides = [_project_line(view, *ends) for ends in zip(loop, np.roll(loop, -1, axis=0), strict=True)]
        outline = np.concatenate(sides)
        if np.isfinite(outline).all():
            paint.fill(panel, outline, DISPLAY_COLORS_BGR[model.face_labels[face]].tolist(), _TINT)
    lines = visible_edges(view, model, pose)
    paint.stroke(panel, lines, paint.BLACK, 3.6, 0.45)
    paint.stroke(panel, lines, paint.WHITE, 1.4)


def _project_line(view: Camera, start: Array, end: Array) -> FloatArray:
    """Pixels (SAMPLES, 2) of points from `start` to `end` [m]; NaN far outside the field of view."""
    return view.project_in_view(start + np.linspace(0, 1, SAMPLES)[:, None] * (end - start))


def _finite_parts(points: FloatArray) -> list[FloatArray]:
    """The stretches without NaN of a line (N, 2), of two points or more."""
    good = np.concatenate([[False], np.isfinite(points).all(axis=1), [False]])
    bounds = np.flatnonzero(np.diff(good))
    return [points[a:b] for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > 1]
