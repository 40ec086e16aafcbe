"""Scenes rendered by the platform's own simulation package."""

import dataclasses
import functools
import tempfile
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.data.package.environment import run
from benchmarks.data.plan import Plan, stream
from benchmarks.data.scenes import Scene
from benchmarks.data.store import Maker, Store
from synthetic.camera.lens import rays_of
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import CalibrationError
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import FACE_CORNERS, corners, visible_faces
from tracker.objects.model import CuboidModel, load_object

SCRIPT = Path(__file__).with_name("script.py")
CHUNK = 20
"""Number of scenes rendered by one process."""

KINDS = {"cube_v2": "cube", "cuboid_2x2x8_v2": "cuboid"}

ROWS_TOO_HIGH = 1.0
"""Number of rows of its own grid by which the package's camera renders everything too high [px]."""

LENS_MARGIN = 27
"""Margin on each side of images that will be distorted: the package's own padding [px]."""


@dataclass(frozen=True)
class Drawing:
    """How the package's images are rendered, and which cameras the tracker is given."""

    scale: int = 1
    """Samples per pixel along each axis: 1 as in the package, 4 for smooth edges."""
    lens: bool = False
    """Whether to distort the finished image by the cameras' lenses and to keep the deviations stated in the
    files, unlike the package, which distorts by whole pixels. If False, there is neither."""

    @property
    def margin(self) -> int:
        """Margin on each side of rendered images [px]."""
        return LENS_MARGIN if self.lens else 0


def package_rig(python: Path, drawing: Drawing) -> CameraRig:
    """Return the package's cameras as they actually render.

    Raises:
        PackageError: the package fails.
    """
    printed = run([str(python), "-c", "import trifinger_simulation as t; print(t.get_data_dir())"])
    folder = Path(printed.strip().splitlines()[-1]) / "camera_params"
    rig = CameraRig.load(folder, pattern="camera*_cropped_and_downsampled.yml")
    return dataclasses.replace(rig, cameras=tuple(as_drawn(camera, drawing) for camera in rig))


def as_drawn(camera: Camera, drawing: Drawing) -> Camera:
    """Return a file's camera with the vertical offset of the package's rendering."""
    matrix = camera.matrix.copy()
    matrix[1, 2] -= ROWS_TOO_HIGH / drawing.scale
    if drawing.lens:
        # These cameras are exact, but a user of the package has files that state deviations.
        return dataclasses.replace(camera, matrix=matrix)
    # These cameras are exact, whatever the files state about the real ones.
    return dataclasses.replace(camera, matrix=matrix, distortion=np.zeros(5), camera_from_world_std=None)


def package_store(object_name: str, drawing: Drawing, python: Path, plan: Plan) -> Store[Scene]:
    """Return the package's scenes of one object, by number; `python` can import the package."""
    own = stream(plan.seed, "package", object_name)
    make = functools.partial(_maker, object_name, drawing, python, own)
    name = f"{object_name}, package, {drawing.scale}, {drawing.margin}"
    modules = (__name__, "benchmarks.data.package.script")
    return Store(name, Scene, make, modules, own, plan, CHUNK)


def _maker(object_name: str, drawing: Drawing, python: Path, seed: int) -> Maker[Scene]:
    model, rig = load_object(object_name), package_rig(python, drawing)
    lenses = [bend_map(camera, LENS_MARGIN) for camera in rig] if drawing.lens else []

    def make(chunk: int, numbers: Collection[int]) -> Iterator[tuple[int, Scene]]:
        with tempfile.TemporaryDirectory() as folder:
            made = Path(folder) / "scenes.npz"
            arguments = [KINDS[object_name], seed, drawing.scale, drawing.margin, made, *numbers]
            run([str(python), str(SCRIPT), *map(str, arguments)])
            with np.load(made) as data:
                arrays = [data[key] for key in ("images", "masks", "position", "rotation")]
        for number, images, masks, position, rotation in zip(numbers, *arrays, strict=True):
            own, shown = list(images), list(masks)
            if lenses:
                own = [bent(image, lens) for image, lens in zip(own, lenses, strict=True)]
                masks = [mask.astype(np.float32) for mask in masks]
                shown = [bent(mask, lens) > 0.5 for mask, lens in zip(masks, lenses, strict=True)]
            faces = [face_map(camera, model, position, rotation) for camera in rig]
            labels = tuple(np.where(mask, face, 0) for mask, face in zip(shown, faces, strict=True))
            share = [np.count_nonzero(label) for label in labels] / np.maximum(
                1, [np.count_nonzero(face) for face in faces]
            )
            yield number, Scene(tuple(own), share, position, rotation, index=number, labels=labels)

    return make


def face_map(camera: Camera, model: CuboidModel, position: Array, rotation: FloatArray) -> Image:
    """Return (H, W) uint8 labels of the object's faces, unoccluded, at the centres of a camera's pixels."""
    points = corners(model.size) @ rotation.T + position
    in_camera = points @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    # In undistorted coordinates, where edges are straight.
    pixels = in_camera[:, :2] / in_camera[:, 2:]
    result = np.zeros((camera.height, camera.width), np.uint8)
    centres = normalised(camera)
    seen = visible_faces(model.size, rotation.T @ (camera.position - position))
    for face in np.flatnonzero(seen):
        outline = pixels[FACE_CORNERS[face]]
        inside = np.ones(result.shape, bool)
        for start, end in zip(outline, np.roll(outline, -1, axis=0), strict=True):
            (dx, dy), offset = end - start, centres - start
            # Corners run counter-clockwise seen from outside, and rows grow downwards.
            inside &= dx * offset[..., 1] <= dy * offset[..., 0]
        result[inside] = model.face_labels[face]
    return result


@functools.lru_cache(maxsize=8)
def normalised(camera: Camera) -> FloatArray:
    """Return normalised coordinates X/Z, Y/Z (H, W, 2) of the rays through a camera's pixel centres.

    Uses OpenCV's inverse of the lens model, iterated to convergence, not the tracker's own projection.

    Raises:
        CalibrationError: the lens model cannot be inverted everywhere in the image.
    """
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack([columns, rows], axis=-1).reshape(-1, 2).astype(np.float64)
    points = rays_of(camera.name, pixels, camera.matrix, camera.distortion)
    points.flags.writeable = False
    return points.reshape(camera.height, camera.width, 2)


def bend_map(camera: Camera, margin: int) -> Array:
    """Return (H, W, 2) float32: where the rays of a camera's pixels meet an undistorted image [px].

    That image extends beyond the camera's own by `margin` [px] on each side.

    Raises:
        CalibrationError: the lens model cannot be inverted everywhere, or the margin is too small.
    """
    places = normalised(camera) * camera.matrix[(0, 1), (0, 1)] + camera.matrix[:2, 2] + margin
    last = np.array([camera.width, camera.height]) + 2 * margin - 1
    beyond = float(max(-places.min(), (places - last).max()))
    if beyond > 0:
        raise CalibrationError(
            f"{camera.name}: its lens shows {margin + beyond:.1f} px more than the image, expected at most "
            f"the margin of {margin} px"
        )
    return places.astype(np.float32)


def bent(picture: Array, places: Array) -> Array:
    """Sample an undistorted image (H', W', ...) bilinearly at `places` (H, W, 2) [px]; keeps its type."""
    return np.asarray(cv2.remap(picture, places[..., 0], places[..., 1], cv2.INTER_LINEAR))
