"""Frames of the simulated platform in memory: pictures, labels and the exact truth.

A frame depends on the seed and its number alone: not on how many are asked for, in which order, or by how
many workers. Frames of a sequence come in chunks of one length, each a motion of its own that is simulated
from its start.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Container, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

from synthetic.camera.rigs import sized, standard_rig
from synthetic.camera.shot import QUALITIES, CameraShot, Quality, shoot
from synthetic.camera.units import STILL, Crew, crew_of, motion_px
from synthetic.closing import Closing
from synthetic.effects import Effects, stream
from synthetic.frame import Frame as Frame
from synthetic.render.renderer import shared_renderer
from synthetic.scene import PlatformScene, SceneAt
from synthetic.world.effects import still_at, with_effects
from synthetic.world.look_alikes import KINDS, look_alike
from synthetic.world.platform import DICE, Platform
from synthetic.world.scenes import random_scene
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray, Image
from tracker.errors import TrackerError

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

    look_alike: str | None = None
    """Which of `synthetic.world.look_alikes.KINDS` stands in the object's place; None: the object itself."""
    raw: bool = False
    """Pictures are the mosaics (H, W) that cameras record; only where those are kept: of size 540, or on the
    path `old`, whose small pictures are mosaics again."""

    def __post_init__(self) -> None:
        valid = {"quality": tuple(QUALITIES), "size": (270, 540), "look_alike": (None, *KINDS)}
        for key, values in valid.items():
            if getattr(self, key) not in values:
                known = ", ".join(map(str, values))
                raise DatasetError(f"{key}: found {getattr(self, key)!r}, expected one of {known}")
        # In one order, whatever the order asked for.
        object.__setattr__(self, "effects", Effects.of(self.effects).names)
        if self.look_alike is not None and self.object_name == DICE:
            raise DatasetError("look_alike: found dice, expected a cube or cuboid")
        if self.seed < 0:
            raise DatasetError(f"seed: found {self.seed}, expected 0 or more")
        if not 0.0 <= self.dropped <= 0.3:
            raise DatasetError(f"dropped: found {self.dropped:g}, expected 0 to 0.3")
        if not 0.1 <= self.rate <= 1000:
            raise DatasetError(f"rate: found {self.rate:g}, expected 0.1 to 1000 Hz")
        if self.raw and self.size != 540 and self.path != "old":
            raise DatasetError(
                f"raw: found size {self.size} and path {self.path!r}, expected size 540, or path 'old'"
            )
        if self.length < 1:
            raise DatasetError(f"length: found {self.length}, expected 1 or more")

    @property
    def chunk(self) -> int:
        """Number of frames that must be made in order."""
        return self.length if self.sequence else 1


