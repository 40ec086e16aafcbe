"""The tracker on recorded, hand-labelled images of the real platform."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd

import tracker
from benchmarks.data.disturbances import as_bytes
from benchmarks.data.recorded import SEGMENTED, labelled_images, triplets
from benchmarks.score.errors import apart, placed, projected
from tracker.color_learning.fit import FitOptions, combine, image_histograms
from tracker.color_learning.labelled import LabelledImage, intersection_over_union
from tracker.conventions import FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners

LIGHT_SEED = 11

FOCAL = 295.0
"""Focal length to which misses in pixels are scaled, whatever the size of the recorded images [px]."""

NOISE = 1.5
"""Standard deviation of the noise added to a film's images, about that of their own noise [levels]."""

FILM_FRAMES = 8

Rows = list[dict[str, Any]]


def measure_triplets(real: Path, draws: int) -> dict[str, pd.DataFrame]:
    """Return the rows of the parts `triplets`, each in `draws` random lightings, and `two sizes`."""
    whole_rows: Rows = []
    sizes: Rows = []
    for name, group, detector, labelled in triplets(real):
        about = {"object": name, "group": group}
        images = [image.image for image in labelled]
        whole = detector.detect(images).object_pose
        whole_rows.append(about | _in_light(detector, labelled, whole, draws))
        other, resized = _other_size(detector, images)
        shift, turn = apart(whole, other.detect(resized).object_pose)
        sizes.append(about | {"shift_mm": shift, "turn_deg": turn})
    return {"triplets": pd.DataFrame(whole_rows), "two sizes": pd.DataFrame(sizes)}


def measure_agreement(real: Path, films: int) -> dict[str, pd.DataFrame]:
    """Return the rows of the parts `third camera` and `recorded, one camera`, of `films` films each."""
    third: Rows = []
    single: Rows = []
    for name, group, detector, labelled in triplets(real):
        images = [image.image for image in labelled]
        whole = detector.detect(images).object_pose
        third += [
            {"object": name, "group": f"{row['camera']}{group and f', {group}'}", **row}
            for row in _third_camera(detector, images, whole)
        ]
        if not group:
            single += [{"object": name} | row for row in _one_camera(detector, images, whole, films)]
    return {"third camera": pd.DataFrame(third), "recorded, one camera": pd.DataFrame(single)}


def face_outlines(
    camera: Camera, model: tracker.CuboidModel, pose: tracker.PoseEstimate
) -> dict[int, FloatArray]:
    """Return the projected outline (N, 2) [px] of every face, including hidden ones, by label."""
    points = corners(model.size)
    share = np.linspace(0, 1, 30, endpoint=False)[:, None]
    result = {}
    for face, label in zip(FACE_CORNERS, model.face_labels, strict=True):
        ends = zip(face, np.roll(face, -1), strict=True)
        loop = np.concatenate([points[a] + share * (points[b] - points[a]) for a, b in ends])
        result[int(label)] = camera.project(loop @ pose.rotation.T + pose.position)
    return result


def inside_distances(detector: tracker.ObjectTracker, images: Sequence[LabelledImage]) -> FloatArray:
    """Return, for every labelled pixel, the distance [px] to its face's outline; negative outside it."""
    pose = detector.detect([i.image for i in images]).object_pose
    if pose is None:
        return np.full(1, -np.inf)
    distances = []
    for camera, truth in zip(detector.rig, images, strict=True):
        for label, outline in face_outlines(camera, detector.model, pose).items():
            rows, columns = np.nonzero(truth.labels == label)
            loop = outline.astype(np.float32)
            distances += [
                cv2.pointPolygonTest(loop, (float(u), float(v)), True)
                for u, v in zip(columns, rows, strict=True)
            ]
    return np.array(distances)


def relit(images: Sequence[Image], rng: np.random.Generator) -> list[Image]:
    """Apply random gains of 0.8-1.2 per channel and exposures of 0.6-1.4 to each image."""
    gains = rng.uniform(0.8, 1.2, (len(images), 3)) * rng.uniform(0.6, 1.4, (len(images), 1))
    return [as_bytes(i * g) for i, g in zip(images, gains, strict=True)]


def light_changes(
    detector: tracker.ObjectTracker, images: list[Image], draws: int
) -> Iterator[tuple[float, float, float]]:
    """Yield shift [mm], rotation [°], confidence for each lighting; inf, inf and 0 if nothing is found."""
    reference = detector.detect(images).object_pose
    rng = np.random.default_rng(LIGHT_SEED)
    for _ in range(draws):
        pose = detector.detect(relit(images, rng)).object_pose
        shift, turn = apart(pose, reference)
        yield (np.inf, np.inf, 0.0) if pose is None else (shift, turn, pose.confidence)


def _in_light(
    detector: tracker.ObjectTracker,
    images: Sequence[LabelledImage],
    pose: tracker.PoseEstimate | None,
    draws: int,
) -> dict[str, float]:
    shift, turn, sure = np.array(list(light_changes(detector, [i.image for i in images], draws))).T
    same = (shift < 3) & (turn < 3)
    # Cosine of the angle between the vertical and the nearest axis of the object.
    upright = np.nan if pose is None else min(1.0, np.abs(pose.rotation[2]).max())
    return {
        "inside": 100 * float(np.mean(inside_distances(detector, images) >= 0)),
        "tilt_deg": float(np.degrees(np.arccos(upright))),
        "same": 100 * float(np.mean(same)),
        "light_wrong": 100 * float(np.mean(~same & (sure > 0.5))),
    }


