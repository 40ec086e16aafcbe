import math

import numpy as np
import pandas as pd
import pytest
from scipy.stats import binomtest

import tracker
from benchmarks.score import errors, metrics
from benchmarks.score.metrics import Metric, wilson_interval
from benchmarks.score.tables import TABLES, VISIBLE, by_confidence, figures
from tests.benchmarks.made_up import OBJECTS, answer, answers, figures_of, results
from tests.helpers import random_rotations
from tracker.geometry import so3


def test_rotation_splits_into_axis_and_roll_about_the_cuboids_longest_axis(rng):
    rotations, frame = random_rotations(rng, 20), random_rotations(rng, 1)[0]
    turned = rotations @ so3.exp([0.02, 0, 0]) @ so3.exp([0, 0.3, 0])
    for pair in ((rotations, turned), (turned, rotations), (frame @ rotations, frame @ turned)):
        np.testing.assert_allclose(errors.roll_error(*pair, 1), 0.3, atol=1e-9)
    assert [errors.longest_axis(tracker.load_object(name).size) for name in OBJECTS] == [None, 1]


def test_nees_of_a_true_covariance_is_chi_squared(rng):
    root = rng.normal(size=(6, 6)) * 1e-3
    covariance = root @ root.T + 1e-8 * np.eye(6)
    d = rng.multivariate_normal(np.zeros(6), covariance, 4000)
    position, rotation = rng.normal(size=3), random_rotations(rng, 1)[0]
    true = position + d[:, :3], so3.exp(d[:, 3:]) @ rotation
    found = np.tile(position, (4000, 1)), np.tile(rotation, (4000, 1, 1))
    values = errors.nees(true, found, np.tile(covariance, (4000, 1, 1)))
    assert values.mean() == pytest.approx(6, abs=0.2)
    assert np.median(values) == pytest.approx(5.348, abs=0.2)
    np.testing.assert_allclose(errors.nees(true, found, 4 * covariance), values / 4)
    assert metrics.INSIDE.of(pd.DataFrame({"found": True, "nees": values})) == pytest.approx(95, abs=1)


def test_figures_count_right_wrong_and_missing():
    rows = [
        *[answer(mm=0.5, deg=0.4, confidence=0.9)] * 6,
        answer(mm=6.0, deg=1.0, confidence=0.8),
        answer(mm=1.0, deg=6.0, confidence=0.2),
        answer(found=False, status="poor_fit"),
        answer(found=False, status="ambiguous", visible=0.4),
    ]
    (row,) = figures_of(rows, "accuracy")
    found = [row[key] for key in ("n", "within_5", "none", "wrong_and_sure", "median_mm")]
    assert found == [10, 60, 20, 10, 0.5]
    (trust,) = figures_of(rows, "trust")
    assert trust["brier"] == pytest.approx((6 * 0.01 + 0.64 + 0.04) / 8)
    assert trust["honesty"] == pytest.approx(abs(100 * (6 * 0.9 + 0.8 + 0.2) / 8 - 75))
    visible = {label: len(own) for label, own in metrics.by_visibility(*VISIBLE)(pd.DataFrame(rows))}
    assert visible == {"0.7-0.9": 9, "0.3-0.5": 1}
    assert sum(len(own) for _, own in by_confidence(pd.DataFrame(rows))) == 8


def test_what_is_not_the_object_counts_as_found_above_a_confidence():
    empty = {"group": "absent", "present": False, "mm": np.nan, "deg": np.nan, "nees": np.nan}
    rows = [answer(**empty, confidence=c) for c in (0.3, 0.6, 0.95)] + [answer(**empty, found=False)]
    (row,) = figures_of(rows, "finds")
    assert [row[key] for key in ("found", "above_5", "above_9", "greatest")] == [75, 50, 25, 0.95]


def test_every_metric_gives_a_number_and_its_text_and_the_typical_one_is_the_geometric_mean():
    frames = results(12).frames
    rows = figures(frames)
    for table in TABLES:
        names = [metric.name for metric in table.metrics]
        assert len(set(names)) == len(names), table.name
        for row in (row for row in rows if row["table"] == table.name):
            for metric in table.metrics:
                assert isinstance(row.get(metric.name, 0.0), float | int)
                assert metric.text(1.0).strip()
    assert metrics.typical("mm")(pd.DataFrame({"mm": [0.1, 10.0, np.nan]})) == pytest.approx(1.0)
    expected = {"accuracy", "trust", "finds", "detect", "films", "update", "third camera"}
    assert {row["table"] for row in rows} > expected
    assert all(math.isfinite(value) for row in rows for value in row.values() if isinstance(value, float))


