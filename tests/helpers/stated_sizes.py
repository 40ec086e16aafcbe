"""Small picture files that say they are large."""

import struct
import zlib

import cv2
import numpy as np

from tracker.conventions import Image

KINDS = ("png", "jpg", "bmp", "tiff", "webp")
"""Suffixes of the files."""


def of_size(kind: str, width: int, height: int) -> bytes:
    """A file with few pixels that says it has so many."""
    data = bytearray(encoded(kind))
    if kind == "png":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif kind == "jpg":
        at = data.index(b"\xff\xc0") + 5
        data[at : at + 4] = struct.pack(">HH", height, width)
    elif kind == "bmp":
        data[18:26] = struct.pack("<ii", width, height)
    elif kind == "webp":
        (bits,) = struct.unpack_from("<I", data, 21)
        struct.pack_into("<I", data, 21, bits >> 28 << 28 | height - 1 << 14 | width - 1)
    else:
        (at,) = struct.unpack_from("<I", data, 4)
        for entry in range(at + 2, at + 2 + 12 * struct.unpack_from("<H", data, at)[0], 12):
            tag = struct.unpack_from("<H", data, entry)[0]
            if tag in (256, 257):
                struct.pack_into("<HII", data, entry + 2, 4, 1, width if tag == 256 else height)
    return bytes(data)


def encoded(kind: str, image: Image | None = None) -> bytes:
    """A small picture in a format; WebP is without losses."""
    shown = np.arange(30 * 40 * 3, dtype=np.uint8).reshape(30, 40, 3) if image is None else image
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if kind == "webp" else []
    return bytes(cv2.imencode(f".{kind}", shown, options)[1].tobytes())
