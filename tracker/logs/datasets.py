"""Image data sets of trifinger_rl_datasets, `NAME.zarr/data.mdb`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tracker.checks import naming
from tracker.conventions import FloatArray, Image
from tracker.errors import LogError
from tracker.files.stores import StoredArray, open_store
from tracker.logs.frame import LogFrame
from tracker.logs.log import MAX_SIDE, MIN_SIDE, Source, default_names
from tracker.logs.pictures import decode, from_bayer, from_quadrants

CAMERA_RATE = 10.0
"""Of the cameras [Hz]."""

CONTROL_RATE = 50.0
"""Of the steps of a policy [Hz], which `obs_to_image_index` counts."""


_MAX_CAMERAS = 16


class DatasetSource(Source):
    """The images of all episodes, one after the other.

    A frame's stamp is that of the first control step that was given it. The store holds no other time.
    """

    gaps = True

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.format = "image store of trifinger_rl_datasets"
        self._store = open_store(path)
        try:
            self._open()
        except BaseException:
            self._store.close()
            raise

    def _open(self) -> None:
        self._images = StoredArray(self._store, "images", str(self.path))
        if not self._images.ragged:
            raise LogError(f"{self.path}: images: found numbers, expected encoded pictures")
        cameras = self._images.attributes.get("n_cameras", 3)
        if not isinstance(cameras, int) or not 1 <= cameras <= _MAX_CAMERAS:
            found = f"n_cameras: found {str(cameras)[:60]}"
            raise LogError(f"{self.path}: images: {found}, expected 1 to {_MAX_CAMERAS}")
        packing = self._images.attributes.get("compression", "image")
        if packing != "image":
            raise LogError(f"{self.path}: images: compression: found {str(packing)[:60]}, expected 'image'")
        self._reordered = bool(self._images.attributes.get("reorder_pixels", False))
        self.camera_names = default_names(cameras)
        self.image_sizes = (self._image_size(),) * cameras
        self.count, left = divmod(len(self._images), cameras)
        if left:
            raise LogError(
                f"{self.path}: images: found {len(self._images)}, expected a multiple of {cameras} cameras"
            )
        steps = self._first_steps(cameras)
        if steps is None:
            self._stamps: FloatArray = np.arange(self.count) / CAMERA_RATE
            return
        self._stamps = steps / CONTROL_RATE
        ends = StoredArray.find(self._store, "episode_ends", str(self.path))
        if ends is not None:  # the last steps of episodes
            after = np.searchsorted(steps, ends.numbers(), side="right")
            self.episode_starts = tuple(sorted({0, *(int(start) for start in after if start < self.count)}))

    def read(self, index: int) -> LogFrame:
        """See Source."""
        cameras = len(self.camera_names)
        images = tuple(self._image(index, camera) for camera in range(cameras))
        stamps = np.full(cameras, self._stamps[index])
        return LogFrame(index, float(stamps[0]), stamps, images, None, None)

    def close(self) -> None:
        """See Source."""
        self._store.close()

    def _image(self, index: int, camera: int) -> Image:
        number = index * len(self.camera_names) + camera
        with naming(f"{self.where(index)}: image {number}", LogError):
            picture = decode(self._images[number], color=False)
            width, height = self.image_sizes[camera]
            if picture.shape[:2] != (height, width):
                found = f"{picture.shape[1]}×{picture.shape[0]}"
                raise LogError(f"found {found} px, expected {width}×{height}")
            if picture.ndim == 3:
                return np.ascontiguousarray(picture[:, :, :3])
            return from_bayer(from_quadrants(picture) if self._reordered else picture)

    def _image_size(self) -> tuple[int, int]:
        shape = self._images.attributes.get("image_shape")
        if isinstance(shape, list) and len(shape) == 2 and all(isinstance(side, int) for side in shape):
            rows, columns = shape
            if MIN_SIDE <= rows <= MAX_SIDE and MIN_SIDE <= columns <= MAX_SIDE:
                return columns, rows
        raise LogError(
            f"{self.path}: images: image_shape: found {str(shape)[:60]}, expected rows and columns"
        )

    def _first_steps(self, cameras: int) -> FloatArray | None:
        """(count,) number of the first control step that saw each frame; None where that is not stored.

        Frames that no step saw lie evenly between those that were seen.
        """
        shown = StoredArray.find(self._store, "obs_to_image_index", str(self.path))
        if shown is None:
            return None
        images = shown.numbers()
        if images.dtype.kind not in "iu":
            raise LogError(f"{self.path}: obs_to_image_index: found {images.dtype}, expected whole numbers")
        images = images.astype(np.int64)
        before = np.concatenate([[0], images[:-1]])
        bad = (images < before) | (images >= len(self._images))
        if bad.any():
            k = int(np.argmax(bad))
            raise LogError(
                f"{self.path}: obs_to_image_index: step {k}: found {images[k]}, "
                f"expected {before[k]} to {len(self._images) - 1}"
            )
        if not len(images):
            return None
        seen, at = np.unique(images // cameras, return_index=True)
        numbers = np.arange(self.count)
        period = CONTROL_RATE / CAMERA_RATE
        result: FloatArray = np.interp(numbers, seen, at)
        result += period * np.minimum(numbers - seen[0], 0) + period * np.maximum(numbers - seen[-1], 0)
        return result - min(0.0, float(result[0]) if len(result) else 0.0)
