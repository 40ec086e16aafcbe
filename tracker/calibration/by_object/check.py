"""Check whether a calibration fits: compare the poses in which the cameras see the same object; see `looks`.

Also predict the disagreement due to the stated deviations, and the depth error due to the focal length.

A camera k with error ξ_k (see `looks`) sees an object at P displaced by -G ξ_k. Relative to the pose that the
others see, camera c then sees it displaced by d = -Σ_k M_k G ξ_k, with M_c = I and M_k minus the share of
camera k in that pose. A corner moves by A d in the image, with A its Jacobian, so its expected squared
displacement under stated covariances Σ_k is the trace of A Σ_k (M_k G Σ_k Gᵀ M_kᵀ) Aᵀ.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.looks import OFTEN, CameraErrors, Look
from tracker.calibration.by_object.sightings import UNSEEN, Footage, observed, require_two, stays
from tracker.calibration.deviations import calibration_covariance, is_stated
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.geometry.cuboid import corners
from tracker.logs.log import evenly
from tracker.objects.model import CuboidModel
from tracker.pipeline import SAMPLE, ObjectTracker, another_shown
from tracker.pose.align import EXPECTED
from tracker.pose.fit import Fit
from tracker.pose.judge import ASTRAY, MIN_VIEW, apparent
from tracker.segmentation.color_model import ColorModel

FOCAL = 295.0
"""Focal length of the reference images in whose pixels all cameras are compared [px]."""

SQUARE = 0.003
"""Largest relative difference of a camera's focal lengths fx and fy; calibrations with a board give 0.001."""

DEPTH = 2e-3
"""Largest depth error of a single camera, which determines how accurate its focal length must be [m]."""

LIMIT = 1.6 / FOCAL
"""Largest median disagreement of the cameras [rad]: 1.6 px on the platform, 3 mm at half a metre."""

LOST = 0.6
"""A camera is reported if its image is unusable, though it should see the object, in this share of looks."""


@dataclass(frozen=True, eq=False)
class CameraCheck:
    """The result for one camera, by the names of `--json`; NaN if not measured.

    Corners are medians over the looks of the root mean square over the object's corners [px at FOCAL].
    """

    name: str
    looks: int
    """Number of looks in which it and at least one other camera see the object."""
    cannot_use: int
    """Number of looks in which it should see the object but its image is unusable."""
    miss_px: float
    """Median disagreement with the other cameras [px]."""
    moved: bool
    """Whether its pose has changed since the calibration; if only two see the object: that of one of them."""
    correction: FloatArray
    """Transform (4, 4) that reconciles it with the others: camera_from_world is correction · given."""
    shift_mm: float
    """Distance by which the correction moves the camera."""
    turn_deg: float
    """Angle by which the correction turns the camera."""
    corners_seen_px: float
    """How far it sees the corners from where the others see them."""
    corners_stated_px: float
    """The same as predicted from the deviations stated in the files; NaN if any file states none."""
    corners_shift_px: float
    """The part common to all corners of a look, due to the object's position."""
    corners_shape_px: float
    """The remainder, due to the object's size and rotation."""
    distance_m: float
    """Distance from the camera to the object, median over the looks."""
    focal_ratio: float
    """fy over fx."""
    focal_off_percent: float
    """Possible error of the focal length: the stated deviation, but at least half the difference of fx and
    fy; NaN if nothing is stated and these are equal."""
    focal_needed_percent: float
    """Accuracy of the focal length that keeps the depth error within DEPTH."""
    depth_off_mm: float
    """Error of the camera's depth due to that of its focal length."""


