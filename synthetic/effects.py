"""Optional real-world imperfections in the images.

Each can be switched on by itself. Without any, the images are those of a tidy world, bit for bit. Each effect
draws its parameters from its own random stream, so switching one on or off does not affect the others.
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
    """The object's edges are rounded or chamfered by up to 1 mm, about like real ones, with glints and dark
    seams."""
    focus: bool = False
    """Blur differs from camera to camera, and with depth."""
    response: bool = False
    """Each camera has its own response exponent, black level and vignetting."""
    surface: bool = False
    """Faces have texture, prints with rounded borders, and different gloss."""
    reflections: bool = False
    """Object, table and fingers reflect each other's colours."""
    contact: bool = False
    """The foot of the object and the table around it shade each other."""
    table: bool = False
    """The table is semi-gloss, with soft highlights, scratches and dust; crosses and rings in the colours of
    faces are painted on it."""
    clutter: bool = False
    """Tape, cables, cloth and tools lie on the wall, at its foot and outside, half of them in the colours of
    faces; never in front of the object."""
    sizes: bool = False
    """Each axis of the object is up to 0.3 mm longer or shorter than stated."""
    fringes: bool = False
    """Lateral chromatic aberration."""
    skewed_psf: bool = False
    """Points are smeared into comets."""
    fixed_pattern: bool = False
    """Each pixel has its own constant gain and offset."""
    drift: bool = False
    """Exposure changes slowly during a film; a single scene just has another exposure."""
    sharpening: bool = False
    """An unsharp mask, as in some cameras."""
    calibration: bool = False
    """The given calibration is wrong by more than its stated standard deviations."""
    compression: bool = False
    """Images are compressed by JPEG or H.264, as in recordings."""
    timing: bool = False
    """In films exposure is not instantaneous, and cameras are grabbed one after another."""
    motion_blur: bool = False
    """Exposure is not instantaneous; in half of the single scenes the object moves."""

    @classmethod
    def none(cls) -> Effects:
        """Return no effects: the tidy world."""
        return cls()

    @classmethod
    def all(cls) -> Effects:
        """Return every effect."""
        return cls(**dict.fromkeys(NAMES, True))

    @classmethod
    def only(cls, *names: str) -> Effects:
        """Return these effects and no others.

        Raises:
            EffectError: no effect has this name.
        """
        for name in names:
            if name not in NAMES:
                raise EffectError(f"effect: found {name!r}, expected one of {', '.join(NAMES)}")
        return cls(**dict.fromkeys(names, True))

    @classmethod
    def of(cls, chosen: str | Iterable[str]) -> Effects:
        """Return the effects given by names or by text: `none`, `world` for all, or comma-separated names.

        Raises:
            EffectError: no effect has this name.
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
"""Names of all effects."""


def stream(name: str, seed: int, *numbers: int) -> np.random.Generator:
    """Return the random stream of one effect, for the scene or image that `numbers` identify."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *numbers])
