"""Camera poses in the world, from photos of a board that all cameras see.

The unknowns are the camera poses and all poses of the board but the first, which is given. The residuals of
all corners in all photos are fitted together:
    r = seen - project(camera_from_world · world_from_board · corner).
Lenses are not changed. The standard deviations of a camera's pose hold for its given lens and relative to the
board's given pose; an error of the given pose moves all cameras together.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from scipy.optimize import least_squares

from tracker.calibration.board.sighting import MANY_TIMES, BoardView, Optics, rms, without_wrong
from tracker.calibration.deviations import rotation_slopes
from tracker.calibration.files import Calibrated
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3

MOST_RMS = 1.5e-3
"""Largest RMS residual of a camera [focal lengths], 0.9 px at 590; if larger, it is another camera's lens."""

LEAST_RMS, SURENESS = 0.15, 8.0
"""Residual that every photo may have [px RMS], since prints and rendered boards are not exact either, and how
many residuals this counts for, since a few corners determine the variance badly."""

TRIED = 3
"""How many of the worst-fitting photos to try leaving out."""

Photo = tuple[int, int]
"""Numbers of a photo's camera and of its board pose."""

Photos = Mapping[Photo, BoardView]
"""Views of the board."""

Poses = Mapping[int, FloatArray]
"""Transforms (4, 4) by the number of a camera or of a board pose."""


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """Camera poses estimated from photos of a board."""

    cameras: tuple[Calibrated, ...]
    """The cameras in the order given, each with the standard deviations of its pose."""
    spreads: tuple[float, ...]
    """Standard deviations of the cameras' positions, over all axes [m]."""
    residuals: Mapping[Photo, FloatArray]
    """Residuals (N, 2) [px] of every photo with a board: observed minus fitted corners."""
    sightings: Photos
    """The views of the board, without outlying corners."""
    faults: Mapping[Photo, str]
    """The photos excluded from the fit, and what is wrong with each."""

    def rms(self, camera: int) -> float:
        """Return the RMS residual of a camera's photos that the fit uses [px]."""
        return rms([one for at, one in self.residuals.items() if at[0] == camera and at not in self.faults])


def place_cameras(lenses: Sequence[Calibrated], sightings: Photos, world_from_board: FloatArray) -> Placed:
    """Fit the poses of the cameras and of the board to photos of the board in several poses.

    The poses of `lenses` are ignored. `world_from_board` (4, 4) [m] is the board's pose number 0.

    Raises:
        CalibrationError: a photo differs in size from its lens's images, no chain of photos links a camera
            to the board's given pose, a camera's lens does not fit its photos, or two of its places do.
    """
    for (number, _), one in sightings.items():
        lens = lenses[number].camera
        if one.size != (lens.width, lens.height):
            raise CalibrationError(
                f"{one.photo}: found {one.size[0]}x{one.size[1]} px, but the lens of {lens.name} is of "
                f"images of {lens.width}x{lens.height} px"
            )
    # Remove outliers from every photo at its own best pose; at least two thirds of its corners must remain.
    views, optics = list(sightings.values()), [_optics(lenses[number]) for number, _ in sightings]

    def misses(views: Sequence[BoardView]) -> list[FloatArray]:
        return [one.least_misses(own) for one, own in zip(views, optics, strict=True)]

    cleaned = without_wrong(views, misses, [2 * len(one) / 3 for one in views]) if views else []
    photos, faults = dict(zip(sightings, cleaned, strict=True)), dict[Photo, str]()
    fit = _fitted(lenses, photos, world_from_board)
    used = photos
    while (odd := _odd_one(lenses, used, world_from_board, fit)) is not None:
        at, faults[at], fit = odd
        used = {other: one for other, one in used.items() if other != at}
    seen = {at: one for at, one in photos.items() if at[1] in fit.places}
    blocks = [fit.covariance[6 * n : 6 * n + 6, 6 * n : 6 * n + 6] for n in range(len(lenses))]
    moves = [np.hstack([so3.hat(fit.cameras[n][:3, 3]), np.eye(3)]) for n in range(len(lenses))]
    placed = Placed(
        tuple(_with_place(lens, fit.cameras[n], blocks[n]) for n, lens in enumerate(lenses)),
        tuple(float(np.sqrt(np.vdot(m, m @ block))) for m, block in zip(moves, blocks, strict=True)),
        _residuals(lenses, seen, fit.cameras, fit.places),
        photos,
        faults,
    )
    _require_fit(placed)
    _require_one_place(placed, fit.places)
    return placed


class _Fit(NamedTuple):
    """A fit to photos: camera_from_world of each camera, world_from_board of each place of the board."""

    cameras: Poses
    places: Poses
    covariance: FloatArray
    """Covariance of six unknowns per camera (ω, δt in exp(ω) R, t + δt), then six per further board pose."""
    squares: float
    """Sum of the squared residuals [px²]."""
    gains: Mapping[Photo, float]
    """About how much less it would be without each photo [px²]."""


