"""Training pixels from frames of recordings: those of each face, and of everything else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from tracker.calibration.rig import CameraRig
from tracker.color_learning.hues import hue_of
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners, visible_faces
from tracker.logs.log import Log, evenly, picked
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit
from tracker.pose.judge import confidence
from tracker.segmentation.color_model import CLASSES, NODES, ColorModel, compand
from tracker.segmentation.labels import MIN_AREA, REFERENCE_SIZE, labels_by_color
from tracker.segmentation.light import apply_gains

Images = tuple[Image | None, ...]
"""Image (H, W, 3) BGR of each camera of a rig, None for a missing one."""

FEWEST_FRAMES = 3
"""Smallest number of frames to learn from and judge by."""


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of one recording by its cameras: those to learn from, and those to judge by."""

    rig: CameraRig
    learned: tuple[Images, ...]
    held_out: tuple[Images, ...]


def frames_of(log: Log, rig: CameraRig, count: int, before: int = 0) -> Frames:
    """Take up to `count` evenly spread frames of a recording: alternately to learn from and to judge by.

    before: number of frames already taken from other recordings, with which these alternate.
    """
    frames = [frame.images for frame in picked(log, evenly(range(len(log)), count))]
    frames = [images for images in frames if any(image is not None for image in images)]
    first = before % 2
    return Frames(rig, tuple(frames[first::2]), tuple(frames[1 - first :: 2]))


def shares(lengths: Sequence[int], count: int) -> list[int]:
    """Divide `count` frames among recordings: equal numbers, as far as their lengths allow."""
    result, left = [0] * len(lengths), count
    shortest_first = sorted(range(len(lengths)), key=lengths.__getitem__)
    for place, k in enumerate(shortest_first):
        result[k] = min(lengths[k], max(2, left // (len(lengths) - place)))
        left -= result[k]
    return result


POSED = 0.5
"""Confidence above which a frame counts as posed."""


@dataclass(frozen=True)
class Judgement:
    """Quality of a colour model on held-out frames."""

    explained: float
    """Mean over the frames, from 0 to 1, of confidence times IoU of the face colours found with those that
    the pose predicts; 0 for a frame without a pose."""
    posed: float
    """Share of the frames with a pose of a confidence above POSED."""
    frames: int

    def __str__(self) -> str:
        return f"{100 * self.explained:.1f} % explained, {100 * self.posed:.1f} % posed"


def judge(model: CuboidModel, footage: Sequence[Frames], colors: ColorModel) -> Judgement:
    """Judge a colour model by the held-out frames."""
    explained, posed = [], []
    for one in footage:
        tracker = ObjectTracker(model, one.rig, colors)
        for images in one.held_out:
            fit = tracker.fit(images)
            sure, alike = (confidence(fit), overlap(fit)) if isinstance(fit, Fit) else (0.0, 0.0)
            explained.append(sure * alike)
            posed.append(sure > POSED)
    return Judgement(float(np.mean(explained)), float(np.mean(posed)), len(posed))


def overlap(fit: Fit) -> float:
    """Return the intersection over union of the face colours found with those that a fit predicts."""
    seen = fit.cameras
    union = (seen["predicted"] + seen["extra"] + seen["elsewhere"]).sum()
    return float(seen["agree"].sum() / max(union, 1.0))


RIM = 2.0
"""Width left out along a face's borders, where both sides mix [px at the reference size]."""

AROUND = 6.0
"""Width left out around the object, likewise: reflections on the table and fringes have its colours."""

_SHIFT = 4
"""Fractional bits of OpenCV's polygon corners."""


def outline(
    model: CuboidModel, camera: Camera, rotation: FloatArray, position: FloatArray
) -> tuple[Image, Array] | None:
    """Render an object with rotation (3, 3) and position (3,) [m] for a camera; None if not in view.

    Return (H, W) label of the face at a pixel, 0 elsewhere and near the faces' borders; and (H, W) bool,
    whether a pixel is on the object or near it.
    """
    pixels = camera.project(corners(model.size) @ rotation.T + position)
    shape = camera.height, camera.width
    if not np.isfinite(pixels).all() or np.abs(pixels).max() > 1e4:
        return None
    scale = min(shape) / REFERENCE_SIZE
    sizes = (2 * max(1, round(length * scale)) + 1 for length in (RIM, AROUND))
    rim, reach = (cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)) for size in sizes)
    faces, solid = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
    visible = visible_faces(model.size, rotation.T @ (camera.position - position))
    for face in np.flatnonzero(visible):
        mask = np.zeros(shape, np.uint8)
        corner = np.rint(pixels[FACE_CORNERS[face]] * (1 << _SHIFT)).astype(np.int32)
        cv2.fillConvexPoly(mask, corner, 1, shift=_SHIFT)
        solid |= mask
        inner = cv2.erode(mask, rim, borderValue=0)
        faces[inner > 0] = model.face_labels[face]
    return (faces, cv2.dilate(solid, reach) > 0) if solid.any() else None


