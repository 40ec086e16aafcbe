"""Lenses from photos of a board."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import pytest

from tests.helpers.boards import BOARD, LENS, photo, pose_towards, sighting
from tracker.calibration.board import Board
from tracker.calibration.board_sighting import find_board
from tracker.calibration.intrinsics import fit_lens
from tracker.errors import CalibrationError


def sightings(seed, count=12, **options):
    rng = np.random.default_rng(seed)
    return [sighting(f"photo {n}", pose_towards(rng), rng, **options) for n in range(count)]


def deviations(lens):
    """Errors (9,) of fx, fy, cx, cy and the distortion, in standard deviations."""
    camera, std = lens.calibrated.camera, lens.calibrated.matrix_std
    places = (0, 1, 0, 1), (0, 1, 2, 2)
    focal = (camera.matrix[places] - LENS.matrix) / std[places]
    return np.concatenate([focal, (camera.distortion - LENS.distortion) / lens.calibrated.distortion_std])


def test_stated_deviations_are_those_of_the_errors():
    errors = np.array([deviations(fit_lens("camera", sightings(seed), BOARD)) for seed in range(12)])
    # The mean square of 108 errors, which hang together by lens, is within these limits in 99 of 100 cases.
    assert 0.6 < (errors**2).mean() < 1.6
    assert np.abs(errors).max() < 4


def test_the_noise_is_told_and_photos_left_out_see_a_little_more():
    lens = fit_lens("camera", sightings(5, noise=0.2), BOARD)
    assert lens.rms == pytest.approx(0.2 * np.sqrt(2), rel=0.1)
    assert lens.rms <= lens.left_out < 1.2 * lens.rms


def test_a_lens_from_rendered_photos_is_the_true_one():
    rng = np.random.default_rng(81)
    images = [photo(pose_towards(rng), rng) for _ in range(12)]
    found = [find_board(f"{n}", image, BOARD) for n, image in enumerate(images)]
    lens = fit_lens("camera", found, BOARD)
    assert lens.left_out < 0.2
    assert all(one.fault is None for one in lens.photos)
    assert np.abs(deviations(lens)).max() < 3.5
    assert np.abs(lens.calibrated.camera.matrix[(0, 1), (0, 1)] - LENS.matrix[:2]).max() < 2


def test_a_photo_of_a_bent_board_is_named_and_left_out():
    seen = sightings(7)
    bent = seen[4]
    waves = np.stack([np.sin(20 * bent.points[:, 1]), np.cos(30 * bent.points[:, 0])], axis=1)
    seen[4] = dataclasses.replace(bent, pixels=bent.pixels + 2 * waves)
    lens = fit_lens("camera", seen, BOARD)
    assert [n for n, one in enumerate(lens.photos) if one.fault is not None] == [4]
    assert "misses by" in lens.photos[4].fault
    without = fit_lens("camera", seen[:4] + seen[5:], BOARD)
    assert lens.calibrated.camera.matrix == pytest.approx(without.calibrated.camera.matrix)


def test_a_corner_that_is_elsewhere_is_dropped_and_no_other():
    seen = sightings(8)
    seen[2].pixels[5] += (6, -4)
    wrong = seen[2].corners[5]
    lens = fit_lens("camera", seen, BOARD)
    assert [one.dropped for one in lens.photos] == [0, 0, 1, *[0] * 9]
    assert wrong not in lens.photos[2].sighting.corners
    assert np.abs(deviations(lens)).max() < 4


def test_a_photo_with_few_corners_has_no_say():
    seen = sightings(9)
    seen[0] = seen[0].without(np.arange(len(seen[0])) >= 6)
    lens = fit_lens("camera", seen, BOARD)
    assert lens.photos[0].fault == "only 6 corners, expected 8"


def of_two_sizes():
    seen = sightings(13)
    seen[3] = dataclasses.replace(seen[3], size=(720, 540))
    return seen


def of_two_lenses():
    rng = np.random.default_rng(14)
    lenses = [LENS, dataclasses.replace(LENS, distortion=(0.3, 0, 0, 0, 0), matrix=(250, 295, 190, 120))]
    return [sighting(f"{n}", pose_towards(rng), rng, lens=lenses[n % 2]) for n in range(12)]


def hardly_tilted(tilt, seed):
    rng = np.random.default_rng(seed)
    return [sighting(f"{n}", pose_towards(rng, tilt=tilt), rng) for n in range(8)]


@pytest.mark.parametrize(
    ("photos", "board", "words"),
    [
        (lambda: sightings(10, count=5), BOARD, r"camera: found 5 photos to go by, of 5 .* at least 6"),
        (
            lambda: sightings(12),
            Board(5, 9, 0.04, 0.03),
            "no more than 5x7 squares of the board, expected 5x9",
        ),
        (of_two_sizes, BOARD, r"photo \d+ of 360x270 px, photo 3 of 720x540 px"),
        (of_two_lenses, BOARD, r"photos left out miss by .* not of one camera"),
        *[
            (functools.partial(hardly_tilted, tilt, seed), BOARD, "too alike; tilt the board")
            for tilt in (0.0, 0.02, 0.2)
            for seed in (11, 12)
        ],
    ],
)
def test_photos_that_give_no_lens_are_refused_with_the_reason(photos, board, words):
    with pytest.raises(CalibrationError, match=words):
        fit_lens("camera", photos(), board)


def test_the_platforms_photos_give_the_platforms_focal_length(real):
    paths = sorted((real / "charuco" / "intrinsic_camera").glob("*.jpeg"))
    assert len(paths) == 18
    found = [find_board(path.name, cv2.imread(str(path)), BOARD) for path in paths]
    lens = fit_lens("camera60", found, BOARD)
    assert lens.left_out <= 0.45
    assert np.abs(lens.calibrated.camera.matrix[(0, 1), (0, 1)] - 589.6).max() < 4
    assert all(one.fault is None for one in lens.photos)
