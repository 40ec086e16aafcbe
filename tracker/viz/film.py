"""Films: pictures one after the other in an mp4 file that every browser plays."""

from __future__ import annotations

import os
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

from tracker.conventions import Image
from tracker.errors import ImageError, TrackerError, install
from tracker.files import whole_file


def write_film(path: str | os.PathLike[str], pictures: Iterable[Image], rate: float) -> int:
    """Write pictures (H, W, 3) BGR of one size as an H.264 film, whole or not at all.

    Odd sizes lose their last row or column, which the format cannot hold.

    Args:
        path: ends in .mp4.
        pictures: taken one by one, so that a long film needs no memory.
        rate: pictures per second.

    Returns:
        The number of pictures.

    Raises:
        ImageError: the suffix is another, or the file cannot be written.
        TrackerError: the optional package `av` is missing.
    """
    target = Path(path)
    if target.suffix.lower() != ".mp4":
        raise ImageError(f"film {target}: found suffix {target.suffix!r}, expected .mp4")
    try:
        import av
    except ImportError as error:
        raise TrackerError(f"films need the package av: {install('video')}") from error
    count = 0
    try:
        with whole_file(target) as temporary, av.open(str(temporary), "w", format="mp4") as film:
            stream = film.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000))
            stream.pix_fmt = "yuv420p"
            stream.options = {"crf": "18", "preset": "veryfast"}
            for picture in pictures:
                height, width = (side - side % 2 for side in picture.shape[:2])
                if count == 0:
                    stream.height, stream.width = height, width
                frame = av.VideoFrame.from_ndarray(picture[:height, :width].copy(), format="bgr24")
                film.mux(stream.encode(frame))
                count += 1
            if count:
                film.mux(stream.encode())
    except OSError as error:
        raise ImageError(f"film {target}: cannot be written: {error.strerror or error}") from error
    return count
