import dataclasses
import math

import numpy as np
import pytest

import tracker
from tests.helpers.fits import LABELS, made_fit, with_cameras
from tracker import Status
from tracker.geometry import so3
from tracker.geometry.probability import probability_within
from tracker.objects.model import Box
from tracker.pose import judge, rivals
from tracker.pose.evidence import NUMBERS, evidence_of
from tracker.pose.rivals import lead, shifted_along, turned_about_face

GOOD, ALONE = made_fit(), made_fit(cameras=1)
NO_EDGES = {"usable": 0.0, "inliers": 0.0, "squares": 0.0}
NOTHING = {"agree": 0, "missing": 410, "extra": 0} | NO_EDGES
PIECE = {"agree": 60, "missing": 350}

REFUSED = {
    "hardly a pixel": (with_cameras(GOOD, agree=2, missing=408, **NO_EDGES), Status.TOO_FEW_PIXELS),
    "one face of three in another colour": (with_cameras(GOOD, agree=270, wrong=140), Status.OTHER_OBJECT),
    "no edge beside faces": (with_cameras(GOOD, **NO_EDGES), Status.OTHER_OBJECT),
    "seen elsewhere": (
        with_cameras(with_cameras(GOOD, elsewhere=2000, **NOTHING), 0, **PIECE),
        Status.INCONSISTENT_VIEWS,
    ),
    "outside the arena": (dataclasses.replace(GOOD, inside=False), Status.INCONSISTENT_VIEWS),
    "outside the arena for one camera": (dataclasses.replace(ALONE, inside=False), Status.AMBIGUOUS),
    "a few pixels of a face": (with_cameras(with_cameras(GOOD, **NOTHING), 0, **PIECE), Status.POOR_FIT),
    "no finite covariance": (
        dataclasses.replace(GOOD, covariance=np.full((6, 6), np.inf)),
        Status.POOR_FIT,
    ),
    "better elsewhere": (dataclasses.replace(GOOD, lead=-2.0), Status.AMBIGUOUS),
    "anywhere": (dataclasses.replace(GOOD, covariance=np.diag([1e-2] * 6)), Status.AMBIGUOUS),
}


@pytest.mark.parametrize("sure", [True, False])
def test_three_views_given_many_times_are_as_much_evidence_as_once(sure):
    cameras, labels = made_fit(sure=sure).cameras, np.array(LABELS)
    many = np.tile(cameras, 4)
    one, four = (evidence_of(seen, labels, 0.0, NUMBERS) for seen in (cameras, many))
    assert four == pytest.approx(one, rel=1e-6)


def rough(rms):
    """A fit whose edges are off by `rms` [px] at the reference focal length."""
    return with_cameras(GOOD, squares=rms**2 * GOOD.cameras["inliers"])


def blind(fit, c, elsewhere=0):
    """The fit, of which camera c shows nothing where the object should be."""
    missing = fit.cameras["predicted"][c]
    fields = {"agree": 0, "wrong": 0, "extra": 0, "expected": 40.0} | NO_EDGES
    return with_cameras(fit, c, missing=missing, elsewhere=elsewhere, **fields)


@pytest.mark.parametrize(("fit", "status"), REFUSED.values(), ids=REFUSED)
def test_a_fit_is_refused_for_what_is_wrong_with_it(fit, status):
    assert judge.refusal(fit) is status


@pytest.mark.parametrize(
    ("less", "more"),
    [
        ({"wrong": 0}, {"wrong": 50}),
        ({"usable": 40.0}, {"usable": 20.0}),
        ({"squares": 0.5}, {"squares": 36.0}),
        ({"missing": 10, "agree": 400}, {"missing": 370, "agree": 40}),
    ],
)
def test_what_speaks_against_a_fit_makes_it_less_likely(less, more):
    less_likely, likelier = (with_cameras(GOOD, **fields) for fields in (more, less))
    assert judge.rank(likelier) > judge.rank(less_likely)
    # Where all speaks for the object's colours, what is left is how rare other bodies are.
    assert judge.log_odds(likelier) > judge.log_odds(less_likely) - 1e-3


