"""Does a calibration fit? Compares where each camera alone sees an object that all see; see `looks`.

It also says what misses a calibration's stated deviations predict, and what a lens leaves open.

A camera k whose error is ξ_k (see `looks`) sees an object at P moved by -G ξ_k. Against the pose of the
others camera c then sees it moved by d = -Σ_k M_k G ξ_k, with M_c = 1 and M_k the share of k in that pose,
negative. A corner moves by A d in the picture, with A its Jacobian, so what stated covariances Σ_k predict
of its square is the trace of A Σ_k (M_k G Σ_k Gᵀ M_kᵀ) Aᵀ.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.looks import OFTEN, CameraErrors, Look
from tracker.calibration.by_object.sightings import Footage, require_two, slow
from tracker.calibration.deviations import calibration_covariance, is_stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.logs.log import evenly
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.estimate import USED
from tracker.pose.fit import Fit
from tracker.pose.judge import ASTRAY, EXPECTED, apparent
from tracker.pose.result import Status
from tracker.segmentation.color_model import ColorModel

FOCAL = 295.0
"""Focal length of the pictures in whose pixels cameras are compared, whatever their own [px]."""

SQUARE = 0.003
"""Share by which the two focal lengths of a camera may differ: those of a board's photos differ by 0.001."""

DEPTH = 2e-3
"""Error of one camera's depth for which the needed accuracy of its focal length is given [m]."""


@dataclass(frozen=True)
class Corners:
    """By how much a camera misses the object's corners where the others have them.

    Of each look the root mean square over the corners, of those the median [px at FOCAL]; NaN: not asked.
    """

    seen: float
    """What the looks show."""
    shift: float
    """The part of it that the corners of a look have in common: where the object is."""
    shape: float
    """The rest: how large the object is, and how it is turned."""
    stated: float
    """What the deviations that the cameras' files state predict; NaN where one states none."""


@dataclass(frozen=True)
class FocalCheck:
    """What a focal length leaves open of the depth that a camera alone sees."""

    ratio: float
    """Of the focal lengths, fy over fx."""
    off: float
    """Share by which the focal length may be off: the deviation that the camera's file states, at least half
    of what the two focal lengths differ by."""
    distance: float
    """From the camera to the object, median over the looks [m]; NaN: not asked."""

    @property
    def depth(self) -> float:
        """Error of the camera's depth that follows [m]."""
        return self.off * self.distance

    @property
    def needed(self) -> float:
        """Share to which the focal length must be right for an error of DEPTH."""
        return DEPTH / self.distance


LIMIT = 1.6 / FOCAL
"""Angle [rad] by which cameras may miss what the others see, in the median over looks: 1.6 px on the
platform, 3 mm at half a metre."""

LOST = 0.6
"""Share of the looks in which a camera should see the object and cannot use it, from which on it is named."""


@dataclass(frozen=True, eq=False)
class CameraCheck:
    """What the looks say of one camera."""

    name: str
    looks: int
    """In which it sees the object."""
    lost: int
    """In which it should, and cannot use what it shows."""
    miss_px: float
    """Median miss of what the others see [px]; NaN where it was not asked."""
    moved: bool
    """Whether it is not where the calibration has it."""
    correction: FloatArray
    """(4, 4) what reconciles it with the others: camera_from_world is correction · given."""
    shift: float
    """Length of the correction of the camera's place [m], …"""
    turn: float
    """… and its angle [rad]."""
    corners: Corners
    """What it misses of the corners, and what was to be expected."""
    focal: FocalCheck
    """What its focal length leaves open."""


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """Whether a calibration fits."""

    cameras: tuple[CameraCheck, ...]
    miss: float
    """Median over the looks of the cameras' root mean square miss [rad]."""
    looks: int
    misses: FloatArray
    """(looks, C, 2) by which each camera misses what the others see [px], right and down; NaN: not asked."""

    @property
    def fits(self) -> bool:
        """Whether the calibration fits the pictures."""
        return self.miss <= LIMIT and not any(one.moved or self.is_lost(one) for one in self.cameras)

    @property
    def warnings(self) -> list[str]:
        """What the lenses' files say that is hardly true, a line each."""
        return [
            f"{one.name}: fy/fx is {one.focal.ratio:.4f}, expected 1 within {100 * SQUARE:g} %: depths that "
            f"it sees alone may be off by {1e3 * one.focal.depth:.1f} mm"
            for one in self.cameras
            if abs(one.focal.ratio - 1.0) > SQUARE
        ]

    def is_lost(self, one: CameraCheck) -> bool:
        """Whether a camera cannot use what it shows, as a rule."""
        return one.lost >= max(OFTEN, LOST * self.looks)


