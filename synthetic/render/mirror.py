"""What a clear coat mirrors: ceiling, walls and table as from the arena's middle, and the lamps."""

from __future__ import annotations

import numpy as np

from tracker.compiled import compiled
from tracker.conventions import Array

_NORMAL_REFLECTANCE = 0.04
"""Of a coat of refractive index 1.5, seen along its normal."""

_LAMP_HALF_WIDTH = 0.17
"""Of lamps as they are mirrored [rad]: panels and tubes, wider than the disks that cast the shadows."""

_TABLE, _WALL, _CEILING = 0.04, 0.25, 1.1
"""Radiance of what is mirrored, of the ambient light."""

_WALL_TOP = 0.45
"""Sine of the height up to which the wall stands around the arena."""


@compiled
def mirrored(
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    blur: float,
    ambient: Array,
    open_sky: float,
    directions: Array,
    lamps: Array,
    lit: Array,
) -> tuple[float, float, float]:
    """Light (blue, green, red) that a whole coat sends from around towards the unit vector v.

    Schlick's form of Fresnel's reflectance; a lamp is a Gaussian as wide as lamp and blur together.
    """
    cosine = max(nx * vx + ny * vy + nz * vz, 0.0)
    grazing = (1.0 - cosine) * (1.0 - cosine)
    fresnel = _NORMAL_REFLECTANCE + (1.0 - _NORMAL_REFLECTANCE) * grazing * grazing * (1.0 - cosine)
    rx, ry, rz = 2 * cosine * nx - vx, 2 * cosine * ny - vy, 2 * cosine * nz - vz
    soft = blur + 0.05
    above = _step(rz / soft)
    high = _step((rz - _WALL_TOP) / soft)
    around = _TABLE + above * (_WALL - _TABLE) + high * open_sky * (_CEILING - _WALL)
    b, g, r = ambient[0] * around, ambient[1] * around, ambient[2] * around
    width = _LAMP_HALF_WIDTH * _LAMP_HALF_WIDTH + blur * blur
    for k in range(len(directions)):
        miss = 1.0 - (rx * directions[k, 0] + ry * directions[k, 1] + rz * directions[k, 2])
        share = lit[k] * np.exp(-2.0 * miss / width) / width
        b, g, r = b + share * lamps[k, 0], g + share * lamps[k, 1], r + share * lamps[k, 2]
    return fresnel * b, fresnel * g, fresnel * r


@compiled
def _step(x: float) -> float:
    """From 0 to 1 between -1 and 1."""
    x = min(max(0.5 + 0.5 * x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)
