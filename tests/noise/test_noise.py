import re

import numpy as np
import pytest

import tracker
from tracker.noise.model import _LARGEST, UNITS, NoiseState

N = 4000

NONE = {group: dict.fromkeys(names, 0.0) for group, names in UNITS.items()}
NONE["missed"]["found"] = NONE["confidence"]["clear"] = 1.0


def state_of(count: int = N, seed: int = 1, **changes: dict[str, float]) -> NoiseState:
    values = {group: {**NONE[group], **changes.get(group, {})} for group in NONE}
    return NoiseState(values, np.random.default_rng(seed), count)


def truths(count: int = N, visible: float = 1.0):
    rng = np.random.default_rng(7)
    return rng.normal(size=(count, 3)), rng.normal(size=(count, 4)), np.full(count, visible)


@pytest.mark.parametrize("name", ["platform", "platform_refined", "predecessor"])
def test_the_same_seed_gives_the_same_bits_and_numbers_are_stated(name):
    model = tracker.noise.NoiseModel.load(name)
    runs = [model.start(np.random.default_rng(3), 50) for _ in range(2)]
    for _ in range(20):
        first, again = (vars(run.step(*truths(50, 0.2), 0.1)) for run in runs)
        for name, values in first.items():
            np.testing.assert_array_equal(values, again[name])
    assert model.about
    assert all(
        number.unit == UNITS[group][key] for group in UNITS for key, number in model.numbers[group].items()
    )


def test_the_predecessor_has_the_bias_and_misses_of_the_platform():
    former, own = (tracker.noise.NoiseModel.load(name).numbers for name in ("predecessor", "platform"))
    assert former["missed"] == own["missed"]
    for group in ("position", "rotation"):
        assert all(former[group][key] == own[group][key] for key in ("bias", "bias_spread"))


def test_a_model_without_errors_gives_the_truth():
    p, q, v = truths()
    for _ in range(3):
        seen = state_of().step(p, q, v, 0.1)
        assert seen.found.all()
        assert np.array_equal(seen.position, p)
        # The sign is the tracker's, whatever that of the simulator.
        own = q / np.linalg.norm(q, axis=1)[:, None] * np.sign(q[:, 3:])
        np.testing.assert_allclose(seen.orientation, own, atol=1e-15)
        assert (seen.orientation[:, 3] >= 0).all()
        assert (seen.confidence == 1.0).all()
        assert (seen.delay == 0.0).all()


def test_a_bias_stays_for_an_episode_and_another_one_has_another():
    state, truth = state_of(position={"bias": 1e-3}), truths()
    one, two = (state.step(*truth, 0.1).position for _ in range(2))
    assert np.array_equal(one, two)
    which = np.arange(N) % 3 == 0
    state.reset(which)
    assert np.array_equal((state.step(*truth, 0.1).position == one).all(axis=1), ~which)
    assert (one - truth[0]).std() == pytest.approx(1e-3, rel=0.03)


@pytest.mark.parametrize("kind", ["bias", "slow"])
def test_calibrations_differ_as_stated(kind):
    truth = truths()
    seen = state_of(position={kind: 1e-3, "bias_spread": 0.5}).step(*truth, 0.1).position
    # The mean square of exp(0.5 z) is exp(2 · 0.5²).
    assert (seen - truth[0]).std() == pytest.approx(1e-3 * np.exp(0.25), rel=0.05)


def test_poses_are_late_as_stated():
    late = state_of(delay={"images": 0.02, "pose": 0.05, "spread": 0.3}).step(*truths(), 0.1).delay
    spread = np.log((late - 0.02) / 0.05)
    assert (spread.mean(), spread.std()) == pytest.approx((0.0, 0.3), abs=0.02)


@pytest.mark.parametrize("steps", [1, 5])
def test_errors_stay_at_rest_and_are_forgotten_on_the_way_as_stated(steps):
    state, (p, q, v) = state_of(position={"slow": 1e-3, "travel": 0.02}), truths()
    begin = state.step(p, q, v, 0.1).position - p
    np.testing.assert_allclose(state.step(p, q, v, 100.0).position - p, begin, atol=1e-12)
    for k in range(1, steps + 1):
        moved = p + np.array([0.01 * k / steps, 0.0, 0.0])
        end = state.step(moved, q, v, 0.1).position - moved
    assert np.corrcoef(begin.ravel(), end.ravel())[0, 1] == pytest.approx(np.exp(-0.5), abs=0.03)
    assert end.std() == pytest.approx(1e-3, rel=0.03)


@pytest.mark.parametrize(("way", "grown"), [(0.0, 1.0), (0.01, 3.0), (0.03, 7.0), (0.1, 21.0), (10.0, 21.0)])
def test_the_scatter_grows_with_the_speed_as_stated_up_to_the_fastest_motion_measured(way, grown):
    state, (p, q, v) = state_of(position={"fast": 1e-3, "moving": 20.0}), truths()
    state.step(p, q, v, 0.1)
    moved = p + np.array([0.0, way, 0.0])
    assert (state.step(moved, q, v, 0.1).position - moved).std() == pytest.approx(1e-3 * grown, rel=0.03)


