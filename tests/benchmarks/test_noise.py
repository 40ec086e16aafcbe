import numpy as np
from scipy.optimize import least_squares

from benchmarks.data.films import FilmFrame
from benchmarks.data.scenes import rig
from benchmarks.measure.noise import covered, mended, write_plot
from benchmarks.score import noise as score
from synthetic.camera.miscalibration import stated
from tracker.noise import NoiseModel


def made_up(count: int = 40, length: int = 30):
    """Episodes of an object that rests and then moves, without any error."""
    rng = np.random.default_rng(2)
    rows = np.zeros((count, length, 16))
    rows[..., 0], rows[..., 1], rows[..., 15] = 0.1 * np.arange(length), 0.8, 1.0
    rows[:, :, 1] = rng.uniform(0.1, 1.0, (count, 1))
    rows[:, length // 2 :, 9] = 0.02 * np.arange(length - length // 2)
    return list(rows)


NUMBERS = NoiseModel.load("platform").numbers
VALUES = {group: {key: n.value for key, n in numbers.items()} for group, numbers in NUMBERS.items()}


def test_a_model_agrees_with_what_it_made(tmp_path):
    one, other = (score.simulated(VALUES, made_up(), seed) for seed in (1, 2))
    for name, first, second in score.agreement(one, other):
        assert abs(second / first - 1.0) < 0.15, name
    write_plot(one, other, tmp_path / "plot.png")
    assert (tmp_path / "plot.png").stat().st_size > 5000


def test_a_file_that_is_written_is_read_again(tmp_path):
    path = tmp_path / "noise.toml"
    found = {
        group: {key: (number.value, number.interval or ()) for key, number in numbers.items()}
        for group, numbers in NUMBERS.items()
    }
    path.write_text(score.to_toml("again", found), encoding="utf-8")
    assert NoiseModel.load(path).numbers == NUMBERS
    assert path.stat().st_size < 5000


def test_rates_of_misses_are_found_again_and_have_an_end(tmp_path):
    own = {"lost": 3.0, "lost_visible": 2.0, "found": 2.0, "found_visible": 1.0}
    found = score._missed(score.simulated({**VALUES, "missed": own}, made_up(), 3))
    for key, value in found.items():
        assert abs(value - own[key]) < 0.25 * own[key], key
    # Where all or nothing is found, or all from a visible share on, rates have no end; a file's numbers have.
    nothing, sudden = np.stack(made_up()), np.stack(made_up())
    nothing[0, :, 2:9] = sudden[sudden[..., 1] < 0.3, 2:9] = np.nan
    for rows in (np.stack(made_up()), nothing, sudden):
        known = {group: {key: (value, ()) for key, value in own.items()} for group, own in VALUES.items()}
        known["missed"] = {key: (value, ()) for key, value in score._missed(rows).items()}
        (tmp_path / "noise.toml").write_text(score.to_toml("", known), encoding="utf-8")
        NoiseModel.load(tmp_path / "noise.toml")


def test_a_slope_of_confidence_that_may_not_be_negative_leaves_mean_and_spread_as_they_are(rng):
    rows = np.stack(made_up())
    rows[..., 2], rows[..., 5] = np.abs(rng.normal(0.0, [[[1e-3]], [[0.02]]], (2, *rows.shape[:2])))
    logit = 2.0 + np.log(rows[..., 1]) - 80.0 * rows[..., 2] + 40.0 * rows[..., 5]
    rows[..., 8] = 1.0 / (1.0 + np.exp(-logit))
    own = score._confidence(rows)
    assert own["angle"] == 0.0
    left = logit - own["visible"] * np.log(rows[..., 1]) + own["distance"] * rows[..., 2]
    assert abs(left.mean() - np.log(own["clear"] / (1.0 - own["clear"]))) < 0.01
    assert abs(left.std() - own["spread"]) < 0.01


def test_covers_hide_the_share_that_they_say_and_refined_cameras_are_near_the_true_ones(rng):
    image = np.full((270, 270, 3), 255, np.uint8)
    pose = np.array([0.0, 0.0, 0.0325]), np.eye(3)
    one = FilmFrame((image,) * 3, np.ones(3), *pose, stamps=np.zeros(3))
    frames = covered([one] * 40, rig(), np.full(3, 0.065), rng)
    shares = np.array([1.0 - frame.visible_fraction for frame in frames])
    painted = np.array([[(i < 255).any() for i in frame.images] for frame in frames])
    assert 0.2 < (shares > 0).mean() < 0.9
    assert painted[shares > 0.2].all()
    assert not painted[shares == 0].any()
    given = stated(rig(), rng)
    for camera, true in zip(mended(rig(), given, rng), rig(), strict=True):
        off = camera.camera_from_world[:3, 3] - true.camera_from_world[:3, 3]
        assert 0.0 < np.linalg.norm(off) < 0.6e-3


def test_the_gain_of_a_fit_is_how_its_solution_changes(rng):
    rows, values = rng.normal(size=(14, 3)), rng.normal(size=14)

    def fit_of(values):
        tight = dict.fromkeys(("xtol", "ftol", "gtol"), 1e-14)
        return least_squares(
            lambda x: rows @ x - values, np.zeros(3), loss="soft_l1", f_scale=score.SCALE, **tight
        )

    best = fit_of(values)
    changed = [(fit_of(values - 1e-4 * one).x - fit_of(values + 1e-4 * one).x) / 2e-4 for one in np.eye(14)]
    np.testing.assert_allclose(score.gain_of(best.jac, best.fun), np.transpose(changed), atol=1e-4)