@pytest.mark.parametrize(
    ("better", "before", "after", "worse"),
    [
        ("lower", 1.0, 1.09, False),
        ("lower", 1.0, 1.11, True),
        ("lower", 1.0, 0.1, False),
        ("higher", 1.0, 0.89, True),
        ("higher", 1.0, 5.0, False),
        ("same", 1.0, 1.2, True),
        ("same", 1.0, 0.8, True),
        ("same", 1.0, 1.05, False),
        ("lower", 1.0, math.nan, True),
        ("lower", math.nan, 1.0, False),
    ],
)
def test_a_metric_knows_what_is_worse(better, before, after, worse):
    for allowed in ({"factor": 1.1}, {"step": 0.1}):
        assert Metric("x", "x", lambda rows: 0.0, better=better, **allowed).worse(before, after) is worse


def test_intervals_hold_their_figure_and_shrink_with_the_count():
    for share, count in ((0.0, 10), (50.0, 10), (100.0, 10), (50.0, 1000)):
        low, high = wilson_interval(share, count)
        assert 0 <= low <= share + 1e-9
        assert share - 1e-9 <= high <= 100
        own = binomtest(round(share * count / 100), count).proportion_ci(method="wilson")
        assert (low, high) == pytest.approx((100 * own.low, 100 * own.high), abs=1e-9)
    assert np.ptp(wilson_interval(50.0, 1000)) < np.ptp(wilson_interval(50.0, 10))
    assert wilson_interval(np.nan, 0) == (0, 100)
    # The frames of a film count once.
    rows = pd.DataFrame(
        {"film": np.repeat([0, 1, 0], 8), "camera": np.repeat(["a", "a", "b"], 8), "right": True}
    )
    share = Metric("x", "x", lambda own: metrics.percent(own.right), share=True)
    assert share.interval(rows) == wilson_interval(100.0, 3)
    assert share.interval(rows.drop(columns="film")) == wilson_interval(100.0, 24)


@pytest.mark.parametrize("count", [6, 20, 200])
def test_the_ellipsoids_interval_covers_as_often_as_it_says(count):
    inside = 0
    for seed in range(100):
        nees = np.random.default_rng(seed).chisquare(6, count)
        low, high = metrics.INSIDE.interval(pd.DataFrame({"found": True, "nees": nees}))
        inside += low <= 95.0 <= high
    assert inside >= 90
    # Poses that were not given are none of the answers.
    rows = pd.DataFrame({"found": np.repeat([True, False], 10), "nees": np.repeat([5.0, np.nan], 10)})
    assert metrics.INSIDE.interval(rows) == wilson_interval(100.0, 10)
    assert metrics.INSIDE.interval(rows[~rows.found]) == (0.0, 100.0)


@pytest.mark.parametrize("frames", [1, 8])
def test_the_bootstraps_interval_covers_as_often_as_it_says(frames):
    inside = 0
    for seed in range(60):
        # The frames of a film show the same with other noise.
        rng, film = np.random.default_rng(seed), np.arange(80).repeat(frames)
        values = rng.normal(size=80)[film] + (0.1 * rng.normal(size=len(film)) if frames > 1 else 0.0)
        frame = pd.DataFrame({"x": values, "film": film})
        low, high = metrics.bootstrap_interval(lambda own: metrics.median(own.x), frame)
        inside += low <= 0.0 <= high
    assert 51 <= inside <= 60


def test_too_few_values_do_not_bound_a_high_quantile():
    slowest = next(metric for metric in metrics.TIMES if metric.name == "p99_ratio")
    for count, bounded in ((200, False), (360, False), (368, True), (1000, True)):
        covered = 0
        for seed in range(20):
            rows = pd.DataFrame({"ratio": np.random.default_rng(seed).exponential(size=count)})
            low, high = slowest.interval(rows)
            assert np.isfinite(high) == bounded
            covered += low <= -np.log(0.01) <= high
        assert covered >= 16
        # The frames of a film count once.
        assert np.isinf(slowest.interval(rows.assign(film=np.arange(count) % 8))[1])


def test_an_honest_confidence_is_found_to_be_honest():
    own = answers(2000)
    plain = own[own.group == "realistic"]
    assert metrics.HONESTY.of(plain) < 1.0
    assert metrics.HONESTY.of(plain.assign(confidence=0.7)) > 20
