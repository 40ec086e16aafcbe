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
from tracker.segmentation.sensor import LOUD

BOX = Box.of(MODEL)


@pytest.fixture(scope="module")
def estimator(rig):
    return PoseEstimator(BOX, rig, tracker.load_colors(MODEL.colors))


@pytest.fixture(scope="module")
def images(rig):
    return shot(rig, pose_at(0.0), 7)


def test_rounds_begin_each_hypothesis_once_whatever_the_rounds_before(estimator, images, monkeypatch):
    ends, begun, begin = [], [], Search.begun

    def noted(self, sight, place, which, left_out=()):
        begun.extend((tuple(place), turn, left_out) for turn in which)
        return begin(self, sight, place, which, left_out)

    monkeypatch.setattr(Search, "begun", noted)
    for order in ((LIKELIEST, TURNS), (LIKELIEST, NEARBY, EVERYWHERE), (EVERYWHERE,)):
        begun.clear()
        next_of = estimator.search.rounds(estimator.reader(images))
        for wide in order:
            scores = [one.score for one in next_of(wide)]
            assert scores == sorted(scores, reverse=True)
        assert len(begun) == len(set(begun))
        first = begun[0][0]
        assert sum(place == first and not left for place, _, left in begun) == order[-1].rotations
        ends.append(set(begun))
    assert ends[1] == ends[2]
    # A clear view needs one.
    begun.clear()
    fits = estimator.candidates(estimator.reader(images))
    assert len(begun) == len(fits) == 1
    assert settled(fits[0])


def test_an_object_is_found_before_a_table_in_any_of_its_colours(estimator, images):
    sight, (position, rotation) = estimator.reader(images), pose_at(0.0)
    for color in range(1, 7):
        flooded = sight._replace(labels=sight.labels.copy(), pictures=sight.pictures.copy())
        flooded.labels[:, 40:][sight.labels[:, 40:] == 0] = color
        flooded.pictures["colored"] = np.count_nonzero(flooded.labels, axis=(1, 2))
        best = estimator.search.rounds(flooded)(TURNS)[0]
        assert np.linalg.norm(best.position - position) < 0.005
        assert np.degrees(so3.angle_between(best.rotation, rotation)) < 5


@pytest.mark.parametrize("exposure", [1.0, 0.3])
def test_a_dark_image_is_as_loud_as_a_bright_one_in_the_light_in_which_its_colours_are_read(
    estimator, rng, exposure
):
    grey = np.full((270, 270, 3), 115.0)
    for sigma, loud in ((0.8 * LOUD, False), (1.3 * LOUD, True)):
        image = np.rint(exposure * (grey + rng.normal(0, sigma, grey.shape))).astype(np.uint8)
        assert estimator.reader.lit([image])["loud"][0] == loud


@pytest.mark.parametrize("shown", [(0, 1), (2,)])
def test_a_camera_without_an_image_explains_nothing(estimator, images, rig, shown):
    fewer = dataclasses.replace(rig, cameras=tuple(rig[c] for c in shown))
    few = PoseEstimator(BOX, fewer, tracker.load_colors(MODEL.colors))
    sights = (
        estimator.reader([image if c in shown else None for c, image in enumerate(images)]),
        few.reader([images[c] for c in shown]),
    )
    position, rotation = pose_at(0.0)
    poses = [(rotation, position), (rotation, position + 0.02)]
    scores = [
        [hypothesis.score for hypothesis in one.search.near(sight, poses)]
        for one, sight in zip((estimator, few), sights, strict=True)
    ]
    assert scores[0] == scores[1]


@pytest.mark.parametrize("left_out", [(), (1,)])
def test_colours_beside_the_object_are_elsewhere_in_an_image_that_was_left_out(estimator, images, left_out):
    position, rotation = pose_at(0.0)
    sight = estimator.reader([images[0], np.roll(images[1], 12, axis=1), images[2]])
    seen = estimator.refiner(sight, rotation, position, left_out=left_out).cameras[1]
    assert (seen["extra"] == 0) == bool(left_out)
    counted = seen["agree"] + seen["wrong"] + seen["extra"] + seen["elsewhere"]
    assert counted == sight.pictures["colored"][1] > 0


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