CONSISTENT = 4.0
"""Factor by which a colour must be more frequent where the poses put a face than elsewhere: fingers that hide
the face are seen elsewhere, too."""

SMOOTHING = 0.7
"""Standard deviation of the smoothing of the densities to compare [nodes]."""

PALEST, DARK = 1.25, 6.0
"""Smallest ratio of the largest to the smallest channel of a face in neutral light, and what is added to both
first, since dark greys are noisy [levels]."""

LEAST = 20
"""Smallest number of pixels of a face in a frame needed to measure its hue."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """The pixels of one frame in neutral light, with faces according to a pose."""

    levels: Array
    """(N, 3) uint8 BGR of the pixels on faces or away from the object."""
    faces: Array
    """(N,) label of the face that the pose predicts, 0 away from the object."""
    found: Array
    """(N,) label that the colour model gave."""
    stray: Array
    """(N,) bool: away from the object, in a patch that looks like a face."""

    def hues(self) -> dict[int, float]:
        """Return the hue [degrees] of each face, from pixels where pose and colour model agree on it."""
        result = {}
        for label in np.unique(self.faces[self.faces > 0]):
            agree = (self.faces == label) & (self.found == label)
            if np.count_nonzero(agree) >= LEAST:
                result[int(label)] = hue_of(self.levels[agree])
        return result


def lesson(model: CuboidModel, rig: CameraRig, images: Images, fit: Fit, colors: ColorModel) -> Lesson:
    """Return the pixels of a frame with a pose; `colors` is the model with which the pose was found."""
    nothing = np.zeros(0, np.uint8)  # if no camera shows the object
    parts = [(np.zeros((0, 3), np.uint8), nothing, nothing, nothing > 0)]
    for camera, image in zip(rig, images, strict=True):
        if image is None:
            continue
        seen = outline(model, camera, fit.rotation, fit.position)
        if seen is None:
            continue
        covered, around = seen
        even, light, labels = labels_by_color(image, colors)  # without clean-up
        neutral = apply_gains(even, light.gains)
        use = (covered > 0) | ~around
        parts.append((neutral[use], covered[use], labels[use], (_patches(labels) & ~around)[use]))
    return Lesson(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _patches(labels: Image) -> Array:
    """Return (H, W) bool: whether a pixel belongs to a patch of one face colour that is not a speck."""
    least = MIN_AREA * (min(labels.shape) / REFERENCE_SIZE) ** 2
    result = np.zeros(labels.shape, dtype=bool)
    for label in np.unique(labels[labels > 0]):
        mask = cv2.medianBlur((labels == label).astype(np.uint8), 3)
        _, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        large = stats[:, cv2.CC_STAT_AREA] >= least
        large[0] = False
        result |= large[parts]
    return result


def owners(lessons: Sequence[Lesson]) -> Array:
    """Return (32³,): the face on which each colour is CONSISTENT times as frequent as elsewhere; else 0.

    Over all frames, whatever hides a face is also seen elsewhere, and with a few wrong poses on other faces.
    """
    pairs = [(nodes_of(one.levels), one) for one in lessons]
    density = np.stack([_density([n[one.faces == k] for n, one in pairs]) for k in range(CLASSES)])
    best = np.argmax(density[1:], axis=0) + 1
    own = np.take_along_axis(density, best[None], axis=0)[0]
    # Leave out greys: grey objects may hide most of a face in all frames.
    levels = 255.0 * (np.indices((NODES,) * 3).reshape(3, -1) / (NODES - 1)) ** 2
    colored = levels.max(axis=0) + DARK > PALEST * (levels.min(axis=0) + DARK)
    return np.where((own > CONSISTENT * density[0]) & colored, best, 0).astype(np.uint8)


def consistent(lessons: Sequence[Lesson]) -> list[Mapping[int, Array]]:
    """Return each frame's pixels (N, 3) by label: of faces only colours that they own; 0: background."""
    owner = owners(lessons)
    result: list[Mapping[int, Array]] = []
    for one in lessons:
        keep = (one.faces == 0) | (owner[nodes_of(one.levels)] == one.faces)
        shown = np.unique(one.faces[keep])
        result.append({int(label): one.levels[keep & (one.faces == label)] for label in shown})
    return result


def nodes_of(levels: Array) -> Array:
    """Return the index (N,) of the colour model's nearest node, blue slowest, for pixels (N, 3)."""
    cells = np.rint(compand(levels, NODES)).astype(np.int64)
    return np.asarray(np.ravel_multi_index((cells[:, 0], cells[:, 1], cells[:, 2]), (NODES,) * 3))


def _density(nodes: Sequence[Array]) -> FloatArray:
    """Return the smoothed density (32³,) over the nodes; all zeros without pixels."""
    counts = np.bincount(np.concatenate(nodes), minlength=NODES**3).astype(np.float64)
    if not counts.any():
        return counts
    grid = gaussian_filter(counts.reshape((NODES,) * 3), SMOOTHING, mode="nearest")
    return np.asarray(grid.ravel() / counts.sum(), dtype=np.float64)
