"""What the tracker does on recorded, hand-labelled images of the real platform."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tracker
from benchmarks.data.recorded import SEGMENTED, labelled_images, triplets
from tracker.conventions import FloatArray, Image
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners
from tracker.segmentation.fit import FitOptions, combine, image_histograms, intersection_over_union
from tracker.segmentation.labelled import LabelledImage

LIGHT_SEED = 11


def face_outlines(
    camera: Camera, model: tracker.CuboidModel, pose: tracker.PoseEstimate
) -> dict[int, FloatArray]:
    """Projected outline (N, 2) [px] of every face, by label; hidden faces as well."""
    points = corners(model.size)
    share = np.linspace(0, 1, 30, endpoint=False)[:, None]
    result = {}
    for face, label in zip(FACE_CORNERS, model.face_labels, strict=True):
        ends = zip(face, np.roll(face, -1), strict=True)
        loop = np.concatenate([points[a] + share * (points[b] - points[a]) for a, b in ends])
        result[int(label)] = camera.project(loop @ pose.rotation.T + pose.position)
    return result


def inside_distances(detector: tracker.ObjectTracker, images: list[LabelledImage]) -> FloatArray:
    """Of every labelled pixel the distance [px] to the outline of its face; negative is outside."""
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


def relit(images: list[Image], rng: np.random.Generator) -> list[Image]:
    """Gains of 0.8-1.2 on each channel and exposures of 0.6-1.4, each image by itself."""
    gains = rng.uniform(0.8, 1.2, (len(images), 3)) * rng.uniform(0.6, 1.4, (len(images), 1))
    return [np.clip(np.rint(i * g), 0, 255).astype(np.uint8) for i, g in zip(images, gains, strict=True)]


def light_changes(
    detector: tracker.ObjectTracker, images: list[Image], draws: int
) -> Iterator[tuple[float, float, float]]:
    """Shift [m], turn [rad], confidence under each draw of light; infinite and 0 where nothing is found."""
    reference = detector.detect(images).object_pose
    rng = np.random.default_rng(LIGHT_SEED)
    for _ in range(draws):
        pose = detector.detect(relit(images, rng)).object_pose
        if pose is None or reference is None:
            yield np.inf, np.inf, 0.0
        else:
            turn = so3.angle_between(pose.rotation, reference.rotation)
            yield float(np.linalg.norm(pose.position - reference.position)), float(turn), pose.confidence


def pose_rows(real: Path, draws: int) -> list[dict[str, Any]]:
    """Rows of the part `triplets`: labelled pixels inside their faces, level, under changed light.

    A row has `inside` [%], `farthest_px` outside, `beyond_1_px` (count), `tilt_deg` of the face on the table,
    and of `n` draws of light `same` [%] within 3 mm and 3° of the undisturbed pose, `wrong_and_sure` [%],
    `median_shift_mm`, `median_turn_deg`.
    """
    rows = []
    for name, group, detector, images in triplets(real):
        distance = inside_distances(detector, images)
        pixels = [i.image for i in images]
        pose = detector.detect(pixels).object_pose
        shift, turn, sure = np.array(list(light_changes(detector, pixels, draws))).T
        same = (shift < 3e-3) & (turn < np.radians(3))
        rows.append(
            {
                "part": "triplets",
                "object": name,
                "group": group,
                "inside": 100 * float(np.mean(distance >= 0)),
                "farthest_px": max(0.0, -float(distance.min())),
                "beyond_1_px": int(np.sum(distance < -1)),
                "tilt_deg": np.nan if pose is None else _tilt(pose.rotation),
                "n": draws,
                "same": 100 * float(np.mean(same)),
                "wrong_and_sure": 100 * float(np.mean(~same & (sure > 0.5))),
                "median_shift_mm": 1e3 * float(np.median(shift)),
                "median_turn_deg": float(np.degrees(np.median(turn))),
            }
        )
    return rows


def _tilt(rotation: FloatArray) -> float:
    """Angle [°] between the vertical and the object's axis nearest to it."""
    return float(np.degrees(np.arccos(min(1.0, np.abs(rotation[2]).max()))))


def segmentation_rows(real: Path) -> list[dict[str, Any]]:
    """Rows of the part `segmentation`: intersection over union with the hand-made masks.

    By the shipped table, and leaving one image out. A row has `n` (faces), `mean` and `worst` of the shipped
    table, and with the image left out `known` (mean over colours that another image of the object shows) and
    `unknown`, with their counts.
    """
    options = FitOptions()
    images = {name: labelled_images(real, name) for name in SEGMENTED}
    histograms = {name: [image_histograms(i, options) for i in images[name]] for name in SEGMENTED}
    rows = []
    for name in SEGMENTED:
        others = [h for other in SEGMENTED if other != name for h in histograms[other]]
        shipped: list[float] = []
        known: list[float] = []
        unknown: list[float] = []
        for k, image in enumerate(images[name]):
            shipped += intersection_over_union(
                tracker.segment(image.image, tracker.load_colors(name)), image.labels
            ).values()
            rest = histograms[name][:k] + histograms[name][k + 1 :]
            found = tracker.segment(image.image, combine(rest, others, options))
            for label, value in intersection_over_union(found, image.labels).items():
                (known if any(label in h for h in rest) else unknown).append(value)
        rows.append(
            {
                "part": "segmentation",
                "object": name,
                "group": "",
                "n": len(shipped),
                "mean": float(np.mean(shipped)),
                "worst": float(min(shipped)),
                "known": float(np.mean(known)) if known else np.nan,
                "known_faces": len(known),
                "unknown": float(np.mean(unknown)) if unknown else np.nan,
                "unknown_faces": len(unknown),
            }
        )
    return rows
