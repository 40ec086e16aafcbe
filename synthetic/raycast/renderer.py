"""An exact ray-cast renderer of one cuboid before calibrated cameras: the independent reference of poses.

It shares no projection with the tracker. The rays through the pixels come from OpenCV's inverse of the
lens, iterated to convergence, and meet the scene's solids in closed form; a pixel's value is the mean over
the square of ±½ around its centre, which is at whole numbers.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import lru_cache

import cv2
import numpy as np

from synthetic.camera.rays import rays_of
from synthetic.camera.sensor import Sensor
from synthetic.raycast.fingers import Capsule, Motor
from synthetic.raycast.kernels import shadow_map, trace_image
from synthetic.raycast.records import CAPSULE, MOTOR, ROOM, VIEW, World
from synthetic.raycast.scene import ARENA_RADIUS, Scene
from synthetic.raycast.shading import FIRST_FACE, FIRST_MOTOR
from tracker.conventions import Array, FloatArray, Image
from tracker.geometry.camera import Camera
from tracker.objects.model import CuboidModel

_OBJECT_LATTICE, _OTHER_LATTICE = (55, 34), (21, 13)
"""Rays per pixel on an edge, of the object and of other things, and the step of their lattice: neighbouring
Fibonacci numbers spread evenly, and no two rays share a column or row."""

_SHADOW_CELLS = 112
_LAMP_DIRECTIONS = 32
_LAMP_HALF_ANGLE = np.radians(20.0)


@dataclass(frozen=True, eq=False)
class Rendering:
    """Pictures of a scene, one per camera, and the truth."""

    images: list[Image]
    """(H, W, 3) uint8, BGR."""
    labels: list[Image]
    """(H, W) uint8: the label of the face at the pixel's centre where it is visible, else 0."""
    coverage: list[Array]
    """(H, W) float32: the share of the pixel's square that the visible object covers."""
    visible_fraction: FloatArray
    """(cameras,) object pixels seen, of those seen without fingers; 0 where there are none."""
    position: FloatArray | None
    """(3,) the object's centre [m]; None without object."""
    rotation: FloatArray | None
    """(3, 3) world from object; None without object."""


def render(
    scene: Scene,
    cameras: tuple[Camera, ...] | list[Camera],
    model: CuboidModel,
    sensor: Sensor,
    rng: np.random.Generator,
) -> Rendering:
    """Pictures of `scene` by all cameras. `rng` draws the sensor's noise and gains, and nothing else."""
    world = _world(scene, model)
    label_of_code = np.zeros(256, dtype=np.uint8)
    label_of_code[FIRST_FACE : FIRST_FACE + 6] = model.face_labels

    images, labels, coverages, fractions = [], [], [], []
    many, few = _lattice_weights(*_OBJECT_LATTICE), _lattice_weights(*_OTHER_LATTICE)
    for camera in cameras:
        radiance, codes, bare, coverage = trace_image(world, _view(camera), _ray_nodes(camera), many, few)
        visible = (codes >= FIRST_FACE) & (codes < FIRST_MOTOR)
        images.append(sensor.expose(radiance, rng))
        labels.append(label_of_code[codes])
        coverages.append(coverage)
        fractions.append(visible.sum() / max(bare.sum(), 1))
    present = scene.rotation is not None
    return Rendering(
        images=images,
        labels=labels,
        coverage=coverages,
        visible_fraction=np.array(fractions),
        position=scene.position if present else None,
        rotation=scene.rotation,
    )


def _world(scene: Scene, model: CuboidModel) -> World:
    present = scene.rotation is not None
    background = scene.background
    room = np.zeros(1, ROOM)
    for source in (scene, background):
        for key in set(ROOM.names or ()).intersection(field.name for field in fields(source)) - {"rotation"}:
            room[key] = getattr(source, key)
    room["present"], room["rotation"] = present, scene.rotation if present else np.eye(3)
    room["half"], room["seed"], room["table_radius"] = model.size / 2, scene.texture_seed, ARENA_RADIUS
    world = World(
        room=room,
        capsules=_records(scene.fingers, CAPSULE),
        motors=_records(scene.motors, MOTOR),
        # A copy: the kernels are compiled for arrays that can be written to.
        blotches=background.blotches.copy(),
        lit=np.ones((2, 2)),
    )
    lit = shadow_map(world, _lamp_directions(scene.light), _SHADOW_CELLS)
    return world._replace(lit=cv2.GaussianBlur(lit, (0, 0), 1.0))


def _view(camera: Camera) -> Array:
    world_from_camera = np.linalg.inv(camera.camera_from_world)
    view = np.zeros(1, VIEW)
    view["eye"], view["rotation"] = world_from_camera[:3, 3], world_from_camera[:3, :3]
    return view


def _records(things: tuple[Capsule, ...] | tuple[Motor, ...], dtype: np.dtype[np.void]) -> Array:
    return np.array([tuple(getattr(thing, key) for key in dtype.names or ()) for thing in things], dtype)


def _lamp_directions(light: Array) -> FloatArray:
    """Unit vectors (N, 3) spread over a cone about the lamp's direction; below the horizon there is none."""
    n = np.arange(_LAMP_DIRECTIONS)
    radius = np.sin(_LAMP_HALF_ANGLE) * np.sqrt((n + 0.5) / _LAMP_DIRECTIONS)
    turn = n * np.pi * (3.0 - np.sqrt(5.0))
    side = np.cross(light, [1.0, 0.0, 0.0] if abs(light[0]) < 0.8 else [0.0, 1.0, 0.0])
    side /= np.linalg.norm(side)
    around = radius * np.cos(turn), radius * np.sin(turn), np.sqrt(1.0 - radius**2)
    directions = np.stack(around, axis=1) @ np.stack([side, np.cross(light, side), light])
    result: FloatArray = directions[directions[:, 2] > 0]
    return result


@lru_cache(maxsize=4)
def _lattice_weights(count: int, step: int) -> FloatArray:
    """Weights (count, 9) of a pixel's 3 × 3 nodes at rays evenly spread over the pixel.

    Between nodes half a pixel apart the rays are interpolated by parabolas; the next term of the lens's
    curvature is below 1e-5 px.
    """
    n = np.arange(count)
    offsets = (n + 0.5) / count - 0.5, ((n * step) % count + 0.5) / count - 0.5
    along_x, along_y = (np.stack([2 * s * s - s, 1 - 4 * s * s, 2 * s * s + s], axis=1) for s in offsets)
    weights: FloatArray = (along_y[:, :, None] * along_x[:, None, :]).reshape(count, 9)
    return weights


def _ray_nodes(camera: Camera) -> FloatArray:
    """Normalised coordinates (2H + 1, 2W + 1, 2) every half pixel, from the image's corner at (-½, -½)."""
    intrinsics = camera.matrix.tobytes(), camera.distortion.tobytes()
    return _cached_ray_nodes(camera.name, camera.width, camera.height, *intrinsics)


@lru_cache(maxsize=8)
def _cached_ray_nodes(name: str, width: int, height: int, matrix: bytes, distortion: bytes) -> FloatArray:
    k = np.frombuffer(matrix).reshape(3, 3)
    lens = np.frombuffer(distortion)
    u, v = np.meshgrid(np.arange(2 * width + 1) / 2 - 0.5, np.arange(2 * height + 1) / 2 - 0.5)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    nodes = rays_of(name, pixels, k, lens)
    return nodes.reshape(2 * height + 1, 2 * width + 1, 2)
