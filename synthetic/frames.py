"""Frames of the simulated platform in memory: pictures, labels and the exact truth.

A frame depends on the seed and its number alone: not on how many are asked for, in which order, or by how
many workers. Frames of a sequence come in chunks of one length, each a motion of its own that is simulated
from its start.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Container, Iterator
from contextlib import ExitStack
from types import TracebackType
from typing import Any

import numpy as np

from synthetic.camera.rigs import sized, standard_rig
from synthetic.camera.shot import QUALITIES, CameraShot, Quality, shoot
from synthetic.camera.units import Unit, units_of
from synthetic.effects import Effects
from synthetic.render.choose import choose_renderer
from synthetic.render.interface import Renderer
from synthetic.scene import ObjectState, PlatformScene
from synthetic.world.effects import with_effects
from synthetic.world.platform import Platform
from synthetic.world.scenes import random_scene
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TrackerError
from tracker.geometry import so3

CHUNK = 100
"""Frames of a sequence that are one motion, by default."""

PERIOD = 0.1
"""Time between the stamps of single scenes [s]."""

EMPTY_SHARE = 0.05
"""Share of single scenes without an object, by default."""

_SCENE, _CAMERAS, _NOISE = range(3)
"""Streams of random numbers of one seed."""


class DatasetError(TrackerError):
    """Frames that cannot be made, or a folder that cannot take them."""


@dataclasses.dataclass(frozen=True)
class FrameOptions:
    """What decides the pixels of all frames, apart from the cameras."""

    object_name: str
    """cube_v1 … cuboid_2x2x8_v2, a file as `tracker.load_object` takes it, or `dice`."""
    seed: int
    """Of everything random."""
    quality: str = "default"
    """`fast`, `default` or `best`."""
    renderer: str = "auto"
    """`auto`, `pyrender` or `tiny`."""
    sequence: bool = False
    """Frames follow each other in time; else every frame is a scene of its own."""
    size: int = 270
    """Height of the pictures [px], 270 or 540."""
    rate: float = 10.0
    """Frames of a sequence per second [Hz]."""
    kind: str | None = None
    """Kind of the single scenes, or of the motions of a sequence; None: drawn."""
    dropped: float = 0.02
    """Probability that a picture of a sequence is missing."""
    path: str | None = None
    """How the pictures are recorded, see `Sensor.path`; None: drawn."""
    shadows: bool | None = None
    """None: as the quality says."""
    empty: float = EMPTY_SHARE
    """Share of single scenes without an object."""
    length: int = CHUNK
    """Frames of a sequence that are one motion."""
    effects: tuple[str, ...] = ()
    """Which of `synthetic.effects.NAMES` the pictures show."""

    def __post_init__(self) -> None:
        valid = {"quality": tuple(QUALITIES), "size": (270, 540)}
        for key, values in valid.items():
            if getattr(self, key) not in values:
                known = ", ".join(map(str, values))
                raise DatasetError(f"{key}: found {getattr(self, key)!r}, expected one of {known}")
        # In one order, whatever the order asked for.
        object.__setattr__(self, "effects", Effects.of(self.effects).names)
        if self.seed < 0:
            raise DatasetError(f"seed: found {self.seed}, expected 0 or more")
        if not 0.0 <= self.dropped <= 0.3:
            raise DatasetError(f"dropped: found {self.dropped:g}, expected 0 to 0.3")
        if not 0.1 <= self.rate <= 1000:
            raise DatasetError(f"rate: found {self.rate:g}, expected 0.1 to 1000 Hz")
        if self.length < 1:
            raise DatasetError(f"length: found {self.length}, expected 1 or more")

    @property
    def chunk(self) -> int:
        """Number of frames that must be made in order."""
        return self.length if self.sequence else 1


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One picture of each camera, and the truth."""

    index: int
    """Number of the frame."""
    timestamp: float
    """[s]"""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR, as the cameras give them, distorted."""
    labels: tuple[Image, ...]
    """(H, W) uint8, what most of a pixel shows: 0 other, 1 red … 6 yellow; of dice their number."""
    visible_fraction: FloatArray
    """(cameras,) visible pixels of the object, of those it has without robot; 0 where there are none."""
    visible_px: Array
    """(cameras,) visible pixels of the object."""
    scene: PlatformScene
    """The scene itself."""
    renderer: str
    """Which renderer made it."""
    pinhole_labels: tuple[tuple[Image, Image], ...] = ()
    """Labels of visible surfaces, and labels without robot, of cameras without distortion, if asked for."""

    @property
    def objects(self) -> tuple[ObjectState, ...]:
        """The object, or all dice, exactly; empty: there is none."""
        return self.scene.objects

    def truth(self, names: tuple[str, ...]) -> dict[str, Any]:
        """The entry of `ground_truth.json` for cameras of these names."""
        poses = [_pose(state) for state in self.objects]
        is_one = len(poses) == 1
        return {
            "frame": f"{self.index:06d}",
            "timestamp": self.timestamp,
            "object": None if not poses else poses[0] if is_one else poses,
            "robot_position": np.asarray(self.scene.robot_position).tolist(),
            "cameras": {
                name: {"visible_fraction": float(fraction), "visible_px": int(count)}
                for name, fraction, count in zip(names, self.visible_fraction, self.visible_px, strict=True)
            },
            "scene": self.scene.about,
        }


def _pose(state: ObjectState) -> dict[str, list[float]]:
    quaternion = so3.quaternion_from_matrix(state.rotation)
    return {"position": state.position.tolist(), "orientation_xyzw": quaternion.tolist()}


class FrameMaker:
    """Makes the frames of one set of options; holds simulation and renderer. A context manager."""

    def __init__(self, options: FrameOptions, rig: CameraRig | None = None, *, pinhole: bool = False) -> None:
        self.options = options
        self.rig = sized(rig or standard_rig(), options.size)
        self._pinhole = pinhole
        self._effects = Effects.of(self.options.effects)
        self._quality: Quality = QUALITIES[options.quality]
        if options.shadows is not None:
            self._quality = dataclasses.replace(self._quality, shadows=options.shadows)
        self._stack = ExitStack()
        self.renderer: Renderer = choose_renderer(options.renderer)
        self._platform = self._stack.enter_context(Platform(options.object_name))

    def __enter__(self) -> FrameMaker:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Free the simulation; the renderer stays, one for each process."""
        self._stack.close()

    def chunk(
        self, number: int, wanted: Container[int] | None = None, emptied: Container[int] = ()
    ) -> Iterator[Frame]:
        """The frames of a chunk in order, or those whose numbers are wanted.

        Those whose numbers are in `emptied` are given a second time, after the first if that is wanted, with
        the same light, fingers and noise but without any object.
        """
        units = self._units(number)
        first = number * self.options.chunk
        for index, (timestamp, tidy) in enumerate(self._scenes(number), start=first):
            scene = with_effects(tidy, self._effects, self.options.seed, number)
            if wanted is None or index in wanted:
                yield self._frame(index, timestamp, scene, units)
            if index in emptied:
                yield self._frame(index, timestamp, scene.emptied(), units)

    def of_scene(self, number: int, scene: PlatformScene) -> Frame:
        """A frame of a scene made elsewhere."""
        scene = with_effects(scene, self._effects, self.options.seed, number)
        return self._frame(number, number * PERIOD, scene, self._units(number))

    def _units(self, number: int) -> tuple[Unit, ...]:
        """The cameras as they are for a chunk."""
        rng = self._rng(_CAMERAS, number)
        sensor = self._quality.sensor(rng, self.options.path)
        return units_of(self.rig, sensor, rng, self._effects, self.options.seed, number)

    def _rng(self, stream: int, number: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, stream, number])

    def _scenes(self, number: int) -> Iterator[tuple[float, PlatformScene]]:
        options, rng = self.options, self._rng(_SCENE, number)
        if not options.sequence:
            present = bool(rng.random() >= options.empty)
            yield (
                number * PERIOD,
                random_scene(self._platform, rng, object_present=present, kind=options.kind),
            )
            return
        from synthetic.world.motion import sequence as motion_sequence

        # Dropped frames: more time than undisturbed frames would take.
        seconds = (1.2 * options.length / (1.0 - options.dropped) + 10.0) / options.rate
        steps = motion_sequence(
            self._platform,
            rng,
            seconds=seconds,
            rate=options.rate,
            kind=options.kind,
            dropped=options.dropped,
        )
        for timestamp, scene in itertools.islice(steps, options.length):
            yield number * seconds + timestamp, scene

    def _frame(
        self,
        index: int,
        timestamp: float,
        scene: PlatformScene,
        units: tuple[Unit, ...],
    ) -> Frame:
        noise = self._rng(_NOISE, index)
        shots: list[CameraShot] = [
            shoot(self.renderer, (scene,), unit, self._quality, noise, pinhole=self._pinhole)
            for unit in units
        ]
        visible = np.array([np.count_nonzero(shot.labels) for shot in shots])
        alone = np.array([np.count_nonzero(shot.alone) for shot in shots])
        return Frame(
            index=index,
            timestamp=float(timestamp),
            images=tuple(shot.image for shot in shots),
            labels=tuple(shot.labels for shot in shots),
            visible_fraction=visible / np.maximum(alone, 1),
            visible_px=visible,
            scene=scene,
            renderer=self.renderer.name,
            pinhole_labels=tuple(shot.pinhole for shot in shots if shot.pinhole is not None),
        )


