"""Images from recordings and from users: raw Bayer pixels, encoded files, and films by number.

The stated size is checked before memory is allocated for the pixels. Pillow reads the headers. Its `verify`
finds all damage to a PNG, but only 7 of 150 truncated JPEGs: these are checked for their end marker. OpenCV
fills missing parts of a damaged image with grey, and reports that on stderr only.
"""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from tracker.checks import in_8_bits, naming, optional
from tracker.conventions import Array, Image
from tracker.errors import LogError, message
from tracker.files import OneAtATime, on_error, open_regular, reading
from tracker.logs.log import check_same_size, check_sides

if TYPE_CHECKING:
    from PIL.ImageFile import ImageFile

RECORDED = ("PNG", "JPEG")
READ = (*RECORDED, "BMP", "TIFF", "WebP")
"""Image formats in recordings, and those accepted from users."""

MAX_PIXELS = 1 << 26
"""Largest number of pixels of a user's image: about eight thousand by eight thousand."""

_READERS = {
    b"\x89PNG\r\n\x1a\n": ("PNG", "Png"),
    b"\xff\xd8": ("JPEG", "Jpeg"),
    b"BM": ("BMP", "Bmp"),
    b"II*\0": ("TIFF", "Tiff"),
    b"MM\0*": ("TIFF", "Tiff"),
    b"RIFF": ("WebP", "WebP"),
}
"""Magic bytes, format and Pillow's name of the format."""


def from_bayer(raw: Image) -> Image:
    """Return the BGR image (H, W, 3) of raw pixels (H, W), red at even rows and columns."""
    # OpenCV names Bayer patterns after the second and third pixel of the second row.
    return np.asarray(cv2.cvtColor(raw, cv2.COLOR_BAYER_BG2BGR), dtype=np.uint8)


def to_bayer(image: Image) -> Image:
    """Return raw pixels (H, W) of a BGR image (H, W, 3), as a sensor with this mosaic measures them."""
    raw = image[:, :, 1].copy()
    raw[0::2, 0::2] = image[0::2, 0::2, 2]
    raw[1::2, 1::2] = image[1::2, 1::2, 0]
    return raw


def from_quadrants(quadrants: Image) -> Image:
    """Return raw Bayer pixels (H, W) of four colour planes: red and green above, blue and green below."""
    height, width = quadrants.shape
    if height % 2 or width % 2:
        raise LogError(f"found {width}×{height} px in four quadrants, expected even numbers")
    rows, columns = height // 2, width // 2
    raw = np.empty_like(quadrants)
    raw[0::2, 0::2] = quadrants[:rows, :columns]
    raw[0::2, 1::2] = quadrants[:rows, columns:]
    raw[1::2, 0::2] = quadrants[rows:, columns:]
    raw[1::2, 1::2] = quadrants[rows:, :columns]
    return raw


def head_of(data: bytes, formats: tuple[str, ...]) -> ImageFile:
    """Read an image's header; LogError if it is damaged, or of another format."""
    # `Image.open` would also warn about sizes that are rejected later anyway.
    for start, (name, reader) in _READERS.items():
        if name in formats and data.startswith(start):
            module = import_module(f"PIL.{reader}ImagePlugin")
            # Pillow may raise any error.
            with naming(f"found a {name} whose head cannot be read", LogError, Exception):
                picture: ImageFile = getattr(module, f"{reader}ImageFile")(BytesIO(data))
            return picture
    expected = f"{', '.join(formats[:-1])} or {formats[-1]}"
    raise LogError(f"found {len(data)} bytes that start with {data[:4]!r}, expected {expected}")


def decode(data: bytes, *, color: bool = True, given: bool = False) -> Image:
    """Decode an image to (H, W, 3) BGR, or unchanged if not `color`; LogError if it is damaged.

    An image of a recording is a PNG or JPEG of a valid size. One that is `given` by a user may have more
    formats and sizes, and data after a JPEG's end, as photos of phones do.
    """
    picture = head_of(data, READ if given else RECORDED)
    width, height = picture.size
    if not given:
        check_sides(width, height)
    elif width * height > MAX_PIXELS:
        raise LogError(f"found {width}×{height} px, expected at most {MAX_PIXELS} in all")
    endless = picture.format == "JPEG" and b"\xff\xd9" not in data[-64:]  # some writers pad
    if endless and not given:
        raise LogError("found a JPEG without an end, it is truncated")
    with naming(f"found a damaged or truncated {picture.format}", LogError, Exception):
        if endless:
            picture.load()
        if picture.format == "PNG":
            picture.verify()
    # Ignore EXIF orientation tags: they do not apply to fixed cameras.
    how = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION if color else cv2.IMREAD_UNCHANGED
    image = _decoded(data, how)
    if image is None or image.dtype != np.uint8:
        raise LogError("found an image that cannot be decoded to 8 bits")
    return image


