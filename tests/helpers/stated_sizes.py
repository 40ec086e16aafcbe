"""Small picture files that say they are large."""

import struct
import zlib

import cv2
import numpy as np

from tracker.conventions import Image


def png_of_size(width: int, height: int) -> bytes:
    """A PNG file that says so, with a few of its pixels."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    chunks = (head, b"IDAT" + zlib.compress(bytes(99)), b"IEND")
    framed = (struct.pack(">I", len(c) - 4) + c + struct.pack(">I", zlib.crc32(c)) for c in chunks)
    return b"\x89PNG\r\n\x1a\n" + b"".join(framed)


def jpeg_of_size(width: int, height: int) -> bytes:
    """A JPEG file that says so, with few pixels."""
    data = bytearray(encoded("jpg"))
    at = data.index(b"\xff\xc0") + 5
    data[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(data)


def bmp_of_size(width: int, height: int) -> bytes:
    """A BMP file that says so, with few pixels."""
    data = bytearray(encoded("bmp"))
    data[18:26] = struct.pack("<ii", width, height)
    return bytes(data)


def tiff_of_size(width: int, height: int) -> bytes:
    """A TIFF file that says so, with few pixels."""
    data = bytearray(encoded("tiff"))
    (at,) = struct.unpack_from("<I", data, 4)
    for entry in range(at + 2, at + 2 + 12 * struct.unpack_from("<H", data, at)[0], 12):
        tag = struct.unpack_from("<H", data, entry)[0]
        if tag in (256, 257):
            struct.pack_into("<HII", data, entry + 2, 4, 1, width if tag == 256 else height)
    return bytes(data)


def webp_of_size(width: int, height: int) -> bytes:
    """A WebP file without losses that says so, with few pixels."""
    data = bytearray(encoded("webp"))
    (bits,) = struct.unpack_from("<I", data, 21)
    struct.pack_into("<I", data, 21, bits >> 28 << 28 | height - 1 << 14 | width - 1)
    return bytes(data)


def encoded(kind: str, image: Image | None = None) -> bytes:
    """A small picture in a format; WebP is without losses."""
    shown = np.arange(30 * 40 * 3, dtype=np.uint8).reshape(30, 40, 3) if image is None else image
    options = [cv2.IMWRITE_WEBP_QUALITY, 101] if kind == "webp" else []
    return bytes(cv2.imencode(f".{kind}", shown, options)[1].tobytes())


OF_SIZE = {
    "png": png_of_size,
    "jpg": jpeg_of_size,
    "bmp": bmp_of_size,
    "tiff": tiff_of_size,
    "webp": webp_of_size,
}
"""By the files' suffix."""