def test_pieces_speak_for_a_fit_the_less_the_rougher_they_are_and_colours_outside_against_it():
    fits = [with_cameras(GOOD, elsewhere=count).evidence.nothing for count in (0, 200, 1000)]
    assert fits == sorted(fits)
    ranks = [judge.rank(rough(rms)) for rms in (0.1, 0.2, 0.4, 0.8)]
    assert ranks == sorted(set(ranks), reverse=True)
    for fit in (rough(0.05), rough(0.3)):
        fewer = {name: 0.7 * fit.cameras[name] for name in ("inliers", "squares")}
        assert judge.rank(with_cameras(fit, **fewer)) < judge.rank(fit)
    assert math.isfinite(judge.rank(with_cameras(GOOD, expected=0.0, blur=0.0, **NO_EDGES)))


def test_what_noise_explains_does_not_speak_against_the_object():
    fit = rough(0.8)
    noisy = [with_cameras(fit, noise=share * fit.cameras["squares"]) for share in (0.0, 0.5, 1.0, 2.0)]
    trusted = [judge.trust(one) for one in noisy]
    assert trusted == sorted(trusted)
    assert trusted[0] < trusted[1] < trusted[2]
    assert len({judge.rank(one) for one in noisy}) == 1


def test_a_clear_fit_is_sure_and_settled_and_one_camera_settles_nothing():
    assert judge.trust(GOOD) > judge.SETTLED
    assert judge.settled(GOOD)
    assert judge.trust(ALONE) > 0.95
    assert judge.alone(ALONE)
    assert judge.refusal(GOOD) is judge.refusal(ALONE) is None
    unsettled = (dataclasses.replace(GOOD, **{field: False}) for field in ("converged", "inside"))
    for doubtful in (ALONE, made_fit(sure=False), *unsettled):
        assert not judge.settled(doubtful)
    # A camera counts from some weight of pieces on.
    for weight, expected in ((judge.MIN_VIEW, False), (0.99 * judge.MIN_VIEW, True), (0.0, True)):
        cameras = GOOD.cameras.copy()
        cameras["inliers"][1:] = 0.0, weight
        assert judge.alone(dataclasses.replace(GOOD, cameras=cameras)) is expected


def test_confidence_is_trust_times_accuracy_and_a_rival_halves_it_at_most_and_it_stays_a_number():
    assert judge.confidence(GOOD) == pytest.approx(judge.trust(GOOD) * judge.nearness(GOOD.covariance, False))
    assert judge.trust(dataclasses.replace(GOOD, lead=0.0)) == pytest.approx(0.5, abs=0.01)
    for odds in (1e3, 1e5):
        others = [{"evidence": GOOD.evidence._replace(**{key: odds})} for key in ("body", "nothing")]
        for change in ({"resized": odds}, *others):
            other = dataclasses.replace(GOOD, **change)
            assert judge.trust(other) < 1e-200
            assert judge.refusal(other) is not None
        assert judge.trust(dataclasses.replace(GOOD, lead=-odds)) < 1e-200


@pytest.mark.parametrize(("single", "factor"), [(False, 1.0), (True, judge.SINGLE)])
def test_odds_of_being_near_are_as_stated_and_greater_for_a_single_camera(single, factor):
    found = []
    for shift in (3e-4, 1e-3, 2e-3, 4e-3, 0.1):
        covariance = np.diag(np.repeat(np.square([shift, 0.02]), 3))
        near = probability_within(covariance, *judge.NEAR)
        found.append(judge.nearness(covariance, single))
        assert found[-1] == pytest.approx(factor * near / (1.0 - near + factor * near))
    assert found == sorted(found, reverse=True)
    assert found[0] > 0.99
    assert found[-1] < 0.01
    assert judge.nearness(np.full((6, 6), np.nan), single) == 0.0


def test_a_camera_that_shows_the_object_elsewhere_contradicts_and_one_that_shows_none_cannot_say():
    assert judge.contradicting(GOOD) == (False, False, False)
    assert judge.unanimous(GOOD)
    hidden, elsewhere = blind(GOOD, 1), blind(GOOD, 1, elsewhere=300)
    for fit in (hidden, elsewhere):
        assert (fit.cameras["shows"] > 0.5).tolist() == [True, False, True]
        assert not judge.unanimous(fit)
        assert judge.supporters(fit) == 2
    assert not any(judge.contradicting(hidden))
    assert judge.contradicting(elsewhere) == (False, True, False)
    assert judge.confidence(elsewhere) < judge.confidence(hidden) < judge.confidence(GOOD)
    contradicted = blind(blind(GOOD, 0, elsewhere=300), 2, elsewhere=300)
    assert judge.trust(contradicted) < 1 / 3  # either of the others may be right, too
    assert judge.confidence(contradicted) < min(0.5, 0.8 * judge.confidence(blind(blind(GOOD, 0), 2)))


