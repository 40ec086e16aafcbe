"""When pictures are taken: cameras run free and are grabbed one after another, and exposure takes time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from synthetic.scene import PlatformScene
from tracker.conventions import FloatArray
from tracker.geometry import so3

PERIOD = 0.010
"""Of cameras that run free [s]: what is grabbed is up to so much older than what is newest."""

EXPOSURES = 0.0015, 0.010
"""Least and greatest time of exposure [s]; the platform's is 1.5 ms."""

IN_ROOM_LIGHT = 0.004, 0.015
"""Least and greatest time of exposure of a camera without the platform's lamps [s]."""

STEP, MOST = 1.0, 6
"""Motion [px] between two of an exposure's scenes, which the lens blurs away, and most of such scenes."""

STILL = 0.02
"""A motion of less [px] is none."""

_RADIUS = 0.05
"""Of what turns, from its origin [m]."""


@dataclass(frozen=True, eq=False)
class Timing:
    """How the cameras of a film are timed."""

    exposure: float
    """[s]"""
    phases: FloatArray
    """(cameras,) of their periods when the film begins, 0 to 1."""
    drifts: FloatArray
    """(cameras,) by how much each clock is fast."""

    @classmethod
    def sample(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Exposure by whatever light there is; clocks as quartzes are."""
        exposure = np.exp(rng.uniform(*np.log(EXPOSURES)))
        return cls(float(exposure), rng.uniform(0.0, 1.0, cameras), rng.normal(0.0, 1e-4, cameras))

    @classmethod
    def together(cls, rng: np.random.Generator, cameras: int) -> Timing:
        """Exposure alone: all cameras at once."""
        return cls(float(np.exp(rng.uniform(*np.log(IN_ROOM_LIGHT)))), np.zeros(cameras), np.zeros(cameras))

    def stamps(self, time: float) -> FloatArray:
        """(cameras,) the middle of each camera's exposure [s]; the latest is `time`."""
        ages = PERIOD * ((self.phases + self.drifts * time / PERIOD) % 1.0)
        result: FloatArray = time - (ages - ages.min())
        return result

    def shutter(self, stamp: float, motion: float) -> list[float]:
        """Times [s] at which scenes are to be averaged, where things move by `motion` [px] meanwhile."""
        count = min(MOST, 1 + round(motion / STEP))
        times = stamp + self.exposure * ((np.arange(count) + 0.5) / count - 0.5)
        return [float(time) for time in times]


def motion_px(first: PlatformScene, second: PlatformScene, focal: float, distance: float = 0.45) -> float:
    """By how many pixels anything moves at most, seen from so far [m] through a focal length [px]."""
    most = 0.0
    for a, b in zip(first.bodies, second.bodies, strict=True):
        if a.world_from_body is b.world_from_body or np.array_equal(a.world_from_body, b.world_from_body):
            continue
        shift = float(np.linalg.norm(a.world_from_body[:3, 3] - b.world_from_body[:3, 3]))
        turn = float(so3.angle_between(a.world_from_body[:3, :3], b.world_from_body[:3, :3]))
        most = max(most, shift + _RADIUS * turn)
    return most * focal / distance