def frames(
    object_name: str,
    count: int,
    seed: int,
    *,
    rig: CameraRig | None = None,
    quality: str = "default",
    renderer: str = "auto",
    sequence: bool = False,
    size: int = 270,
    first: int = 0,
    **more: Any,
) -> Iterator[Frame]:
    """Frames `first` … `first + count - 1` of the platform with this object.

    Args:
        object_name: cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2 or dice.
        count: number of frames.
        seed: of everything random.
        rig: the cameras, scaled to `size`; by default those of the simulated platform.
        quality: `fast`, `default` or `best`.
        renderer: `auto`, `pyrender` or `tiny`.
        sequence: a motion, instead of single scenes.
        size: height of the pictures [px].
        first: number of the first frame.
        more: other fields of `FrameOptions`.

    Raises:
        TrackerError: an option is not valid, or robot meshes or renderer cannot be had.
    """
    options = FrameOptions(object_name, seed, quality, renderer, sequence, size, **more)
    with FrameMaker(options, rig) as maker:
        numbers = range(first, first + count)
        for chunk in range(first // options.chunk, -(-(first + count) // options.chunk)):
            part = range(max(first, chunk * options.chunk), min(numbers.stop, (chunk + 1) * options.chunk))
            yield from itertools.islice(maker.chunk(chunk, part), len(part))
