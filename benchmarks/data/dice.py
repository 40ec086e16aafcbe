"""Benchmark scenes of the dice task: images, and the poses of all dice."""

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.data.plan import Plan, stream
from benchmarks.data.scenes import SIZE
from benchmarks.data.store import Store, each
from synthetic.frames import FrameMaker, FrameOptions
from tracker.conventions import FloatArray, Image

KINDS = {"thrown": "dice_thrown", "laid": "dice_goal"}
"""Kinds of scenes. thrown: dice dropped in a physics simulation. laid: on cells of the task's grid."""


@dataclass(frozen=True, eq=False)
class DiceScene:
    """One image of each camera, and the ground truth."""

    index: int
    """Number of the scene in its stream."""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR."""
    labels: tuple[Image, ...]
    """(H, W) uint8 label map, by majority in each pixel: 0 other, k + 1 die k."""
    positions: FloatArray
    """(D, 3) centres of the dice [m]."""
    rotations: FloatArray
    """(D, 3, 3) world_from_die."""
    bars: FloatArray
    """(B, 3, 2) smallest and largest x, y, z [m] of the bars of the cross on the table; B = 0: no cross."""


def dice_store(kind: str, plan: Plan) -> Store[DiceScene]:
    """Return the scenes of one of KINDS, by number."""
    own = stream(plan.seed, "dice", kind)
    make = functools.partial(each, _scenes, kind, own)
    return Store(f"dice, {kind}", DiceScene, make, (__name__,), own, plan)


def _scenes(kind: str, seed: int) -> Callable[[int], DiceScene]:
    frames = FrameMaker(FrameOptions("dice", seed, size=SIZE, empty=0.0, kind=KINDS[kind]))

    def make(index: int) -> DiceScene:
        (frame,) = frames.chunk(index)
        bars = []
        for body in frame.scene.bodies:
            if body.name.startswith("cross_"):
                bars.append(np.stack([body.points.min(axis=0), body.points.max(axis=0)], axis=1))
        return DiceScene(
            frame.index,
            frame.images,
            frame.labels,
            np.array([state.position for state in frame.objects]),
            np.array([state.rotation for state in frame.objects]),
            np.array(bars).reshape(-1, 3, 2),
        )

    return make
