"""Write image files, and films (.mp4) that any browser can play."""

import os
from collections.abc import Callable, Iterable, Iterator
from fractions import Fraction

import cv2
import numpy as np
import numpy.typing as npt

from tracker.checks import is_number, optional, path_of
from tracker.conventions import Array, Image
from tracker.errors import ImageError, shown
from tracker.files import check_suffix, whole_file, write_whole, writing
from tracker.logs import Log

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg")
"""Formats of `write_image`."""

MAX_SIDE = 65500
"""Largest width and height of a JPEG file that OpenCV writes [px]."""

_SLOWEST, _FASTEST = 0.5, 60.0  # frame rates of a recording's film [frames per second]


def write_image(path: str | os.PathLike[str], image: Array) -> None:
    """Write uint8 pixels, grey (H, W) or BGR (H, W, 3), as a PNG or JPEG file, atomically.

    Raises:
        ImageError: the suffix is not in IMAGE_SUFFIXES, the image is invalid, or the file cannot be written.
    """
    target = path_of(path, "image", ImageError)
    check_suffix(target, IMAGE_SUFFIXES, "image", ImageError)
    found = f"image {target}: found {shown(image)}"
    of_pixels = isinstance(image, np.ndarray) and image.dtype == np.uint8 and image.size
    if not (of_pixels and (image.ndim == 2 or image.shape[2:] == (3,))):
        raise ImageError(f"{found}, expected uint8 of shape (H, W) or (H, W, 3)")
    if max(image.shape[:2]) > MAX_SIDE:
        raise ImageError(f"{found}, expected at most {MAX_SIDE} px a side")
    suffix = target.suffix.lower()
    options = [cv2.IMWRITE_PNG_COMPRESSION, 5] if suffix == ".png" else [cv2.IMWRITE_JPEG_QUALITY, 95]
    content = cv2.imencode(suffix, image, options)[1].tobytes()
    with writing(ImageError, f"image {target}"):
        write_whole(target, content)


def write_film(path: str | os.PathLike[str], pictures: Iterable[Image], rate: float) -> int:
    """Write images (H, W, 3) BGR of one size as an H.264 film, atomically.

    The last row or column of odd sizes is dropped, since the format requires even ones.

    Args:
        path: ends in .mp4.
        pictures: the images, consumed one by one, so that a long film does not fill up memory.
        rate: images per second, 0.001 to 1000.

    Returns:
        The number of images.

    Raises:
        ImageError: the suffix is wrong, there are no images, or the file cannot be written.
        TrackerError: the optional package `av` is missing.
    """
    target = path_of(path, "film", ImageError)
    check_suffix(target, (".mp4",), "film", ImageError)
    if not is_number(rate) or not 1e-3 <= rate <= 1e3:
        raise ImageError(f"film {target}: rate: found {shown(rate)}, expected 0.001 to 1000 per second")
    av = optional("av", "video", "a film")
    count = 0
    with (
        writing(ImageError, f"film {target}"),
        whole_file(target) as temporary,
        av.open(str(temporary), "w", format="mp4") as film,
    ):
        stream = film.add_stream("libx264", rate=Fraction(float(rate)).limit_denominator(1000))
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "18", "preset": "veryfast", "colorspace": "smpte170m"}
        for picture in pictures:
            shape = picture.shape if isinstance(picture, np.ndarray) else (0, 0)
            height, width = (side - side % 2 for side in shape[:2])
            if count == 0:
                stream.height, stream.width = height, width
            if not height * width or (height, width) != (stream.height, stream.width):
                found, valid = shown(picture), "images of one size, of 2×2 px or more"
                raise ImageError(f"film {target}: image {count}: found {found}, expected {valid}")
            frame = av.VideoFrame.from_ndarray(picture[:height, :width].copy(), format="bgr24")
            film.mux(stream.encode(frame))
            count += 1
        if not count:
            raise ImageError(f"film {target}: found no images for it, expected at least one")
        film.mux(stream.encode())
    return count


def write_log_film(path: str | os.PathLike[str], log: Log, progress: Callable[[int], None]) -> None:
    """Write a recording's cameras side by side as a film; TrackerError if it cannot be read or written."""
    height = max((size[1] for size in log.image_sizes), default=0)

    def side_by_side() -> Iterator[Image]:
        for frame in log:
            pictures = []
            for image, (width, rows) in zip(frame.images, log.image_sizes, strict=True):
                pictures.append(np.zeros((height, width, 3), np.uint8))  # black if it is missing
                if image is not None:
                    pictures[-1][:rows] = image
            yield np.concatenate(pictures, axis=1)
            progress(1)

    write_film(path, side_by_side(), film_rate([frame.timestamp for frame in log[:100]]))


def film_rate(stamps: npt.ArrayLike) -> float:
    """Return the frame rate of a film whose frames have timestamps (n,) [s]; repeated ones do not count."""
    steps = np.diff(stamps)
    steps = steps[steps > 0]
    return float(np.clip(1 / np.median(steps), _SLOWEST, _FASTEST)) if len(steps) else 10.0