def _fitted(
    lenses: Sequence[Calibrated], photos: Photos, world_from_board: FloatArray, near: _Fit | None = None
) -> _Fit:
    """Return the fit to photos; CalibrationError if they do not link all cameras to board pose 0.

    near: a fit from which to start; None: from the poses that single photos give.
    """
    cameras, places = _start(lenses, photos, world_from_board)
    if near is not None:
        cameras, places = dict(near.cameras), {place: near.places[place] for place in places}
    free = sorted(place for place in places if place != 0)

    def moved(unknowns: FloatArray) -> tuple[Poses, Poses]:
        steps = unknowns.reshape(-1, 6)
        further = {b: _step(places[b], steps[len(cameras) + n]) for n, b in enumerate(free)}
        return {n: _step(pose, steps[n]) for n, pose in cameras.items()}, {0: places[0], **further}

    def missed(unknowns: FloatArray) -> FloatArray:
        found = _residuals(lenses, photos, *moved(unknowns))
        return np.concatenate([one.ravel() for one in found.values()])

    def slopes(unknowns: FloatArray) -> FloatArray:
        now, turns = moved(unknowns), list(map(so3.left_jacobian, unknowns.reshape(-1, 6)[:, :3]))
        rows = []
        for (camera, place), one in photos.items():
            blocks = _slopes(one, now[0][camera], now[1][place], _optics(lenses[camera]))
            row = np.zeros((2 * len(one), len(unknowns)))
            numbers = [camera] if place == 0 else [camera, len(cameras) + free.index(place)]
            for n, block in zip(numbers, blocks, strict=False):  # the given place does not move
                row[:, 6 * n : 6 * n + 6] = np.hstack([block[:, :3] @ turns[n], block[:, 3:]])
            rows.append(row)
        return np.concatenate(rows)

    fit = least_squares(missed, np.zeros(6 * (len(cameras) + len(free))), slopes, method="lm")
    squares = float(fit.fun @ fit.fun)
    evidence = squares + SURENESS * LEAST_RMS**2 / 2.0
    variance = evidence / (max(len(fit.fun) - len(fit.x), 0) + SURENESS)
    inverse, gains, last = np.linalg.inv(fit.jac.T @ fit.jac), {}, 0
    for at, one in photos.items():
        first, last = last, last + 2 * len(one)
        slope, left = fit.jac[first:last], fit.fun[first:last]
        # Deleted residuals: those that a linear fit to the other photos would leave.
        deleted = np.linalg.lstsq(np.eye(len(left)) - slope @ inverse @ slope.T, left, rcond=1e-9)[0]
        gains[at] = float(left @ deleted)
    return _Fit(*moved(fit.x), inverse * variance, squares, gains)


def _slopes(
    one: BoardView, camera: FloatArray, place: FloatArray, optics: Optics
) -> tuple[FloatArray, FloatArray]:
    """Derivatives (2 N, 6) of a photo's residuals with respect to `_step`s of its camera and of its place."""
    pose = camera @ place
    turn = cv2.Rodrigues(pose[:3, :3])[0]
    _, by = cv2.projectPoints(one.points, turn, pose[:3, 3], *optics)
    by_point = -np.asarray(by)[:, 3:6].reshape(-1, 2, 3)  # with respect to the shift
    held = one.points @ place[:3, :3].T
    seen = (held + place[:3, 3]) @ camera[:3, :3].T
    by_place = by_point @ camera[:3, :3]
    by_camera = np.concatenate([by_point @ -so3.hat(seen), by_point], axis=2)
    by_place = np.concatenate([by_place @ -so3.hat(held), by_place], axis=2)
    return np.asarray(by_camera.reshape(-1, 6)), np.asarray(by_place.reshape(-1, 6))


def _residuals(
    lenses: Sequence[Calibrated], photos: Photos, cameras: Poses, places: Poses
) -> dict[Photo, FloatArray]:
    return {
        (camera, place): one.misses(cameras[camera] @ places[place], _optics(lenses[camera]))
        for (camera, place), one in photos.items()
    }


def _odd_one(
    lenses: Sequence[Calibrated], photos: Photos, world_from_board: FloatArray, fit: _Fit
) -> tuple[Photo, str, _Fit] | None:
    """Return the photo that the others contradict, what is wrong with it, and the fit without it; or None.

    Removing this photo lowers the sum of squares most, and by far more than its corners account for.
    Its own residuals are not a criterion: a `fit` to all photos spreads the error of one over many.
    """
    best: tuple[Photo, _Fit] | None = None
    left = TRIED
    for at in sorted(photos, key=lambda at: -fit.gains[at]):
        others = {other: kept for other, kept in photos.items() if other != at}
        if not others or left == 0:
            break
        try:
            rest = _fitted(lenses, others, world_from_board, fit)
        except CalibrationError:  # only this photo links some camera to the others
            continue
        left -= 1
        variance = max(rest.squares / sum(map(len, others.values())), LEAST_RMS**2)
        odd = fit.squares - rest.squares > MANY_TIMES**2 * variance * len(photos[at])
        if odd and (best is None or rest.squares < best[1].squares):
            best = at, rest
    if best is None:
        return None
    at, rest = best
    missed = float(np.sqrt((fit.squares - rest.squares) / len(photos[at])))
    usual = float(np.sqrt(rest.squares / sum(len(one) for other, one in photos.items() if other != at)))
    return at, f"with it all miss by {missed:.2f} px for each of its corners, without it {usual:.2f}", rest