class FrameMaker(Closing):
    """Makes the frames of one set of options; holds simulation and renderer. A context manager."""

    def __init__(self, options: FrameOptions, rig: CameraRig | None = None) -> None:
        self.options = options
        self.rig = sized(rig or standard_rig(), options.size)
        self._effects = Effects.of(options.effects)
        self._quality: Quality = QUALITIES[options.quality]
        if options.shadows is not None:
            self._quality = dataclasses.replace(self._quality, shadows=options.shadows)
        self._stack = ExitStack()
        self.renderer = shared_renderer()
        self._platform = self._stack.enter_context(Platform(options.object_name))

    def close(self) -> None:
        """Free the simulation; the renderer stays, one for each process."""
        self._stack.close()

    def chunk(
        self, number: int, chosen: Container[int] | None = None, emptied: Container[int] = ()
    ) -> Iterator[Frame]:
        """The frames of a chunk in order, or those whose numbers are in `chosen`.

        Those whose numbers are in `emptied` are given a second time, after the first if that is chosen, with
        the same light, fingers and noise but without any object.
        """
        crew = self._crew(number)
        first = number * self.options.chunk
        taken: list[tuple[Image, ...]] = []
        for index, (timestamp, scene_at) in enumerate(self._scenes(number), start=first):
            place = (index - first) % crew.group
            if place == 0:
                taken = []
            # Of a group of coded pictures each needs those before.
            left = range(index, index - place + crew.group)
            if chosen is not None and not any(k in chosen or k in emptied for k in left):
                continue
            frame = self._frame(index, timestamp, scene_at, crew)
            if chosen is None or index in chosen:
                yield self._recorded(frame, taken, crew)
            if index in emptied:
                emptied_at = functools.partial(_emptied, scene_at)
                yield self._recorded(self._frame(index, timestamp, emptied_at, crew), taken, crew)
            taken.append(frame.images)

    def of_scene(self, number: int, scene: PlatformScene) -> Frame:
        """A frame of a scene made elsewhere."""
        crew, stamp = self._crew(number), number * PERIOD
        return self._recorded(self._frame(number, stamp, self._still_at(scene, number), crew), [], crew)

    def _still_at(self, tidy: PlatformScene, number: int) -> SceneAt:
        """A single scene with effects, around its time stamp."""
        scene = self._dressed(tidy, number)
        return still_at(scene, number * PERIOD, self._effects, self.options.seed, number)

    def _dressed(self, tidy: PlatformScene, number: int) -> PlatformScene:
        """A scene with a look-alike, if one is chosen, and with effects."""
        kind, seed = self.options.look_alike, self.options.seed
        if kind is not None:
            tidy = look_alike(tidy, kind, stream("look_alike", seed, number))
        return with_effects(tidy, self._effects, seed, number)

    def _crew(self, number: int) -> Crew:
        """The cameras as they are for a chunk."""
        rng = self._rng(_CAMERAS, number)
        sensor = self._quality.sensor(rng, self.options.path)
        film = self.options.sequence
        return crew_of(self.rig, sensor, rng, self._effects, self.options.seed, number, film=film)

    def _rng(self, stream: int, number: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, stream, number])

    def _scenes(self, number: int) -> Iterator[tuple[float, SceneAt]]:
        """Time stamps and the scenes around them, by the time."""
        options, rng = self.options, self._rng(_SCENE, number)
        if not options.sequence:
            present = bool(rng.random() >= options.empty)
            tidy = random_scene(self._platform, rng, object_present=present, kind=options.kind)
            yield number * PERIOD, self._still_at(tidy, number)
            return
        from synthetic.world.motion import film

        # Dropped frames: more time than undisturbed frames would take.
        seconds = (1.2 * options.length / (1.0 - options.dropped) + 10.0) / options.rate
        steps = film(
            self._platform,
            rng,
            seconds=seconds,
            rate=options.rate,
            kind=options.kind,
            dropped=options.dropped,
        )
        for own, scene_at in itertools.islice(steps, options.length):
            stamp = number * seconds + own

            def at(
                time: float, own: float = own, stamp: float = stamp, tidy_at: SceneAt = scene_at
            ) -> PlatformScene:
                # At its stamp exactly: a sum of times and back is not that.
                tidy = tidy_at(own if time == stamp else own + (time - stamp))
                return self._dressed(tidy, number)

            yield stamp, at

    def _frame(self, index: int, timestamp: float, scene_at: SceneAt, crew: Crew) -> Frame:
        """The frame before it is recorded."""
        noise = self._rng(_NOISE, index)
        scene = scene_at(timestamp)
        stamps, shutters = self._exposures(timestamp, scene, scene_at, crew)
        shots: list[CameraShot] = [
            shoot(self.renderer, scenes, unit.at(stamp), self._quality, noise)
            for scenes, unit, stamp in zip(shutters, crew.units, stamps.tolist(), strict=True)
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
            calibrated=crew.calibrated,
            stamps=stamps,
            scenes=tuple(scene if stamp == timestamp else scene_at(stamp) for stamp in stamps.tolist()),
            alone=tuple(shot.alone for shot in shots),
        )

    def _exposures(
        self, timestamp: float, scene: PlatformScene, scene_at: SceneAt, crew: Crew
    ) -> tuple[FloatArray, list[tuple[PlatformScene, ...]]]:
        """When each camera takes its picture, and what there is while its shutter is open."""
        stamps, timing = np.full(len(self.rig), timestamp), crew.timing
        if timing is None:
            return stamps, [(scene,)] * len(self.rig)
        stamps = timing.stamps(timestamp)
        half = 0.5 * timing.exposure
        shutters: list[tuple[PlatformScene, ...]] = []
        for stamp, camera in zip(stamps.tolist(), self.rig, strict=True):
            focal = float(camera.matrix[0, 0])
            first, last = scene_at(stamp - half), scene_at(stamp + half)
            if max(motion_px(first, scene, focal), motion_px(last, scene, focal)) <= STILL:
                shutters.append((scene,))
                continue
            times = timing.shutter(stamp, motion_px(first, last, focal))
            shutters.append(tuple(scene_at(time) for time in times))
        return stamps, shutters

    def _recorded(self, frame: Frame, before: list[tuple[Image, ...]], crew: Crew) -> Frame:
        """The frame as it comes out of a recording in which those pictures came before."""
        images = crew.recorded([*before, frame.images], raw=self.options.raw)
        return dataclasses.replace(frame, images=images)


def _emptied(scene_at: SceneAt, time: float) -> PlatformScene:
    return scene_at(time).emptied()


def frames(
    object_name: str,
    count: int,
    seed: int,
    *,
    rig: CameraRig | None = None,
    quality: str = "default",
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
        sequence: a motion, instead of single scenes.
        size: height of the pictures [px].
        first: number of the first frame.
        more: other fields of `FrameOptions`.

    Raises:
        TrackerError: an option is not valid, or robot meshes cannot be had.
    """
    options = FrameOptions(object_name, seed, quality, sequence, size, **more)
    with FrameMaker(options, rig) as maker:
        numbers = range(first, first + count)
        for chunk, part in itertools.groupby(numbers, lambda number: number // options.chunk):
            chosen = list(part)
            yield from itertools.islice(maker.chunk(chunk, chosen), len(chosen))