def _third_camera(
    detector: tracker.ObjectTracker, images: Sequence[Image], whole: tracker.PoseEstimate | None
) -> Iterator[dict[str, Any]]:
    """Compare, for each camera, its own pose with the pose from the other two cameras."""
    for camera, two, own in without_each(detector, images):
        shift, turn = apart(two, whole)
        row = {"camera": camera.name, "shift_mm": shift, "turn_deg": turn}
        yield row | third_camera_miss(camera, detector.model, two, own)


def without_each(
    detector: tracker.ObjectTracker, images: Sequence[Image]
) -> Iterator[tuple[Camera, tracker.PoseEstimate | None, tracker.PoseEstimate | None]]:
    """Yield each camera, the pose from the other cameras, and the one from its image alone."""
    for k, camera in enumerate(detector.rig):
        others = detector.detect([None if j == k else image for j, image in enumerate(images)]).object_pose
        own = detector.detect([image if j == k else None for j, image in enumerate(images)]).object_pose
        yield camera, others, own


def third_camera_miss(
    camera: Camera,
    model: tracker.CuboidModel,
    two: tracker.PoseEstimate | None,
    own: tracker.PoseEstimate | None,
) -> dict[str, float]:
    """Return the RMS distance, over the corners, between two poses in a camera's image.

    `px` is scaled to FOCAL, and `miss_mm` is across the line of sight; nan if a pose is missing.
    """
    if two is None or own is None:
        return {"px": np.nan, "miss_mm": np.nan}
    points = corners(model.size)
    ends = [projected(camera, placed(points, pose.position, pose.rotation)) for pose in (two, own)]
    miss = float(np.sqrt(np.mean(((ends[0] - ends[1]) ** 2).sum(axis=1))))
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    distance = float(np.linalg.norm(two.position - camera.position))
    return {"px": miss * FOCAL / focal, "miss_mm": 1e3 * miss * distance / focal}


def _one_camera(
    detector: tracker.ObjectTracker,
    images: Sequence[Image],
    whole: tracker.PoseEstimate | None,
    films: int,
) -> Iterator[dict[str, Any]]:
    """Yield answers of `detect` and `update` to one camera's films: its image in random light and noise."""
    follower = tracker.ObjectTracker(detector.model, detector.rig)
    rng = np.random.default_rng(LIGHT_SEED)
    for k in range(len(images)):
        for film in range(films):
            (lit,) = relit([images[k]], rng) if film else [images[k]]
            follower.reset()
            for frame in range(FILM_FRAMES):
                noise = NOISE * rng.standard_normal(lit.shape, np.float32)
                given = [as_bytes(lit + noise) if j == k else None for j in range(len(images))]
                followed = follower.update(given, frame / 10.0).filtered_object_pose
                answers: dict[str, tracker.PoseEstimate | None] = {"update": followed}
                if frame == 0:
                    answers["detect"] = detector.detect(given).object_pose
                for by, pose in answers.items():
                    shift, turn = apart(pose, whole)
                    sure = np.nan if pose is None else float(pose.confidence)
                    about = {"group": by, "camera": k, "film": film, "found": pose is not None}
                    yield about | {"confidence": sure, "mm": shift, "deg": turn}


def _other_size(
    detector: tracker.ObjectTracker, images: Sequence[Image]
) -> tuple[tracker.ObjectTracker, list[Image]]:
    """Return tracker and images of the same triplet at half the size if it is large, else at double size."""
    height = detector.rig[0].height
    size = height // 2 if height > 400 else 2 * height
    method = cv2.INTER_AREA if size < height else cv2.INTER_CUBIC
    resized = [
        np.asarray(cv2.resize(image, (size, size), interpolation=method), np.uint8) for image in images
    ]
    return tracker.ObjectTracker(detector.model, detector.rig.resized(size, size)), resized


def measure_segmentation(real: Path) -> pd.DataFrame:
    """Return the intersection over union with the hand-made masks, a row for each object.

    `iou` (mean) and `worst_iou` are for the shipped table; `known_iou` is for a table fitted without the
    image, over the colours that another image of the object shows.
    """
    options = FitOptions()
    images = {name: labelled_images(real, name) for name in SEGMENTED}
    histograms, drawn_as_others = (
        {name: [image_histograms(i, how) for i in images[name]] for name in SEGMENTED}
        for how in (options, options.for_others())
    )
    rows = []
    for name in SEGMENTED:
        others = [h for other in SEGMENTED if other != name for h in drawn_as_others[other]]
        shipped: list[float] = []
        known: list[float] = []
        for k, image in enumerate(images[name]):
            found = tracker.segment(image.image, tracker.load_colors(name))
            shipped += intersection_over_union(found, image.labels).values()
            rest = histograms[name][:k] + histograms[name][k + 1 :]
            found = tracker.segment(image.image, combine(rest, others, options))
            scores = intersection_over_union(found, image.labels)
            known += [value for label, value in scores.items() if any(label in h for h in rest)]
        row = {"object": name, "group": "", "iou": float(np.mean(shipped)), "worst_iou": min(shipped)}
        rows.append(row | {"known_iou": float(np.mean(known)) if known else np.nan})
    return pd.DataFrame(rows)