def _decoded(data: bytes, how: int) -> Array | None:
    """Return the image in a file's content, read by OpenCV as its flags `how` say; None if it cannot.

    LogError: it is black, or seems so: of values of up to 12 bits in 16, only the upper 8 bits are left.
    """
    content = np.frombuffer(data, np.uint8)
    try:
        image = cv2.imdecode(content, how)
        if image is None or image.max() >= 4096 >> 8:
            return image
        deep = cv2.imdecode(content, cv2.IMREAD_UNCHANGED)
    except cv2.error:  # more pixels than OpenCV reads
        return None
    if deep is not None and deep.dtype == np.uint16 and 0 < deep.max() < 4096:
        bits, remedy = in_8_bits(deep)
        raise LogError(
            f"found 16-bit values up to {deep.max()}, as from a {bits}-bit camera; expected 8 bits: {remedy}"
        )
    return image


FILM_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov")
"""File name suffixes of films."""

_MAX_PICTURES = 10_000_000
_MOST_REORDERED = 16  # images of a film that are stored after one that they precede
_CONTAINERS = {"format_whitelist": "mov,matroska,avi", "protocol_whitelist": "file"}
"""The only containers and protocols that FFmpeg may open: playlists would read the files they name."""

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_MATROSKA = b"\x1aE\xdf\xa3"
"""Magic bytes of the containers; those of MP4 and MOV follow the length of the first box."""


def check_container(path: Path) -> None:
    """Raise LogError unless the file is a known container; for libraries that open any format."""
    with reading(path), open_regular(path) as file:
        head = file.read(12)
    avi = head[:4] == b"RIFF" and head[8:] == b"AVI "
    if not avi and head[:4] != _MATROSKA and head[4:8] not in _BOXES:
        raise LogError(f"{path}: found no film: it starts with {head!r}, expected MP4, MOV, MKV or AVI")


class FilmFile:
    """A film whose images are decoded on access; LogError if it is not a film, or is damaged.

    TrackerError: the optional package `av` is missing.
    """

    def __init__(self, path: Path) -> None:
        av = optional("av", "video", f"{path}: a film")
        self.path, self._alone = path, OneAtATime(path)
        self._faults: tuple[type[Exception], ...] = (av.FFmpegError, ValueError, MemoryError)
        with naming(f"{path}: found no film", LogError, *self._faults), reading(path):
            open_regular(path).close()  # FFmpeg would wait for a pipe's writer
            self._film: Any = av.open(str(path), "r", container_options=_CONTAINERS)
        with on_error(self.close):
            if not self._film.streams.video:
                raise LogError(f"{path}: found no images, expected a film")
            self._stream = self._film.streams.video[0]
            if self._stream.codec_context is None:
                raise LogError(f"{path}: found images in an unknown code, expected a film")
            check_sides(self._stream.width, self._stream.height, f"{path}: ")
            self._stream.thread_type = "NONE"  # recordings are decoded in parallel instead
            # Otherwise the decoder conceals damage.
            self._stream.codec_context.options = {"err_detect": "explode"}
            self._times = self._read_times()
        self.size = (self._stream.width, self._stream.height)
        """(width, height) [px] of the images."""
        first, unit = self._times[0], self._stream.time_base
        self.stamps: tuple[float, ...] = tuple(float((time - first) * unit) for time in self._times)
        """Presentation time of each image, relative to the first [s]."""
        self._next: Any = None  # decoder, positioned after the image of the time `_ahead`
        self._ahead: int | None = None

    def _read_times(self) -> list[int]:
        """Return the sorted presentation times in the stream's time base, without decoding images."""
        times: list[int] = []
        with naming(f"{self.path}: damaged", LogError, *self._faults):
            for packet in self._film.demux(self._stream):
                if not packet.size or packet.is_discard:  # kept only to decode others, where a film was cut
                    continue
                time = packet.pts if packet.pts is not None else packet.dts
                if time is None or len(times) >= _MAX_PICTURES:
                    raise LogError(f"{self.path}: found images without a time, or too many")
                times.append(time)
        if not times or len(set(times)) != len(times):
            raise LogError(f"{self.path}: found {len(times)} images, expected some, each at its own time")
        return sorted(times)

    def picture(self, number: int) -> Image:
        """Return the image (H, W, 3) BGR with this number; LogError if it is damaged."""
        sought, before = self._times[number], self._times[number - 1] if number else None
        where = f"{self.path}: image {number}: "
        with self._alone.lock():
            ways, self._next = [self._next], None  # an error or Ctrl-C leaves None
            if ways == [None] or self._ahead != before:
                # Images in front of a keyframe may be stored after it, and need those before it, too.
                early = number - _MOST_REORDERED
                earlier = self._times[early] if early > 0 else self._stream.start_time or 0
                ways = [self._decoded(time) for time in (sought, earlier)]
            fault = "found none, the film is damaged"
            for following in ways:
                try:
                    for frame in following:
                        time = frame.pts if frame.pts is not None else frame.dts
                        check_same_size((frame.width, frame.height), self.size, where)
                        if time == sought:
                            image = np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
                            self._next, self._ahead = following, time
                            return image
                        if time is not None and time > sought:
                            break
                except self._faults as error:
                    fault = message(error)
        raise LogError(f"{where}{fault}")

    def _decoded(self, time: int) -> Iterator[Any]:
        """Yield all images from the last keyframe before a time on."""
        self._film.seek(time, stream=self._stream, backward=True)
        yield from self._film.decode(self._stream)

    def close(self) -> None:
        """Close the file."""
        self._film.close()


class FilmPicture(NamedTuple):
    """An image of a film."""

    film: FilmFile
    number: int