def check_calibration(
    looks: Sequence[Look], cameras: Sequence[Camera], focal_std: Mapping[str, float] = {}
) -> CalibrationCheck:
    """Judge a calibration of two cameras or more by looks at still objects.

    focal_std: by the camera's name, the deviation of the focal length that its file states [itself].
    CalibrationError: there are too few cameras or looks.
    """
    require_two(cameras, "check")
    if not looks:
        raise CalibrationError(
            "check: found no picture in which two cameras see the object still; expected one or more, better "
            "twenty"
        )
    problem = CameraErrors(looks, cameras)
    free = problem.moved()
    errors = problem.solve(free)[0]
    misses = problem.misses()
    expected = corner_misses(looks, cameras, problem)
    result = []
    for c, camera in enumerate(cameras):
        lengths = np.linalg.norm(misses[:, c], axis=1)
        asked = np.isfinite(lengths)
        correction, shift, turn = _correction(camera, errors[c])
        result.append(
            CameraCheck(
                camera.name,
                int(np.count_nonzero(asked)),
                int(sum(bool(look.lost[c]) for look in looks)),
                float(np.median(lengths[asked])) if asked.any() else float("nan"),
                c in free,
                correction,
                shift,
                turn,
                expected[c],
                focal_check(camera, problem.distance[asked, c], focal_std),
            )
        )
    return CalibrationCheck(tuple(result), _median_miss(misses, cameras), len(looks), misses)


def corner_misses(looks: Sequence[Look], cameras: Sequence[Camera], problem: CameraErrors) -> list[Corners]:
    """What each camera misses of the corners, and what was to be expected."""
    stated = all(map(is_stated, cameras))
    covariances = np.array([calibration_covariance(one) for one in cameras])
    result = []
    for c, camera in enumerate(cameras):
        rows = []
        for f, look in enumerate(looks):
            shares = problem.shares(f, c)
            if shares is None:
                continue
            motion = _corner_motion(camera, look)
            moves = (motion @ np.einsum("kij,kj->i", shares, look.moved)).reshape(-1, 2)
            shift = moves.mean(axis=0)
            feigned = motion @ shares @ problem.lever[f]
            expected = np.einsum("kni,kij,knj->", feigned, covariances, feigned) / len(moves)
            rows.append(
                [(moves**2).sum(1).mean(), shift @ shift, ((moves - shift) ** 2).sum(1).mean(), expected]
            )
        found = np.sqrt(np.median(rows, axis=0)) if rows else np.full(4, np.nan)
        if not stated:
            found[3] = np.nan
        result.append(Corners(*found.tolist()))
    return result


def focal_check(camera: Camera, distances: FloatArray, focal_std: Mapping[str, float]) -> FocalCheck:
    """What a camera's lens leaves open at distances (N,) [m]; `focal_std`: see `check_calibration`."""
    ratio = float(camera.matrix[1, 1] / camera.matrix[0, 0])
    off = max(abs(ratio - 1.0) / 2.0, focal_std.get(camera.name, 0.0))
    return FocalCheck(ratio, off, float(np.median(distances)) if len(distances) else float("nan"))


def _corner_motion(camera: Camera, look: Look) -> FloatArray:
    """(2 N, 6) motion of a look's corners in a camera's picture with the object's pose [px at FOCAL]."""
    _, jacobian = camera.project_with_jacobian(look.corners)
    swing = np.stack([-so3.hat(arm) for arm in look.corners - look.position])
    motion = np.concatenate([jacobian, jacobian @ swing], axis=2)
    motion *= FOCAL / camera.matrix[(0, 1), (0, 1)][:, None]
    return np.asarray(motion.reshape(-1, 6))


