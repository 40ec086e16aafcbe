"""Hand-labelled images, a picture and one mask for each face colour that it shows; and labels against them.

Two layouts are read, and mixed folders are fine:
    NN_image.png     with NN_mask_red.png, NN_mask_green.png, …
    cameraNN.png     with rNN.png, gNN.png, bNN.png, cNN.png, mNN.png, yNN.png
A mask that is not there: the colour is not visible. A mask's pixel counts where it is not black.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tracker.checks import naming
from tracker.conventions import Array, Image
from tracker.errors import ImageError, LogError
from tracker.files import read_bounded, told_of
from tracker.logs.pictures import READ, check_whole, head_of
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import CLASSES

MAX_PIXELS = 1 << 26
"""Most pixels of a picture that is read: eight thousand by eight thousand."""

MAX_FILE_SIZE = 4 * MAX_PIXELS
"""Largest file of a picture [bytes]."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """A picture (H, W, 3) BGR and its labels (H, W); 0 is background or not labelled."""

    name: str
    image: Image
    labels: Image


def read_image(path: Path) -> Image:
    """An 8-bit BGR image; ImageError names the file where that fails."""
    if not path.is_file():
        raise ImageError(f"image {path}: no such file")
    with told_of(f"image {path}", ImageError):
        content = read_bounded(path, MAX_FILE_SIZE)
    # Before pixels are made of them: OpenCV fills what is missing with grey, slowly where sizes are damaged.
    with naming(f"image {path}", ImageError, LogError):
        picture = head_of(content, READ)
        width, height = picture.size
        if width * height > MAX_PIXELS:
            raise LogError(f"found {width}×{height} px, expected at most {MAX_PIXELS} in all")
        check_whole(picture, content, appended=True)
    image = _decoded(content, cv2.IMREAD_COLOR)
    if image is None:
        raise ImageError(f"image {path}: not an image that can be read, or truncated")
    if image.max() < 4096 >> 8:  # black, or so it looks where 8 of 16 bits are left of 12
        deep = _decoded(content, cv2.IMREAD_UNCHANGED)
        if deep is not None and deep.dtype == np.uint16 and 0 < deep.max() < 4096:
            raise ImageError(
                f"image {path}: found values up to {deep.max()} in 16 bits, as of a camera of 12 bits; "
                "expected 8 bits: (image >> 4).astype(np.uint8)"
            )
    return np.asarray(image, dtype=np.uint8)


def _decoded(content: bytes, how: int) -> Array | None:
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), how)
    except cv2.error:  # more pixels than OpenCV reads
        return None


def _masks(path: Path) -> dict[int, Path]:
    found = {}
    platform = re.fullmatch(r"camera(\d+)", path.stem)
    for label, color in list(enumerate(COLOR_NAMES))[1:]:
        if platform:
            mask = path.with_name(f"{color[0]}{platform[1]}{path.suffix}")
        else:
            mask = path.with_name(path.name.replace("_image", f"_mask_{color}"))
        if mask != path and mask.is_file():
            found[label] = mask
    return found


def read_labelled(folder: str | Path) -> list[LabelledImage]:
    """All labelled images of a folder, in the order of their names; ImageError where there is none."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ImageError(f"labelled images {folder}: no such folder")
    result = []
    for path in sorted([*folder.glob("*_image.png"), *folder.glob("camera*.png")]):
        masks = _masks(path)
        if not masks:
            continue
        image = read_image(path)
        labels = np.zeros(image.shape[:2], np.uint8)
        for label, mask_path in masks.items():
            mask = read_image(mask_path)
            if mask.shape != image.shape:
                raise ImageError(f"mask {mask_path}: {mask.shape[:2]} px, its image has {image.shape[:2]}")
            labels[mask.max(axis=2) > 0] = label
        result.append(LabelledImage(f"{folder.name}/{path.stem}", image, labels))
    if not result:
        raise ImageError(
            f"labelled images {folder}: none found; expected NN_image.png with NN_mask_red.png …, "
            "or cameraNN.png with rNN.png …"
        )
    return result


def surely_background(labels: Image) -> Array:
    """Pixels (H, W) bool away from labels (H, W), and from the rim of masks, which are drawn too small."""
    margin = 2 * (labels.shape[0] // 50) + 1
    near = cv2.dilate((labels > 0).astype(np.uint8), np.ones((margin, margin), np.uint8))
    return np.equal(near, 0)


def confusion(pairs: Iterable[tuple[Image, Image]]) -> Array:
    """Numbers (7, 7) of pixels by true label (row) and label found (column), of pairs (found, true).

    Background counts away from the true labels only.
    """
    total = np.zeros((CLASSES, CLASSES), np.int64)
    for found, truth in pairs:
        use = (truth > 0) | surely_background(truth)
        codes = CLASSES * truth[use].astype(np.int64) + found[use]
        total += np.bincount(codes, minlength=CLASSES**2).reshape(CLASSES, CLASSES)
    return total


def intersection_over_union(predicted: Array, truth: Array) -> dict[int, float]:
    """IoU of every label that the truth (H, W) shows, over the whole image."""
    result = {}
    for label in np.unique(truth[truth > 0]):
        a, b = predicted == label, truth == label
        result[int(label)] = float((a & b).sum() / (a | b).sum())
    return result
