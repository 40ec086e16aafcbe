"""Scenes that the platform's own simulation package renders."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import tracker
from benchmarks.data.package.environment import VERSION, interpreter, run
from benchmarks.data.package.lens import bend_map, bent, normalised
from benchmarks.data.scenes import SEED, Scene
from benchmarks.data.store import CACHE
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners, visible_faces
from tracker.objects.model import CuboidModel

SCRIPT = Path(__file__).with_name("script.py")
KINDS = {"cube_v2": "cube", "cuboid_2x2x8_v2": "cuboid"}

ROWS_TOO_HIGH = 1.0
"""Rows of its own grid by which the package's camera draws everything too high [px]."""


LENS_MARGIN = 27
"""By which pictures that the lens is to bend are wider on each side: the package's own padding [px]."""


@dataclass(frozen=True)
class Drawing:
    """How the package's pictures are drawn, and what the tracker is told of its cameras."""

    scale: int = 1
    """Points along each axis of a pixel: 1 as the package draws, 4 for smooth edges."""
    lens: bool = False
    """Whether the cameras' distortion bends the finished picture, and the deviations that the files state
    are kept; the package itself bends by whole pixels. Else there is neither."""

    @property
    def margin(self) -> int:
        """By which pictures are wider on each side than the camera's own [px]."""
        return LENS_MARGIN if self.lens else 0


def package_rig(python: Path, drawing: Drawing) -> CameraRig:
    """The package's cameras as they draw.

    Raises:
        PackageError: the package fails.
    """
    printed = run([str(python), "-c", "import trifinger_simulation as t; print(t.get_data_dir())"])
    folder = Path(printed.strip().splitlines()[-1]) / "camera_params"
    rig = CameraRig.load(folder, pattern="camera*_cropped_and_downsampled.yml")
    return dataclasses.replace(rig, cameras=tuple(as_drawn(camera, drawing) for camera in rig))


def as_drawn(camera: Camera, drawing: Drawing) -> Camera:
    """The camera of a file, looking as high as the package draws it."""
    matrix = camera.matrix.copy()
    matrix[1, 2] -= ROWS_TOO_HIGH / drawing.scale
    if drawing.lens:
        # Nothing of these cameras is uncertain, but a user of the package has these files.
        return dataclasses.replace(camera, matrix=matrix)
    # Nothing of these cameras is uncertain, whatever the files say of the real ones.
    return dataclasses.replace(camera, matrix=matrix, distortion=np.zeros(5), camera_from_world_std=None)


class PackageStore:
    """The package's scenes of one object, rendered on the first use and then kept.

    Args:
        object_name: name of the object.
        drawing: how they are drawn.
        count: number of scenes.
        folder: where they are kept.
        seed: another one than SEED for all but judging.

    Raises:
        PackageError: the package cannot be had, or fails.
    """

    def __init__(
        self, object_name: str, drawing: Drawing, count: int, folder: Path = CACHE, seed: int = SEED
    ) -> None:
        self._model, self._drawing = tracker.load_object(object_name), drawing
        self._python = interpreter(folder)
        self.rig = package_rig(self._python, drawing)
        script = hashlib.sha256(SCRIPT.read_bytes()).hexdigest()[:12]
        drawn = f"{drawing.scale}-{drawing.margin}"
        self._file = folder / f"package-{object_name}-{drawn}-{seed}-{count}-{VERSION}-{script}.npz"
        if not self._file.is_file():
            self._render(KINDS[object_name], count, seed)

    def _render(self, kind: str, count: int, seed: int) -> None:
        self._file.parent.mkdir(parents=True, exist_ok=True)
        numbers = (count, seed, self._drawing.scale, self._drawing.margin)
        with tempfile.TemporaryDirectory(dir=self._file.parent) as temporary:
            made = Path(temporary) / "scenes.npz"
            run([str(self._python), str(SCRIPT), kind, *(str(number) for number in numbers), str(made)])
            os.replace(made, self._file)

    def scenes(self, indices: Sequence[int]) -> Iterator[Scene]:
        """The scenes of these numbers, in this order."""
        with np.load(self._file) as data:
            images, masks = data["images"], data["masks"]
            positions, rotations = data["position"], data["rotation"]
        lenses = [bend_map(camera, LENS_MARGIN) for camera in self.rig] if self._drawing.lens else []
        for k in indices:
            own, shown = list(images[k]), list(masks[k])
            if lenses:
                own = [bent(image, lens) for image, lens in zip(own, lenses, strict=True)]
                shown = [
                    bent(mask.astype(np.float32), lens) > 0.5
                    for mask, lens in zip(shown, lenses, strict=True)
                ]
            faces = [face_map(camera, self._model, positions[k], rotations[k]) for camera in self.rig]
            labels = tuple(np.where(mask, face, 0) for mask, face in zip(shown, faces, strict=True))
            share = [np.count_nonzero(label) for label in labels] / np.maximum(
                1, [np.count_nonzero(face) for face in faces]
            )
            yield Scene(int(k), tuple(own), labels, share, positions[k], rotations[k])


def face_map(camera: Camera, model: CuboidModel, position: Array, rotation: FloatArray) -> Image:
    """(H, W) uint8 labels of the faces that a camera sees of the object alone, at the pixels' centres."""
    points = corners(model.size) @ rotation.T + position
    in_camera = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    # Where edges are straight: before the lens.
    pixels = in_camera[:, :2] / in_camera[:, 2:]
    result = np.zeros((camera.height, camera.width), np.uint8)
    centres = normalised(camera)
    seen = visible_faces(model.size, rotation.T @ (camera.position - position))
    for face in np.flatnonzero(seen):
        outline = pixels[FACE_CORNERS[face]]
        inside = np.ones(result.shape, bool)
        for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            (dx, dy), offset = end - start, centres - start
            # Seen from outside, corners go counter-clockwise; rows grow downwards.
            inside &= dx * offset[..., 1] <= dy * offset[..., 0]
        result[inside] = model.face_labels[face]
    return result
