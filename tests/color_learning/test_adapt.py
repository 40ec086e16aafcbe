import dataclasses
from pathlib import Path

import numpy as np
import pytest

import tracker
from tests.helpers import RIG
from tests.helpers.filmed import footage_of, on_wood, overlap, shots
from tracker.cli.colors import _learned
from tracker.color_learning import lessons
from tracker.color_learning.adapt import Adapted, adapt, from_names, nearest, refit
from tracker.color_learning.fit import FitOptions
from tracker.color_learning.hues import NAMED_HUES, hue_distance, hue_of
from tracker.errors import NotBetterError
from tracker.pipeline import ObjectTracker
from tracker.pose.fit import Fit

MODEL, COLORS = tracker.load_object("cube_v2"), tracker.load_colors("cube_v2")
OPTIONS = FitOptions(draws=5000)


@pytest.fixture(scope="module")
def film():
    return shots("cube_v2", 8, seed=511)


def test_colors_of_renderings_become_those_of_the_pictures(film):
    start, other_film = tracker.load_colors("simulation"), shots("cube_v2", 3, seed=512)
    learned = adapt(MODEL, [footage_of(film)], start, OPTIONS, rounds=3)
    shown = COLORS, dataclasses.replace(start, normalise=True), learned.colors
    shipped, before, after = (overlap(other_film, colors) for colors in shown)
    assert learned.after.explained > learned.before.explained
    assert after - before > 0.8 * (shipped - before)


def test_on_a_brown_table_colors_are_learned_from_images_as_they_are(film):
    brown = [dataclasses.replace(shot, images=list(map(on_wood, shot.images, shot.labels))) for shot in film]
    learned = adapt(MODEL, [footage_of(brown[:6])], None, OPTIONS, rounds=3)
    assert not learned.colors.normalise
    assert learned.before.posed < 0.5
    assert learned.after.posed == 1.0
    assert "keep exposure and white balance fixed" in _learned(learned, Path("mine.npz"))
    other_order = tracker.load_object("cube_v1")
    with pytest.raises(NotBetterError, match="refused: found 0 of"):
        adapt(other_order, [footage_of(brown)], COLORS, OPTIONS, rounds=1)


def test_the_same_frames_give_the_same_colors(film):
    start, footage = tracker.load_colors("simulation"), [footage_of(film[:4])]
    one = adapt(MODEL, footage, start, OPTIONS, rounds=1).colors
    from_names.cache_clear()
    two = adapt(MODEL, footage, start, OPTIONS, rounds=1).colors
    assert (one.log_posterior == two.log_posterior).all()


def test_another_object_is_refused(film):
    cuboid = tracker.load_object("cuboid_2x2x8_v2")
    with pytest.raises(NotBetterError, match=r"refused: the images show .* rather than cuboid_2x2x8_v2"):
        adapt(cuboid, [footage_of(film)], COLORS, OPTIONS, rounds=2)
    grey = [np.full_like(image, 110) for image in film[0].images]
    empty = [dataclasses.replace(shot, images=grey) for shot in film]
    with pytest.raises(NotBetterError, match=r"found 0 of .*size and faces .*or use `tracker colors fit`"):
        adapt(cuboid, [footage_of(empty)], COLORS, OPTIONS, rounds=2)
    with pytest.raises(NotBetterError, match=r"no better than by cube_v2 \(see --colors\)"):
        adapt(MODEL, [footage_of(film)], COLORS, OPTIONS, rounds=0)


def test_a_higher_confidence_that_too_few_frames_reach_ends_the_learning_and_is_no_fault(film, monkeypatch):
    monkeypatch.setattr("tracker.color_learning.adapt.GATES", (0.3, 1.0))
    monkeypatch.setattr("tracker.color_learning.adapt.GAIN", 1.0)
    with pytest.raises(NotBetterError, match=r"no better than by cube_v2 \(see --colors\)"):
        adapt(MODEL, [footage_of(film)], COLORS, OPTIONS, rounds=3)
    found = adapt(MODEL, [footage_of(film)], COLORS, OPTIONS, rounds=3, first=True)
    np.testing.assert_array_equal(found.colors.label_table, COLORS.label_table)


