import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.helpers import random_rotations
from tests.helpers.consistency import FACTORS, consistent, nees
from tracker.geometry import so3
from tracker.tracking.motion import CONSTANT, MotionFilter

DT = 0.1
NOISE = np.diag(np.repeat(np.square([0.5e-3, np.radians(0.5)]), 3))
"""Covariance of a made-up measurement."""


def drawn(rng, covariance, count=None):
    """Errors with a covariance."""
    return rng.multivariate_normal(np.zeros(len(covariance)), covariance, count, method="cholesky")


def moved(position, rotation, error):
    """A pose off by an error (6,)."""
    return position + error[:3], so3.exp(error[3:6]) @ rotation


def error_of(state, position, rotation):
    """(6,) of the estimate against the truth."""
    return np.concatenate([position - state.position, so3.log(rotation @ state.rotation.T)])


def path(velocity, spin, seconds, start=None):
    """Pose after some seconds at a constant velocity [m/s] and [rad/s]."""
    rotation = np.eye(3) if start is None else start
    return seconds * np.asarray(velocity), so3.exp(seconds * np.asarray(spin)) @ rotation


def surprise(filtered, position, rotation, noise):
    """Squared Mahalanobis distance of a measurement from the likeliest kind's prediction."""
    best = np.argmax(filtered.modes["weight"])
    turned = so3.log(rotation @ filtered.modes["rotation"][best].T)
    innovation = np.concatenate([position - filtered.modes["position"][best], turned])
    spread = filtered.modes["covariance"][best][:6, :6] + (1 - CONSTANT) * noise
    return innovation @ np.linalg.solve(spread, innovation)


def test_a_measurement_moves_each_kind_as_kalmans_equations_say(rng):
    filtered = settled_at_rest(rng, 5).predicted(DT)
    root = 1e-3 * rng.normal(size=(6, 6))
    noise = root @ root.T + 0.1 * NOISE
    position, rotation = moved(np.zeros(3), np.eye(3), drawn(rng, 4 * NOISE))
    after = filtered.updated(position, rotation, noise)
    likelihoods = []
    for before, mode in zip(filtered.modes, after.modes, strict=True):
        turned = so3.log(rotation @ before["rotation"].T)
        innovation, covariance = np.concatenate([position - before["position"], turned]), before["covariance"]
        spread = covariance[:6, :6] + (1 - CONSTANT) * noise
        gain = np.linalg.solve(spread, covariance[:6]).T
        error = gain @ innovation
        np.testing.assert_allclose(mode["position"], before["position"] + error[:3], atol=1e-12)
        expected = so3.exp(error[3:6]) @ before["rotation"]
        np.testing.assert_allclose(mode["rotation"], expected, atol=1e-12)
        np.testing.assert_allclose(mode["velocity"], before["velocity"] + error[6:], atol=1e-12)
        np.testing.assert_allclose(mode["covariance"], covariance - gain @ spread @ gain.T, atol=1e-12)
        np.testing.assert_array_equal(mode["covariance"], mode["covariance"].T)
        distance = innovation @ np.linalg.solve(spread, innovation)
        likelihoods.append(-0.5 * (distance + np.linalg.slogdet(spread)[1]))
    weights = filtered.modes["weight"] * np.exp(likelihoods - np.max(likelihoods))
    weights = np.maximum(weights / weights.sum(), 1e-6)
    np.testing.assert_allclose(after.modes["weight"], weights / weights.sum(), rtol=1e-9)


def run(poses, rng, noise=NOISE, constant=True, dt=DT):
    """The filter after each of the poses, measured with white errors and, unless left out, constant ones."""
    offset = constant * drawn(rng, CONSTANT * noise)
    filtered, states = None, []
    for position, rotation in poses:
        measurement = moved(position, rotation, offset + drawn(rng, (1 - CONSTANT) * noise))
        if filtered is None:
            filtered = MotionFilter.start(*measurement, noise)
        else:
            filtered = filtered.predicted(dt).updated(*measurement, noise)
        states.append(filtered.state)
    return states


def settled_at_rest(rng, count=30):
    """A filter that has seen an object lie still."""
    filtered = MotionFilter.start(*moved(np.zeros(3), np.eye(3), drawn(rng, (1 - CONSTANT) * NOISE)), NOISE)
    for _ in range(count):
        measurement = moved(np.zeros(3), np.eye(3), drawn(rng, (1 - CONSTANT) * NOISE))
        filtered = filtered.predicted(DT).updated(*measurement, NOISE)
    return filtered


def test_two_half_steps_predict_what_one_step_does(rng):
    for seed in range(5):
        once = settled_at_rest(np.random.default_rng(seed), 5)
        twice = settled_at_rest(np.random.default_rng(seed), 5)
        first, second = once.predicted(DT).state, twice.predicted(DT / 2).predicted(DT / 2).state
        np.testing.assert_allclose(first.position, second.position, atol=2e-5)
        assert so3.angle_between(first.rotation, second.rotation) < np.radians(0.02)
        assert first.at_rest == pytest.approx(second.at_rest, abs=0.02)
        # A change of the kind of motion counts from the beginning of a step: one long step is more careful.
        ratio = np.sqrt(np.diag(second.covariance) / np.diag(first.covariance))
        assert (ratio < 1.02).all()
        assert (ratio > 0.7).all()


