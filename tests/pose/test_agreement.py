import dataclasses
import itertools
import math

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

import tracker
from tests.helpers import nudged, random_rotations, sight_of
from tests.helpers.kept_stills import bare
from tracker.geometry.lens import LENS
from tracker.pose import agreement
from tracker.pose.agreement import CONTRADICTION, SCALES, SCALES_PRIOR, probably_fits, size, spread
from tracker.pose.fit import OwnViews
from tracker.pose.judge import apparent, confidence
from tracker.pose.result import Status

RADIUS = 0.05
CENTRE = np.array([0.02, -0.03, 0.03])
STILL = np.zeros((3, 6))
KNOWN = 1 / np.repeat([2e-4, 4e-3], 3) ** 2
"""Information of a camera that sees the object well, the same in all directions."""
CLEAR = np.tile(np.diag(KNOWN), (3, 1, 1))


def placed(seed=3):
    """(3,) of LENS of cameras around an object."""
    rng, lenses = np.random.default_rng(seed), np.zeros(3, LENS)
    lenses["rotation"] = random_rotations(rng, 3)
    lenses["position"] = CENTRE + rng.uniform(0.3, 0.6, (3, 1)) * random_rotations(rng, 3)[:, 0]
    return lenses


def likelihoods(moved, information=CLEAR, seed=3):
    """Of what each of the cameras sees of the object by itself."""
    own = OwnViews(information, moved, np.full(3, 30.0))
    return agreement.disagreement(own, placed(seed), CENTRE, RADIUS)


def scattered(std, seed=5):
    """(3, 6) motions of `std` [m] along each axis, and turns as of a camera half a metre away."""
    return np.random.default_rng(seed).normal(size=(3, 6)) * np.repeat([std, std / 0.5], 3)


def test_likelihoods_are_those_of_one_gaussian_over_all_cameras():
    places = agreement.ACROSS, agreement.ACROSS, agreement.ALONG
    turns = agreement.TILT, agreement.TILT, agreement.ROLL
    for seed in range(5):
        # All directions are coupled.
        roots = np.random.default_rng(seed).normal(size=(3, 6, 6)) * np.sqrt(KNOWN)
        moved, information = scattered(2e-3, seed), roots @ roots.transpose(0, 2, 1)
        found = likelihoods(moved, information, seed)
        sights = CENTRE - placed(seed)["position"]
        prior = np.diag([RADIUS**2 / 3] * 3 + [0.1] * 3)
        expected = []
        for scale in SCALES:
            whole = np.kron(np.ones((3, 3)), prior)
            for c in range(3):
                distance = np.linalg.norm(sights[c])
                own = [scale**2 + (e * distance) ** 2 for e in places]
                own += [(scale / distance) ** 2 + e**2 for e in turns]
                turned = np.kron(np.eye(2), np.linalg.svd(sights[c : c + 1])[2][[1, 2, 0]].T)
                part = slice(6 * c, 6 * c + 6)
                whole[part, part] += np.linalg.inv(information[c]) + turned @ np.diag(own) @ turned.T
            expected.append(multivariate_normal(cov=whole).logpdf(moved.ravel()))
        np.testing.assert_allclose(np.diff(found), np.diff(expected), rtol=1e-6, atol=1e-6)


def test_cameras_are_taken_to_be_off_by_what_they_disagree_and_so_little_is_the_pose_probably_near():
    sizes = [np.median([size(likelihoods(scattered(std, k))) for k in range(9)]) for std in SCALES]
    assert sizes == sorted(sizes)
    for std, found in zip(SCALES[4:-2], sizes[4:-2], strict=True):
        assert std / 2 < found < 2 * std
    assert size(likelihoods(STILL)) < SCALES[2]
    near = [probably_fits(likelihoods(scattered(std)), 3) for std in SCALES]
    assert near == sorted(near, reverse=True)
    assert near[0] > 0.99
    assert near[-1] < 0.05
    assert sum(agreement.probabilities(likelihoods(scattered(1e-3)))) == pytest.approx(1.0)


def test_a_camera_that_tells_little_is_no_evidence_and_no_cameras_view_leaves_what_was_believed():
    moved = scattered(1e-4)
    moved[2] = 0.02
    assert size(likelihoods(moved)) > 3e-3
    for share in (1e-6, 0.0):
        assert size(likelihoods(moved, CLEAR * np.reshape([1.0, 1.0, share], (3, 1, 1)))) < 5e-4
    nothing = likelihoods(STILL, np.zeros((3, 6, 6)))
    np.testing.assert_allclose(nothing, nothing[0])
    np.testing.assert_allclose(agreement.probabilities(nothing), SCALES_PRIOR / SCALES_PRIOR.sum())
    # Three normal deviates are near together as chi-square has it; all cameras' world may be displaced, too.
    std = agreement.SHARED_SHARE * SCALES * np.sqrt(1.0 + (SCALES / CONTRADICTION) ** 2)
    expected = SCALES_PRIOR @ chi2.cdf((agreement.NEAR_DISTANCE / std) ** 2, 3) / SCALES_PRIOR.sum()
    assert probably_fits(nothing, 3) == pytest.approx(expected, abs=1e-9)


