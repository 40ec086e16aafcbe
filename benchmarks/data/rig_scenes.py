"""Scenes of the platform before rigs unlike the platform's: pictures of any sizes, and the truth."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.data.rig_cases import CASES, RigCase
from benchmarks.data.scenes import Scene
from benchmarks.data.seeds import stream
from benchmarks.data.store import CACHE, Store, each
from synthetic.camera.sensor import Sensor
from synthetic.stills import bare_scene, scene_with_fingers, take
from tracker.objects.model import CuboidModel

NEAR = 0.2
"""In turn there are no fingers, and three that are near the object with this probability each."""


def rig_scene(case: RigCase, model: CuboidModel, seed: int, index: int) -> Scene:
    """A scene of an object (in the world's size); all rigs see the same scene of a number and size on stage.

    Args:
        case: the rig.
        model: one of its objects.
        seed: of all scenes.
        index: number of the scene.
    """
    on_stage = case.on_stage(model)
    rng = np.random.default_rng([seed, index])
    scene = scene_with_fingers(on_stage, rng, near=NEAR) if index % 2 else bare_scene(on_stage, rng)
    # The noise takes more draws of larger pictures: it has a stream of its own.
    noise = np.random.default_rng([seed, index, 1])
    made = take(scene, case.stage_cameras, Sensor.realistic(), noise)
    return Scene(
        index,
        tuple(made.images),
        tuple(made.labels),
        made.visible_fraction,
        *case.placement.pose(made.position, made.rotation),
    )


def rig_store(
    case_name: str, object_name: str, seed: int, workers: int = 2, cache: Path = CACHE
) -> Store[Scene]:
    """The scenes of one rig and object, by their numbers.

    Args:
        case_name: name of the rig in `CASES`.
        object_name: name of one of its objects.
        seed: of all that is drawn.
        workers: number of processes that render what is missing.
        cache: where scenes are kept.
    """
    own = stream(seed, "rigs")
    make = functools.partial(each, _scenes, case_name, object_name, own)
    name = f"{object_name}, rig, {case_name}"
    return Store(name, Scene, make, (__name__,), own, workers=workers, cache=cache)


def _scenes(case_name: str, object_name: str, seed: int) -> Callable[[int], Scene]:
    case = CASES[case_name]
    return functools.partial(rig_scene, case, case.model(object_name), seed)