def test_rotations_are_perturbed_along_world_axes():
    state, (p, q, v) = state_of(rotation={"fast": 0.02}), truths()
    seen = state.step(p, q, v, 0.1)
    rotation = tracker.geometry.so3.matrix_from_quaternion
    turn = tracker.geometry.so3.log(rotation(seen.orientation) @ np.swapaxes(rotation(q), 1, 2))
    np.testing.assert_allclose(turn.std(axis=0), 0.02, rtol=0.05)
    np.testing.assert_allclose(np.linalg.norm(seen.orientation, axis=1), 1.0)


@pytest.mark.parametrize("kind", ["fast", "slow"])
def test_what_is_hidden_more_is_seen_worse(kind):
    spread = [
        (state_of(position={kind: 1e-3, "visible": 1.0}).step(*truth, 0.1).position - truth[0]).std()
        for truth in (truths(visible=1.0), truths(visible=0.5))
    ]
    assert spread[1] == pytest.approx(2.0 * spread[0])


def test_the_confidence_falls_with_the_errors_as_stated_and_scatters_otherwise():
    own, (p, q, v) = {"clear": 0.9, "visible": 2.0, "distance": 300.0, "angle": 5.0}, truths(visible=0.5)
    errors = {"position": {"fast": 1e-3}, "rotation": {"fast": 0.02}}
    rotation = tracker.geometry.so3.matrix_from_quaternion
    for spread in (0.0, 0.5):
        seen = state_of(**errors, confidence={**own, "spread": spread}).step(p, q, v, 0.1)
        turns = tracker.geometry.so3.angle_between(rotation(seen.orientation), rotation(q))
        expected = np.log(9.0 / 4.0) - 300.0 * np.linalg.norm(seen.position - p, axis=1) - 5.0 * turns
        left = np.log(seen.confidence / (1.0 - seen.confidence)) - expected
        assert left.std() == pytest.approx(spread, rel=0.05, abs=1e-9)
        assert left.mean() == pytest.approx(0.0, abs=0.05 * spread + 1e-9)


def test_misses_last_as_stated_and_never_bear_a_pose():
    state, truth = state_of(missed={"lost": 1.0, "found": 4.0}), truths()
    seen = [state.step(*truth, 0.05) for _ in range(100)]
    found = np.array([one.found for one in seen])
    assert found.mean() == pytest.approx(0.8, abs=0.01)
    back = found[1:][~found[:-1]].mean()
    assert back == pytest.approx(0.8 * (1.0 - np.exp(-0.25)), rel=0.03)
    for one in seen:
        assert np.array_equal(np.isnan(one.position).all(axis=1), ~one.found)
        assert np.array_equal(np.isnan(one.orientation).all(axis=1), ~one.found)
        assert (one.confidence[~one.found] == 0.0).all()
        assert np.isfinite(one.delay).all()


@pytest.mark.parametrize("dt", [0.02, 0.1, 1.0, 10.0])
def test_gross_errors_come_and_go_as_stated_at_any_rate_and_stay_as_they_are(dt):
    own = {"rate": 0.5, "seconds": 0.4, "distance": 0.02, "angle": 0.5}
    state, truth = state_of(gross=own), truths()
    off = np.array([state.step(*truth, dt).position - truth[0] for _ in range(100)])
    gross = np.linalg.norm(off, axis=2) > 1e-9
    assert np.allclose(np.linalg.norm(off[gross], axis=1), 0.02)
    share, goes_on = 0.5 / (0.5 + 1 / 0.4), np.exp(-dt / 0.4)
    assert gross.mean() == pytest.approx(share, rel=0.1)
    both = gross[1:] & gross[:-1]
    same = np.isclose(off[1:], off[:-1], atol=1e-12).all(axis=2)[both]
    stays = share + (1 - share) * np.exp(-dt * (0.5 + 1 / 0.4))
    assert both.sum() / gross[:-1].sum() == pytest.approx(stays, rel=0.05)
    assert same.mean() == pytest.approx(goes_on / stays, abs=0.02)


def test_the_largest_numbers_of_a_model_give_poses():
    most = {group: {name: _LARGEST.get(name.split("_")[-1], 1e6) for name in UNITS[group]} for group in UNITS}
    seen = state_of(**most, seed=2).step(*truths(visible=0.05), 0.1)
    assert seen.found.any()
    assert np.isfinite(seen.position[seen.found]).all()
    np.testing.assert_allclose(np.linalg.norm(seen.orientation[seen.found], axis=1), 1.0)
    assert np.isfinite(seen.delay).all()
    most["confidence"]["clear"] = 0.5
    seen = state_of(**most).step(*truths(visible=0.05), 0.1)
    assert ((seen.confidence >= 0.0) & (seen.confidence <= 1.0)).all()