def test_a_camera_that_shows_another_thing_there_is_broken_and_does_not_spoil_the_pose():
    fit = with_cameras(GOOD, 2, agree=0, wrong=400, **NO_EDGES)
    assert fit.cameras["broken"][2] > 0.5
    assert judge.contradicting(fit) == (False, False, True)
    assert judge.supporters(fit) == 2
    assert 0.2 < judge.confidence(fit) < judge.confidence(GOOD)
    # One in whose picture the object is not has no say.
    fit = with_cameras(GOOD, 2, predicted=0, agree=0, wrong=0, missing=0, elsewhere=500, extra=0)
    assert (fit.cameras["shows"] > 0.5).tolist() == [True, True, False]
    assert not any(judge.contradicting(fit))
    assert judge.unanimous(fit)
    assert not any(judge.contradicting(with_cameras(fit, 2, predicted=judge.EXPECTED - 1)))


def test_a_lead_is_over_all_other_poses_together_and_the_same_pose_counts_once(monkeypatch):
    def turned(quarters, rank):
        rotation = so3.exp(np.array([0.0, 0.0, quarters * math.pi / 2]))
        return dataclasses.replace(made_fit(), rotation=rotation, stands=rank)

    radius = 0.05
    monkeypatch.setattr(rivals, "rank", lambda fit: fit.stands)
    best, *others = fits = [turned(0, 5.0), turned(1, 4.0), turned(2, 4.0), turned(3, 3.0)]
    odds = math.exp(5.0) / sum(math.exp(fit.stands) for fit in others)
    assert lead(best, fits, radius) == pytest.approx(math.log(odds))
    assert lead(best, fits[:2], radius) == pytest.approx(1.0)
    fits = [turned(0, 5.0), turned(0, 4.9), turned(1, 4.0), turned(1, 4.0)]
    assert lead(fits[0], fits, radius) == pytest.approx(1.0)
    assert lead(fits[0], fits[:2], radius) == math.inf


@pytest.mark.parametrize("half", [(0.03, 0.03, 0.03), (0.01, 0.01, 0.04), (0.02, 0.03, 0.04)])
@pytest.mark.parametrize("face", range(3))
def test_turns_about_the_one_face_in_view_look_the_same_and_of_two_faces_none(half, face):
    found = list(turned_about_face(np.eye(3), np.zeros(3), np.array(half), 0.5 * np.eye(3)[face]))
    one, other = np.delete(half, face)
    assert len(found) == (3 if one == other else 1)
    for rotation in found:
        np.testing.assert_allclose(rotation[:, face], np.eye(3)[face], atol=1e-12)
        np.testing.assert_allclose(np.abs(rotation) @ half, half, atol=1e-12)
        assert so3.angle_between(rotation, np.eye(3)) > 1
    two = np.roll([0.4, 0.3, 0.0], face) * half
    assert not list(turned_about_face(np.eye(3), np.zeros(3), np.array(half), two))


LONG_BOX = tracker.load_object("cuboid_2x2x8_v2")


@pytest.mark.parametrize("seen", [0, judge.EXPECTED - 1, judge.EXPECTED])
def test_a_long_box_may_be_shifted_along_while_no_end_is_seen(seen, rng):
    box, fit = Box.of(LONG_BOX), dataclasses.replace(made_fit(), rotation=so3.exp(rng.normal(size=3)))
    fit.cameras["faces"][:] = 0
    fit.cameras["faces"][1, 2, box.face_labels[2]] = seen  # the face +y
    found = [fit.rotation.T @ (place - fit.position) for place in shifted_along(fit, box)]
    assert len(found) == (6 if seen < judge.EXPECTED else 0)
    for x, y, z in found:
        assert (x, z) == pytest.approx((0.0, 0.0), abs=1e-12)
        assert 0.009 < abs(y) < 0.031
    assert sum(y for _, y, _ in found) == pytest.approx(0.0, abs=1e-12)
    for size in ((0.065, 0.065, 0.065), (0.02, 0.03, 0.04)):
        model = dataclasses.replace(LONG_BOX, size=np.array(size))
        assert not list(shifted_along(fit, Box.of(model)))
