import cv2
import numpy as np
import pytest

from synthetic.camera.sensor import Sensor
from tests.helpers import exposed
from tests.helpers.pushed_cube import DT, bits, has_seen, honest, near, new, play, pose_at, shot, within
from tracker import Status
from tracker.geometry import so3
from tracker.geometry.cuboid import corners
from tracker.pose.estimate import PoseEstimator
from tracker.pose.hypotheses import Search
from tracker.tracking import follow

FAR = np.array([-0.09, 0.08, 0.0325]), so3.exp([0.0, 0.0, 2.0])
BLACKNESS = np.zeros((270, 270, 3), np.uint8)


@pytest.fixture(scope="module")
def empty(rig):
    """Two different sets of images of the arena without object."""
    return [shot(rig, None, seed) for seed in (100, 101)]


@pytest.fixture(scope="module")
def away(rig):
    """The cube somewhere else."""
    return [shot(rig, FAR, seed) for seed in (200, 201, 202)]


def spreads(answers):
    return [np.trace(one.object_pose.covariance[:3, :3]) for one in answers]


def test_a_moving_cube_is_tracked_and_its_velocity_found(reference):
    assert [one.status for one in reference] == [Status.FOUND] + [Status.TRACKING] * (len(reference) - 1)
    for k, one in enumerate(reference):
        assert near(one, pose_at(DT * k)), k
        assert one.object_pose.confidence > 0.9
        assert one.filtered_object_pose.confidence > 0.9
        assert one.reason is None
    # The push goes on from image 4 to image 12.
    velocity = reference[11].filtered_object_pose.velocity
    np.testing.assert_allclose(velocity[:3], [0.06, 0.08, 0.0], atol=0.005)
    np.testing.assert_allclose(velocity[3:], [0.0, 0.0, np.radians(60)], atol=0.1)
    assert np.abs(reference[3].filtered_object_pose.velocity).max() < 0.02
    assert np.abs(reference[-1].filtered_object_pose.velocity).max() < 0.05


@pytest.mark.parametrize("before", ["film", "nothing to see", "no images", "one camera"])
def test_after_a_reset_it_is_as_new(rig, film, empty, reference, before):
    seen = {
        "film": film[:7],
        "nothing to see": [film[5], *empty],
        "no images": [film[5]] + [[None] * 3] * 2,
        "one camera": [[None, images[1], None] for images in film[:4]],
    }
    one = has_seen(rig, seen[before], start=100.0)
    one.reset()
    assert bits(*play(one, film[:6])) == bits(*reference[:6])


def test_a_repeated_stamp_gives_the_same_answer_and_changes_nothing(rig, film, empty, reference):
    one = new(rig)
    for k, images in enumerate(film[:8]):
        answer = one.update(images, DT * k)
        for again in (images, empty[0], [None] * 3):
            assert one.update(again, DT * k) is answer
        assert bits(answer) == bits(reference[k])


@pytest.mark.parametrize("shown", [(0, 1, 2), (0,), (1,), (2,)])
def test_what_detect_finds_and_tries_does_not_depend_on_updates(rig, film, shown, monkeypatch):
    images = [image if c in shown else None for c, image in enumerate(film[9])]
    one, tried = new(rig), []
    refine = one._estimator.refiner

    def recorded(*arguments, **named):
        fit = refine(*arguments, **named)
        tried.append(fit.position.tobytes() + fit.rotation.tobytes())
        return fit

    monkeypatch.setattr(one._estimator, "refiner", recorded)
    before, first = bits(one.detect(images)), list(tried)
    one_camera = [[None, None, last] for *_, last in film[5:8]]
    for seen, start in ((film[:5], 0.0), (one_camera, 0.5)):
        play(one, seen, start=start)
        tried.clear()
        assert bits(one.detect(images)) == before
        assert tried == first


def test_a_film_in_buffers_that_are_used_again_is_left_alone_and_gives_the_same_bits(rig, film, reference):
    buffers = [np.empty_like(image) for image in film[0]]
    read_only = [buffer.view() for buffer in buffers]
    for view in read_only:
        view.flags.writeable = False
    one = new(rig)
    for k, images in enumerate(film):
        for buffer, image in zip(buffers, images, strict=True):
            buffer[:] = image
        assert bits(one.update(read_only, DT * k)) == bits(reference[k])
        np.testing.assert_array_equal(buffers, images)


