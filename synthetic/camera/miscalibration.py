"""Wrong calibrations: their world frame is not the table's, and the stated cameras differ from the true ones.

A calibration defines its world frame, so that frame cannot be wrong even if it floats above the table: ground
truth is given in it. Only disagreements between cameras are errors.
"""

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from synthetic.scene import ObjectState, direction
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

FLOAT, TILT = 0.006, np.radians(0.5)
"""Largest height of the calibrated world's z = 0 above the table [m], and largest tilt between them [rad]."""

FREEDOM = 3.0
"""Degrees of freedom of Student's t for the errors: 1 in 17 exceeds three scales; of a Gaussian 1 in 370."""

STATED = 4.8e-4, 2.7e-3
"""Typical standard deviations that calibrations state: of translations [m] and of rotations [rad]
(scripts/fit_rigs.py)."""

FOCAL, ASPECT, CENTER, LENS, DECENTERING = 1e-3, 5e-4, 0.5, 0.01, 2e-4
"""Scales of the errors of the focal length (relative), of the ratio of both, of the principal point
[px at 270 px], of the second radial coefficient (the others follow it), and of both tangential ones."""

KNOCKED = 0.04
"""Share of cameras that were knocked after their calibration."""

KNOCK = 0.003, np.radians(0.5)
"""Size of a knock: either a translation [m] or a rotation [rad]."""

_BOARD = np.array([[x, y, 0.0] for x in np.linspace(-0.14, 0.14, 7) for y in np.linspace(-0.14, 0.14, 7)])
"""Board points [m] by which the cameras' poses were calibrated, with their lenses as stated."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A true rig and what its calibration states."""

    rig: CameraRig
    """The true cameras, in the calibrated world."""
    given: CameraRig
    """The cameras as stated by the calibration, which a user is given."""
    calibrated_from_world: FloatArray | None = None
    """(4, 4) transform from the simulation's world [m]; None: both worlds are the same."""

    def in_calibrated_world(self, state: ObjectState) -> ObjectState:
        """Return the exact pose of a simulated object in the calibrated world."""
        if self.calibrated_from_world is None:
            return state
        rotation, shift = self.calibrated_from_world[:3, :3], self.calibrated_from_world[:3, 3]
        return ObjectState(state.name, rotation @ state.position + shift, rotation @ state.rotation)


def miscalibrated(rig: CameraRig, rng: np.random.Generator) -> Calibrated:
    """Draw a wrong calibration of a rig that is given in the simulation's world."""
    height, angle, azimuth = rng.uniform(0.0, FLOAT), rng.uniform(0.0, TILT), rng.uniform(0.0, 2.0 * np.pi)
    turn = so3.exp(angle * direction(azimuth))
    floating = so3.transform(turn, turn @ [0.0, 0.0, -height])
    back = np.linalg.inv(floating)
    true = [_posed(camera, camera.camera_from_world @ back) for camera in rig]
    own = dataclasses.replace(rig, cameras=tuple(true))
    return Calibrated(own, stated(own, rng), floating)


def stated(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Draw what one more calibration of the true cameras states."""
    return dataclasses.replace(rig, cameras=tuple(_given(camera, rng) for camera in rig))


def _posed(camera: Camera, camera_from_world: FloatArray) -> Camera:
    """Return the camera at another pose, whose rotation is made orthonormal again after rounding."""
    rotation = so3.nearest_rotation(camera_from_world[:3, :3])
    return dataclasses.replace(camera, camera_from_world=so3.transform(rotation, camera_from_world[:3, 3]))


def _given(camera: Camera, rng: np.random.Generator) -> Camera:
    """Draw what a calibration states of a camera."""
    turn_std = np.exp(rng.normal(0.0, 0.25)) * STATED[1]
    move_std = np.exp(rng.normal(0.0, 0.15)) * STATED[0]
    board = _with_board(camera, _with_wrong_lens(camera, rng))
    move, turn = move_std * _heavy(rng, 3), turn_std * _heavy(rng, 3)
    own = board.camera_from_world.copy()
    own[:3, :3] = so3.exp(turn) @ own[:3, :3]
    own[:3, 3] += move
    knocked, turned, axis = rng.random() < KNOCKED, rng.random() < 0.5, rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    if knocked and turned:
        # A rotation about the camera's centre: the whole image shifts.
        own[:3] = so3.exp(KNOCK[1] * axis) @ own[:3]
    elif knocked:
        own[:3, 3] += KNOCK[0] * axis
    std = camera.camera_from_world_std
    if std is None or not std.any():
        std = np.zeros((4, 4))
        turns = [so3.hat(unit) @ own[:3, :3] for unit in np.eye(3)]
        std[:3, :3] = turn_std * np.sqrt(np.sum(np.square(turns), axis=0))
        std[:3, 3] = move_std
    return dataclasses.replace(_posed(board, own), camera_from_world_std=std)


def _heavy(rng: np.random.Generator, count: int) -> FloatArray:
    """Draw heavy-tailed errors of unit scale, clipped at 8: larger ones would have been noticed."""
    return np.clip(rng.standard_t(FREEDOM, count), -8.0, 8.0)


def _with_wrong_lens(camera: Camera, rng: np.random.Generator) -> Camera:
    errors = _heavy(rng, 7)
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[(0, 1), (0, 1)] *= 1.0 + FOCAL * errors[0]
    matrix[1, 1] *= 1.0 + ASPECT * errors[1]
    matrix[:2, 2] += CENTER * camera.height / 270 * errors[2:4]
    # Radial coefficients are correlated: scripts/fit_rigs.py.
    distortion[[0, 1, 4]] += LENS * errors[4] * np.array([-0.153, 1.0, -2.06])
    distortion[2:4] += DECENTERING * errors[5:7]
    return dataclasses.replace(camera, matrix=matrix, distortion=distortion)


def _with_board(true: Camera, stated: Camera) -> Camera:
    """Return `stated` at the pose that a board seen by `true` gives: a wrong lens moves the camera's pose."""
    rotation, translation = true.camera_from_world[:3, :3], true.camera_from_world[:3, 3]
    start, _ = cv2.Rodrigues(rotation.copy())
    pixels, _ = cv2.projectPoints(_BOARD, start, translation, true.matrix, true.distortion)
    _, turn, move = cv2.solvePnP(
        _BOARD, pixels, stated.matrix, stated.distortion, start.copy(), translation.reshape(3, 1).copy(), True
    )
    return _posed(stated, so3.transform(cv2.Rodrigues(turn)[0], move.ravel()))
