import dataclasses

import numpy as np
import pytest

import tracker
from tests.helpers.kept_stills import bare
from tests.helpers.pushed_cube import MODEL, pose_at, shot
from tracker.geometry import so3
from tracker.objects.model import Box
from tracker.pose.estimate import REFINED, PoseEstimator
from tracker.pose.hypotheses import EVERYWHERE, LIKELIEST, NEARBY, TURNS, Search
from tracker.pose.judge import settled
from tracker.pose.schedule import FIRST


@pytest.fixture(scope="module")
def estimator(rig):
    return PoseEstimator(Box.of(MODEL), rig, tracker.load_colors(MODEL.colors))


@pytest.fixture(scope="module")
def images(rig):
    return shot(rig, pose_at(0.0), 7)


@pytest.fixture
def begun(monkeypatch):
    """What is begun: places, turns and cameras left out."""
    seen, begin = [], Search.begun

    def noted(self, sight, place, which, left_out=()):
        seen.extend((tuple(place), turn, left_out) for turn in which)
        return begin(self, sight, place, which, left_out)

    monkeypatch.setattr(Search, "begun", noted)
    return seen


def scores_of(estimator, images, order):
    """Of what each round of a search finds."""
    next_of = estimator.search.rounds(estimator.reader(images))
    return [[one.score for one in next_of(wide)] for wide in order]


@pytest.mark.parametrize("order", [(LIKELIEST, NEARBY, EVERYWHERE), (LIKELIEST, TURNS), (EVERYWHERE,)])
def test_rounds_begin_each_hypothesis_once(estimator, images, begun, order):
    for scores in scores_of(estimator, images, order):
        assert scores == sorted(scores, reverse=True)
    assert len(begun) == len(set(begun))
    first = begun[0][0]
    assert sum(place == first and not left for place, _, left in begun) == order[-1].first


def test_what_is_begun_does_not_depend_on_the_rounds_before(estimator, images, begun):
    for order in ((LIKELIEST, NEARBY, EVERYWHERE), (EVERYWHERE,)):
        scores_of(estimator, images, order)
    half = len(begun) // 2
    assert set(begun[:half]) == set(begun[half:])


def test_a_clear_view_needs_one_hypothesis(estimator, images, begun):
    fits = estimator.candidates(estimator.reader(images))
    assert len(begun) == 1
    assert len(fits) == 1
    assert settled(fits[0])


@pytest.mark.parametrize("spoilt", ["mixed", "one camera", "empty"])
def test_few_poses_are_refined_whatever_the_pictures_show(estimator, images, rig, spoilt, monkeypatch):
    moved = shot(rig, pose_at(1.2), 8)
    shown = {
        "mixed": [images[0], moved[1], np.ascontiguousarray(images[2][:, ::-1])],
        "one camera": [images[0], None, None],
        "empty": shot(rig, None, 9),
    }[spoilt]
    schedules, refine = [], PoseEstimator._fitted

    def noted(self, sight, one, schedule, lag):
        schedules.append(schedule)
        return refine(self, sight, one, schedule, lag)

    monkeypatch.setattr(PoseEstimator, "_fitted", noted)
    estimator.candidates(estimator.reader(shown))
    assert sum(one is not FIRST for one in schedules) <= REFINED


def test_a_plate_turned_about_the_face_that_all_cameras_see_competes(rig):
    """Its sides are so narrow that their colours hardly count beside those of the face."""
    plate = dataclasses.replace(MODEL, size=np.array([0.14, 0.14, 0.005]), rim=0.0, rim_std=1e-4)
    finder = tracker.ObjectTracker(plate, rig)
    still = bare(plate, rig.cameras, 3)  # lies flat
    fit = finder.fit(still.images)
    others = finder._estimator._alike(finder._estimator.reader(still.images), fit, None)
    assert others
    assert all(so3.angle_between(one.rotation, fit.rotation) > 1.0 for one in others)
