"""Show a recording over time and in 3D in the viewer Rerun; imported only if that package is installed.

    world                      z up [m]
      arena                    circle on the table: largest distance of the object's centre from the axis
      cameras/NAME             pinhole; the images stay distorted, so overlays are distorted as well
        image                  as recorded
        image/measured         the object's edges, distorted by the lens; likewise image/filtered
      measured, filtered       the object: coloured faces at the measured pose, wire frame at the filtered one
      uncertainty/KIND         ellipsoid of the position, two standard deviations
      trajectory/KIND          one piece per frame; the view shows all pieces so far
    confidence/KIND, std_mm/KIND, std_deg/KIND, status
    health/QUANTITY/CAMERA     see `calibration.by_object.health`; health/table: height over the arena's table

Whatever is missing in a frame is cleared: a stale pose is never shown.
"""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from tracker.calibration.by_object.health import HEIGHT, QUANTITIES, Sample, of_pictures
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.geometry import cuboid, so3
from tracker.geometry.camera import Camera
from tracker.inputs import check_images
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.viz.overlays import edges_in_view

SIGMAS = 2.0  # half axes of the ellipsoid, in standard deviations
TIME, FRAME = "time", "frame"
"""Timelines: seconds since the first frame shown, and the frame's number in the recording."""

KINDS = {"measured": (30, 136, 229), "filtered": (225, 100, 0)}
"""Colour (red, green, blue) of each kind of pose, visible on dark and light backgrounds.

The viewer follows the system's theme. Neither a blueprint nor a command-line option can set it.
"""

_AXES = {"x": (215, 60, 50), "y": (40, 140, 60), "z": (40, 110, 215)}
_BAD = {Status.LOST, Status.NO_OBJECT_COLORS, Status.TOO_FEW_PIXELS, Status.INCONSISTENT_VIEWS}

FLUSH_SECONDS = 30.0  # longest wait for a writer, which may never answer after a failure [s]
_FLUSH_FRAMES = 100  # number of frames between flushes, so that the queue does not grow


