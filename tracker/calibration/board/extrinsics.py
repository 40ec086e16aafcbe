"""Where cameras are in the world, from photos of a board that all of them look at.

Unknown are the cameras and all places of the board but the first, which is given; the residuals are those
of all corners in all photos together:
    r = seen - project(camera_from_world · world_from_board · corner).
Lenses are taken as they are. A deviation tells by how much a camera, with the lens of its file, may be off
relative to the board's given place; what that place itself is off by moves all cameras alike.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from tracker.calibration.board.sighting import MANY_TIMES, BoardView, Optics, rms, transform, without_wrong
from tracker.calibration.files.platform import Calibrated
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.geometry import so3

MOST_RMS = 1.5e-3
"""Largest RMS of a camera's photos [focal lengths], 0.9 px at 590: beyond it the lens is not the camera's."""

Photo = tuple[int, int]
"""Numbers of the camera and of the board's place."""

Poses = Mapping[int, FloatArray]
"""(4, 4) by the number of a camera or place."""


@dataclasses.dataclass(frozen=True, eq=False)
class Placed:
    """What photos of a board say of where cameras are."""

    cameras: tuple[Calibrated, ...]
    """In the order given, each with the standard deviations of its place."""
    world_from_board: tuple[FloatArray, ...]
    """(4, 4) places of the board, the first as given."""
    residuals: Mapping[Photo, FloatArray]
    """(N, 2) where corners are seen, less where the fit puts them [px], of every photo with a board."""
    sightings: Mapping[Photo, BoardView]
    """Without the corners that were dropped."""
    faults: Mapping[Photo, str]
    """What is wrong with the photos that the fit does not rest on."""

    def rms(self, camera: int) -> float:
        """Of a camera's photos that the fit rests on [px]."""
        return rms([one for at, one in self.residuals.items() if at[0] == camera and at not in self.faults])


def place_cameras(
    lenses: Sequence[Calibrated], sightings: Mapping[Photo, BoardView], world_from_board: FloatArray
) -> Placed:
    """Fit the places of cameras, and of the board, to photos of the board in several places.

    Where the `lenses` are is not used. `world_from_board` (4, 4) [m] is the board's place 0.

    Raises:
        CalibrationError: a photo is of another size than its lens, a camera cannot be linked to the
            board's given place, or a camera's lens does not fit its photos.
    """
    for (number, _), one in sightings.items():
        lens = lenses[number].camera
        if one.size != (lens.width, lens.height):
            raise CalibrationError(
                f"{one.photo}: found {one.size[0]}x{one.size[1]} px, but the lens of {lens.name} is of "
                f"images of {lens.width}x{lens.height} px"
            )
    residuals = [one.least_misses(_optics(lenses[number])) for (number, _), one in sightings.items()]
    views = list(sightings.values())
    # Each photo by itself; most of its corners stay.
    cleaned = without_wrong(views, residuals, lambda one: 2 * len(one) / 3) if views else []
    photos, faults = dict(zip(sightings, cleaned, strict=True)), dict[Photo, str]()
    fit = _fitted(lenses, photos, world_from_board)
    used = photos
    while (odd := _odd_one(lenses, used, world_from_board, fit)) is not None:
        at, faults[at], fit = odd
        used = {other: one for other, one in used.items() if other != at}
    seen = {at: one for at, one in photos.items() if at[1] in fit.places}
    placed = Placed(
        tuple(
            _with_place(lens, fit.cameras[n], fit.covariance[6 * n : 6 * n + 6, 6 * n : 6 * n + 6])
            for n, lens in enumerate(lenses)
        ),
        tuple(fit.places[place] for place in sorted(fit.places)),
        _residuals(lenses, seen, fit.cameras, fit.places),
        photos,
        faults,
    )
    _require_fit(placed)
    return placed


class _Fit(NamedTuple):
    cameras: Poses
    """camera_from_world of each."""
    places: Poses
    """world_from_board of each."""
    covariance: FloatArray
    """Of six unknowns of each camera (ω, δt of exp(ω) R, t + δt), then of six of each further place."""
    squares: float
    """Sum of the squared residuals [px²]."""


def _fitted(
    lenses: Sequence[Calibrated], photos: Mapping[Photo, BoardView], world_from_board: FloatArray
) -> _Fit:
    """The fit to photos; CalibrationError where they do not link all cameras to place 0."""
    cameras, places = _start(lenses, photos, world_from_board)
    free = sorted(place for place in places if place != 0)

    def moved(unknowns: FloatArray) -> tuple[Poses, Poses]:
        steps = unknowns.reshape(-1, 6)
        further = {b: _step(places[b], steps[len(cameras) + n]) for n, b in enumerate(free)}
        return {n: _step(pose, steps[n]) for n, pose in cameras.items()}, {0: places[0], **further}

    def missed(unknowns: FloatArray) -> FloatArray:
        found = _residuals(lenses, photos, *moved(unknowns))
        return np.concatenate([one.ravel() for one in found.values()])

    fit = least_squares(missed, np.zeros(6 * (len(cameras) + len(free))), method="lm")
    squares = float(fit.fun @ fit.fun)
    variance = squares / max(len(fit.fun) - len(fit.x), 1)
    return _Fit(*moved(fit.x), np.linalg.inv(fit.jac.T @ fit.jac) * variance, squares)