@dataclass(frozen=True, eq=False)
class CalibrationCheck:
    """The result for all cameras."""

    cameras: tuple[CameraCheck, ...]
    miss: float
    """Median over the looks of the cameras' root mean square disagreement [rad]; poor views do not count."""
    looks: int
    """Number of looks in which at least two cameras see the object."""
    misses: FloatArray
    """Disagreement (looks, C, 2) of each camera with the others [px], right and down; NaN if not measured."""

    @property
    def fits(self) -> bool:
        """Whether the calibration fits the images."""
        return self.miss <= LIMIT and not any(one.moved or self.is_lost(one) for one in self.cameras)

    @property
    def warnings(self) -> list[str]:
        """Cameras that could not be checked, and implausible values of the lenses, one line each."""
        return [
            f"{one.name}: not checked, it never sees the object: {UNSEEN}"
            for one in self.cameras
            if not (one.looks or one.moved or self.is_lost(one))
        ] + [
            f"{one.name}: fy/fx is {one.focal_ratio:.4f}, expected 1 within {100 * SQUARE:g} %: depths that "
            f"it sees alone may be off by {one.focal_off_percent:.1f} % of the distance"
            for one in self.cameras
            if abs(one.focal_ratio - 1.0) > SQUARE
        ]

    def is_lost(self, one: CameraCheck) -> bool:
        """Whether a camera's image is unusable in most looks."""
        return one.cannot_use >= max(OFTEN, LOST * len(self.misses))


def check_calibration(
    looks: Sequence[Look], cameras: Sequence[Camera], focal_std: Mapping[str, float] = {}
) -> CalibrationCheck:
    """Check a calibration of two or more cameras, given looks at still objects.

    focal_std: relative standard deviation of the focal length stated in a camera's file, by camera name.
    CalibrationError: there are too few looks.
    """
    compared = any(np.count_nonzero(look.information[:, 0, 0]) > 1 for look in looks)
    lost = sum((look.lost for look in looks), np.zeros(len(cameras), int))
    if not compared and lost.max() < max(OFTEN, LOST * len(looks)):
        raise CalibrationError(
            "check: found no set of images in which two cameras see the object still and in one place; "
            "expected one or more, preferably twenty; are object and calibration those of these images, "
            "and the cameras in their order?"
        )
    problem = CameraErrors(looks, cameras)
    free, errors = problem.moved()
    misses = problem.misses()
    expected = corner_misses(looks, cameras, problem)
    result = []
    for c, camera in enumerate(cameras):
        lengths = np.linalg.norm(misses[:, c], axis=1)
        asked = np.isfinite(lengths)
        distance, (seen, stated, shift, shape) = _median(problem.distance[asked, c]), expected[c]
        ratio = float(camera.matrix[1, 1] / camera.matrix[0, 0])
        off = max(abs(ratio - 1.0) / 2.0, focal_std.get(camera.name, 0.0)) or float("nan")
        result.append(
            CameraCheck(
                camera.name,
                int(np.count_nonzero(asked)),
                int(lost[c]),
                _median(lengths[asked]),
                c in free,
                *_correction(camera, errors[c]),
                corners_seen_px=seen,
                corners_stated_px=stated,
                corners_shift_px=shift,
                corners_shape_px=shape,
                distance_m=distance,
                focal_ratio=ratio,
                focal_off_percent=100.0 * off,
                focal_needed_percent=100.0 * DEPTH / distance,
                depth_off_mm=1e3 * off * distance,
            )
        )
    count = int(np.isfinite(misses).any(axis=(1, 2)).sum())
    return CalibrationCheck(tuple(result), _median_miss(misses, problem), count, misses)


def corner_misses(
    looks: Sequence[Look], cameras: Sequence[Camera], problem: CameraErrors
) -> list[list[float]]:
    """Return each camera's displacement of the object's corners: seen, stated, shift and shape [px]."""
    stated = all(map(is_stated, cameras))
    covariances = np.array([calibration_covariance(one) for one in cameras])
    result = []
    for c, camera in enumerate(cameras):
        rows = []
        for f in np.flatnonzero(problem.compared[:, c]).tolist():
            look, shares = looks[f], problem.shares[f, c]
            # The corners' Jacobian (2 N, 6) in the image with respect to the object's pose [px at FOCAL].
            _, jacobian = camera.project_with_jacobian(look.corners)
            swing = -so3.hat(look.corners - look.position)
            motion = np.concatenate([jacobian, jacobian @ swing], axis=2)
            motion *= FOCAL / problem.focal[c, :, None]
            motion = motion.reshape(-1, 6)
            moves = (motion @ np.einsum("kij,kj->i", shares, look.moved)).reshape(-1, 2)
            shift = moves.mean(axis=0)
            feigned = motion @ shares @ problem.lever[f]
            expected = np.einsum("kni,kij,knj->", feigned, covariances, feigned) / len(moves)
            seen, shape = ((part**2).sum(1).mean() for part in (moves, moves - shift))
            rows.append([seen, expected if stated else np.nan, shift @ shift, shape])
        found = np.sqrt(np.median(rows, axis=0)) if rows else np.full(4, np.nan)
        result.append(found.tolist())
    return result


