"""Ray-cast scenes before rigs unlike the platform's, kept on disk: pictures of any sizes, and the truth."""

from __future__ import annotations

import functools
import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.data import scenes
from benchmarks.data.rig_cases import CASES, RigCase
from benchmarks.data.store import CACHE, Store, fingerprint, read_packed
from synthetic.camera.sensor import Sensor
from synthetic.raycast import render
from synthetic.raycast.scene import random_scene
from tracker.conventions import FloatArray, Image
from tracker.objects.model import CuboidModel

SEED = scenes.SEED + 500
"""Of what is judged. Like the seed that it comes from, for nothing else."""

DEVELOPMENT_SEED = 4201
"""Of what may be looked at and adjusted with."""

OCCLUSION = (0.0, 0.2)
"""In turn there are no fingers, and three that touch the object with this probability each."""

SOURCES = ("benchmarks/data/rig_cases.py", "benchmarks/data/rig_scenes.py")
"""What the pixels depend on besides what all scenes do."""


@dataclass(frozen=True, eq=False)
class RigScene:
    """One picture of each camera of a rig, and the truth in the rig's world."""

    index: int
    """Number in its stream."""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR, of each camera's own size."""
    labels: tuple[Image, ...]
    """(H, W) uint8 of the pixels' centres: 0 other, 1 red ... 6 yellow."""
    visible_fraction: FloatArray
    """(cameras,) visible share of the object's pixels."""
    position: FloatArray
    """(3,) of the object [m]."""
    rotation: FloatArray
    """(3, 3) world from object."""

    def packed(self) -> bytes:
        """The scene as the content of an npz file."""
        buffer = io.BytesIO()
        arrays: dict[str, Any] = {f"image{view}": image for view, image in enumerate(self.images)}
        arrays |= {f"labels{view}": labels for view, labels in enumerate(self.labels)}
        np.savez_compressed(
            buffer,
            index=self.index,
            visible_fraction=self.visible_fraction,
            position=self.position,
            rotation=self.rotation,
            **arrays,
        )
        return buffer.getvalue()

    @classmethod
    def unpacked(cls, content: bytes) -> RigScene:
        """The scene that `packed` wrote.

        Raises:
            ValueError, KeyError, OSError, zipfile.BadZipFile: the content is something else.
        """
        with np.load(io.BytesIO(content), allow_pickle=False) as data:
            views = range(len(data["visible_fraction"]))
            return cls(
                int(data["index"]),
                tuple(data[f"image{view}"] for view in views),
                tuple(data[f"labels{view}"] for view in views),
                data["visible_fraction"],
                data["position"],
                data["rotation"],
            )


def rig_scene(case: RigCase, model: CuboidModel, seed: int, index: int) -> RigScene:
    """A scene of an object (in the world's size); all rigs see the same scene of a number and size on stage.

    Args:
        case: the rig.
        model: one of its objects.
        seed: of all scenes.
        index: number of the scene.
    """
    on_stage = case.on_stage(model)
    occlusion = OCCLUSION[index % len(OCCLUSION)]
    scene = random_scene(on_stage, np.random.default_rng([seed, index]), occlusion=occlusion)
    # The noise takes more draws of larger pictures: it has a stream of its own.
    noise = np.random.default_rng([seed, index, 1])
    made = render(scene, case.stage_cameras, on_stage, Sensor.realistic(), noise)
    assert made.position is not None
    assert made.rotation is not None
    return RigScene(
        index,
        tuple(made.images),
        tuple(made.labels),
        made.visible_fraction,
        *case.placement.pose(made.position, made.rotation),
    )


def maker(case_name: str, object_name: str, seed: int) -> Callable[[int], RigScene]:
    """The function that makes the scenes of a rig and object by their numbers."""
    case = CASES[case_name]
    return functools.partial(rig_scene, case, case.model(object_name), seed)


def _read(path: Path) -> RigScene | None:
    return read_packed(path, RigScene.unpacked)


class RigSceneStore(Store[RigScene]):
    """The scenes of one rig and object, by their numbers.

    Args:
        case_name: name of the rig in `CASES`.
        object_name: name of one of its objects.
        seed: of the scenes.
        workers: number of processes that render what is missing.
        cache: where scenes are kept.
    """

    def __init__(
        self, case_name: str, object_name: str, seed: int, workers: int = 2, cache: Path = CACHE
    ) -> None:
        kind = f"rig-{case_name.replace(' ', '_')}-{object_name}"
        super().__init__(
            f"{case_name}, {object_name}",
            cache / f"{kind}-{seed}-{fingerprint(*SOURCES)}",
            functools.partial(maker, case_name, object_name, seed),
            _read,
            workers,
        )