@pytest.mark.parametrize(("posed", "neutral"), [(0.5, False), (0.6, True)])
def test_images_are_tried_as_they_are_if_learning_ends_while_few_frames_are_posed(
    posed, neutral, film, monkeypatch
):
    def judged(_model, _footage, colors):
        gain = 0.2 if colors.normalise else 0.7
        return lessons.Judgement(0.1 + gain * (colors.name == "fitted"), posed, 4)

    monkeypatch.setattr("tracker.color_learning.adapt.GATES", (0.3, 1.0))
    monkeypatch.setattr("tracker.color_learning.adapt.judge", judged)
    assert adapt(MODEL, [footage_of(film)], COLORS, OPTIONS, rounds=2).colors.normalise is neutral


def test_images_as_they_are_must_be_explained_better_than_those_in_neutral_light(film, monkeypatch):
    def learned(_model, _footage, start, *_):
        before = lessons.Judgement(0.5 if start.normalise else 0.1, 1.0, 4)
        after = before if start.normalise else lessons.Judgement(reached, 1.0, 4)
        return Adapted(start, before, after, {}), "no frames" if start.normalise else ""

    monkeypatch.setattr("tracker.color_learning.adapt._adapted", learned)
    reached = 0.6
    assert not adapt(MODEL, [footage_of(film)], COLORS, OPTIONS).colors.normalise
    reached = 0.4
    with pytest.raises(NotBetterError, match="refused: no frames"):
        adapt(MODEL, [footage_of(film)], COLORS, OPTIONS)


def test_a_new_object_keeps_the_colours_of_names_that_nothing_improves(film):
    start = dataclasses.replace(COLORS, name="names")
    found = adapt(MODEL, [footage_of(film)], start, OPTIONS, rounds=0, first=True)
    np.testing.assert_array_equal(found.colors.label_table, COLORS.label_table)
    grey = [np.full_like(image, 110) for image in film[0].images]
    empty = [dataclasses.replace(shot, images=grey) for shot in film]
    with pytest.raises(NotBetterError, match="found 0 of"):
        adapt(MODEL, [footage_of(empty)], start, OPTIONS, rounds=1, first=True)


def test_the_nearest_model_explains_most_and_may_know_only_names(film, monkeypatch):
    footage = footage_of(film)
    judged = [dataclasses.replace(footage, held_out=footage.learned)]
    best = lessons.judge(MODEL, judged, nearest(MODEL, [footage], 0)).explained
    for name in ("cube_v1", "cube_v2", "simulation"):
        colors = dataclasses.replace(tracker.load_colors(name), normalise=True)
        assert best >= lessons.judge(MODEL, judged, colors).explained
    monkeypatch.setattr("tracker.color_learning.adapt.color_model_names", lambda: ["dice"])
    assert nearest(dataclasses.replace(MODEL, colors="not yet"), [footage], 0).name == from_names(0).name


def test_the_objects_own_colours_are_tried_beside_the_shipped_ones(film, tmp_path, monkeypatch):
    footage, file = footage_of(film), tmp_path / "own.npz"
    COLORS.save(file)
    monkeypatch.setattr("tracker.color_learning.adapt.color_model_names", lambda: ["dice"])
    mine = dataclasses.replace(MODEL, colors=str(file))
    found = nearest(mine, [footage], 0)
    np.testing.assert_array_equal(found.label_table, dataclasses.replace(COLORS, normalise=True).label_table)
    # A new object has none yet.
    monkeypatch.setattr("tracker.color_learning.adapt.color_model_names", lambda: ["dice", "cube_v3"])
    assert nearest(dataclasses.replace(MODEL, colors="not yet"), [footage], 0).name == "cube_v3"


def test_colors_that_are_not_shown_stay_as_they_were():
    rng = np.random.default_rng(3)
    pixels = [
        {0: rng.integers(90, 130, (4000, 3)), 1: rng.integers((10, 20, 150), (30, 40, 170), (400, 3))}
        for _ in range(6)
    ]
    model = refit(pixels, np.zeros(32**3, dtype=bool), [COLORS], OPTIONS)
    old = np.argmax(COLORS.log_posterior, axis=0)
    new = np.argmax(model.log_posterior, axis=0)
    for label in range(2, 7):
        sure = (old == label) & (COLORS.log_posterior[0] < -2)
        assert (new[sure] == label).mean() > 0.85


