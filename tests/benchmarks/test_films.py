from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from benchmarks import commands
from benchmarks.__main__ import main
from benchmarks.data import dice as dice_scenes
from benchmarks.data import scenes
from benchmarks.data.films import ABSENT, SEED, FilmFrame, FilmStore, vanishing_film, vanishing_frames
from benchmarks.data.store import read_packed
from benchmarks.measure.films import FilmOptions
from benchmarks.measure.playing import Played
from benchmarks.report.film_plot import FILE, write_film_plot
from benchmarks.report.film_tables import TARGETS, film_tables, film_targets
from benchmarks.score.films import (
    camera_row,
    longest_wait,
    losses,
    share_row,
    speed_row,
    vanished_row,
    whole_row,
    within,
)
from benchmarks.score.records import read_results
from tests.helpers import random_rotations
from tests.helpers.synthetic_needs import skip_without_platform


def played(count=10, **changed) -> Played:
    """A film in which all is well."""
    errors = np.tile([0.1, 0.2], (count, 1))
    fine = Played(
        timestamp=np.arange(count) / 10,
        visible=np.ones((count, 3)),
        present=np.ones(count, bool),
        measured=errors,
        filtered=errors / 2,
        given=np.ones((count, 2), bool),
        confidence=np.full(count, 0.99),
        nees=np.full(count, 5.0),
        status=np.array(["FOUND", *["TRACKING"] * (count - 1)]),
        times=np.tile([0.8, 1.0], (count, 1)),
        at_rest=np.arange(count) < count // 2,
    )
    return dataclasses.replace(fine, **changed)


def frame_of(number, position=(0.0, 0.0, 0.0), rotation=None) -> FilmFrame:
    image = np.full((4, 4, 3), number, np.uint8)
    turn = np.eye(3) if rotation is None else rotation
    return FilmFrame(number / 10, (image,) * 3, np.ones(3), np.array(position), turn)


def test_a_frame_survives_the_disk(rng, tmp_path):
    file = tmp_path / "frame.npz"
    for frame in (
        frame_of(3, rng.normal(size=3), random_rotations(rng, 1)[0]),
        dataclasses.replace(frame_of(4), position=None, rotation=None),
    ):
        file.write_bytes(frame.packed())
        again = read_packed(file, FilmFrame.unpacked)
        for field in dataclasses.fields(FilmFrame):
            assert np.array_equal(getattr(again, field.name), getattr(frame, field.name))
    file.write_bytes(frame.packed()[:100])
    assert read_packed(file, FilmFrame.unpacked) is None


def test_the_films_have_seeds_of_their_own():
    own = {SEED + k for k in range(len(scenes.OBJECTS))}
    taken = {scenes.SEED + 10 * k + style for k in range(len(scenes.OBJECTS)) for style in range(10)}
    assert not own & (taken | {dice_scenes.SEED, dice_scenes.SEED + 1})


@pytest.mark.parametrize("length", [40, 600])
def test_an_object_that_vanishes_comes_back_within_the_film(length):
    starts = vanishing_frames(length)
    assert len(starts) == (1 if length == 40 else 4)
    assert all(start > 0 and start + ABSENT < length for start in starts)


class MadeUp:
    """Stands for a store of films."""

    length = 40

    def frames(self, film, numbers, empty=False):
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
    filtered = np.tile([0.05, 0.1], (10, 1))
    filtered[8], filtered[9] = (1.0, 170.0), (1.0, 170.0)
    confidence = np.full(10, 0.9)
    confidence[9] = 0.2
    single = np.tile([0.1, 0.4], (10, 1))
    row = whole_row([played(filtered=filtered, confidence=confidence)], single)
    assert (row["filtered"], row["measured"], row["single"], row["flips"]) == (80.0, 100.0, 100.0, 1)
    assert (row["rest_ratio_mm"], row["rest_ratio_deg"]) == pytest.approx((0.5, 0.25))
    assert row["statuses"] == {"FOUND": 1, "TRACKING": 9}
    assert not within(np.array([[np.nan, np.nan], [1.0, 6.0], [6.0, 1.0]])).any()


