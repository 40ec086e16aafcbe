"""Draw camera views side by side, with the estimate's lens-distorted edges, and small tables below."""

import textwrap
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import cv2
import numpy as np

from tracker.calibration.rig import CameraRig
from tracker.checks import of_kind
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import ImageError, TrackerError
from tracker.geometry import cuboid
from tracker.geometry.camera import Camera
from tracker.inputs import check_images
from tracker.objects.labels import DISPLAY_COLORS_BGR
from tracker.objects.model import CuboidModel
from tracker.pose.result import Observation, PoseEstimate, Status
from tracker.viz import paint

MIN_HEIGHT = 400
"""Smallest height of an image [px]; smaller images are enlarged by the smallest sufficient integer factor."""

GAP = 6
"""Width of the space between images [px]."""

_NAME_SIZE = 14.0
_EMPTY = (44, 38, 35)

Draw = Callable[[int, Image, Camera], None]
"""Draws into a camera's panel; takes its index, the panel, and the camera for the scaled image."""


def panels(images: Sequence[Image | None], rig: CameraRig, draw: Draw) -> Image:
    """Return all views in a row, after calling `draw` on each; ImageError if images do not fit the rig."""
    of_kind(rig, CameraRig, "overlay: rig", ImageError, "tracker.CameraRig.load")
    images = check_images(images, rig, least=0)
    height = max(camera.height * -(-MIN_HEIGHT // camera.height) for camera in rig)
    parts: list[Image] = []
    for index, (image, camera) in enumerate(zip(images, rig, strict=True)):
        size = (max(1, round(camera.width * height / camera.height)), height)
        panel = paint.canvas(*size, _EMPTY)
        if image is None:
            paint.put_text(panel, "no image", (size[0] / 2, height / 2), paint.FAINT, size=18, align=0.5)
        else:
            cv2.resize(image, size, panel, interpolation=cv2.INTER_CUBIC)
            draw(index, panel, camera.resized(*size))
        right, bottom = 36 + paint.text_width(camera.name, _NAME_SIZE), 26 + 1.7 * _NAME_SIZE
        corners = np.array([(12, 12), (right, 12), (right, bottom), (12, bottom)])
        paint.fill(panel, corners, paint.BACKGROUND, 0.6)
        at = 24, (12 + bottom + _NAME_SIZE) / 2
        paint.put_text(panel, camera.name, at, paint.BRIGHT, size=_NAME_SIZE)
        parts += [paint.canvas(GAP, height), panel]
    return np.concatenate(parts[1:], axis=1)


GOOD: paint.Color = (120, 200, 110)
DOUBTFUL: paint.Color = (80, 170, 245)
"""Colours of a block's last line, for good and for doubtful results."""

_MARGIN, _LINE, _SPACE, _COLUMN = 24, 28, 50, 17
"""Spacing around the strip, and between lines, blocks, and columns of a block [px]; scaled with the strip."""
_SIZES = (10.0, 12.0, 12.0)  # heights of the digits in a block's lines [px]
_WIDTH, _MOST = 1000, 1.5
"""Width of a strip above which its text is enlarged [px], and the largest factor."""


class Block(NamedTuple):
    """A small table of three lines: headings, values, and notes in a colour."""

    headings: list[str]
    values: list[str]
    notes: list[str]
    color: paint.Color = paint.FAINT


def footer(width: int, blocks: Iterable[Block]) -> Image:
    """Return a strip, `width` [px] wide, of blocks side by side, which wrap if it is narrow.

    The first column of a block is left-aligned, the others are right-aligned.
    """
    scale = float(np.clip(width / _WIDTH, 1.0, _MOST))
    sizes = [size * scale for size in _SIZES]
    margin, line, between = _MARGIN * scale, _LINE * scale, _COLUMN * scale
    left = top = margin
    cells = []
    for *lines, color in blocks:
        columns = zip(*lines, strict=True)
        widths = [max(map(paint.text_width, column, sizes)) for column in columns]
        whole = sum(widths) + between * (len(widths) - 1)
        if left > margin and left + whole > width - margin:
            left, top = margin, top + 3 * line + margin / 2
        ends = [left, *(left + np.cumsum(widths) + between * np.arange(len(widths)))[1:]]
        rows = zip(lines, sizes, (paint.FAINT, paint.BRIGHT, color), strict=True)
        for row, (texts, size, ink) in enumerate(rows):
            for column, text in enumerate(texts):
                at = float(ends[column]), top + row * line + sizes[0]
                cells.append((text, at, ink, size, float(column > 0)))
        left += whole + _SPACE * scale
    picture = paint.canvas(width, round(top + 2 * line + sizes[0] + margin))
    for text, at, ink, size, align in cells:
        paint.put_text(picture, text, at, ink, size=size, align=align)
    return picture


def note_strip(width: int, text: str) -> Image:
    """Return a strip, `width` [px] wide, with a remark in as many lines as it needs."""
    scale = float(np.clip(width / _WIDTH, 1.0, _MOST))
    size, margin, step = _SIZES[1] * scale, _MARGIN * scale, 0.8 * _LINE * scale
    lines = textwrap.wrap(text, int((width - 2 * margin) / paint.text_width("n", size)))
    picture = paint.canvas(width, round(size + (len(lines) - 1) * step + margin))
    for number, line in enumerate(lines):
        paint.put_text(picture, line, (margin, size + number * step), DOUBTFUL, size=size)
    return picture


def caption(name: str, observation: Observation, title: str) -> Iterable[Block]:
    """Yield blocks with the object, the status and the pose in numbers; `title` is above the object."""
    measured, filtered = observation.object_pose, observation.filtered_object_pose
    pose, status = measured or filtered, observation.status
    if measured is None:
        state, color = f"{'no pose' if pose is None else 'predicted'}: {status}", DOUBTFUL
    else:
        state = observation.reason or status  # what makes a pose doubtful is the reason from `detect`
        color = DOUBTFUL if state is Status.INCONSISTENT_VIEWS else GOOD
    yield Block([title or "object"], [name], [state], color)
    if pose is None:
        return
    std = np.sqrt(np.diag(pose.covariance))
    yield Block(
        ["position", "x", "y", "z", ""],
        ["", *_numbers(1e3 * pose.position, 2), "mm"],
        ["std", *_numbers(1e3 * std[:3], 2), "mm"],
    )
    yield Block(
        ["orientation", "x", "y", "z", "w"],
        ["", *_numbers(pose.orientation, 4)],
        ["std", *(f"{value}°" for value in _numbers(np.degrees(std[3:]), 2)), ""],
    )
    note, color = ("hint only", DOUBTFUL) if pose.confidence < HINT else ("within 5 mm, 5°", paint.FAINT)
    yield Block(["confidence"], [f"{pose.confidence:.3f}"], [note], color)


def _numbers(values: Array, digits: int) -> list[str]:
    return [f"{value:.{digits}f}".replace("-", "−") for value in values]


SAMPLES = 17
"""Number of points on an edge that are projected, since the lens bends it."""

HINT = 0.5  # confidence below which a pose is only a hint, drawn in amber

_DASH, _DASH_GAP = 7.0, 6.0
"""Lengths of a hidden edge's dashes and of the gaps between them [px]."""


def overlay(
    images: Sequence[Array | None],
    rig: CameraRig,
    model: CuboidModel,
    observation: Observation,
    *,
    title: str = "",
    note: str = "",
) -> Image:
    """Return the camera views with the estimate's edges drawn in, above a caption with its numbers.

    The measured pose is drawn, or the filtered pose if there is none, in amber if its confidence is below
    0.5. Edges hidden by the object itself are dashed; edges behind a finger are not, since the tracker has
    no model of the fingers.

    Args:
        images: image (H, W, 3) uint8 BGR of each camera of the rig; None: the panel says "no image".
        rig: the cameras.
        model: the object.
        observation: what the tracker found in the images.
        title: a line above the numbers, e.g. the time.
        note: a remark below the numbers, e.g. why there is no pose.

    Raises:
        ImageError: the images do not fit the rig.
    """
    of_kind(model, CuboidModel, "overlay: model", TrackerError, "tracker.load_object")
    of_kind(observation, Observation, "overlay: observation", TrackerError, "ObjectTracker.detect")
    of_kind(title, str, "overlay: title", TrackerError)
    of_kind(note, str, "overlay: note", TrackerError)
    pose = observation.object_pose or observation.filtered_object_pose

    def draw(_: int, panel: Image, view: Camera) -> None:
        if pose is not None:
            _draw_object(panel, view, model, pose)

    row = panels(images, rig, draw)
    strips = [footer(row.shape[1], caption(model.name, observation, title))]
    if note:
        strips.append(note_strip(row.shape[1], note))
    return np.concatenate([row, *strips])


def edges_in_view(
    view: Camera, model: CuboidModel, pose: PoseEstimate
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return distorted lines (N, 2) [px] of the edges that a camera sees, and of those the object hides."""
    seen, corners = _seen(view, model, pose)
    visible, hidden = list[FloatArray](), list[FloatArray]()
    for a, b, f, g in cuboid.EDGES:
        line = _project_line(view, corners[a], corners[b])
        parts = np.split(line, np.flatnonzero(np.diff(np.isnan(line[:, 0]))) + 1)
        own = visible if seen[f] or seen[g] else hidden
        own += [part for part in parts if len(part) > 1 and not np.isnan(part[0, 0])]
    return visible, hidden


def _seen(view: Camera, model: CuboidModel, pose: PoseEstimate) -> tuple[Array, FloatArray]:
    """Return whether a camera sees each face (6,), and the object's corners (8, 3) [m]."""
    seen = cuboid.visible_faces(model.size, pose.rotation.T @ (view.position - pose.position))
    return seen, pose.position + cuboid.corners(model.size) @ pose.rotation.T


def _dashes(line: FloatArray) -> list[FloatArray]:
    """Cut a line (N, 2) [px] into dashes (2, 2) of equal length, with gaps between them."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    starts = np.arange(_DASH_GAP, along[-1] - _DASH, _DASH + _DASH_GAP)
    ends = np.stack([starts, starts + _DASH], axis=1)
    return list(np.stack([np.interp(ends, along, line[:, k]) for k in range(2)], axis=2))


def _draw_object(panel: Image, view: Camera, model: CuboidModel, pose: PoseEstimate) -> None:
    """Tint the faces that the camera sees, and draw all edges, the hidden ones dashed."""
    seen, corners = _seen(view, model, pose)
    for face in np.flatnonzero(seen):
        loop = corners[cuboid.FACE_CORNERS[face]]
        sides = [_project_line(view, *ends) for ends in zip(loop, np.roll(loop, -1, axis=0), strict=True)]
        outline = np.concatenate(sides)
        if np.isfinite(outline).all():
            paint.fill(panel, outline, DISPLAY_COLORS_BGR[model.face_labels[face]].tolist(), opacity=0.15)
    color = DOUBTFUL if pose.confidence < HINT else paint.WHITE
    visible, hidden = edges_in_view(view, model, pose)
    dashes = [dash for line in hidden for dash in _dashes(line)]
    for lines, opacity in ((dashes, 0.75), (visible, 1.0)):
        paint.stroke(panel, lines, paint.BLACK, 3.6, 0.45 * opacity)
        paint.stroke(panel, lines, color, 1.4, opacity)


def _project_line(view: Camera, start: Array, end: Array) -> FloatArray:
    """Return pixels (SAMPLES, 2) of points from `start` to `end` [m]; NaN far outside the field of view."""
    return view.project_in_view(start + np.linspace(0, 1, SAMPLES)[:, None] * (end - start))