@pytest.mark.parametrize("camera", [0, 1, 2])
@pytest.mark.parametrize("fault", ["frozen", "black", "none", "grey"])
def test_a_camera_that_fails_does_no_harm(rig, film, camera, fault):
    broken = {"black": BLACKNESS, "none": None, "grey": BLACKNESS + np.uint8(90), "frozen": film[3][camera]}
    damaged = [list(images) for images in film]
    for images in damaged[4:]:
        images[camera] = broken[fault]
    for k, one in enumerate(play(new(rig), damaged)):
        assert near(one, pose_at(DT * k), 1.5, 1.5), k


def test_a_camera_that_comes_back_is_used_again(rig, film, reference):
    damaged = [list(images) for images in film]
    for images in damaged[4:9]:
        images[0] = film[3][0]
    answers = play(new(rig), damaged)
    assert (np.divide(spreads(answers), spreads(reference))[4:9] > 1.2).all()
    np.testing.assert_allclose(spreads(answers)[9:], spreads(reference)[9:], rtol=0.2)


@pytest.mark.parametrize("gains", [(1.0, 0.8, 0.55), (0.3, 0.3, 0.3)])
def test_light_that_changed_while_the_object_was_lost_is_measured_again(rig, film, monkeypatch, gains):
    one, searches, find = has_seen(rig, film[:4]), [], PoseEstimator.find

    def noted(self, images, timing, **options):
        searches.append(images)
        return find(self, images, timing, **options)

    monkeypatch.setattr(PoseEstimator, "find", noted)
    images = [exposed(image.astype(float), gains) for image in film[0]]
    answers = [one.update(images, 5.0 + DT * k) for k in range(4)]
    assert [answer.status for answer in answers] == [Status.REFOUND] + [Status.TRACKING] * 3
    assert len(searches) == 1


def test_rival_bodies_are_remembered_where_a_search_everywhere_finds_nothing_better(rig, film, monkeypatch):
    one = has_seen(rig, film[:1])
    monkeypatch.setattr(follow, "kept", lambda *_: False)
    monkeypatch.setattr(PoseEstimator, "find", lambda *_, **__: Status.AMBIGUOUS)
    monkeypatch.setattr(Search, "resized", lambda *_: -7.0)
    answers = play(one, film[:5] * 2, start=1e-3)
    assert {answer.status for answer in answers} == {Status.TRACKING}
    assert one._memory.resized == -7.0


def test_without_images_from_the_start_it_is_lost(rig, film, empty):
    one = new(rig)
    for k, images in enumerate([[None] * 3, empty[0], [BLACKNESS] * 3]):
        answer = one.update(images, DT * k)
        assert answer.status is Status.LOST
        assert answer.object_pose is None
        assert answer.filtered_object_pose is None
        assert answer.reason is not None
    assert one.update(film[0], 1.0).status is Status.FOUND


@pytest.mark.parametrize("gone", [0, 1, 3, 8])
def test_an_object_that_returns_elsewhere_is_followed_within_two_images(rig, film, empty, away, gone):
    one = has_seen(rig, film[:4])
    for k in range(gone):
        answer = one.update(empty[k % 2], 0.4 + DT * k)
        assert answer.object_pose is None
        assert answer.status is (Status.COASTING if k < 5 else Status.LOST)
        if answer.filtered_object_pose is not None:
            assert within(answer.filtered_object_pose, pose_at(0.3))
    first, *others = play(one, away, first=4 + gone)
    assert first.object_pose is None or within(first.object_pose, FAR)
    for answer in others:
        assert near(answer, FAR)
    assert np.linalg.norm(others[-1].filtered_object_pose.velocity[:3]) < 0.1


def test_a_sudden_change_of_light_does_no_harm(rig, film):
    lit = [[exposed(image, (0.6, 0.75, 0.9)) for image in images] for images in film[7:]]
    for k, one in enumerate(play(new(rig), film[:7] + lit)):
        assert near(one, pose_at(DT * k)), k


