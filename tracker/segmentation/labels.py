"""Label maps from images: table look-ups, and a clean-up of specks and weak regions."""

import cv2
import numpy as np

from tracker.checks import in_8_bits, of_kind
from tracker.compiled import compiled
from tracker.conventions import Array, Image
from tracker.errors import ColorModelError, ImageError
from tracker.segmentation.color_model import ColorModel
from tracker.segmentation.light import CLIPPED, Light, evened, find_light, unveiled

REFERENCE_SIZE = 270
"""Image height for which the lengths below are stated [px]."""

FINE_IMAGE = 1.5
"""Scale relative to REFERENCE_SIZE above which images are denoised and patches are eroded."""

MIN_AREA = 10.0
"""Smallest patch of one colour that is kept [px² at the reference size]: the cuboid's end has 30."""

GAP = 3.0
"""Half the distance up to which patches belong to one object [px at the reference size]."""

MIN_EVIDENCE = 0.25
"""Smallest evidence of an object that is kept, as a share of the strongest object's."""

MAY_BE_GREY = 1.2
"""Largest ratio between the channels of a clipped pixel that counts as grey."""


@compiled
def may_be_grey(b, g, r, gains):  # type: ignore[no-untyped-def]
    """Whether a pixel has a clipped channel, whose level is a lower bound, and may be grey."""
    if max(b, g, r) < CLIPPED:
        return False
    brightest, least, most = 0.0, 1e9, 0.0
    for k in range(3):
        raw = b if k == 0 else g if k == 1 else r
        level = gains[k] * raw
        if raw >= CLIPPED:
            brightest = max(brightest, level)
        else:
            least, most = min(least, level), max(most, level)
    return most < MAY_BE_GREY * least and brightest < MAY_BE_GREY * least


@compiled
def label_of(b, g, r, channels, table, gains):  # type: ignore[no-untyped-def]
    """Look up a pixel's label in the table, 0 for clipped greys: equation (2) of docs/how-it-works.md.

    channels: (3, 256) from ColorModel.channel_tables for the gains (3,).
    """
    # Unsigned, since a signed index could count from the end.
    cell = channels[0, np.uint8(b)] + channels[1, np.uint8(g)] + channels[2, np.uint8(r)]
    label = table[np.uint32(cell)]
    if label > 0 and may_be_grey(b, g, r, gains):
        return np.uint8(0)
    return label


@compiled
def look_up(image, channels, table, gains, out):  # type: ignore[no-untyped-def]
    """Fill out (H, W) with the labels of an image's pixels, see `label_of`."""
    for j in range(image.shape[0]):
        for i in range(image.shape[1]):
            out[j, i] = label_of(image[j, i, 0], image[j, i, 1], image[j, i, 2], channels, table, gains)


def check_image(image: object, who: str = "image") -> Image:
    """Return the image, contiguous and writeable, if it is (H, W, 3) uint8; else raise ImageError."""
    if not isinstance(image, np.ndarray):
        raise ImageError(
            f"{who}: found {type(image).__name__}, expected a NumPy array (H, W, 3) of uint8, BGR"
        )
    if image.dtype != np.uint8:
        remedy = f": {in_8_bits(image)[1]}" if image.dtype == np.uint16 else ""
        raise ImageError(f"{who}: found {image.dtype}, expected uint8{remedy}")
    if image.ndim != 3 or image.shape[2] != 3:
        raise ImageError(f"{who}: found shape {image.shape}, expected (height, width, 3), BGR")
    if min(image.shape[:2]) < 16:
        raise ImageError(f"{who}: found {image.shape[1]}×{image.shape[0]} px, expected at least 16×16")
    # Numba would compile its functions once more for read-only arrays and for subclasses.
    plain = type(image) is np.ndarray and image.flags.carray
    return image if plain else np.array(image, order="C")


def segment(image: Array, colors: ColorModel) -> Image:
    """Return the label map (H, W) uint8 of an image (H, W, 3) uint8 BGR: 0 background, 1 red … 6 yellow.

    Pixels are labelled by colour. Specks and regions much weaker than the strongest are removed: copper
    coils and coloured fringes at edges are not faces.

    Raises:
        ImageError: the image is not an (H, W, 3) uint8 array.
        ColorModelError: `colors` is not a colour model.
    """
    of_kind(colors, ColorModel, "colors", ColorModelError, "tracker.load_colors")
    image, light, labels = labels_by_color(check_image(image), colors)
    margin = np.empty(image.shape[:2], np.uint8)
    look_up(image, colors.channel_tables(light.gains), colors.margin_table, light.gains, margin)
    return keep_strongest(labels, np.minimum(margin, 64))


def labels_by_color(image: Image, colors: ColorModel) -> tuple[Image, Light, Image]:
    """Return the image (H, W, 3) in even light, its light, and its labels (H, W) without clean-up."""
    if min(image.shape[:2]) / REFERENCE_SIZE > FINE_IMAGE:
        # Demosaicing leaves single wrong pixels at this resolution.
        image = np.asarray(cv2.medianBlur(image, 3), dtype=np.uint8)
    image, light = in_even_light(image, colors.normalise)
    labels = np.empty(image.shape[:2], np.uint8)
    look_up(image, colors.channel_tables(light.gains), colors.label_table, light.gains, labels)
    return image, light, labels


def in_even_light(image: Image, normalise: bool) -> tuple[Image, Light]:
    """Return the image (H, W, 3) without veil and tilt, and its light; as it is if not to be normalised."""
    if not normalise:
        return image, Light(np.ones(3), np.zeros((2, 2)), 0.0)
    image = unveiled(image)
    light = find_light(image)
    return evened(image, light), light


def keep_strongest(labels: Image, evidence: Array) -> Image:
    """Return labels without specks and without objects whose summed evidence is far below the strongest."""
    scale = min(labels.shape) / REFERENCE_SIZE
    fine = scale > FINE_IMAGE
    kept = np.zeros(labels.shape, np.uint8)
    for label in range(1, 7):
        mask = cv2.medianBlur((labels == label).astype(np.uint8), 5 if fine else 3)
        if fine:
            # Pixels at the border mix two surfaces; at this resolution a face is large enough without them.
            mask = cv2.erode(mask, cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3)))
        count, parts, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        large = stats[:, cv2.CC_STAT_AREA] >= MIN_AREA * scale * scale
        large[0] = False
        if count > 1:
            kept |= np.where(large[parts], np.uint8(label), np.uint8(0))
    reach = 2 * max(1, round(GAP * scale)) + 1
    joined = cv2.dilate(np.minimum(kept, 1), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    count, things = cv2.connectedComponents(joined)
    weight = np.bincount(things.ravel(), weights=np.where(kept > 0, evidence, 0).ravel(), minlength=count)
    strong = weight >= MIN_EVIDENCE * weight.max()
    return np.where(strong[things], kept, np.uint8(0))