def test_no_time_changes_nothing(rng):
    filtered = settled_at_rest(rng)
    before = filtered.state
    after = filtered.predicted(0.0).state
    np.testing.assert_allclose(after.position, before.position, atol=1e-15)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-5, atol=1e-12)
    assert after.at_rest == pytest.approx(before.at_rest)


@pytest.mark.parametrize("seed", range(4))
def test_covariance_stays_symmetric_and_positive_and_weights_stay_probabilities(seed):
    rng = np.random.default_rng(seed)
    position, rotation = np.zeros(3), np.eye(3)
    filtered = MotionFilter.start(position, rotation, NOISE)
    for _ in range(400):
        # Anything goes: rests, jumps, turns by up to half a turn, gaps, good and bad measurements.
        leap = rng.choice([0.0, 1e-3, 0.1], p=[0.5, 0.4, 0.1])
        position = position + leap * rng.normal(size=3)
        rotation = so3.exp(min(30 * leap, 2.0) * rng.normal(size=3)) @ rotation
        filtered = filtered.predicted(rng.choice([1e-4, 0.03, 0.1, 0.5]))
        if rng.random() < 0.8:
            root = rng.normal(size=(6, 6)) * 10 ** rng.uniform(-5, -2)
            measurement = position, rotation, root @ root.T + 1e-10 * np.eye(6)
            assert surprise(filtered, *measurement) >= 0
            filtered = filtered.updated(*measurement)
        state = filtered.state
        assert np.isfinite(state.position).all()
        np.testing.assert_allclose(state.rotation @ state.rotation.T, np.eye(3), atol=1e-9)
        asymmetry = np.abs(state.covariance - state.covariance.T).max()
        assert asymmetry <= 1e-9 * np.abs(state.covariance).max()
        scale = np.sqrt(np.diag(state.covariance))
        assert (scale > 0).all()
        assert np.linalg.eigvalsh(state.covariance / np.outer(scale, scale))[0] > -1e-9
        assert np.linalg.eigvalsh(state.covariance[:6, :6])[0] > 0
        weights = filtered.modes["weight"]
        assert (weights > 0).all()
        assert weights.sum() == pytest.approx(1.0)
        assert 0 <= state.at_rest <= 1


def rms(errors):
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_errors_of_a_still_object_average_away():
    single, late = [], {4: [], 16: []}
    for seed in range(120):
        rng = np.random.default_rng([1, seed])
        rotation = random_rotations(rng, 1)[0]
        states = run([(np.ones(3), rotation)] * 16, rng, constant=False)
        for count, errors in late.items():
            errors.append(error_of(states[count - 1], np.ones(3), rotation))
        single.append(error_of(states[0], np.ones(3), rotation))
    for count, errors in late.items():
        ratio = rms(np.array(errors)) / rms(np.array(single))
        share = ratio.reshape(2, 3).mean(axis=1)
        assert (share > 0.8 / np.sqrt(count)).all()
        assert (share < 1.5 / np.sqrt(count)).all(), (count, share)


@pytest.mark.parametrize(
    ("velocity", "spin"), [((0.1, -0.05, 0.0), (0.0, 0.0, 0.5)), ((0.4, 0.3, 0.1), (1.0, -2.0, 2.0))]
)
def test_a_steady_motion_is_followed_without_lag_and_its_velocity_found(velocity, spin):
    off, rates = [], []
    for seed in range(40):
        rng = np.random.default_rng([2, seed])
        poses = [path(velocity, spin, DT * k) for k in range(20)]
        states = run(poses, rng, constant=False)
        off += [error_of(state, *pose) for state, pose in zip(states[-5:], poses[-5:], strict=True)]
        rates += [state.velocity for state in states[-5:]]
    off = np.array(off)
    assert np.linalg.norm(off[:, :3].mean(axis=0)) < 0.1e-3
    assert np.linalg.norm(off[:, 3:].mean(axis=0)) < np.radians(0.15)
    assert (rms(off) < 1.05 * np.sqrt(np.diag((1 - CONSTANT) * NOISE))).all()
    np.testing.assert_allclose(np.mean(rates, axis=0), [*velocity, *spin], atol=0.05)
    np.testing.assert_allclose(np.mean(rates, axis=0)[:3], velocity, atol=3e-3)


