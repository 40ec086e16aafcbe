"""Hand-labelled images, with one mask for every visible face colour, and comparison of labels with them.

Two layouts are read, and may be mixed in a folder:
    NN_image.png     with NN_mask_red.png, NN_mask_green.png, …
    cameraNN.png     with rNN.png, gNN.png, bNN.png, cNN.png, mNN.png, yNN.png
A colour without a mask is not visible. Mask pixels count unless they are black.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tracker.checks import naming
from tracker.conventions import Array, Image
from tracker.errors import ImageError, LogError
from tracker.files import read_bounded, reading
from tracker.logs.pictures import MAX_PIXELS, decode
from tracker.objects.labels import COLOR_NAMES
from tracker.segmentation.color_model import CLASSES
from tracker.segmentation.labels import in_even_light
from tracker.segmentation.light import Light, apply_gains

MAX_FILE_SIZE = 4 * MAX_PIXELS
"""Largest image file [bytes]."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """An image (H, W, 3) BGR and its labels (H, W); 0 is background or not labelled."""

    name: str
    image: Image
    labels: Image


def read_image(path: Path) -> Image:
    """Read an 8-bit BGR image; ImageError, which names the file, if that fails."""
    if path.is_dir() or not path.exists():
        raise ImageError(f"image {path}: no such file{', but a folder' if path.is_dir() else ''}")
    with reading(f"image {path}", ImageError):
        content = read_bounded(path, MAX_FILE_SIZE)
    with naming(f"image {path}", ImageError, LogError):
        return decode(content, given=True)


_MASK = re.compile(r".*_mask_.*|[RGBCMYrgbcmy]\d+")
"""Names of masks, also of those without an image or a colour."""


def _masks(path: Path) -> dict[int, Path]:
    found = {}
    platform = re.fullmatch(r"camera(\d+)", path.stem)
    for label, color in list(enumerate(COLOR_NAMES))[1:]:
        words = f"{path.name.removesuffix('_image.png')}_mask_{color}.png"
        mask = path.with_name(f"{color[0]}{platform[1]}{path.suffix}" if platform else words)
        if mask != path and mask.exists():
            found[label] = mask
    return found


def read_labelled(folder: str | Path) -> list[LabelledImage]:
    """Read the labelled images of a folder by name; ImageError: there is none, or a mask without one."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ImageError(f"labelled images {folder}: no such folder")
    result: list[LabelledImage] = []
    unused = {path for path in folder.glob("[!.]*.png") if _MASK.fullmatch(path.stem)}
    for path in sorted({*folder.glob("[!.]*_image.png"), *folder.glob("camera*.png")}):
        masks = _masks(path)
        unused -= set(masks.values())
        if not masks:
            continue
        image = read_image(path)
        labels = np.zeros(image.shape[:2], np.uint8)
        for label, mask_path in masks.items():
            mask = read_image(mask_path)
            if mask.shape != image.shape:
                raise ImageError(f"mask {mask_path}: {mask.shape[:2]} px, its image has {image.shape[:2]}")
            labels[mask.max(axis=2) > 0] = label
        result.append(LabelledImage(f"{folder.resolve().name}/{path.stem}", image, labels))
    if unused:
        colors = ", ".join(COLOR_NAMES[1:])
        lone = min(unused)
        words, sign, _ = lone.name.rpartition("_mask_")
        missing = f"{words}_image.png" if sign else f"camera{lone.name[1:]}"
        raise ImageError(f"mask {lone}: found no {missing} for it, or no colour of {colors}")
    if not result:
        raise ImageError(
            f"labelled images {folder}: none found; expected NN_image.png with NN_mask_red.png …, "
            "or cameraNN.png with rNN.png …"
        )
    return result


def neutral(image: Image) -> tuple[Image, Light]:
    """Return an image (H, W, 3) in neutral and even light, as models see it, and its own light."""
    even, light = in_even_light(image, normalise=True)
    return apply_gains(even, light.gains), light


def surely_background(labels: Image) -> Array:
    """Return (H, W) bool: pixels some way off all labels (H, W), since masks are drawn too small."""
    margin = 2 * (labels.shape[0] // 50) + 1
    near = cv2.dilate((labels > 0).astype(np.uint8), np.ones((margin, margin), np.uint8))
    return np.equal(near, 0)


def confusion(pairs: Iterable[tuple[Image, Image]]) -> Array:
    """Return pixel counts (7, 7) by true label (row) and found label (column), of pairs (found, true).

    True background counts only where `surely_background`.
    """
    total = np.zeros((CLASSES, CLASSES), np.int64)
    for found, truth in pairs:
        use = (truth > 0) | surely_background(truth)
        codes = CLASSES * truth[use].astype(np.int64) + found[use]
        total += np.bincount(codes, minlength=CLASSES**2).reshape(CLASSES, CLASSES)
    return total


def intersection_over_union(predicted: Array, truth: Array) -> dict[int, float]:
    """Return the IoU of every label in the truth (H, W), over the whole image."""
    result = {}
    for label in np.unique(truth[truth > 0]):
        a, b = predicted == label, truth == label
        result[int(label)] = float((a & b).sum() / (a | b).sum())
    return result