def test_options_hold_beyond_a_reset(rig, film):
    one = new(rig, coast_seconds=0.15)
    for start in (0.0, 0.0, 5.0):
        play(one, film[:2], start=start)
        assert one.update([None] * 3, start + 0.2).status is Status.COASTING
        assert one.update([None] * 3, start + 0.3).status is Status.LOST
        one.reset()


@pytest.mark.parametrize("left", [0, 1, 2])
def test_one_camera_that_is_left_gives_a_pose_near_the_truth_or_none(rig, film, left):
    alone = [[image if c == left else None for c, image in enumerate(images)] for images in film[4:]]
    for k, one in enumerate(play(new(rig), film[:4] + alone)):
        assert honest(one, pose_at(DT * k)), k


def test_a_jump_that_is_not_believed_yet_gives_no_pose(rig, film, away):
    never = new(rig, jump_confidence=2.0)
    play(never, film[:4], dt=0.02)
    answers = play(never, away, dt=0.02, first=4)
    assert [one.status for one in answers] == [Status.COASTING, Status.REFOUND, Status.TRACKING]
    assert answers[0].object_pose is None
    assert within(answers[0].filtered_object_pose, pose_at(0.0))
    assert within(answers[1].object_pose, FAR)


def test_dropped_images_and_uneven_stamps_do_no_harm(rig, film):
    rng = np.random.default_rng(5)
    one = new(rig)
    for k in (0, 1, 2, 4, 5, 8, 9, 12, 13, 15):
        stamp = DT * k + rng.uniform(-0.004, 0.004) + 1.7e9
        answer = one.update(film[k], stamp)
        assert answer.status is (Status.TRACKING if k else Status.FOUND)
        assert near(answer, pose_at(DT * k)), k


@pytest.mark.parametrize("shown", ["still", 2e-5, 1e-4, "moving in one"])
def test_a_film_without_noise_is_not_taken_for_frozen_cameras(rig, shown):
    place, rotation = pose_at(0.0)
    steps = [0.0] * 8 if isinstance(shown, str) else shown * np.arange(4)
    film = [shot(rig, (place + step * np.eye(3)[0], rotation), 0, Sensor.clean()) for step in steps]
    if shown == "moving in one":
        film = [[film[0][0].copy(), *film[0][1:]] for _ in range(4)]
        for k, (first, *_) in enumerate(film):
            first[5:40, 20 + 10 * k : 60 + 10 * k] = 90
    answers = play(new(rig), film)
    assert [one.status for one in answers] == [Status.FOUND] + [Status.TRACKING] * (len(answers) - 1)
    np.testing.assert_allclose(spreads(answers), spreads(answers[:1])[0], rtol=0.2)
    assert all(within(one.object_pose, pose_at(0.0)) for one in answers)


def beside(images, rig, pose):
    """Those images, with one of the cube's colours beside the left of its outline."""
    place, rotation = pose
    result = []
    for image, camera in zip(images, rig, strict=True):
        pixels = camera.project(corners(np.full(3, 0.0325)) @ rotation.T + place)
        outline = cv2.convexHull(pixels.astype(np.float32)).astype(np.int32)
        shape, kernel = np.zeros(image.shape[:2], np.uint8), np.ones((3, 3), np.uint8)
        shape = cv2.fillConvexPoly(shape, outline, 1)
        beyond, far = (cv2.dilate(shape, kernel, iterations=n) for n in (10, 16))
        u, v = camera.project(place[None])[0].astype(int)
        far[:, u:] = 0
        result.append(np.where(((far > 0) & (beyond == 0))[..., None], image[v, u], image))
    return result


def test_colours_beside_a_resting_cube_are_looked_at_once(rig, film, monkeypatch):
    searches, find = [], PoseEstimator.find

    def noted(self, images, timing, **options):
        searches.append(len(answers))
        return find(self, images, timing, **options)

    monkeypatch.setattr(PoseEstimator, "find", noted)
    one, answers = new(rig), []
    for k in range(4):
        answers.append(one.update(beside(film[k], rig, pose_at(DT * k)), DT * k))
    assert all(within(answer.object_pose, pose_at(DT * k)) for k, answer in enumerate(answers))
    assert searches == [0]
