"""Which of the real world's imperfections the pictures show, beyond those that all pictures do.

Each can be had alone. Without any the pictures are, to the bit, those of a tidy world; an effect draws its
parameters from a stream of its own, so that switching one on or off changes no draw of any other.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Iterable

import numpy as np

from synthetic.errors import EffectError


@dataclasses.dataclass(frozen=True)
class Effects:
    """One switch for each effect."""

    chamfers: bool = False
    """Edges of the object are rounded or chamfered by up to 1 mm, about as recorded ones, with glints and
    dark seams."""
    focus: bool = False
    """Blur differs from camera to camera, and with depth."""
    response: bool = False
    """Each camera has a response exponent, a black level and vignetting of its own."""
    surface: bool = False
    """Faces have texture, prints with rounded borders, and a gloss each."""
    reflections: bool = False
    """Object, table and fingers give each other of their colours."""
    contact: bool = False
    """Where the object stands, its foot and the table are in each other's shade."""
    table: bool = False
    """The table is semi-gloss, with soft highlights, scratches and dust; crosses and rings are painted on it
    in the colours of faces."""
    clutter: bool = False
    """Tape, cables, cloth and tools on the wall, at its foot and outside, half of them in the colours of
    faces; never in front of the object."""
    sizes: bool = False
    """Each axis of the object is up to 0.3 mm longer or shorter than stated."""
    fringes: bool = False
    """Lateral chromatic aberration."""
    skewed_psf: bool = False
    """Points are drawn out to comets."""
    fixed_pattern: bool = False
    """Pixels have gains and offsets of their own, which stay."""
    drift: bool = False
    """Exposure changes slowly through a film; in single scenes it is another one."""
    sharpening: bool = False
    """An unsharp mask, as some cameras have it."""
    calibration: bool = False
    """The calibration that is given out is wrong beyond the deviations that it states."""
    compression: bool = False
    """JPEG and H.264, as recordings go through them."""
    timing: bool = False
    """In films exposure takes time, and cameras are grabbed one after another."""
    motion_blur: bool = False
    """Exposure takes time; in half of the single scenes the object is on its way."""

    @classmethod
    def none(cls) -> Effects:
        """The tidy world."""
        return cls()

    @classmethod
    def all(cls) -> Effects:
        """Every effect."""
        return cls(**dict.fromkeys(NAMES, True))

    @classmethod
    def only(cls, *names: str) -> Effects:
        """These effects and no others.

        Raises:
            EffectError: there is none of this name.
        """
        for name in names:
            if name not in NAMES:
                raise EffectError(f"effect: found {name!r}, expected one of {', '.join(NAMES)}")
        return cls(**dict.fromkeys(names, True))

    @classmethod
    def of(cls, chosen: str | Iterable[str]) -> Effects:
        """The effects that names or a text say: `none`, `world` for all of them, or names between commas.

        Raises:
            EffectError: there is none of this name.
        """
        if not isinstance(chosen, str):
            return cls.only(*chosen)
        if chosen in ("none", ""):
            return cls.none()
        if chosen == "world":
            return cls.all()
        return cls.only(*(name.strip() for name in chosen.split(",")))

    @property
    def names(self) -> tuple[str, ...]:
        """The effects that are on, in the order of NAMES."""
        return tuple(name for name in NAMES if getattr(self, name))


NAMES = tuple(field.name for field in dataclasses.fields(Effects))
"""All effects."""


def stream(name: str, seed: int, *numbers: int) -> np.random.Generator:
    """The random numbers of one effect, for the scene or picture that `numbers` say."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *numbers])
