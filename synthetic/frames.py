"""Frames of the simulated platform in memory: images, label maps and exact ground truth.

A frame depends on the seed and its number alone: not on how many frames are made, in which order, or by how
many workers. Frames of a sequence come in chunks of one length; each is a separate motion, simulated from its
start.
"""

import dataclasses
import functools
import itertools
from collections.abc import Container, Iterable, Iterator
from typing import Any

import numpy as np

from synthetic.camera.miscalibration import Calibrated
from synthetic.camera.rigs import sized, standard_rig
from synthetic.camera.sensor import PATHS
from synthetic.camera.shot import QUALITIES, CameraShot, Quality, shoot
from synthetic.camera.units import STILL, Crew, crew_of, motion_px
from synthetic.closing import Closing
from synthetic.effects import chosen_effects, stream
from synthetic.scene import ObjectState, PlatformScene, SceneAt
from synthetic.world.effects import still_at, with_effects
from synthetic.world.look_alikes import KINDS, look_alike
from synthetic.world.platform import DICE, Platform
from synthetic.world.scenes import random_scene
from tracker.calibration.rig import CameraRig
from tracker.checks import is_number, is_whole
from tracker.conventions import Array, FloatArray, Image
from tracker.errors import TrackerError, shown
from tracker.geometry import so3

CHUNK = 100
"""Default number of frames of one motion in a sequence."""

PERIOD = 0.1
"""Interval between the timestamps of single scenes [s]."""

EMPTY_SHARE = 0.05
"""Default share of single scenes without an object."""

_SCENE, _CAMERAS, _NOISE = range(3)
"""Random streams of one seed."""


class DatasetError(TrackerError):
    """Frames cannot be made, or a folder cannot hold them."""


@dataclasses.dataclass(frozen=True)
class FrameOptions:
    """Everything that determines the pixels of all frames, except the cameras."""

    object_name: str
    """cube_v1 … cuboid_2x2x8_v2, a file for `tracker.load_object`, or `dice`."""
    seed: int
    """Seed of all randomness."""
    quality: str = "default"
    """`fast`, `default` or `best`."""
    sequence: bool = False
    """Frames follow each other in time; otherwise every frame is a separate scene."""
    size: int = 270
    """Height of the images [px], 270 or 540."""
    rate: float = 10.0
    """Frame rate of a sequence [Hz]."""
    kind: str | None = None
    """Kind of the single scenes, or of a sequence's motions; None: drawn."""
    dropped: float = 0.02
    """Probability that a frame of a sequence is missing."""
    path: str | None = None
    """How the images are recorded, see `Sensor.path`; None: drawn."""
    shadows: bool | None = None
    """Whether lamps cast shadows; None: by the quality."""
    empty: float = EMPTY_SHARE
    """Share of single scenes without an object."""
    length: int = CHUNK
    """Number of frames of one motion in a sequence."""
    effects: tuple[str, ...] = ()
    """Effects in the images, of `synthetic.effects.NAMES`."""

    look_alike: str | None = None
    """Kind of look-alike in the object's place, of `synthetic.world.look_alikes.KINDS`; None: the object."""
    raw: bool = False
    """Return the mosaics (H, W) that cameras record. Only for size 540, where they are kept, or the path
    `old`, whose small images are mosaics again."""

    def __post_init__(self) -> None:
        valid = {
            "quality": tuple(QUALITIES), "size": (270, 540), "path": (None, *PATHS),
            "look_alike": (None, *KINDS),
        }  # fmt: skip
        for key, values in valid.items():
            if getattr(self, key) not in values:
                known = ", ".join(map(str, values))
                raise DatasetError(f"{key}: found {getattr(self, key)!r}, expected one of {known}")
        # In the order of NAMES, whatever the order in which they were given.
        object.__setattr__(self, "effects", chosen_effects(self.effects))
        if self.look_alike is not None and self.object_name == DICE:
            raise DatasetError("look_alike: found dice, expected a cube or cuboid")
        for key, least in (("seed", 0), ("length", 1)):
            number = getattr(self, key)
            if not is_whole(number) or number < least:
                raise DatasetError(f"{key}: found {shown(number)}, expected a whole number from {least}")
        limits = {"dropped": (0.0, 0.3, ""), "empty": (0.0, 1.0, ""), "rate": (0.1, 1000.0, " Hz")}
        for key, (low, high, unit) in limits.items():
            number = getattr(self, key)
            if not is_number(number) or not low <= number <= high:
                raise DatasetError(f"{key}: found {shown(number)}, expected {low:g} to {high:g}{unit}")
        if self.raw and self.size != 540 and self.path != "old":
            raise DatasetError(
                f"raw: found size {self.size}, expected 540 (or in Python path='old', found {self.path!r})"
            )

    @property
    def chunk(self) -> int:
        """Number of frames that must be made in order."""
        return self.length if self.sequence else 1


