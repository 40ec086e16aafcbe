"""Pictures of a cube that moves or rests, and cameras that are not where their files have them."""

import dataclasses
import functools

import numpy as np

from synthetic.camera.sensor import Sensor
from tests.helpers import RIG, misplaced
from tests.helpers.kept_stills import take
from tests.helpers.stills import Still, posed_scene
from tracker import CameraRig, load_object
from tracker.conventions import FloatArray
from tracker.geometry import so3

COUNT = 27


@functools.cache
def carried() -> tuple[Still, ...]:
    """Pictures of different poses in the air, drawn once."""
    rng, model, stills = np.random.default_rng(21), load_object("cube_v2"), []
    for _ in range(COUNT):
        angle, distance = rng.uniform(0, 2 * np.pi), 0.12 * np.sqrt(rng.random())
        place = np.array([distance * np.cos(angle), distance * np.sin(angle), rng.uniform(0.06, 0.12)])
        turn = so3.matrix_from_quaternion(rng.normal(size=4))
        stills.append(take(posed_scene(model, (place, turn), rng), RIG.cameras, Sensor.realistic(), rng))
    return tuple(stills)


def knocked(rig: CameraRig, seed: int) -> CameraRig:
    """The rig with cameras that are off by about 2 mm and 0.3° along each axis."""
    rng = np.random.default_rng(seed)
    cameras = tuple(misplaced(camera, rng, 2e-3, np.radians(0.3)) for camera in rig)
    return dataclasses.replace(rig, cameras=cameras)


def relative_errors(found: CameraRig, true: CameraRig) -> FloatArray:
    """(C, 6) by how much cameras are off against the mean of all [m, rad], along world axes."""
    errors = []
    for one, other in zip(found, true, strict=True):
        moved = np.linalg.inv(one.camera_from_world) @ other.camera_from_world
        errors.append([*moved[:3, 3], *so3.log(moved[:3, :3])])
    return np.array(errors) - np.mean(errors, axis=0)


PLACES = ((-0.08, 0.03), (0.02, 0.09), (0.07, -0.05), (-0.03, -0.08), (0.0, 0.01), (0.1, 0.05))


@functools.cache
def rests() -> tuple[Still, ...]:
    """Pictures of each place, drawn once."""
    rng, model = np.random.default_rng(15), load_object("cube_v2")
    poses = [(np.array([*place, 0.0325]), so3.exp([0, 0, k])) for k, place in enumerate(PLACES)]
    return tuple(take(posed_scene(model, pose, rng), RIG.cameras, Sensor.realistic(), rng) for pose in poses)