def test_what_is_fully_hidden_is_not_found():
    state = tracker.noise.NoiseModel.load("platform").start(np.random.default_rng(1), 2000)
    position, orientation, visible = truths(2000)
    assert state.step(position, orientation, visible, 0.1).found.mean() > 0.95
    for _ in range(3):
        assert not state.step(position, orientation, 0.0 * visible, 0.1).found.any()


def test_shares_that_rounding_puts_out_of_range_count_as_their_bounds():
    model, truth = tracker.noise.NoiseModel.load("platform"), truths()
    one, other = (
        model.start(np.random.default_rng(1), N).step(*truth[:2], truth[2] * share, 0.1)
        for share in (1.0, np.float32(1.0000001))
    )
    np.testing.assert_array_equal(one.position, other.position)


def test_environments_together_are_distributed_as_each_alone():
    model = tracker.noise.NoiseModel.load("platform")
    truth = truths(1, 0.7)
    rng = np.random.default_rng(5)
    alone = np.array([model.start(rng, 1).step(*truth, 0.1).position[0] for _ in range(1000)]) - truth[0]
    many = model.start(rng, 2000).step(*(np.repeat(x, 2000, axis=0) for x in truth), 0.1).position - truth[0]
    sizes = [np.quantile(np.linalg.norm(x, axis=1), [0.25, 0.5, 0.75]) for x in (alone, many)]
    np.testing.assert_allclose(*sizes, rtol=0.1)


P, Q, V = truths(2)


class Refusing:
    """An array that cannot be converted, as a tensor with a gradient."""

    def __array__(self, *_: object, **options: object) -> None:
        raise RuntimeError("Can't call numpy() on Tensor that requires grad.")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((P[:1], Q, V, 0.1), r"position: found shape \(1, 3\), expected"),
        ((P * np.nan, Q, V, 0.1), "position: found values that are not finite"),
        ((P, 0 * Q, V, 0.1), "orientation: found one of length 0"),
        ((P, 1e200 * Q, V, 0.1), "orientation: found one of length inf"),
        ((P, Q, np.ma.masked_array(V, mask=[0, 1]), 0.1), "visible: found .*, expected numbers of shape"),
        ((P, Q, Refusing(), 0.1), "visible: found .*, expected numbers of shape"),
        ((P, Q, V + 1, 0.1), "visible: found 2 to 2, expected shares"),
        ((P, Q, V, 0.0), "dt: found 0.0, expected"),
    ],
)
def test_what_is_no_step_is_refused_with_the_reason(arguments, message):
    with pytest.raises(tracker.TrackerError, match=message):
        state_of(2).step(*arguments)


def test_what_is_no_model_or_start_is_refused_with_the_reason(tmp_path):
    load, rng = tracker.noise.NoiseModel.load, np.random.default_rng(0)
    with pytest.raises(tracker.TrackerError, match="valid are platform, platform_refined, predecessor"):
        load("robot")
    for count, found in ((0, "0"), (10**8, "100000000"), (10**30, "a whole number above")):
        with pytest.raises(tracker.TrackerError, match=f"count: found {found}.*, expected .* to 10,000,000"):
            load("platform").start(rng, count)
    with pytest.raises(tracker.TrackerError, match="rng: found 3"):
        load("platform").start(3, 1)  # type: ignore[arg-type]
    for which in ([2], [[0], [1, 0]], ["a", None], [0, 0]):
        with pytest.raises(tracker.TrackerError, match=r"which: found a list.* \(2,\) bool"):
            state_of(2).reset(which)
    preset = (tracker.noise.model._DATA / "platform.toml").read_text(encoding="utf-8")
    path = tmp_path / "own.toml"
    path.write_text(preset, encoding="utf-8")
    assert load(path).numbers == load("platform").numbers
    for old, new, message in (
        ('unit = "m"', 'unit = "mm"', "position.bias: found"),
        (r"\[delay\]", "[delays]", "'delay' is missing|'delays' is unknown"),
        ("bias =", "bias", "not a TOML file"),
        ("value = ", "value = -", "found value -"),
        (
            r"interval = \[",
            "interval = [0.0, 9.0, ",
            "found interval a list of 4, expected two numbers around",
        ),
        (r"interval = \[[^,]*", "interval = [9.0", "found interval a list of 2, expected two numbers around"),
        (r"interval = \[[^,]*", 'interval = ["0"', "found interval a list of 2, expected two numbers around"),
        *(
            (rf"\b{name} = \{{value = [\d.]+", f"{name} = {{value = {value}", message)
            for name, value, message in (
                ("clear", 1.5, "confidence.clear: found value 1.5, expected 0 to 1"),
                ("visible", 31, "position.visible: found value 31, expected 0 to 30"),
                ("fast_spread", 999, "position.fast_spread: found value 999, expected 0 to 10"),
            )
        ),
    ):
        path.write_text(re.sub(old, new, preset, count=1), encoding="utf-8")
        with pytest.raises(tracker.TrackerError, match=message):
            load(path)