@dataclasses.dataclass(frozen=True, eq=False)
class Frame:
    """One image of each camera, and the ground truth."""

    index: int
    timestamp: float
    """[s]"""
    images: tuple[Image, ...]
    """(H, W, 3) uint8 BGR, distorted, as cameras return them; raw ones are RGGB mosaics (H, W)."""
    labels: tuple[Image, ...]
    """(H, W) uint8 label map, by majority: 0 other, 1 red … 6 yellow; of dice their number."""
    visible_fraction: FloatArray
    """(cameras,) share of the object's pixels that nothing else hides; 0 where there are none."""
    visible_px: Array
    """(cameras,) visible pixels of the object."""
    scene: PlatformScene
    """The scene itself, in the simulation's world."""
    calibrated: Calibrated
    """The true cameras and what their calibration states."""
    stamps: FloatArray
    """(cameras,) timestamp of each image: the middle of its exposure [s]; the latest is `timestamp`."""
    scenes: tuple[PlatformScene, ...]
    """The scene at each camera's timestamp."""
    alone: tuple[Image, ...]
    """(H, W) uint8 label map of the objects alone, without robot or surroundings."""

    @property
    def objects(self) -> tuple[ObjectState, ...]:
        """Exact states of the object or all dice at `timestamp`, in the calibrated world; empty: none."""
        return tuple(self.calibrated.in_calibrated_world(state) for state in self.scene.objects)

    @property
    def objects_at_stamps(self) -> tuple[tuple[ObjectState, ...], ...]:
        """Exact states of the objects at each camera's timestamp."""
        return tuple(
            tuple(self.calibrated.in_calibrated_world(state) for state in scene.objects)
            for scene in self.scenes
        )

    @property
    def rig(self) -> CameraRig:
        """The true cameras."""
        return self.calibrated.rig

    @property
    def given(self) -> CameraRig:
        """The calibration that a user is given."""
        return self.calibrated.given

    def truth(self) -> dict[str, Any]:
        """Return the entry for `ground_truth.json`."""
        cameras: dict[str, dict[str, Any]] = {}
        for c, camera in enumerate(self.rig):
            own = cameras[camera.name] = {
                "visible_fraction": float(self.visible_fraction[c]),
                "visible_px": int(self.visible_px[c]),
            }
            # True calibration if the stated one differs; timestamp and poses if they are the camera's own.
            if self.calibrated.calibrated_from_world is not None:
                for key in ("matrix", "distortion", "camera_from_world"):
                    own[key] = getattr(camera, key).tolist()
            if any(stamp != self.timestamp for stamp in self.stamps):
                own["timestamp"], own["object"] = float(self.stamps[c]), _told(self.objects_at_stamps[c])
        return {
            "frame": f"{self.index:06d}",
            "timestamp": self.timestamp,
            "object": _told(self.objects),
            "robot_position": np.asarray(self.scene.robot_position).tolist(),
            "cameras": cameras,
            "scene": self.scene.about,
        }


def _told(states: tuple[ObjectState, ...]) -> Any:
    """Return None, one pose, or the poses of all dice."""
    poses = [
        {
            "position": state.position.tolist(),
            "orientation_xyzw": so3.quaternion_from_matrix(state.rotation).tolist(),
        }
        for state in states
    ]
    return None if not poses else poses[0] if len(poses) == 1 else poses


