"""Scenes that the platform's own simulation package renders."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

import tracker
from benchmarks.cache import CACHE
from benchmarks.package import VERSION, interpreter, run
from benchmarks.scenes import SEED, Scene
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners, visible_faces
from tracker.objects.model import CuboidModel

SCRIPT = Path(__file__).with_name("package_script.py")
KINDS = {"cube_v2": "cube", "cuboid_2x2x8_v2": "cuboid"}

ROWS_TOO_HIGH = 1.0
"""Rows of its own grid by which the package's camera draws everything too high [px]."""


def package_rig(python: Path, scale: int) -> CameraRig:
    """The package's cameras, without distortion and drawing as high as they do at this scale.

    Raises:
        PackageError: the package fails.
    """
    printed = run([str(python), "-c", "import trifinger_simulation as t; print(t.get_data_dir())"])
    folder = Path(printed.strip().splitlines()[-1]) / "camera_params"
    rig = CameraRig.load(folder, pattern="camera*_cropped_and_downsampled.yml")
    return dataclasses.replace(rig, cameras=tuple(_as_drawn(camera, scale) for camera in rig))


def _as_drawn(camera: Camera, scale: int) -> Camera:
    matrix = camera.matrix.copy()
    matrix[1, 2] -= ROWS_TOO_HIGH / scale
    # Nothing of these cameras is uncertain, whatever the files say of the real ones.
    return dataclasses.replace(camera, matrix=matrix, distortion=np.zeros(5), camera_from_world_std=None)


class PackageStore:
    """The package's scenes of one object, rendered on the first use and then kept.

    Args:
        object_name: name of the object.
        scale: points along each axis of a pixel: 1 as the package draws, 4 for smooth edges.
        count: number of scenes.
        folder: where they are kept.

    Raises:
        PackageError: the package cannot be had, or fails.
    """

    def __init__(self, object_name: str, scale: int, count: int, folder: Path = CACHE) -> None:
        self._model = tracker.load_object(object_name)
        self._python = interpreter(folder)
        self.rig = package_rig(self._python, scale)
        script = hashlib.sha256(SCRIPT.read_bytes()).hexdigest()[:12]
        self._file = folder / f"package-{object_name}-{scale}-{SEED}-{count}-{VERSION}-{script}.npz"
        if not self._file.is_file():
            self._render(KINDS[object_name], count, scale)

    def _render(self, kind: str, count: int, scale: int) -> None:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=self._file.parent) as temporary:
            made = Path(temporary) / "scenes.npz"
            run([str(self._python), str(SCRIPT), kind, str(count), str(SEED), str(scale), str(made)])
            os.replace(made, self._file)

    def scenes(self, indices: Sequence[int]) -> Iterator[Scene]:
        """The scenes of these numbers, in this order."""
        with np.load(self._file) as data:
            images, masks = data["images"], data["masks"]
            positions, rotations = data["position"], data["rotation"]
        for k in indices:
            faces = [face_map(camera, self._model, positions[k], rotations[k]) for camera in self.rig]
            labels = tuple(np.where(mask, face, 0) for mask, face in zip(masks[k], faces, strict=True))
            share = [np.count_nonzero(label) for label in labels] / np.maximum(
                1, [np.count_nonzero(face) for face in faces]
            )
            yield Scene(int(k), tuple(images[k]), labels, share, positions[k], rotations[k])


def face_map(camera: Camera, model: CuboidModel, position: Array, rotation: FloatArray) -> Image:
    """(H, W) uint8 labels of the faces that a camera without distortion sees of the object alone."""
    points = corners(model.size) @ rotation.T + position
    turn, shift = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
    pixels, _ = cv2.projectPoints(points, cv2.Rodrigues(turn)[0], shift, camera.matrix, camera.distortion)
    result = np.zeros((camera.height, camera.width), np.uint8)
    centres = np.stack(np.meshgrid(np.arange(camera.width), np.arange(camera.height)), axis=-1)
    seen = visible_faces(model.size, rotation.T @ (camera.position - position))
    for face in np.flatnonzero(seen):
        outline = pixels[FACE_CORNERS[face], 0]
        inside = np.ones(result.shape, bool)
        for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            (dx, dy), offset = end - start, centres - start
            # Seen from outside, corners go counter-clockwise; rows grow downwards.
            inside &= dx * offset[..., 1] <= dy * offset[..., 0]
        result[inside] = model.face_labels[face]
    return result