def _median(values: FloatArray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _median_miss(misses: FloatArray, problem: CameraErrors) -> float:
    """Return the median over the looks of the root mean square over the cameras [rad].

    Views that are as uncertain as LIMIT count only if there are no others.
    """
    squares = ((misses / problem.focal) ** 2).sum(axis=2)
    for one in (np.where(problem.noise() < LIMIT, squares, np.nan), squares):
        asked = np.isfinite(one).sum(axis=1) > 1
        if asked.any():
            return float(np.median(np.sqrt(np.nanmean(one[asked], axis=1))))
    return 0.0


def _correction(camera: Camera, error: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the transform that undoes an error (a, w) of camera_from_world, its shift [mm] and turn [°]."""
    rotation = camera.camera_from_world[:3, :3]
    turn, shift = so3.exp(-rotation @ error[3:]), camera.camera_from_world[:3, 3]
    back = so3.transform(turn, shift - rotation @ error[:3] - turn @ shift)
    true = back @ camera.camera_from_world
    place = -true[:3, :3].T @ true[:3, 3]
    return (
        back,
        1e3 * float(np.linalg.norm(place - camera.position)),
        float(np.degrees(np.linalg.norm(error[3:]))),
    )


MOST, APART = 40, 5
"""Largest number of looks per recording or list of images, and smallest distance between two [shots]."""

LOOK_CONFIDENCE = 0.3
"""Smallest confidence of a pose that becomes a look, computed as if the calibration fitted; otherwise, few
poses would reach it."""


def check(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    progress: Callable[[int], None] = lambda _: None,
    focal_std: Mapping[str, float] = {},
) -> CalibrationCheck:
    """Check a calibration with recordings and stills of an object.

    `progress` receives the number of shots read since the last call; `focal_std`: see `check_calibration`.
    CalibrationError: there is only one camera, or the object was never seen still.
    """
    require_two(rig.cameras, "check")
    tracker = ObjectTracker(model, rig, colors, table_prior=False)
    looks: list[Look] = []
    for one in footage:
        numbers = evenly(list(_still(tracker, one, progress)), MOST)
        if another := another_shown(tracker, list(one.images(evenly(numbers, SAMPLE)))):
            raise CalibrationError(another)
        for images in one.images(numbers):
            fit = tracker.fit(images)
            if isinstance(fit, Fit) and fit.own is not None and apparent(fit) >= LOOK_CONFIDENCE:
                looks.append(look_of(fit, model.size))
    return check_calibration(looks, rig.cameras, focal_std)


def look_of(fit: Fit, size: FloatArray) -> Look:
    """Return the look at a fitted cuboid of `size` (3,) [m]: the poses that the cameras separately see."""
    assert fit.own is not None
    seen = fit.cameras
    used = fit.own.inliers >= MIN_VIEW
    shown = seen["agree"] + seen["wrong"] + seen["extra"]
    enough = np.maximum(EXPECTED, ASTRAY * seen["predicted"])
    lost = ~used & (seen["predicted"] >= EXPECTED) & (shown > enough)
    lost[list(fit.left_out)] = True
    known = np.where(used[:, None, None], fit.own.information, 0.0)
    return Look(fit.position, known, fit.own.moved, lost, corners(size) @ fit.rotation.T + fit.position)


def _still(tracker: ObjectTracker, footage: Footage, progress: Callable[[int], None]) -> Iterator[int]:
    """Yield the numbers of the shots in which the object is at rest; stills always count."""
    last, now = -APART, None
    for shot, found in observed(tracker, footage):
        progress(1)
        if shot.begins:
            last, now = -APART, None
        if found is not None:
            before, now = now, found.filtered_object_pose
            if found.object_pose is None or not stays(before, now) or shot.number < last + APART:
                continue
        last = shot.number
        yield shot.number