def _residuals(
    lenses: Sequence[Calibrated], photos: Mapping[Photo, BoardView], cameras: Poses, places: Poses
) -> dict[Photo, FloatArray]:
    return {
        (camera, place): one.misses(cameras[camera] @ places[place], _optics(lenses[camera]))
        for (camera, place), one in photos.items()
    }


def _odd_one(
    lenses: Sequence[Calibrated], photos: Mapping[Photo, BoardView], world_from_board: FloatArray, fit: _Fit
) -> tuple[Photo, str, _Fit] | None:
    """The photo that the others contradict, what is wrong with it, and the fit without it; or None.

    It is the one without which the sum of squares falls most, by far more than its corners account for: the
    `fit` to all spreads what one photo misses over many.
    """
    alone = {at: float((one.least_misses(_optics(lenses[at[0]])) ** 2).sum()) for at, one in photos.items()}
    best: tuple[Photo, _Fit] | None = None
    for at, one in photos.items():
        others = {other: kept for other, kept in photos.items() if other != at}
        # No fit of the others is better than each alone: most photos are cleared without a fit.
        least = sum(alone[other] for other in others)
        if not others or fit.squares - least <= _odd_gain(one, least, others):
            continue
        try:
            rest = _fitted(lenses, others, world_from_board)
        except CalibrationError:  # it links a camera to the others
            continue
        odd = fit.squares - rest.squares > _odd_gain(one, rest.squares, others)
        if odd and (best is None or rest.squares < best[1].squares):
            best = at, rest
    if best is None:
        return None
    at, rest = best
    missed = float(np.sqrt((fit.squares - rest.squares) / len(photos[at])))
    usual = float(np.sqrt(rest.squares / sum(len(one) for other, one in photos.items() if other != at)))
    return at, f"with it all miss by {missed:.2f} px for each of its corners, without it {usual:.2f}", rest


def _odd_gain(photo: BoardView, rest: float, others: Mapping[Photo, BoardView]) -> float:
    """What the sum of squares [px²] may rise by with a photo that the others do not contradict."""
    return MANY_TIMES**2 * rest / sum(len(one) for one in others.values()) * len(photo)


def _optics(one: Calibrated) -> Optics:
    return one.camera.matrix, one.camera.distortion


def _step(pose: FloatArray, step: FloatArray) -> FloatArray:
    out = transform(step[:3], step[3:])
    out[:3, :3] = out[:3, :3] @ pose[:3, :3]
    out[:3, 3] += pose[:3, 3]
    return out


def _start(
    lenses: Sequence[Calibrated], photos: Mapping[Photo, BoardView], world_from_board: FloatArray
) -> tuple[dict[int, FloatArray], dict[int, FloatArray]]:
    """Cameras and places to begin with, from photo to photo, those with most corners first."""
    poses = {at: one.pose(_optics(lenses[at[0]])) for at, one in photos.items()}
    cameras: dict[int, FloatArray] = {}
    places = {0: world_from_board}
    waiting = sorted(photos, key=lambda at: -len(photos[at]))
    while True:
        linked = [at for at in waiting if (at[0] in cameras) != (at[1] in places)]
        if not linked:
            break
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
    """The camera at its place; element-wise deviations follow from those of (ω, δt)."""
    std = np.zeros((4, 4))
    turns = np.stack([so3.hat(axis) @ camera_from_world[:3, :3] for axis in np.eye(3)])
    std[:3, :3] = np.sqrt(np.einsum("aij,ab,bij->ij", turns, covariance[:3, :3], turns))
    std[:3, 3] = np.sqrt(np.diagonal(covariance)[3:])
    pose = camera_from_world.copy()
    pose[:3, :3] = so3.nearest_rotation(pose[:3, :3])
    camera = dataclasses.replace(lens.camera, camera_from_world=pose, camera_from_world_std=std)
    return dataclasses.replace(lens, camera=camera, placed=True)


def _require_fit(placed: Placed) -> None:
    for number, one in enumerate(placed.cameras):
        name, limit = one.camera.name, MOST_RMS * float(one.camera.matrix.diagonal()[:2].min())
        own = [at for at in placed.residuals if at[0] == number]
        refused = sum(at in placed.faults for at in own)
        if 2 * refused >= len(own):
            found = f"{refused} of its {len(own)} photos are contradicted by others"
        elif not placed.rms(number) <= limit:
            found = f"its photos miss by {placed.rms(number):.2f} px RMS, expected at most {limit:.2f}"
        else:
            continue
        raise CalibrationError(
            f"{name}: {found}: the lens is not this camera's, or the board moved between cameras"
        )