class Scene:
    """Sends frames one by one to a stream, to which a file or a viewer is attached, and keeps none."""

    def __init__(self, stream: rr.RecordingStream, rig: CameraRig, model: CuboidModel) -> None:
        self._stream, self._rig, self._model = stream, rig, model
        self._start: float | None = None
        self._shown: set[tuple[str, ...]] = set()
        self._last: dict[str, FloatArray] = {}
        self._status: Status | None = None
        self._count = 0
        self._set_up()

    def show(
        self,
        index: int,
        timestamp: float,
        observation: Observation,
        images: Sequence[Image | None] = (),
        health: Sample | None = None,
    ) -> None:
        """Add a frame: its number in the recording, its time [s], and the tracker's result.

        Times are shown relative to the first frame. `images` (H, W, 3) are uint8 BGR, one of each camera or
        None; empty if there are none at all. Without `health` of the rig, only brightness, clipping and white
        balance are measured.

        Raises:
            ImageError: an image does not fit the rig.
            RuntimeError: earlier frames cannot be written.
        """
        if self._start is None:
            self._start = timestamp
        images = check_images(images or [None] * len(self._rig), self._rig, least=0)
        self._stream.set_time(FRAME, sequence=index)
        self._stream.set_time(TIME, duration=timestamp - self._start)
        for camera, image in zip(self._rig, images, strict=True):
            file = None
            if image is not None:
                content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 90])[1].tobytes()
                file = rr.EncodedImage(contents=content, media_type="image/jpeg")
            self._put(_image_path(camera), file)
        values = of_pictures(images) if health is None else health.values
        for key, column in values.items():
            for camera, value in zip(self._rig, column.tolist(), strict=True):
                self._put(("health", key, camera.name), _scalar(value))
        self._put(("health", "table"), _scalar(float("nan") if health is None else health.height))
        self._show_pose("measured", observation.object_pose)
        self._show_pose("filtered", observation.filtered_object_pose)
        if observation.status is not self._status:
            self._status = observation.status
            level = rr.TextLogLevel.WARN if self._status in _BAD else rr.TextLogLevel.INFO
            self._log(("status",), rr.TextLog(self._status.value, level=level))
        self._count += 1
        if self._count % _FLUSH_FRAMES == 0:
            self._stream.flush(timeout_sec=FLUSH_SECONDS)

    def _show_pose(self, kind: str, pose: PoseEstimate | None) -> None:
        """Show everything about a pose; if there is none, clear the last one."""
        last = self._last.pop(kind, None)
        if pose is None:
            for path in sorted(self._shown):
                if path[0] != "health" and path[-1] == kind:
                    self._put(path, None)
            return
        body, colors = ("world", kind), [KINDS[kind]]
        if body not in self._shown:  # the first time, and after it was cleared
            frame = rr.Boxes3D(half_sizes=[self._model.size / 2], colors=colors, radii=[5e-4])
            self._put(body, _mesh(self._model) if kind == "measured" else frame)
        self._log(body, rr.Transform3D(translation=pose.position, quaternion=_quaternion(pose.orientation)))
        self._put(("world", "uncertainty", kind), _ellipsoid(pose, KINDS[kind]))
        for camera in self._rig:
            lines, _ = edges_in_view(camera, self._model, pose)
            # In Rerun, whole numbers are the corners of pixels, not their centres.
            strips = rr.LineStrips2D([line + 0.5 for line in lines], colors=colors, radii=[0.6])
            self._put((*_image_path(camera), kind), strips if lines else None)
        if last is not None:
            piece = rr.LineStrips3D([np.stack([last, pose.position])], colors=colors, radii=[4e-4])
            self._log(("world", "trajectory", kind), piece)
        self._last[kind] = pose.position
        std = np.sqrt(np.diag(pose.covariance))
        self._put(("confidence", kind), rr.Scalars([pose.confidence]))
        self._put(("std_mm", kind), rr.Scalars(1e3 * std[:3]))
        self._put(("std_deg", kind), rr.Scalars(np.degrees(std[3:])))

    def _set_up(self) -> None:
        self._log(("world",), rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        turn, arena = np.linspace(0, 2 * np.pi, 121), self._rig.arena
        circle = arena.radius * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
        circle += (*arena.center, arena.ground)
        line = rr.LineStrips3D([circle], colors=[(130, 130, 130)], radii=[6e-4])
        self._log(("world", "arena"), line, static=True)
        for camera in self._rig:
            self._log(_image_path(camera)[:-1], *_pinhole(camera), static=True)
            for key in QUANTITIES:
                self._log(("health", key, camera.name), rr.SeriesLines(names=[camera.name]), static=True)
        for kind, color in KINDS.items():
            self._log(("confidence", kind), rr.SeriesLines(names=[kind], colors=[color]), static=True)
            for path in ("std_mm", "std_deg"):
                names = [f"{axis} {kind}" for axis in _AXES]
                widths = [1.0 if kind == "measured" else 2.0] * 3
                lines = rr.SeriesLines(names=names, colors=list(_AXES.values()), widths=widths)
                self._log((path, kind), lines, static=True)

    def _put(self, path: tuple[str, ...], what: Any) -> None:
        """Show something at a path from this frame on; None: clear the path."""
        if what is not None:
            self._shown.add(path)
            self._log(path, what)
        elif path in self._shown:
            self._shown.remove(path)
            self._log(path, rr.Clear(recursive=False))

    def _log(self, path: tuple[str, ...], *what: Any, static: bool = False) -> None:
        self._stream.log(list(path), *what, static=static, strict=True)


def layout(rig: CameraRig) -> rrb.Blueprint:
    """Return the viewer's layout: 3D view, cameras, curves, status."""
    begin, now = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    so_far = rrb.VisibleTimeRanges(timeline=TIME, start=begin, end=now)
    pieces: Any = {f"world/trajectory/{kind}": so_far for kind in KINDS}
    space = rrb.Spatial3DView(origin="world", name="arena", overrides=pieces)
    paths = [rr.new_entity_path(list(_image_path(camera)[:-1])) for camera in rig]
    views = [rrb.Spatial2DView(origin=path, name=name) for path, name in zip(paths, rig.names, strict=True)]
    curves = [
        rrb.TimeSeriesView(origin=path, name=name)
        for path, name in (("confidence", "confidence"), ("std_mm", "std [mm]"), ("std_deg", "std [°]"))
    ]
    health = [
        rrb.TimeSeriesView(origin=rr.new_entity_path(["health", key]), name=f"{key} [{quantity.unit}]")
        for key, quantity in {**QUANTITIES, "table": HEIGHT}.items()
    ]
    status = rrb.TextLogView(origin="status", name="status")
    left = rrb.Vertical(space, rrb.Horizontal(*views), row_shares=[2, 1])
    tabs = rrb.Tabs(rrb.Vertical(*curves, name="poses"), rrb.Vertical(*health, name="rig"))
    both = rrb.Horizontal(left, rrb.Vertical(tabs, status, row_shares=[4, 1]), column_shares=[2, 1])
    return rrb.Blueprint(both, rrb.TimePanel(timeline=TIME), collapse_panels=True)


def _scalar(value: float) -> Any:
    return rr.Scalars([value]) if np.isfinite(value) else None


def _image_path(camera: Camera) -> tuple[str, ...]:
    return ("world", "cameras", camera.name, "image")


def _pinhole(camera: Camera) -> tuple[Any, Any]:
    """Return a camera's pose and lens, with x to the right, y down and z forward as in OpenCV."""
    pose = camera.world_from_camera
    place = rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3])
    matrix = camera.matrix.copy()
    matrix[:2, 2] += 0.5  # in Rerun, whole numbers are the corners of pixels
    lens = rr.Pinhole(
        image_from_camera=matrix,
        resolution=[camera.width, camera.height],
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=0.12,  # in the 3D view [m]
    )
    return place, lens


def _mesh(model: CuboidModel) -> Any:
    triangles = 4 * np.arange(6)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    colors = DISPLAY_COLORS_BGR[model.face_labels][:, ::-1]
    return rr.Mesh3D(
        vertex_positions=cuboid.corners(model.size)[cuboid.FACE_CORNERS.ravel()],
        triangle_indices=triangles.reshape(-1, 3),
        vertex_normals=np.repeat(cuboid.FACE_NORMALS, 4, axis=0),
        vertex_colors=np.repeat(colors, 4, axis=0),
        albedo_factor=(255, 255, 255, 190),  # the ellipsoid inside must show through
    )


def _ellipsoid(pose: PoseEstimate, color: tuple[int, int, int]) -> Any:
    variances, axes = np.linalg.eigh(pose.covariance[:3, :3])
    axes *= np.sign(np.linalg.det(axes))  # a rotation, not a reflection
    return rr.Ellipsoids3D(
        centers=[pose.position],
        half_sizes=[SIGMAS * np.sqrt(np.maximum(variances, 0))],
        quaternions=[_quaternion(so3.quaternion_from_matrix(axes))],
        colors=[color],
        fill_mode="solid",
    )


def _quaternion(xyzw: FloatArray) -> Any:
    return rr.Quaternion(xyzw=xyzw.astype(np.float32))
