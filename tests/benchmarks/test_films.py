from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner

from benchmarks.data.films import ABSENT, FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.store import packed, unpacked
from benchmarks.judge.results import read_results
from benchmarks.measure import films
from benchmarks.program import main
from benchmarks.report.film_plot import FILE, write_film_plot
from benchmarks.score.films import (
    COLUMNS,
    camera_row,
    longest_wait,
    losses,
    right,
    share_row,
    state_rows,
    status_row,
    vanished_row,
)
from tests.helpers import random_rotations
from tests.helpers.synthetic_needs import skip_without_platform


def played(count=10, **changed) -> pd.DataFrame:
    """A film in which all is well."""
    fine = {
        "film": 0,
        "timestamp": np.arange(count) / 10,
        "present": True,
        "status": ["FOUND", *["TRACKING"] * (count - 1)],
        "confidence": 0.99,
        "update_ms": 0.8,
        "reference_ms": 1.0,
        "at_rest": np.arange(count) < count // 2,
        "measured_given": True,
        "filtered_given": True,
        "measured_mm": 0.1,
        "measured_deg": 0.2,
        "filtered_mm": 0.05,
        "filtered_deg": 0.1,
        "measured_nees": 5.0,
        "filtered_nees": 5.0,
    }
    assert set(fine) == set(COLUMNS)
    return pd.DataFrame({**fine, **{f"visible_{k}": np.ones(count) for k in range(3)}, **changed})


def frame_of(number, position=(0.0, 0.0, 0.0), rotation=None) -> FilmFrame:
    image = np.full((4, 4, 3), number, np.uint8)
    turn = np.eye(3) if rotation is None else rotation
    return FilmFrame(number / 10, (image,) * 3, np.ones(3), np.array(position), turn)


def test_a_frame_survives_the_disk(rng):
    for frame in (
        frame_of(3, rng.normal(size=3), random_rotations(rng, 1)[0]),
        dataclasses.replace(frame_of(4), position=None, rotation=None),
    ):
        again = unpacked(FilmFrame, packed(frame))
        for field in dataclasses.fields(FilmFrame):
            assert np.array_equal(getattr(again, field.name), getattr(frame, field.name))
        assert unpacked(FilmFrame, packed(frame)[:100]) is None


@pytest.mark.parametrize("length", [40, 600])
def test_an_object_that_vanishes_comes_back_within_the_film(length):
    starts = vanishing_frames(length)
    assert len(starts) == (1 if length == 40 else 4)
    assert all(start > 0 and start + ABSENT < length for start in starts)


class MadeUp:
    """Stands for a store of films."""

    length = 40

    def frames(self, film, numbers, *, empty=False):
        for number in numbers:
            frame = frame_of(number, (0.01 * number, 0.0, 0.0))
            yield dataclasses.replace(frame, position=None, rotation=None) if empty else frame


def test_a_vanished_object_returns_elsewhere_without_a_jump_in_time():
    positions = np.array([[0.01 * number, 0.0, 0.0] for number in range(40)])
    frames = list(vanishing_film(MadeUp(), 0, 13, positions))  # type: ignore[arg-type]
    assert [frame.position is None for frame in frames] == [False] * 13 + [True] * 20 + [False] * 7
    np.testing.assert_allclose(np.diff([frame.timestamp for frame in frames]), 0.1)
    assert np.linalg.norm(frames[33].position - frames[12].position) > 0.1


def test_losses_are_of_what_had_been_found():
    assert losses(np.array(["LOST", "FOUND", "COASTING", "LOST", "LOST", "REFOUND", "LOST"])) == 2
    assert losses(np.array(["LOST", "LOST"])) == 0


