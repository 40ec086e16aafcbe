"""Films, one per camera: pictures by number, with their presentation times."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tracker.checks import naming, optional
from tracker.conventions import Image
from tracker.errors import LogError
from tracker.files import OneAtATime, on_error, open_regular, told_of
from tracker.logs.log import check_same_size, check_sides

SUFFIXES = (".mp4", ".avi", ".mkv", ".mov")
"""File name suffixes of films."""

_MAX_PICTURES = 10_000_000

_CONTAINERS = {"format_whitelist": "mov,matroska,avi", "protocol_whitelist": "file"}
"""The only containers and protocols that FFmpeg may open: playlists would read the files they name."""

_BOXES = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip")
_MATROSKA = b"\x1aE\xdf\xa3"
"""Magic bytes of the containers; those of MP4 and MOV follow the length of the first box."""


def check_container(path: Path) -> None:
    """Raise LogError unless the file is a known container; for libraries that open any format."""
    with told_of(path), open_regular(path) as file:
        head = file.read(12)
    avi = head[:4] == b"RIFF" and head[8:] == b"AVI "
    if not avi and head[:4] != _MATROSKA and head[4:8] not in _BOXES:
        raise LogError(f"{path}: found no film: it starts with {head!r}, expected MP4, MOV, MKV or AVI")


class FilmFile:
    """A film whose pictures are decoded on access; LogError if it is none, or damaged.

    TrackerError: the optional package `av` is missing.
    """

    def __init__(self, path: Path) -> None:
        av = optional("av", "video", f"{path}: a film")
        self.path, self._alone = path, OneAtATime(path)
        self._faults: tuple[type[Exception], ...] = (av.FFmpegError, ValueError, MemoryError)
        with naming(f"{path}: found no film", LogError, *self._faults), told_of(path):
            open_regular(path).close()  # FFmpeg would wait for a pipe's writer
            self._film: Any = av.open(str(path), "r", container_options=_CONTAINERS)
        with on_error(self.close):
            self._stream = self._video()
            self._times = self._read_times()
        self.size = (self._stream.width, self._stream.height)
        """(width, height) [px] of the pictures."""
        first, unit = self._times[0], self._stream.time_base
        self.stamps: tuple[float, ...] = tuple(float((time - first) * unit) for time in self._times)
        """Presentation time of each picture, relative to the first [s]."""
        self._next: Any = None  # decoder, positioned after the last decoded picture
        self._ahead: int | None = None  # time of the last decoded picture

    def _video(self) -> Any:
        if not self._film.streams.video:
            raise LogError(f"{self.path}: found no pictures, expected a film")
        stream = self._film.streams.video[0]
        if stream.codec_context is None:
            raise LogError(f"{self.path}: found pictures in an unknown code, expected a film")
        check_sides(stream.width, stream.height, f"{self.path}: ")
        stream.thread_type = "NONE"  # recordings are decoded in parallel instead
        stream.codec_context.options = {"err_detect": "explode"}  # else the decoder conceals damage
        return stream

    def _read_times(self) -> list[int]:
        """Return the sorted presentation times in the stream's time base, without decoding pictures."""
        times: list[int] = []
        with naming(f"{self.path}: damaged", LogError, *self._faults):
            for packet in self._film.demux(self._stream):
                if not packet.size:
                    continue
                time = packet.pts if packet.pts is not None else packet.dts
                if time is None or len(times) >= _MAX_PICTURES:
                    raise LogError(f"{self.path}: found pictures without a time, or too many")
                times.append(time)
        if not times or len(set(times)) != len(times):
            raise LogError(f"{self.path}: found {len(times)} pictures, expected some, each at its own time")
        return sorted(times)

    def picture(self, number: int) -> Image:
        """Return the picture (H, W, 3) BGR with this number; LogError if it is damaged."""
        sought, before = self._times[number], self._times[number - 1] if number else None
        where = f"{self.path}: picture {number}: "
        with self._alone:
            try:
                if self._next is None or self._ahead != before:
                    self._film.seek(sought, stream=self._stream, backward=True)  # to a keyframe before it
                    self._next, self._ahead = self._film.decode(self._stream), None
                for frame in self._next:
                    self._ahead = frame.pts if frame.pts is not None else frame.dts
                    check_same_size((frame.width, frame.height), self.size, where)
                    if self._ahead == sought:
                        return np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
                    if self._ahead is not None and self._ahead > sought:
                        break
            except self._faults as error:
                self._next = None
                raise LogError(f"{where}{' '.join(str(error).split())}") from error
            self._next = None
        raise LogError(f"{where}found none, the film is damaged")

    def close(self) -> None:
        """Close the file."""
        self._film.close()


class FilmPicture(NamedTuple):
    """A picture of a film."""

    film: FilmFile
    number: int