def test_one_camera_is_judged_where_it_sees_enough():
    visible, measured, given = np.ones((10, 3)), np.tile([15.0, 2.0], (10, 1)), np.ones((10, 2), bool)
    visible[:2, 1] = 0.4
    measured[:4] = 50.0, 2.0
    measured[4], given[4, 0] = np.nan, False
    row = camera_row([played(visible=visible, measured=measured, given=given)], 1)
    assert (row["frames"], row["right"], row["none"], row["wrong"]) == (8, 62.5, 12.5, 25.0)
    assert row["right_or_none"] == 75.0


def test_the_wait_begins_when_the_view_has_been_clear():
    visible = np.array([0.2, 0.8, 0.8, 0.8, 0.8, 0.8, 0.3, 0.8])
    assert longest_wait(visible, np.zeros(8, bool)) == 3
    assert longest_wait(visible, np.array([0, 0, 0, 0, 1, 0, 0, 0], bool)) == 1
    assert longest_wait(visible, np.ones(8, bool)) == 0


def test_what_is_said_of_an_object_that_is_away():
    present, given, measured = np.ones(30, bool), np.ones((30, 2), bool), np.tile([0.1, 0.1], (30, 1))
    present[5:25] = False
    given[5:26, 0] = False
    given[12:25, 1] = False
    measured[~given[:, 0]] = np.nan
    given[20, 0] = True
    row = vanished_row([played(30, present=present, given=given, measured=measured)])
    assert (row["invented"], row["longest_wait"]) == (1, 2)
    assert row["kept"] >= 1
    assert row["kept_seconds"] == pytest.approx(0.7)


def made_up() -> dict:
    def both(*rows):
        return [{"object": name, **row} for name in scenes.OBJECTS for row in rows]

    parts = [played()]
    away = played(30, present=~((np.arange(30) >= 5) & (np.arange(30) < 25)))
    return {
        "about": {"seed": 3, "films": 1, "frames": 10},
        "whole": both(whole_row(parts, np.tile([0.1, 0.2], (10, 1)))),
        "thinned": both({"stride": 2, **share_row(parts)}),
        "cameras": both(*(camera_row(parts, camera) for camera in range(3))),
        "vanished": both(vanished_row([away])),
        "speed": both(speed_row(parts)),
        "figures": {"cube_v2": {"filtered": 99.6, "nees": 10.0}},
    }


def test_targets_are_met_missed_or_not_measured():
    rows = film_targets(made_up()["figures"])
    assert len(rows) == 2 * len(TARGETS)
    measured = {row["name"]: row for row in rows if not math.isnan(row["value"])}
    assert {row["object"] for row in measured.values()} == {"cube_v2"}
    assert [row["met"] for row in measured.values()] == [True, False]
    assert not any(row["met"] for row in film_targets({}))


def test_tables_have_a_cell_for_each_heading():
    for table in film_tables(made_up()):
        assert table.rows
        assert all(len(row) == len(table.heads) for row in table.rows)
        assert "nan" not in table.markdown()


def test_a_film_is_drawn(tmp_path):
    nothing = np.full((10, 2), np.nan)
    lost = played(measured=nothing, filtered=nothing, status=np.array(["LOST"] * 10))
    picture = cv2.imread(str(write_film_plot({"cube_v2": played(), "cuboid_2x2x8_v2": lost}, tmp_path)))
    assert picture is not None


def test_a_smoke_run_of_the_command(tmp_path, monkeypatch):
    skip_without_platform()
    monkeypatch.setattr(commands, "QUICK_FILMS", FilmOptions(films=1, length=3))
    monkeypatch.setattr("benchmarks.data.films.ABSENT", 1)
    out, cache = tmp_path / "out", tmp_path / "cache"
    arguments = ["films", "--quick", "--workers", "1", "--seed", "5", "--cache", str(cache), "-o", str(out)]
    done = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert done.exit_code == 0
    assert "## Over time" in done.output
    films = read_results(out)["films"]
    assert films["about"] == {"seed": 5, "films": 1, "frames": 3}
    assert [row["frames"] for row in films["whole"]] == [3, 3]
    assert (out / FILE).is_file()
    assert len(list(cache.rglob("*.npz"))) == 2 * (3 + 1)
    store = FilmStore("cube_v2", 3, 5, 1, cache)
    file = store.file(0, 1)
    before = next(store.frames(0, [1]))
    file.write_bytes(b"broken")
    again = next(store.frames(0, [1]))
    assert np.array_equal(before.images, again.images)
