import dataclasses
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from benchmarks.data.films import ABSENT, FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.plan import Plan
from benchmarks.judge.results import read_results
from benchmarks.measure import films
from benchmarks.score import films as score
from tests.benchmarks.made_up import Knowing, assert_survives, figures_of, film, printed_by
from tests.helpers import random_rotations
from tests.helpers.synthetic_needs import skip_without_platform


def frame_of(number, position=(0.0, 0.0, 0.0), rotation=None) -> FilmFrame:
    image = np.full((4, 4, 3), number, np.uint8)
    turn = np.eye(3) if rotation is None else rotation
    stamps = number / 10 - np.array([0.004, 0.0, 0.002])
    shown = {"positions": np.outer(stamps, [1.0, 0.0, 0.0]), "rotations": np.stack([turn] * 3)}
    return FilmFrame((image,) * 3, np.ones(3), np.array(position), turn, stamps=stamps, **shown)


def test_a_frame_survives_the_disk(rng):
    frame = frame_of(3, rng.normal(size=3), random_rotations(rng, 1)[0])
    for one in (frame, dataclasses.replace(frame, position=None, rotation=None, positions=None)):
        assert_survives(one)


@pytest.mark.parametrize(("camera", "stamps"), [(None, [0.296, 0.3, 0.298]), (0, 0.296), (1, 0.3)])
def test_update_is_given_the_stamp_of_each_image_and_judged_at_it(camera, stamps):
    own = Knowing()
    played = films.play(own, [frame_of(k, (k / 10, 0.0, 0.0)) for k in range(4)], camera)
    np.testing.assert_allclose(own.given[3][1], stamps)
    np.testing.assert_allclose(played[["measured_mm", "measured_deg"]], 0.0, atol=1e-9)


@pytest.mark.parametrize("length", [40, 600])
def test_an_object_that_vanishes_comes_back_within_the_film(length):
    starts = vanishing_frames(length)
    assert len(starts) == (1 if length == 40 else 4)
    assert all(start > 0 and start + ABSENT < length for start in starts)


def test_a_vanished_object_returns_elsewhere_without_a_jump_in_time():
    positions = np.outer(np.arange(40), [0.01, 0.0, 0.0])

    def made_up(film, numbers, *, empty=False):
        for number in numbers:
            frame = frame_of(number, positions[number])
            yield dataclasses.replace(frame, position=None, rotation=None) if empty else frame

    store = SimpleNamespace(length=40, frames=made_up)
    frames = list(vanishing_film(store, 0, 13, positions))
    assert [frame.position is None for frame in frames] == [False] * 13 + [True] * 20 + [False] * 7
    np.testing.assert_allclose(np.diff([frame.timestamp for frame in frames]), 0.1)
    assert np.linalg.norm(frames[33].position - frames[12].position) > 0.1


def test_losses_are_of_what_had_been_found_and_shares_flips_and_ratios_of_all():
    names = ["lost", "found", "coasting", "lost", "lost", "refound", "lost"]
    assert score.losses(film(7, status=names)) == 2
    assert score.losses(pd.concat([film(1, status=["found"]), film(1, film=1, status=["lost"])])) == 0
    own = film()
    own.loc[8:9, ["mm", "deg"]] = 1.0, 170.0
    own.loc[9, "confidence"] = 0.2
    (row,) = figures_of(own, "films")
    found = [row[key] for key in ("within_5", "single", "flips", "n", "inside_95")]
    assert found == [80.0, 100.0, 1, 10, 100]
    (unasked,) = figures_of(film(group="world", single_mm=np.nan, single_deg=np.nan), "films")
    assert "single" not in unasked or np.isnan(unasked["single"])
    # Ratios are of frames in which `detect` found the object, too.
    own = film()
    own.loc[:2, ["mm", "single_mm"]] = 5.0, np.nan
    at_rest, moving = figures_of(own, "films, at rest")
    assert (at_rest["over_single_mm"], at_rest["over_single_deg"]) == pytest.approx((0.5, 0.25))
    assert at_rest["n"] + moving["n"] == 10


def test_one_camera_is_judged_where_it_sees_enough_and_waited_for_where_its_view_has_been_clear():
    own = film(group="camera 2", measured_mm=15.0, measured_deg=2.0)
    own.loc[:1, "visible"] = 0.4
    own.loc[:3, "measured_mm"] = 50.0
    own.loc[4, ["measured_mm", "measured_given"]] = np.nan, False
    (row,) = figures_of(own, "films, one camera")
    assert [row[key] for key in ("near", "none", "wrong")] == [62.5, 12.5, 25.0]
    visible = [0.2, 0.8, 0.8, 0.8, 0.8, 0.8, 0.3, 0.8]
    for given, wait in (([0] * 8, 3), ([0, 0, 0, 0, 1, 0, 0, 0], 1), ([1] * 8, 0)):
        own = film(8, visible=visible, measured_given=np.array(given, bool))
        assert score.longest_wait(own) == wait


def test_answers_while_the_object_is_away_count_as_invented():
    number = np.arange(30)
    measured = (number < 5) | (number >= 26)
    own = film(
        30,
        group="vanished",
        present=(number < 5) | (number >= 25),
        measured_mm=np.where(measured, 0.1, np.nan),
        measured_given=measured | (number == 20),
        found=(number < 12) | (number >= 25),
    )
    (row,) = figures_of(own, "films, vanished")
    assert (row["invented"], row["longest_wait"]) == (1, 2)
    assert row["kept"] >= 1


@pytest.mark.usefixtures("sketched")
def test_a_smoke_run_of_the_command(tmp_path, monkeypatch):
    skip_without_platform()
    monkeypatch.setattr(films, "FILMS", {"realistic": 1, "world": 2})
    monkeypatch.setattr(films, "OBJECTS", ("cube_v2",))
    monkeypatch.setattr(films, "SHORTEST", 3)
    monkeypatch.setattr("benchmarks.data.films.ABSENT", 1)
    out, cache = tmp_path / "out", tmp_path / "cache"
    assert "## Over time" in printed_by("films", "--scenes", 3, "--workers", 1, "--cache", cache, "-o", out)
    frames = read_results(out).frames["films"]
    counts = frames.groupby("group").size()
    assert counts["all"] == counts["camera 1"] == 3
    assert counts["world"] == counts["world, camera 3"] == 2 * 3
    assert (frames.ratio > 0).all()
    assert len(list(cache.rglob("*.npz"))) == (3 + 1) + 2 * 3
    (one,) = FilmStore("cube_v2", "world", 3, Plan(workers=1, cache=cache)).frames(1, [2])
    newest = int(np.argmax(one.stamps))
    assert np.array_equal(one.positions[newest], one.position)
    assert np.array_equal(one.rotations[newest], one.rotation)
    store = FilmStore("cube_v2", "realistic", 3, Plan(seed=5, workers=1, cache=cache))
    before = next(store.frames(0, [1]))
    store.store.file(1).write_bytes(b"broken")
    again = next(store.frames(0, [1]))
    assert np.array_equal(before.images, again.images)