def test_the_spread_is_that_of_the_errors_which_average_out_where_cameras_are_more_than_three():
    assert spread(size(None), 3) == 0.0
    stds = [math.sqrt(spread(size(np.where(scale == SCALES, 0.0, -50.0)), 3)) for scale in SCALES]
    np.testing.assert_allclose(stds, agreement.SHARED_SHARE * SCALES, rtol=1e-6)
    factors = [spread(1e-3, count) / spread(1e-3, 3) for count in (0, 1, 2, 6, 12)]
    assert factors == pytest.approx([1, 1, 1, 0.5, 0.25])
    known = np.where(np.isclose(SCALES, 3.5e-3), 0.0, -50.0)
    few, many = (probably_fits(known, count) for count in (3, 12))
    assert few < many < 0.9


@pytest.fixture(scope="module")
def stills(rig):
    """Scenes of a cube without fingers."""
    return [bare("cube_v2", rig.cameras, [61, k], kind="rest") for k in range(3)]


def moved(rig, c, shift, turn=(0.0, 0.0, 0.0)):
    """A rig with camera c off by a shift [m] and a turn [rad] in its own frame, which states errors."""
    std = np.full((4, 4), 1e-3)
    std[:3, 3] = 5e-4
    cameras = (dataclasses.replace(camera, camera_from_world_std=std) for camera in rig)
    return nudged(dataclasses.replace(rig, cameras=tuple(cameras)), c, turn, shift)


def fits(rig, stills, name="cube_v2"):
    detector = tracker.ObjectTracker(name, rig)
    return [detector.fit(still.images) for still in stills]


def test_each_camera_by_itself_sees_the_object_where_all_do(rig, stills):
    for fit in fits(rig, stills):
        # Across each camera's line of sight, in its own axes [m].
        across, deviations = np.empty((2, 3, 2))
        for c, camera in enumerate(rig):
            rotation = camera.camera_from_world[:3, :3]
            across[c] = (rotation @ fit.own.moved[c, :3])[:2]
            covariance = rotation @ np.linalg.pinv(fit.own.information[c])[:3, :3] @ rotation.T
            deviations[c] = np.sqrt(np.diag(covariance))[:2]
        # A single camera's deviations are 0.06 to 0.6 mm here: no one limit in millimetres suits them all.
        assert np.median(np.abs(across)) < 0.15e-3
        assert (np.abs(across) < 2 * deviations).all()
        assert (fit.own.inliers > 15).all()
        assert size(fit.disagreement) < 0.5e-3


@pytest.mark.parametrize("c", range(3))
def test_a_camera_that_was_moved_sees_the_object_moved(rig, stills, c):
    shift = np.array([2e-3, -1.5e-3, 0.0])
    given = moved(rig, c, shift)
    before, after = fits(moved(rig, c, np.zeros(3)), stills), fits(given, stills)
    for old, new in zip(before, after, strict=True):
        # The pose moves, too: what the camera sees is where the true pose and the wrong camera have it.
        rotation = given[c].camera_from_world[:3, :3]
        seen = rotation @ (new.position + new.own.moved[c, :3] - old.position - old.own.moved[c, :3])
        np.testing.assert_allclose(seen[:2], -shift[:2], atol=0.3e-3)
        assert size(new.disagreement) > size(old.disagreement)
    # One that was left out is asked, too.
    detector = tracker.ObjectTracker("cube_v2", moved(rig, c, (9e-3, 0.0, 0.0)))
    estimator = detector._estimator
    for still in stills:
        sight = sight_of(detector, still.images)
        fit = estimator.refiner(sight, still.rotation, still.position, left_out=(c,))
        assert size(estimator.examined(sight, fit).disagreement) > CONTRADICTION


def test_faces_of_a_narrow_object_are_counted_where_each_camera_sees_it_if_not_wholly_beside(rig):
    stills = [bare("cuboid_2x2x8_v2", rig.cameras, [62, k], kind="rest") for k in range(3)]
    std = np.full((4, 4), 5e-3)
    given = [dataclasses.replace(camera, camera_from_world_std=std) for camera in rig]
    given, rng = dataclasses.replace(rig, cameras=tuple(given)), np.random.default_rng(5)
    for c in range(3):
        given = nudged(given, c, rng.normal(0.0, 5e-3, 3), rng.normal(0.0, 5e-3, 3))
    for exact, off in zip(*(fits(one, stills, "cuboid_2x2x8_v2") for one in (rig, given)), strict=True):
        share, other = (fit.cameras["agree"].sum() / fit.cameras["predicted"].sum() for fit in (exact, off))
        assert other > 0.93 * share
    # A camera that sees the object wholly beside its pose contradicts.
    for c, shift in itertools.product(range(3), ((0.025, 0.0, 0.0), (0.0, 0.02, 0.0), (-0.02, -0.02, 0.0))):
        for fit in fits(moved(rig, c, shift), stills, "cuboid_2x2x8_v2"):
            assert isinstance(fit, Status) or size(fit.disagreement) > CONTRADICTION, (c, shift)


def test_cameras_of_another_platform_are_not_believed(rig, stills):
    rng = np.random.default_rng(4)
    given = rig
    for c in range(3):
        given = moved(given, c, rng.normal(0.0, 6e-3, 3), rng.normal(0.0, 0.015, 3))
    found = [fit for fit in fits(given, stills) if not isinstance(fit, Status)]
    assert found
    for fit in found:
        assert size(fit.disagreement) > 2e-3
        assert confidence(fit) < 0.7 * apparent(fit)