def _optics(one: Calibrated) -> Optics:
    return one.camera.matrix, one.camera.distortion


def _step(pose: FloatArray, step: FloatArray) -> FloatArray:
    return so3.transform(so3.exp(step[:3]) @ pose[:3, :3], step[3:] + pose[:3, 3])


def _start(
    lenses: Sequence[Calibrated], photos: Photos, world_from_board: FloatArray
) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
    """Return initial camera and board poses, chained by photos, those with the most corners first."""
    poses = {at: one.pose(_optics(lenses[at[0]])) for at, one in photos.items()}
    cameras: dict[int, FloatArray] = {}
    places = {0: world_from_board}
    waiting = sorted(photos, key=lambda at: -len(photos[at]))
    while linked := [at for at in waiting if (at[0] in cameras) != (at[1] in places)]:
        camera, place = linked[0]
        if place in places:
            cameras[camera] = poses[camera, place] @ np.linalg.inv(places[place])
        else:
            places[place] = np.linalg.inv(cameras[camera]) @ poses[camera, place]
    lost = [lens.camera.name for n, lens in enumerate(lenses) if n not in cameras]
    if lost:
        raise CalibrationError(
            f"{', '.join(lost)}: found no photo of the board in its given place, nor one of another place "
            "that a camera with such a photo sees too"
        )
    return {n: cameras[n] for n in range(len(lenses))}, places


def _with_place(lens: Calibrated, camera_from_world: FloatArray, covariance: FloatArray) -> Calibrated:
    """Return the camera at its pose, with the element-wise deviations that follow from those of (ω, δt)."""
    std, turns = np.zeros((4, 4)), rotation_slopes(camera_from_world[:3, :3])
    std[:3, :3] = np.sqrt(np.einsum("aij,ab,bij->ij", turns, covariance[:3, :3], turns))
    std[:3, 3] = np.sqrt(np.diagonal(covariance)[3:])
    camera = dataclasses.replace(lens.camera, camera_from_world=camera_from_world, camera_from_world_std=std)
    return dataclasses.replace(lens, camera=camera, placed=True)


def _require_fit(placed: Placed) -> None:
    for number, one in enumerate(placed.cameras):
        limit = MOST_RMS * float(one.camera.matrix.diagonal()[:2].min())
        own = [at for at in placed.residuals if at[0] == number]
        refused = [placed.sightings[at].photo for at in own if at in placed.faults]
        if 2 * len(refused) >= len(own):
            which = f"{len(refused)} of its {len(own)} photos"
            found = f"{which} are contradicted by others ({', '.join(refused)})"
        elif not placed.rms(number) <= limit:
            found = f"its photos miss by {placed.rms(number):.2f} px RMS, expected at most {limit:.2f}"
        else:
            continue
        why = "the lens is not this camera's, the board moved between cameras, or is seen too flat"
        raise CalibrationError(f"{one.camera.name}: {found}: {why}")


def _require_one_place(placed: Placed, places: Poses) -> None:
    """Raise if the second pose of a camera's largest view of the board fits all its photos as well."""
    for number, one in enumerate(placed.cameras):
        own = [at for at in placed.residuals if at[0] == number and at not in placed.faults]
        largest = max(own, key=lambda at: len(placed.sightings[at]))
        board_from_world, optics = np.linalg.inv(places[largest[1]]), _optics(one)
        views, moves = [placed.sightings[at] for at in own], [board_from_world @ places[at[1]] for at in own]
        points = [view.points @ move[:3, :3].T + move[:3, 3] for view, move in zip(views, moves, strict=True)]
        pixels = [view.pixels for view in views]
        every = dataclasses.replace(views[0], points=np.concatenate(points), pixels=np.concatenate(pixels))
        found = one.camera.camera_from_world @ places[largest[1]]
        other = every.refined(placed.sightings[largest].poses(optics)[-1], optics)
        apart = float(np.linalg.norm(np.linalg.inv(other)[:3, 3] - np.linalg.inv(found)[:3, 3]))
        more = len(every.pixels) * (rms([every.misses(other, optics)]) ** 2 - placed.rms(number) ** 2)
        usual = max(placed.rms(number), LEAST_RMS)
        if apart > MANY_TIMES * placed.spreads[number] and more < (MANY_TIMES * usual) ** 2:
            raise CalibrationError(
                f"{one.camera.name}: two places {1000 * apart:.0f} mm apart fit its photos equally well: too "
                "little of the board is seen, or too small; expected it nearer, or also in other places"
            )
