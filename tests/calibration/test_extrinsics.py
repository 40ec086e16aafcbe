"""Places of cameras from photos of a board that they all see."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from tests.helpers.boards import BOARD, LENS, sighting
from tracker.calibration.board_sighting import find_board
from tracker.calibration.calibrated import Calibrated, read_calibrated
from tracker.calibration.extrinsics import place_cameras
from tracker.errors import CalibrationError
from tracker.geometry import so3
from tracker.geometry.camera import Camera

GIVEN = np.eye(4)
GIVEN[:3, :3] = so3.exp([0, 0, 0.4])
GIVEN[:3, 3] = (0.01, -0.02, 0.005)


def looking(azimuth, height=0.4, distance=0.3):
    """(4, 4) camera_from_world of a camera that looks at the arena's centre."""
    position = np.array([distance * np.cos(azimuth), distance * np.sin(azimuth), height])
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, -rotation @ position
    return pose


TRUE = [looking(azimuth) for azimuth in (1.0, 3.1, 5.2)]
PLACES = [GIVEN, *(np.eye(4) for _ in range(2))]
PLACES[1][:3, :3], PLACES[1][:3, 3] = so3.exp([0.3, -0.2, 2.0]), (0.03, 0.02, 0.05)
PLACES[2][:3, :3], PLACES[2][:3, 3] = so3.exp([-0.2, 0.4, -1.0]), (-0.03, 0.03, 0.04)


def lenses(count=3):
    """Lenses of cameras that are said to be where they are not."""
    matrix, distortion = LENS.arrays
    one = Camera("camera", LENS.width, LENS.height, matrix, distortion, np.eye(4))
    return [Calibrated(dataclasses.replace(one, name=f"camera{n}"), placed=False) for n in range(count)]


def views(seed, pairs=None, noise=0.1):
    """Photos by (camera, place), by default all."""
    rng = np.random.default_rng(seed)
    pairs = [(c, p) for c in range(3) for p in range(3)] if pairs is None else pairs
    return {(c, p): sighting(f"{c} {p}", TRUE[c] @ PLACES[p], rng, noise=noise) for c, p in pairs}


ALONE = [(c, 0) for c in range(3)]


def test_without_noise_the_places_are_the_true_ones():
    placed = place_cameras(lenses(), views(1, noise=0), GIVEN)
    for one, true in zip(placed.cameras, TRUE, strict=True):
        assert one.placed
        assert one.camera.camera_from_world == pytest.approx(true, abs=1e-7)
    for found, true in zip(placed.world_from_board, PLACES, strict=True):
        assert found == pytest.approx(true, abs=1e-7)


@pytest.mark.parametrize("pairs", [ALONE, None])
def test_stated_deviations_are_those_of_the_errors(pairs):
    errors = []
    for seed in range(8):
        placed = place_cameras(lenses(), views(seed, pairs), GIVEN)
        for one, true in zip(placed.cameras, TRUE, strict=True):
            std = one.camera.camera_from_world_std
            errors.append(((one.camera.camera_from_world - true)[:3] / std[:3]).ravel())
    assert 0.6 < (np.array(errors) ** 2).mean() < 1.6
    assert np.abs(errors).max() < 5


def test_more_places_make_cameras_more_certain():
    def certainty(pairs):
        cameras = place_cameras(lenses(), views(3, pairs), GIVEN).cameras
        return np.array([np.linalg.norm(one.camera.camera_from_world_std[:3, 3]) for one in cameras])

    assert (certainty(None) < certainty(ALONE)).all()


def test_a_camera_is_placed_through_another_that_sees_the_given_place():
    placed = place_cameras(lenses(), views(4, [(0, 0), (0, 1), (1, 1), (1, 2), (2, 2)], noise=0.0), GIVEN)
    assert placed.cameras[2].camera.camera_from_world == pytest.approx(TRUE[2], abs=1e-6)


def test_a_camera_without_a_link_to_the_given_place_is_named():
    with pytest.raises(CalibrationError, match="camera1, camera2: found no photo of the board in its given"):
        place_cameras(lenses(), views(5, [(0, 0), (1, 1), (2, 1)]), GIVEN)


def test_a_photo_taken_after_the_board_moved_is_named():
    seen = views(6)
    moved = PLACES[2].copy()
    moved[:3, 3] += (0.01, 0, 0)
    seen[1, 2] = sighting("moved", TRUE[1] @ moved, np.random.default_rng(1))
    placed = place_cameras(lenses(), seen, GIVEN)
    assert set(placed.faults) == {(1, 2)}
    assert "without it" in placed.faults[1, 2]
    for one, true in zip(placed.cameras, TRUE, strict=True):
        assert np.abs(one.camera.camera_from_world - true)[:3, 3].max() < 5e-4


def of_another_focal_length(lens, factor):
    matrix = lens.camera.matrix.copy()
    matrix[0, 0] *= factor
    return dataclasses.replace(lens, camera=dataclasses.replace(lens.camera, matrix=matrix))


@pytest.mark.parametrize(
    ("change", "pairs", "words"),
    [
        (lambda lens: of_another_focal_length(lens, 1.1), None, "2 of its 3 photos are .* the lens is not"),
        (lambda lens: of_another_focal_length(lens, 1.3), ALONE, "its photos miss by.* the lens is not"),
        (lambda lens: lens.resized(180, 135), None, "found 360x270 px, but the lens of camera1 .* 180x135"),
    ],
)
def test_a_lens_of_another_camera_is_named(change, pairs, words):
    wrong = lenses()
    wrong[1] = change(wrong[1])
    with pytest.raises(CalibrationError, match=f"(camera1|1 \\d): {words}"):
        place_cameras(wrong, views(7, pairs), GIVEN)


def test_a_corner_that_is_elsewhere_is_dropped():
    seen = views(9)
    seen[0, 0].pixels[3] += (5, 5)
    placed = place_cameras(lenses(), seen, GIVEN)
    assert len(placed.sightings[0, 0]) == len(seen[0, 0]) - 1
    assert placed.rms(0) < 0.2


@pytest.mark.parametrize("folders", [1, 2])
def test_the_platforms_board_in_the_arena_is_met_by_every_camera(folders, real):
    names = ("camera60", "camera180", "camera300")
    known = [read_calibrated(real / "calibration" / "simulation" / f"{name}_full.yml") for name in names]
    seen = {}
    for place, folder in enumerate(("position_centered_5x7_board", "corner_in_center_3x3_board")[:folders]):
        for number, name in enumerate(names):
            image = cv2.imread(str(real / "charuco" / folder / f"{name}.png"))
            seen[number, place] = find_board(f"{folder}/{name}", image, BOARD)
    placed = place_cameras(known, seen, np.eye(4))
    assert not placed.faults
    for number, one in enumerate(placed.cameras):
        assert placed.rms(number) <= 0.6
        assert 0.25 < one.camera.position[2] < 0.5
