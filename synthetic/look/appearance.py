"""Colours and light of the real platforms, and their variation from platform to platform.

Colours are linear BGR reflectances. Constants given as levels are pixel values from 0 to 1 in an image under
light of irradiance 1.
"""

from dataclasses import dataclass

import numpy as np

from synthetic.camera.sensor import RESPONSE_GAMMA
from synthetic.look.face_colors import reflectances
from synthetic.scene import Lamp, Lighting, direction
from tracker.conventions import Array, FloatArray
from tracker.objects.model import CuboidModel

COPPER = np.array([3.0, 54.0, 102.0]) / 255
DICE_BLUE = np.array([203.0, 119.0, 6.0]) / 255
PIP_WHITE = np.array([207.0, 207.0, 207.0]) / 255
CROSS_BLUE = np.array([110.0, 50.0, 20.0]) / 255
"""Levels (3,), BGR."""

_DARKEST = 0.001

DARK_ROBOTS, CROSSES = 0.12, 0.1
"""Shares of scenes with a dark robot and with a cross painted on the table."""


@dataclass(frozen=True, eq=False)
class Look:
    """The colours of everything in a scene."""

    robot: FloatArray
    """(4, 3) of shell, joints and motors, rubber tips, copper."""
    faces: FloatArray
    """(6, 3) of a cuboid's faces in the order of FACE_NAMES."""
    dice: FloatArray
    """(25, 3)"""
    pips: FloatArray
    """(3,) of the pips of all dice."""
    table: FloatArray
    """(3,)"""
    wall: FloatArray
    """(3,)"""
    floor: FloatArray
    """(3,) of what is visible beyond the wall."""
    cross: FloatArray
    """(3,)"""
    cross_size: FloatArray
    """(2,) width and length [m] of the bars of the cross on the table; zeros: no cross."""
    dirt: float
    """Relative standard deviation of an object's reflectance over its surface."""
    gloss: FloatArray
    """(4,) gloss of robot, objects, table, wall."""
    dark_robot: bool


def random_look(rng: np.random.Generator, model: CuboidModel | None) -> Look:
    """Draw colours from `rng`; `model`: the object, None for dice."""
    dark = bool(rng.random() < DARK_ROBOTS)
    shell = rng.uniform(0.15, 0.25) if dark else rng.uniform(0.66, 0.86)
    robot = np.stack(
        [
            shell * rng.normal([0.98, 1.0, 1.0], 0.015),
            np.full(3, rng.uniform(0.05, 0.13)),
            rng.uniform(0.30, 0.46) * rng.normal([1.05, 1.0, 0.96], 0.02),
            COPPER * rng.uniform(0.6, 1.1),
        ]
    )
    faces = np.zeros((6, 3)) if model is None else reflectances(model.colors)[model.face_labels]
    tints, brightness = rng.normal(1.0, 0.06, (6, 3)), rng.normal(1.0, 0.06)
    faces = faces * tints * brightness
    dice = DICE_BLUE * rng.normal(1.0, 0.04, 3) * rng.normal(1.0, 0.02, (25, 1))
    has_cross = rng.random() < CROSSES
    return Look(
        robot=_linear(robot),
        faces=np.clip(faces, _DARKEST, 1.0),
        dice=_linear(dice),
        # These get no draws of their own, which would change everything drawn later.
        pips=_linear(PIP_WHITE * (1 + (tints[0] - 1) / 4 + (brightness - 1) / 2)),
        table=_linear(rng.uniform(0.15, 0.27) * rng.normal([1.0, 1.0, 1.0], 0.025)),
        wall=_linear(rng.uniform(0.45, 0.62) * rng.normal([1.02, 1.0, 0.98], 0.015)),
        floor=_linear(rng.uniform(0.0, 0.08) * rng.normal(1.0, 0.1, 3)),
        cross=_linear(CROSS_BLUE * rng.normal(1.0, 0.1, 3)),
        cross_size=rng.uniform([0.004, 0.03], [0.01, 0.07]) * has_cross,
        dirt=float(rng.uniform(0.01, 0.05)),
        gloss=rng.uniform([0.1, 0.0, 0.1, 0.0], [0.4, 0.15, 0.5, 0.1]),
        dark_robot=dark,
    )


def random_lighting(rng: np.random.Generator) -> Lighting:
    """Draw ambient light and one to three lamps; the irradiance on a surface that faces up is about 1."""
    total = np.exp(rng.normal(0.0, 0.08)) * rng.normal(1.0, 0.015, 3)
    ambient_share = rng.uniform(0.5, 0.85)
    count = int(rng.integers(1, 4))
    shares = rng.dirichlet(np.full(count, 2.0)) * (1 - ambient_share)
    lamps = []
    for share in shares:
        azimuth, elevation = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(48, 88))
        towards = direction(azimuth, elevation)
        # A lamp's share is its irradiance on the table; capped, since a low lamp would dazzle the sides.
        color = total * share / max(towards[2], 0.75) * rng.normal(1.0, 0.02, 3)
        lamps.append(Lamp(towards, color))
    return Lighting(total * ambient_share, tuple(lamps))


def _linear(levels: Array) -> FloatArray:
    """Return the reflectances of levels (0 to 1) in an image."""
    result: FloatArray = np.clip(np.asarray(levels, dtype=np.float64), 0.0, 1.0) ** RESPONSE_GAMMA
    return np.maximum(result, _DARKEST)
