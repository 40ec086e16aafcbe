"""Optional real-world imperfections in the images.

Each can be switched on alone. Without any, the images are those of a tidy world, bit for bit. Each effect
draws its parameters from its own random stream, so switching one on or off does not affect the others.
"""

import zlib
from collections.abc import Iterable

import numpy as np

from tracker.errors import TrackerError


class EffectError(TrackerError):
    """An effect does not exist, or lacks a package."""


NAMES = (
    # The object's edges are rounded or chamfered by up to 1 mm, about like real ones, with glints and dark
    # seams.
    "chamfers",
    # Blur differs from camera to camera, and with depth.
    "focus",
    # Each camera has its own response exponent, black level and vignetting.
    "response",
    # Faces have texture, prints with rounded borders, and different gloss.
    "surface",
    # Object, table and fingers reflect each other's colours.
    "reflections",
    # The foot of the object and the table around it shade each other.
    "contact",
    # The table is semi-gloss, with soft highlights, scratches and dust; crosses and rings in the colours of
    # faces are painted on it.
    "table",
    # Tape, cables, cloth, tools and boxes are on the wall and outside, half of them in the colours of faces;
    # rarely in front of the object.
    "clutter",
    # Each axis of the object is up to 0.3 mm longer or shorter than stated.
    "sizes",
    # Lateral chromatic aberration.
    "fringes",
    # Points are smeared into comets.
    "skewed_psf",
    # Each pixel has its own constant gain and offset.
    "fixed_pattern",
    # Exposure changes slowly during a film; a single scene just has another exposure.
    "drift",
    # An unsharp mask, as in some cameras.
    "sharpening",
    # The given calibration is wrong by more than its stated standard deviations.
    "calibration",
    # Images are compressed by JPEG or H.264, as in recordings.
    "compression",
    # In films exposure is not instantaneous, and cameras are grabbed one after another.
    "timing",
    # Exposure is not instantaneous; in half of the single scenes the object moves.
    "motion_blur",
)
"""All effects."""


def chosen_effects(given: str | Iterable[str]) -> tuple[str, ...]:
    """Return effects in the order of NAMES.

    `given` has their names, or is a text: `none`, `world` for all, or names with commas.

    Raises:
        EffectError: no effect has this name.
    """
    if isinstance(given, str):
        known = {"none": (), "": (), "world": NAMES}
        given = known.get(given, [name.strip() for name in given.split(",")])
    names = tuple(given)
    for name in names:
        if name not in NAMES:
            raise EffectError(f"effect: found {name!r}, expected one of {', '.join(NAMES)}")
    return tuple(name for name in NAMES if name in names)


def stream(name: str, seed: int, *numbers: int) -> np.random.Generator:
    """Return the random stream of one effect, for the scene or image that `numbers` identify."""
    return np.random.default_rng([seed, zlib.crc32(name.encode()), *numbers])