def test_turning_and_shifting_the_world_turns_and_shifts_the_answer(rng):
    turn, shift = random_rotations(rng, 1)[0], rng.normal(size=3)
    both = np.kron(np.eye(2), turn)
    four = np.kron(np.eye(4), turn)
    root = rng.normal(size=(6, 6)) * np.repeat([1e-3, 1e-2], 3)[:, None]
    noise = root @ root.T + 0.1 * NOISE
    here = there = None
    for k in range(15):
        position, rotation = path((0.1, 0.2, 0.0), (0.0, 1.0, 0.5), DT * k * (k > 5))
        position, rotation = moved(position, rotation, drawn(rng, (1 - CONSTANT) * noise))
        other = turn @ position + shift, turn @ rotation, both @ noise @ both.T
        if here is None or there is None:
            here, there = MotionFilter.start(position, rotation, noise), MotionFilter.start(*other)
        else:
            here, there = here.predicted(DT), there.predicted(DT)
            distance = surprise(here, position, rotation, noise)
            assert distance == pytest.approx(surprise(there, *other), rel=1e-6)
            here, there = here.updated(position, rotation, noise), there.updated(*other)
        first, second = here.state, there.state
        np.testing.assert_allclose(second.position, turn @ first.position + shift, atol=1e-9)
        np.testing.assert_allclose(second.rotation, turn @ first.rotation, atol=1e-9)
        np.testing.assert_allclose(second.velocity, both @ first.velocity, atol=1e-8)
        np.testing.assert_allclose(second.covariance, four @ first.covariance @ four.T, atol=1e-8)
        assert second.at_rest == pytest.approx(first.at_rest, abs=1e-6)


MOVES = {"still": [0] * 25, "moving": [1] * 25, "starts and stops": [0] * 8 + [1] * 8 + [0] * 9}
"""Whether the object moves during each step."""


@pytest.fixture(scope="module")
def squares():
    """NEES (films, steps) of each kind, once a film has settled."""
    found = {}
    for kind, moves in MOVES.items():
        found[kind] = []
        for seed in range(60):
            rng = np.random.default_rng([3, seed])
            start = random_rotations(rng, 1)[0]
            velocity, spin = 0.1 * rng.normal(size=3), 0.7 * rng.normal(size=3)
            poses = [path(velocity, spin, t, start) for t in DT * np.cumsum(moves)]
            states = zip(run(poses, rng)[4:], poses[4:], strict=True)
            found[kind].append([nees(error_of(s, *pose), s.covariance[:6, :6]) for s, pose in states])
    return found


@pytest.mark.parametrize("kind", MOVES)
@pytest.mark.parametrize(("factor", "holds"), FACTORS)
def test_stated_covariance_is_that_of_the_errors_at_every_step(squares, kind, factor, holds):
    assert {consistent(step, factor) for step in np.transpose(squares[kind])} == {holds}


def test_a_first_measurement_is_taken_as_it_is(rng):
    rotation = random_rotations(rng, 1)[0]
    state = MotionFilter.start(np.ones(3), rotation, NOISE).state
    np.testing.assert_allclose(state.position, np.ones(3), atol=1e-15)
    np.testing.assert_allclose(state.rotation, rotation, atol=1e-15)
    np.testing.assert_allclose(state.covariance[:6, :6], NOISE, rtol=1e-12)
    np.testing.assert_array_equal(state.velocity, 0)


def test_an_object_that_lies_still_is_known_to_and_one_that_moves_at_once():
    for seed in range(20):
        rng = np.random.default_rng([4, seed])
        filtered = settled_at_rest(rng, 3)
        early = filtered.state.at_rest
        for _ in range(15):
            measurement = moved(np.zeros(3), np.eye(3), drawn(rng, (1 - CONSTANT) * NOISE))
            filtered = filtered.predicted(DT).updated(*measurement, NOISE)
        late = filtered.state.at_rest
        assert late > 0.8
        assert late > early - 0.1
        filtered = filtered.predicted(DT).updated(np.array([0.01, 0.0, 0.0]), np.eye(3), NOISE)
        assert filtered.state.at_rest < 0.05


@given(st.sampled_from([1e-9, 1e-6, 1e-2, 1.0]), st.sampled_from([0.0, 1e-6, 0.1, 0.5, 10.0]))
def test_any_accuracy_and_any_gap_give_finite_answers(size, gap):
    noise = size**2 * np.eye(6)
    filtered = MotionFilter.start(np.zeros(3), np.eye(3), noise)
    for k in range(1, 4):
        measurement = 0.1 * k * np.ones(3), so3.exp([0.5 * k, 0.0, 0.0]), noise
        filtered = filtered.predicted(gap)
        assert np.isfinite(surprise(filtered, *measurement))
        filtered = filtered.updated(*measurement)
        state = filtered.state
        for key in ("position", "rotation", "velocity", "covariance", "at_rest"):
            assert np.isfinite(getattr(state, key)).all()


def test_only_the_white_share_of_the_covariance_averages_away():
    filtered = MotionFilter.start(np.zeros(3), np.eye(3), NOISE).predicted(1e-9)
    filtered = filtered.updated(np.zeros(3), np.eye(3), NOISE)
    left = np.diag(filtered.state.covariance[:6, :6]) / np.diag(NOISE)
    np.testing.assert_allclose(left, CONSTANT + (1 - CONSTANT) / 2, rtol=1e-3)


def test_an_unseen_object_is_ever_less_surely_at_rest(rng):
    filtered = settled_at_rest(rng)
    chances = [filtered.state.at_rest]
    for _ in range(20):
        filtered = filtered.predicted(DT)
        chances.append(filtered.state.at_rest)
    assert (np.diff(chances) < 0).all()
    assert chances[-1] < 0.7