def test_shares_flips_and_ratios():
    film = played()
    film.loc[8:9, ["filtered_mm", "filtered_deg"]] = 1.0, 170.0
    film.loc[9, "confidence"] = 0.2
    row = share_row(film)
    assert (row["filtered"], row["measured"], row["flips"], row["n"]) == (80.0, 100.0, 1, 10)
    assert row["inside_50"] == row["inside_95"] == 100
    at_rest, moving = state_rows(film, pd.DataFrame({"mm": [0.1] * 10, "deg": [0.4] * 10}))
    assert (at_rest["ratio_mm"], at_rest["ratio_deg"]) == pytest.approx((0.5, 0.25))
    assert at_rest["n"] + moving["n"] == 10
    assert status_row(film) == {"n": 10, "found": 1, "tracking": 9}
    wrong = pd.DataFrame({"filtered_mm": [np.nan, 1.0, 6.0], "filtered_deg": [np.nan, 6.0, 1.0]})
    assert not right(wrong, "filtered").any()


def test_one_camera_is_judged_where_it_sees_enough():
    film = played(measured_mm=15.0, measured_deg=2.0)
    film.loc[:1, "visible_1"] = 0.4
    film.loc[:3, "measured_mm"] = 50.0
    film.loc[4, ["measured_mm", "measured_given"]] = np.nan, False
    film["measured_given"] = film.measured_given.astype(bool)
    row = camera_row(film, 1)
    assert (row["n"], row["right"], row["none"], row["wrong"]) == (8, 62.5, 12.5, 25.0)
    assert row["right_or_none"] == 75.0


def test_the_wait_begins_when_the_view_has_been_clear():
    visible = np.array([0.2, 0.8, 0.8, 0.8, 0.8, 0.8, 0.3, 0.8])
    assert longest_wait(visible, np.zeros(8, bool)) == 3
    assert longest_wait(visible, np.array([0, 0, 0, 0, 1, 0, 0, 0], bool)) == 1
    assert longest_wait(visible, np.ones(8, bool)) == 0


def test_what_is_said_of_an_object_that_is_away():
    number = np.arange(30)
    measured = (number < 5) | (number >= 26)
    film = played(
        30,
        present=(number < 5) | (number >= 25),
        measured_mm=np.where(measured, 0.1, np.nan),
        measured_given=measured | (number == 20),
        filtered_given=(number < 12) | (number >= 25),
    )
    row = vanished_row(film)
    assert (row["invented"], row["longest_wait"], row["n"]) == (1, 2, 1)
    assert row["kept"] >= 1
    assert row["kept_seconds"] == pytest.approx(0.7)


def test_a_film_is_drawn(tmp_path):
    nothing = dict.fromkeys(("measured_mm", "measured_deg", "filtered_mm", "filtered_deg"), np.nan)
    lost = played(status=["LOST"] * 10, **nothing)
    picture = cv2.imread(str(write_film_plot({"cube_v2": played(), "cuboid_2x2x8_v2": lost}, tmp_path)))
    assert picture is not None


@pytest.mark.usefixtures("sketched")
def test_a_smoke_run_of_the_command(tmp_path, monkeypatch):
    skip_without_platform()
    monkeypatch.setattr(films, "FILMS", 1)
    monkeypatch.setattr(films, "film_length", lambda plan: 3)
    monkeypatch.setattr("benchmarks.data.films.ABSENT", 1)
    out, cache = tmp_path / "out", tmp_path / "cache"
    arguments = ["films", "--quick", "--workers", "1", "--cache", str(cache), "-o", str(out)]
    done = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    assert "## Over time" in done.output
    rows = [row for row in read_results(out).rows if row["part"] == "films" and row["group"] == "all"]
    assert [row["n"] for row in rows] == [3, 3]
    assert (out / FILE).is_file()
    assert len(list(cache.rglob("*.npz"))) == 2 * (3 + 1)
    store = FilmStore("cube_v2", 3, 5, 1, cache)
    before = next(store.frames(0, [1]))
    store.store.file(1).write_bytes(b"broken")
    again = next(store.frames(0, [1]))
    assert np.array_equal(before.images, again.images)
