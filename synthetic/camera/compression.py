"""Compression artefacts of recordings: JPEG of the image, JPEG of its mosaic, or H.264."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import cv2
import numpy as np

from synthetic.camera.sensor import demosaicked, mosaicked
from synthetic.effects import EffectError
from tracker.conventions import Image
from tracker.errors import install

GROUP = 10
"""Interval between the key frames of a film [images]."""

KINDS = {"jpeg": 0.5, "mosaic": 0.2, "h264": 0.3}
"""Kinds of compression and their probabilities: JPEG of the image; JPEG of the mosaic's four colour planes
side by side, as image stores hold them; H.264."""


@dataclass(frozen=True)
class Compression:
    """Compression of one recording."""

    kind: str
    """One of KINDS."""
    quality: int
    """JPEG quality, 1 to 100. Chroma is stored at half the resolution, except in mosaics, which have none.
    Recorded photos have quality 95 (scripts/measure_cameras.py)."""
    crf: int
    """Rate factor of H.264, 0 (lossless) to 51."""

    @classmethod
    def sample(cls, rng: np.random.Generator) -> Compression:
        """Draw the compression of a recording that people would keep."""
        kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
        return cls(kind, int(rng.integers(80, 99)), int(rng.integers(17, 27)))

    def applied(self, pictures: Sequence[Image], *, raw: bool = False) -> Image:
        """Return the last of these images (H, W, 3) BGR, compressed and decompressed.

        Args:
            pictures: consecutive images of one camera, beginning at a key frame: H.264 predicts each image
                from the one before.
            raw: the recording holds mosaics, so JPEG always compresses the mosaic, whatever the image.

        Raises:
            EffectError: PyAV, the extra `video`, is missing.
        """
        if self.kind == "h264":
            return _filmed(pictures, self.crf)
        picture = pictures[-1]
        if raw or self.kind == "mosaic":
            mosaic = mosaicked(picture)
            inner = np.s_[2:-2, 2:-2]  # OpenCV copies values to the border
            if raw or np.array_equal(demosaicked(mosaic)[inner], picture[inner]):
                return demosaicked(_joined(_jpeg(_quadrants(mosaic), self.quality)))
        return _jpeg(picture, self.quality)


def _jpeg(picture: Image, quality: int) -> Image:
    _, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_UNCHANGED), dtype=np.uint8)


def _quadrants(raw: Image) -> Image:
    """Return the mosaic's colour planes in one image (H, W): red and green above blue and the other green."""
    above, below = (raw[0::2, 0::2], raw[0::2, 1::2]), (raw[1::2, 1::2], raw[1::2, 0::2])
    return np.vstack([np.hstack(above), np.hstack(below)])


def _joined(quadrants: Image) -> Image:
    """Inverse of `_quadrants`."""
    rows, columns = (size // 2 for size in quadrants.shape)
    raw = np.empty_like(quadrants)
    raw[0::2, 0::2], raw[0::2, 1::2] = quadrants[:rows, :columns], quadrants[:rows, columns:]
    raw[1::2, 1::2], raw[1::2, 0::2] = quadrants[rows:, :columns], quadrants[rows:, columns:]
    return raw


def _filmed(pictures: Sequence[Image], crf: int) -> Image:
    try:
        import av
    except ImportError as error:
        raise EffectError(f"compression: H.264 needs PyAV: {install('video')}") from error
    height, width = pictures[0].shape[:2]
    coder = av.CodecContext.create("libx264", "w")
    coder.width, coder.height, coder.pix_fmt, coder.time_base = width, height, "yuv420p", Fraction(1, 10)
    # Zero latency: no image waits for later ones. One thread: the bits depend on nothing but the images.
    coder.options = {"crf": str(crf), "preset": "veryfast", "tune": "zerolatency", "threads": "1"}
    decoder = av.CodecContext.create("h264", "r")
    packets = []
    for number, picture in enumerate(pictures):
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
        frame.pts = number
        packets += coder.encode(frame)
    frames = [frame for packet in [*packets, *coder.encode(None), None] for frame in decoder.decode(packet)]
    return np.asarray(frames[-1].to_ndarray(format="bgr24"), dtype=np.uint8)
