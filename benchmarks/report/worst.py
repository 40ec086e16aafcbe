"""A page of the worst answers, with estimated and true outlines of the object."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

import tracker
from benchmarks.data.plan import Plan
from benchmarks.data.sets import scene_set
from benchmarks.data.workloads import BY_NAME, case
from tracker.conventions import FloatArray, Image
from tracker.files import write_whole
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.viz import paint
from tracker.viz.overlays import edges_in_view

EACH = 5
"""Number of frames shown for each object."""

FILE = "worst.jpg"
"""File name of the page, beside the results."""

CAPTION = 22
"""Height of the line above the panels of an answer [px]."""

PANEL = 300
"""Side of a panel [px]."""

GAP = 6
"""Width between panels [px]."""

MIN_CROP = 90.0
"""Smallest side of the region of an image that a panel shows, for images 270 px high [px]."""

MARGIN = 1.5
"""Side of that region as a multiple of the outlines' extent."""

TRUTH_BGR: paint.Color = (255, 255, 255)
ESTIMATE_BGR: paint.Color = (20, 120, 255)
QUALITY = 88


@dataclass(frozen=True, eq=False)
class Shown:
    """Input, estimate and ground truth of an answer."""

    images: Sequence[Image | None]
    """(H, W, 3) uint8 BGR of each camera of the rig; None: no image."""
    rig: tracker.CameraRig
    """The true cameras, which may differ from the tracker's calibration."""
    model: tracker.CuboidModel
    estimate: tracker.PoseEstimate | None
    truth: tracker.PoseEstimate | None
    """The true pose; None: no object."""


def again(plan: Plan, row: pd.Series) -> Shown:
    """Repeat an answer of `benchmarks.measure.accuracy`."""
    workload = BY_NAME[row.group]
    scenes = scene_set(row.object, workload.base, plan)
    (scene,) = scenes.store.scenes([int(row["index"])])
    given = case(workload, row.object, scene, scenes.rig, plan.seed, scenes.another(scene))
    answer = tracker.ObjectTracker(scenes.model, given.rig, scenes.colors).detect(given.images)
    truth = None
    if scene.position is not None and scene.rotation is not None:
        turn = so3.quaternion_from_matrix(scene.rotation)
        truth = tracker.PoseEstimate(scene.position, turn, np.eye(6), 1.0)
    return Shown(given.images, given.true_rig, scenes.model, answer.object_pose, truth)


def badness(record: pd.Series) -> tuple[int, float]:
    """Return a sort key for frames, from harmless to worst: right, not found, wrong, found without an object.

    Within each rank, frames are sorted by error relative to 5 mm and 5°; missed ones by visible fraction;
    poses without an object by confidence.
    """
    if not record.present:
        return (3, record.confidence) if record.found else (0, 0.0)
    if not record.found:
        return 1, record.visible
    error = max(record.mm, record.deg) / 5.0
    return (2, error) if error > 1.0 else (0, error)


def worst_records(frames: pd.DataFrame, each: int = EACH) -> pd.DataFrame:
    """Return the `each` worst frames of every object, worst first."""
    ranked = frames.assign(badness=frames.apply(badness, axis=1))
    ranked = ranked.sort_values("badness", ascending=False, kind="stable")
    return ranked.groupby("object", sort=False).head(each).drop(columns="badness")


def write_worst(frames: pd.DataFrame, shown_of: Callable[[pd.Series], Shown], folder: Path) -> Path:
    """Write the page of the worst answers of each object into the folder of the results; return the file."""
    rows = [_captioned(record, shown_of(record)) for _, record in worst_records(frames).iterrows()]
    width = max(row.shape[1] for row in rows)
    page = np.concatenate([np.pad(row, ((0, GAP), (0, width - row.shape[1]), (0, 0))) for row in rows])
    _, data = cv2.imencode(".jpg", page, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    write_whole(folder / FILE, data.tobytes())
    return folder / FILE


def _captioned(record: pd.Series, view: Shown) -> Image:
    picture = worst_picture(view)
    line = paint.canvas(picture.shape[1], CAPTION)
    paint.put_text(line, caption(record), (4, 16), paint.BRIGHT, size=12)
    return np.concatenate([line, picture])


def caption(record: pd.Series) -> str:
    """Return a description of the answer in one line."""
    place = f"{record.object}, {record.group}, scene {record['index']}"
    seen = f"visible {record.visible:.2f}" if record.present else "no object"
    if not record.found:
        return f"{place}: no pose, {record.status}; {seen}"
    stated = f"confidence {record.confidence:.3f}; {seen}"
    if not record.present:
        return f"{place}: found; {stated}"
    return f"{place}: {record.mm:.2f} mm, {record.deg:.2f}°, NEES {record.nees:.3g}; {stated}"


def worst_picture(view: Shown) -> Image:
    """Return the object's surroundings in each camera side by side, magnified: (PANEL, W, 3) uint8 BGR.

    The true outline is white, the estimated one dashed orange; edges that the object itself hides are left
    out. Without any outline the whole image is shown.
    """
    parts: list[Image] = []
    for image, camera in zip(view.images, view.rig, strict=True):
        if parts:
            parts.append(paint.canvas(GAP, PANEL))
        parts.append(_panel(image, camera, view))
    return np.concatenate(parts, axis=1)


def _panel(image: Image | None, camera: Camera, view: Shown) -> Image:
    if image is None:
        panel = paint.canvas(PANEL, PANEL)
        paint.put_text(panel, "no image", (PANEL / 2, PANEL / 2), paint.FAINT, size=14, align=0.5)
        return panel
    true, found = (
        edges_in_view(camera, view.model, pose)[0] if pose else [] for pose in (view.truth, view.estimate)
    )
    # Centre on the true outline if there is one, so that an estimate that is far off leaves the panel.
    center, side = _region(true or found, camera)
    scale = PANEL / side
    # (x, y) of the panel = scale · (column, row) + offset, with pixel centres at integers.
    offset = PANEL / 2 - 0.5 - scale * center
    transform = np.array([[scale, 0, offset[0]], [0, scale, offset[1]]])
    panel = np.asarray(
        cv2.warpAffine(image, transform, (PANEL, PANEL), flags=cv2.INTER_CUBIC, borderValue=paint.BACKGROUND),
        dtype=np.uint8,
    )
    true, found = ([scale * line + offset for line in lines] for lines in (true, found))
    paint.stroke(panel, true, paint.BLACK, 3.4, 0.4)
    paint.stroke(panel, true, TRUTH_BGR, 1.5)
    paint.stroke(panel, [dash for line in found for dash in _dashes(line)], ESTIMATE_BGR, 1.7)
    paint.put_text(panel, camera.name, (11, 21), paint.BLACK, size=10)
    paint.put_text(panel, camera.name, (10, 20), paint.BRIGHT, size=10)
    return panel


def _region(lines: list[FloatArray], camera: Camera) -> tuple[FloatArray, float]:
    """Return the centre (2,) and side [px] of the square that a panel shows."""
    if not lines:
        return np.array([camera.width - 1, camera.height - 1]) / 2, float(max(camera.width, camera.height))
    points = np.concatenate(lines)
    low, high = points.min(axis=0), points.max(axis=0)
    least = MIN_CROP * camera.height / 270
    return (low + high) / 2, float(max(least, MARGIN * (high - low).max()))


def _dashes(line: FloatArray) -> list[FloatArray]:
    """Return every other stretch between samples of a line (N, 2) [px]."""
    return [line[start : start + 2] for start in range(0, len(line) - 1, 2)]
