"""The views side by side, with the estimate's edges drawn through the lens."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError
from tracker.geometry import cuboid
from tracker.geometry.camera import Camera
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation, PoseEstimate
from tracker.viz import paint
from tracker.viz.caption import caption

MIN_PANEL_HEIGHT = 400
"""Images are scaled by the smallest whole number that makes them at least this high [px]."""

GAP = 6
"""Between panels [px]."""

SAMPLES = 17
"""Points per edge: the lens bends edges, so each is drawn as this many short lines."""

_TINT = 0.15
_NAME_SIZE = 14.0
_EMPTY = (44, 38, 35)


def overlay(
    images: Sequence[Image | None],
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
    if len(images) != len(rig):
        raise ImageError(
            f"overlay: found {len(images)} images, expected one of each of {', '.join(rig.names)}"
        )
    pose = observation.object_pose
    if pose is None:
        pose = observation.filtered_object_pose
    height = max(camera.height * -(-MIN_PANEL_HEIGHT // camera.height) for camera in rig)
    parts: list[Image] = []
    for image, camera in zip(images, rig, strict=True):
        if parts:
            parts.append(np.full((height, GAP, 3), paint.BACKGROUND, np.uint8))
        parts.append(_panel(image, camera, model, pose, height))
    row = np.concatenate(parts, axis=1)
    return np.concatenate([row, caption(row.shape[1], model.name, observation, title)])


def _panel(
    image: Image | None, camera: Camera, model: CuboidModel, pose: PoseEstimate | None, height: int
) -> Image:
    """One view scaled to `height` with the object drawn into it."""
    size = (max(1, round(camera.width * height / camera.height)), height)
    if image is None:
        panel: Image = np.full((size[1], size[0], 3), _EMPTY, np.uint8)
        paint.put_text(panel, "no image", (size[0] / 2, height / 2), paint.FAINT, size=18, align=0.5)
    else:
        expected = (camera.height, camera.width, 3)
        if image.shape != expected or image.dtype != np.uint8:
            found = f"{image.dtype} {image.shape}"
            raise ImageError(f"overlay: {camera.name}: found an image {found}, expected uint8 {expected}")
        panel = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_CUBIC), dtype=np.uint8)
        if pose is not None:
            _draw_object(panel, camera.resized(*size), model, pose)
    _draw_name(panel, camera.name)
    return panel


def _draw_name(panel: Image, name: str) -> None:
    left, top, right, bottom = 12, 12, 36 + paint.text_width(name, _NAME_SIZE), 26 + 1.7 * _NAME_SIZE
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)], dtype=np.float64)
    paint.fill(panel, corners, paint.BACKGROUND, 0.6)
    paint.put_text(panel, name, (24, (top + bottom + _NAME_SIZE) / 2), paint.BRIGHT, size=_NAME_SIZE)


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
    edges = [_project_line(view, corners[a], corners[b]) for a, b, f, g in cuboid.EDGES if seen[f] or seen[g]]
    lines = [part for edge in edges for part in _finite_parts(edge)]
    paint.stroke(panel, lines, paint.BLACK, 3.6, 0.45)
    paint.stroke(panel, lines, paint.WHITE, 1.4)


def _project_line(view: Camera, start: Array, end: Array) -> FloatArray:
    """Pixels (SAMPLES, 2) of points from `start` to `end` [m]; NaN far outside the field of view."""
    points = start + np.linspace(0, 1, SAMPLES)[:, None] * (end - start)
    in_camera = points @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
    pixels = view.project(points)
    # Beyond the field of view the distortion folds back into the image.
    tangent = np.linalg.norm(in_camera[:, :2], axis=1)
    pixels[~(tangent < 1.2 * _field_of_view(view) * in_camera[:, 2])] = np.nan
    return pixels


def _field_of_view(view: Camera) -> float:
    """Largest tangent of the angle between the optical axis and the rays of the image's border."""
    columns, rows = (np.linspace(-0.5, count - 0.5, 9) for count in (view.width, view.height))
    pixels = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    return float(np.nanmax(np.linalg.norm(view.undistort(pixels), axis=1)))


def _finite_parts(points: FloatArray) -> list[FloatArray]:
    """The stretches without NaN of a line (N, 2), of two points or more."""
    good = np.concatenate([[False], np.isfinite(points).all(axis=1), [False]])
    bounds = np.flatnonzero(np.diff(good))
    return [points[a:b] for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > 1]