class FrameMaker(Closing):
    """Makes the frames for one set of options; owns the simulation. A context manager."""

    def __init__(self, options: FrameOptions, rig: CameraRig | None = None) -> None:
        self.options = options
        self.rig = sized(rig or standard_rig(), options.size)
        self._quality: Quality = QUALITIES[options.quality]
        if options.shadows is not None:
            self._quality = dataclasses.replace(self._quality, shadows=options.shadows)
        self._platform = Platform(options.object_name)

    def close(self) -> None:
        """Free the simulation."""
        self._platform.close()

    def numbered(self, numbers: Iterable[int]) -> Iterator[Frame]:
        """Yield the frames with these increasing numbers."""
        for chunk, part in itertools.groupby(numbers, lambda number: number // self.options.chunk):
            chosen = set(part)
            yield from itertools.islice(self.chunk(chunk, chosen), len(chosen))

    def chunk(
        self, number: int, chosen: Container[int] | None = None, emptied: Container[int] = ()
    ) -> Iterator[Frame]:
        """Yield the frames of a chunk in order, or only those whose numbers are in `chosen`.

        Frames whose numbers are in `emptied` are also yielded without any object (after the first version if
        that is chosen), with the same light, fingers and noise.
        """
        crew = self._crew(number)
        first = number * self.options.chunk
        taken: list[tuple[Image, ...]] = []
        for index, (timestamp, scene_at) in enumerate(self._scenes(number), start=first):
            place = (index - first) % crew.group
            if place == 0:
                taken = []
            # In a group of compressed images, each needs those before it.
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

    def _dressed(self, tidy: PlatformScene, number: int) -> PlatformScene:
        """Return a scene with a look-alike, if one is chosen, and with effects."""
        kind, seed = self.options.look_alike, self.options.seed
        if kind is not None:
            tidy = look_alike(tidy, kind, stream("look_alike", seed, number))
        return with_effects(tidy, self.options.effects, seed, number)

    def _crew(self, number: int) -> Crew:
        """Draw the cameras of a chunk."""
        rng = self._rng(_CAMERAS, number)
        sensor = self._quality.sensor(rng, self.options.path, self.options.size)
        film = self.options.sequence
        return crew_of(self.rig, sensor, rng, self.options.effects, self.options.seed, number, film=film)

    def _rng(self, stream: int, number: int) -> np.random.Generator:
        return np.random.default_rng([self.options.seed, stream, number])

    def _scenes(self, number: int) -> Iterator[tuple[float, SceneAt]]:
        """Yield timestamps and, for each, the scene as a function of time."""
        options, rng = self.options, self._rng(_SCENE, number)
        if not options.sequence:
            present = bool(rng.random() >= options.empty)
            tidy = random_scene(self._platform, rng, object_present=present, kind=options.kind)
            stamp, scene = number * PERIOD, self._dressed(tidy, number)
            yield stamp, still_at(scene, stamp, options.effects, options.seed, number)
            return
        from synthetic.world.motion import film

        # Dropped frames need a longer simulation than the frames alone would.
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
                # At the stamp itself use its own time: adding and subtracting would round it.
                tidy = tidy_at(own if time == stamp else own + (time - stamp))
                return self._dressed(tidy, number)

            yield stamp, at

    def _frame(self, index: int, timestamp: float, scene_at: SceneAt, crew: Crew) -> Frame:
        """Return the frame before it is recorded."""
        noise = self._rng(_NOISE, index)
        scene = scene_at(timestamp)
        stamps, shutters = self._exposures(timestamp, scene, scene_at, crew)
        at_stamps = tuple(scene if stamp == timestamp else scene_at(stamp) for stamp in stamps.tolist())
        shots: list[CameraShot] = [
            shoot(scenes, unit.at(stamp), self._quality, noise, middle)
            for scenes, unit, stamp, middle in zip(
                shutters, crew.units, stamps.tolist(), at_stamps, strict=True
            )
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
            calibrated=crew.calibrated,
            stamps=stamps,
            scenes=at_stamps,
            alone=tuple(shot.alone for shot in shots),
        )

    def _exposures(
        self, timestamp: float, scene: PlatformScene, scene_at: SceneAt, crew: Crew
    ) -> tuple[FloatArray, list[tuple[PlatformScene, ...]]]:
        """Return each camera's timestamp, and the scenes while its shutter is open."""
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
        """Return the frame as it comes out of a recording in which the images `before` came first."""
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
    first: int = 0,
    **more: Any,
) -> Iterator[Frame]:
    """Yield frames `first` … `first + count - 1` of the platform with this object.

    Args:
        object_name: cube_v1, cube_v2, cube_v3, cuboid_2x2x8_v2 or dice.
        count: number of frames.
        seed: seed of all randomness.
        rig: the cameras, scaled to the images' size; by default those of the simulated platform.
        first: number of the first frame.
        more: other fields of `FrameOptions`.

    Raises:
        TrackerError: an option is invalid, or the robot's meshes are not available.
    """
    with FrameMaker(FrameOptions(object_name, seed, **more), rig) as maker:
        yield from maker.numbered(range(first, first + count))