def _median_miss(misses: FloatArray, cameras: Sequence[Camera]) -> float:
    """Median over the looks of the root mean square over the cameras [rad]."""
    focal = np.array([np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]) for camera in cameras])
    squares = ((misses / focal[:, None]) ** 2).sum(axis=2)
    asked = np.isfinite(squares).sum(axis=1) > 1
    return float(np.median(np.sqrt(np.nanmean(squares[asked], axis=1)))) if asked.any() else 0.0


def _correction(camera: Camera, error: FloatArray) -> tuple[FloatArray, float, float]:
    """What undoes an error (a, w) of camera_from_world; how far it moves [m] and turns [rad] the camera."""
    rotation = camera.camera_from_world[:3, :3]
    back = np.eye(4)
    back[:3, :3] = so3.exp(-rotation @ error[3:])
    back[:3, 3] = camera.camera_from_world[:3, 3] - rotation @ error[:3]
    back[:3, 3] -= back[:3, :3] @ camera.camera_from_world[:3, 3]
    true = back @ camera.camera_from_world
    place = -true[:3, :3].T @ true[:3, 3]
    return back, float(np.linalg.norm(place - camera.position)), float(np.linalg.norm(error[3:]))


MOST = 40
"""Looks at a film, at most."""

APART = 5
"""Shots from one look at an object in the same place to the next."""

SURE = 0.3
"""Probability that a pose is the object, if the calibration fits, from which it is looked at: where it does
not, few are."""


def check(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    progress: Callable[[int], None] = lambda _: None,
    focal_std: Mapping[str, float] = {},
) -> CalibrationCheck:
    """Whether a calibration fits films and stills of an object.

    `progress` takes how many more shots were seen; `focal_std`: see `check_calibration`. CalibrationError:
    there is one camera only, or the object was never seen still.
    """
    tracker = ObjectTracker(model, rig, colors, table_prior=False)
    looks: list[Look] = []
    for one in footage:
        chosen = list(_still(tracker, one, progress))
        for images in one.images([chosen[k] for k in evenly(len(chosen), MOST)]):
            fit = tracker.fit(images)
            if isinstance(fit, Fit) and fit.own is not None and apparent(fit) >= SURE:
                looks.append(look_of(fit, model.size))
    return check_calibration(looks, rig.cameras, focal_std)


def look_of(fit: Fit, size: FloatArray) -> Look:
    """What the cameras by themselves say of a pose of a cuboid of `size` (3,) [m]."""
    assert fit.own is not None
    seen = fit.cameras
    used = fit.own.inliers >= USED
    shown = seen["agree"] + seen["wrong"] + seen["extra"]
    enough = np.maximum(ASTRAY[0], ASTRAY[1] * seen["predicted"])
    lost = ~used & (seen["predicted"] >= EXPECTED) & (shown > enough)
    lost[list(fit.left_out)] = True
    known = np.where(used[:, None, None], fit.own.information, 0.0)
    return Look(fit.position, known, fit.own.moved, lost, corners(size) @ fit.rotation.T + fit.position)


def _still(tracker: ObjectTracker, footage: Footage, progress: Callable[[int], None]) -> Iterator[int]:
    """Numbers of the shots that show the object still; stills do."""
    tracker.reset()
    last = -APART
    for shot in footage.shots():
        progress(1)
        if shot.begins:
            tracker.reset()
            last = -APART
        if all(image is None for image in shot.images):
            continue
        if shot.stamps is not None:
            found = tracker.update(shot.images, shot.stamps.tolist())
            state = found.filtered_object_pose
            if found.object_pose is None or state is None or found.status in (Status.FOUND, Status.REFOUND):
                continue
            if not slow(state.velocity) or shot.number < last + APART:
                continue
        last = shot.number
        yield shot.number