def test_a_colour_that_the_initial_model_does_not_know_is_that_of_its_name():
    """And not every colour that nothing else claims."""
    log_posterior = COLORS.log_posterior.copy()
    log_posterior[1] = -15.0
    blind = dataclasses.replace(COLORS, log_posterior=log_posterior - log_posterior.max(axis=0))
    grey = {0: np.random.default_rng(3).integers(90, 130, (4000, 3))}
    model = refit([grey], np.zeros(32**3, dtype=bool), [blind, from_names(0)], OPTIONS)
    levels = 255 * (np.argwhere(np.argmax(model.log_posterior, axis=0) == 1) / 31) ** 2
    hues = np.array([hue_of(one[None]) for one in levels])
    assert np.nanmean(hue_distance(hues, NAMED_HUES[1]) > 60) < 0.01


def test_names_alone_tell_pure_colors():
    labels = from_names(0).label_table.reshape(64, 64, 64)  # red, green, blue
    pure = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 0), (1, 0, 1), (0, 1, 1)]
    for label, (blue, green, red) in enumerate(pure, start=1):
        assert labels[50 * red, 50 * green, 50 * blue] == label


def test_faces_of_the_outline_are_those_of_the_picture_and_out_of_view_there_is_none(film):
    inside = total = 0
    for shot in film:
        for camera, labels in zip(RIG, shot.labels, strict=True):
            faces, around = lessons.outline(MODEL, camera, shot.rotation, shot.position)
            assert not (labels[~around] > 0).any()
            both = (labels > 0) & (faces > 0)
            assert (faces[both] == labels[both]).all()
            inside, total = inside + np.count_nonzero(both), total + np.count_nonzero(labels)
    assert inside > 0.7 * total
    assert lessons.outline(MODEL, RIG[0], np.eye(3), np.array([0.0, 0.0, 5.0])) is None


def test_a_frame_teaches_the_pixels_in_their_faces_colors_and_not_what_hides_a_face(film):
    tracked, frames, labelled = ObjectTracker(MODEL, RIG, COLORS), [], []
    for shot in film:
        fit = tracked.fit(shot.images)
        assert isinstance(fit, Fit)
        frames.append(lessons.lesson(MODEL, RIG, tuple(shot.images), fit, COLORS))
        for camera, labels in zip(RIG, shot.labels, strict=True):
            faces, around = lessons.outline(MODEL, camera, fit.rotation, fit.position)
            labelled.append(labels[(faces > 0) | ~around])
    owner, truth = lessons.owners(frames), np.concatenate(labelled)
    faces = np.concatenate([one.faces for one in frames])
    kept = owner[np.concatenate([lessons.nodes_of(one.levels) for one in frames])] == faces
    hidden, shown = (faces > 0) & (truth == 0), (faces > 0) & (truth == faces)
    assert np.count_nonzero(hidden) > 300
    assert kept[hidden].mean() < 0.2
    assert kept[shown].mean() > 0.9
    for pixels, one in zip(lessons.consistent(frames), frames, strict=True):
        assert len(pixels[0]) == np.count_nonzero(one.faces == 0)
        for label in set(pixels) - {0}:
            assert (owner[lessons.nodes_of(pixels[label])] == label).all()


def test_a_grey_thing_that_hides_most_of_a_face_does_not_teach_it():
    rng = np.random.default_rng(5)
    levels = np.concatenate(
        [
            rng.normal([150, 152, 158], 2, (900, 3)),  # on the face
            rng.normal([84, 89, 52], 3, (300, 3)),  # the face
            rng.normal([90, 90, 90], 12, (9000, 3)),
        ]
    )
    faces = np.repeat([4, 4, 0], [900, 300, 9000]).astype(np.uint8)
    one = lessons.Lesson(np.rint(levels).astype(np.uint8), faces, faces, faces > 9)
    kept = lessons.consistent([one])[0][4]
    assert 250 < len(kept) <= 300
    assert np.allclose(np.median(kept, axis=0), [84, 89, 52], atol=2)


@pytest.mark.parametrize(
    ("lengths", "count", "expected"),
    [([100], 80, [80]), ([10, 100], 80, [10, 70]), ([100, 100], 80, [40, 40]), ([3, 4, 3], 80, [3, 4, 3])],
)
def test_recordings_share_the_frames(lengths, count, expected):
    assert lessons.shares(lengths, count) == expected
