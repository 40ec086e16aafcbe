"""Calibrations that are wrong: their world is not the table's, and cameras are not where they say.

What is defined by a calibration cannot be wrong: a world that floats above the table is a world all the
same, and truth is given in it. What cameras do not agree on are errors.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import cv2
import numpy as np

from synthetic.scene import ObjectState, direction, transform
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera

FLOAT, TILT = 0.006, np.radians(0.5)
"""Greatest height of the calibrated world's z = 0 above the table [m], and angle between them [rad]."""

FREEDOM = 3.0
"""Of Student's t, by which errors are drawn: one in 17 is beyond three scales, of a Gaussian one in 370."""

STATED = 4.8e-4, 2.7e-3
"""Typical standard deviations that calibrations state: of translations [m] and of turns [rad]
(scripts/fit_rigs.py)."""

FOCAL, ASPECT, CENTER, LENS, DECENTERING = 1e-3, 5e-4, 0.5, 0.01, 2e-4
"""Scales of the errors of focal length and of its ratio of both axes, of the principal point [px of 270], of
the second radial coefficient, which the others follow, and of both tangential ones."""

KNOCKED = 0.04
"""Share of cameras that were knocked since they were calibrated."""

KNOCK = 0.003, np.radians(0.5)
"""By so much, either moved [m] or turned [rad]."""

_BOARD = np.array([[x, y, 0.0] for x in np.linspace(-0.14, 0.14, 7) for y in np.linspace(-0.14, 0.14, 7)])
"""Where a board lay [m] when the cameras' poses were found, with their lenses as stated."""


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A rig as it is and as its calibration states it."""

    rig: CameraRig
    """The cameras as they truly are, in the calibrated world."""
    given: CameraRig
    """What a user is given."""
    calibrated_from_world: FloatArray | None = None
    """(4, 4) from the world of the simulation [m]; None: the same world."""

    def in_calibrated_world(self, state: ObjectState) -> ObjectState:
        """Where an object of the simulation is in the calibrated world, exactly."""
        if self.calibrated_from_world is None:
            return state
        rotation, shift = self.calibrated_from_world[:3, :3], self.calibrated_from_world[:3, 3]
        return ObjectState(state.name, rotation @ state.position + shift, rotation @ state.rotation)


def exactly(rig: CameraRig) -> Calibrated:
    """A calibration without any error."""
    return Calibrated(rig, rig)


def miscalibrated(rig: CameraRig, rng: np.random.Generator) -> Calibrated:
    """A wrong calibration of a rig that is given in the simulation's world."""
    height, angle, azimuth = rng.uniform(0.0, FLOAT), rng.uniform(0.0, TILT), rng.uniform(0.0, 2.0 * np.pi)
    turn = so3.exp(angle * direction(azimuth))
    floating = transform(turn, turn @ [0.0, 0.0, -height])
    back = np.linalg.inv(floating)
    true = [_posed(camera, camera.camera_from_world @ back) for camera in rig]
    own = dataclasses.replace(rig, cameras=tuple(true))
    return Calibrated(own, stated(own, rng), floating)


def stated(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """True cameras as one more calibration states them."""
    return dataclasses.replace(rig, cameras=tuple(_given(camera, rng) for camera in rig))


def _posed(camera: Camera, camera_from_world: FloatArray) -> Camera:
    """The camera elsewhere; products of transforms lose what rounding takes."""
    u, _, vt = np.linalg.svd(camera_from_world[:3, :3])
    return dataclasses.replace(camera, camera_from_world=transform(u @ vt, camera_from_world[:3, 3]))


def _given(camera: Camera, rng: np.random.Generator) -> Camera:
    """A camera as its calibration states it."""
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
        # About the camera itself: what it sees turns as a whole.
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
    """Errors of unit scale; those beyond eight would have been noticed."""
    return np.clip(rng.standard_t(FREEDOM, count), -8.0, 8.0)


def _with_wrong_lens(camera: Camera, rng: np.random.Generator) -> Camera:
    errors = _heavy(rng, 7)
    matrix, distortion = camera.matrix.copy(), camera.distortion.copy()
    matrix[(0, 1), (0, 1)] *= 1.0 + FOCAL * errors[0]
    matrix[1, 1] *= 1.0 + ASPECT * errors[1]
    matrix[:2, 2] += CENTER * camera.height / 270 * errors[2:4]
    # Radial coefficients are found together: scripts/fit_rigs.py.
    distortion[[0, 1, 4]] += LENS * errors[4] * np.array([-0.153, 1.0, -2.06])
    distortion[2:4] += DECENTERING * errors[5:7]
    return dataclasses.replace(camera, matrix=matrix, distortion=distortion)


def _with_board(true: Camera, stated: Camera) -> Camera:
    """`stated`, placed where a board seen by `true` shows it to be: a wrong lens puts a camera elsewhere."""
    rotation, translation = true.camera_from_world[:3, :3], true.camera_from_world[:3, 3]
    start, _ = cv2.Rodrigues(rotation.copy())
    pixels, _ = cv2.projectPoints(_BOARD, start, translation, true.matrix, true.distortion)
    _, turn, move = cv2.solvePnP(
        _BOARD, pixels, stated.matrix, stated.distortion, start.copy(), translation.reshape(3, 1).copy(), True
    )
    return _posed(stated, transform(cv2.Rodrigues(turn)[0], move.ravel()))
