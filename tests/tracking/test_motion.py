import numpy as np
import pytest

from tests.helpers import numerical_jacobian, random_rotations
from tests.helpers.consistency import FACTORS, consistent, nees, pose_error
from tracker.geometry import so3
from tracker.tracking import motion
from tracker.tracking.motion import CONSTANT, MODE, STATE, MotionFilter, Motions

DT = 0.1
NOISE = np.diag(np.repeat(np.square([0.5e-3, np.radians(0.5)]), 3))
"""Covariance of a made-up measurement."""
WHITE = (1 - CONSTANT) * NOISE
AT_HOME = np.zeros(3), np.eye(3)
NO_PUSH = Motions(np.array([False]), walk=np.zeros((1, 2)), push=np.zeros((1, 2)), lasting=np.ones(1))
PUSHED = NO_PUSH._replace(walk=np.array([[3e-4, 6e-3]]), push=np.array([[0.05, 1.0]]))
"""Constant velocity, disturbed, and nothing else."""


def drawn(rng, covariance):
    """An error with a covariance."""
    return rng.multivariate_normal(np.zeros(len(covariance)), covariance, method="cholesky")


def moved(position, rotation, error):
    """A pose off by an error (6,)."""
    return position + error[:3], so3.exp(error[3:6]) @ rotation


def error_of(state, position, rotation):
    """(6,) of the estimate against the truth."""
    return pose_error(position, rotation, state.position, state.rotation)


def path(velocity, spin, seconds, start=AT_HOME[1]):
    """Pose after some seconds at a constant velocity [m/s] and [rad/s]."""
    return seconds * np.asarray(velocity), so3.exp(seconds * np.asarray(spin)) @ start


def innovation_of(mode, position, rotation, noise):
    """(6,) by which a measurement is off a mode's prediction, its covariance, its squared length by that."""
    innovation = pose_error(position, rotation, mode["position"], mode["rotation"])
    spread = mode["covariance"][:6, :6] + (1 - CONSTANT) * noise
    return innovation, spread, nees(innovation, spread)


def surprise(filtered, *measurement):
    """Squared Mahalanobis distance of a measurement from the likeliest kind's prediction."""
    return innovation_of(filtered.modes[np.argmax(filtered.modes["weight"])], *measurement)[2]


def filters(poses, rng, offset=0.0):
    """The filter after each of the poses, measured with white errors and a constant one."""
    found = []
    for pose in poses:
        measurement = *moved(*pose, offset + drawn(rng, WHITE)), NOISE
        if found:
            found.append(found[-1].predicted(DT).updated(*measurement))
        else:
            found.append(MotionFilter.start(*measurement))
    return found


def run(poses, rng, constant=True):
    offset = drawn(rng, CONSTANT * NOISE)
    return [one.state for one in filters(poses, rng, constant * offset)]


def test_a_measurement_moves_each_kind_as_kalmans_equations_say(rng):
    filtered = filters([AT_HOME] * 6, rng)[-1].predicted(DT)
    root = 1e-3 * rng.normal(size=(6, 6))
    noise = root @ root.T + 0.1 * NOISE
    position, rotation = moved(*AT_HOME, drawn(rng, 4 * NOISE))
    after = filtered.updated(position, rotation, noise)
    likelihoods = []
    for before, mode in zip(filtered.modes, after.modes, strict=True):
        innovation, spread, distance = innovation_of(before, position, rotation, noise)
        covariance = before["covariance"]
        gain = np.linalg.solve(spread, covariance[:6]).T
        error = gain @ innovation
        np.testing.assert_allclose(mode["position"], before["position"] + error[:3], atol=1e-12)
        turned = so3.exp(error[3:6]) @ before["rotation"]
        np.testing.assert_allclose(mode["rotation"], turned, atol=1e-12)
        np.testing.assert_allclose(mode["velocity"], before["velocity"] + error[6:], atol=1e-12)
        np.testing.assert_allclose(mode["covariance"], covariance - gain @ spread @ gain.T, atol=1e-12)
        np.testing.assert_array_equal(mode["covariance"], mode["covariance"].T)
        likelihoods.append(-0.5 * (distance + np.linalg.slogdet(spread)[1]))
    weights = filtered.modes["weight"] * np.exp(likelihoods - np.max(likelihoods))
    weights = np.maximum(weights / weights.sum(), 1e-6)
    np.testing.assert_allclose(after.modes["weight"], weights / weights.sum(), rtol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_covariance_stays_symmetric_and_positive_and_weights_stay_probabilities(seed):
    rng = np.random.default_rng(seed)
    position, rotation = AT_HOME
    filtered = MotionFilter.start(position, rotation, 10.0 ** (-6 * seed) * np.eye(6))
    for _ in range(200):
        # Anything goes: rests, jumps, turns by up to half a turn, gaps, measurements of any accuracy.
        leap = rng.choice([0.0, 1e-3, 0.1], p=[0.5, 0.4, 0.1])
        position = position + leap * rng.normal(size=3)
        rotation = so3.exp(min(30 * leap, 2.0) * rng.normal(size=3)) @ rotation
        filtered = filtered.predicted(rng.choice([0.0, 1e-6, 1e-4, 0.03, 0.1, 0.5, 10.0]))
        if rng.random() < 0.8:
            root = rng.normal(size=(6, 6)) * 10 ** rng.uniform(-9, 0)
            measurement = position, rotation, root @ root.T + 1e-10 * np.eye(6)
            assert surprise(filtered, *measurement) >= 0
            filtered = filtered.updated(*measurement)
        state = filtered.state
        assert np.isfinite([*state.position, *state.velocity]).all()
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
        pose = np.ones(3), random_rotations(rng, 1)[0]
        states = run([pose] * 16, rng, constant=False)
        for count, errors in late.items():
            errors.append(error_of(states[count - 1], *pose))
        single.append(error_of(states[0], *pose))
    for count, errors in late.items():
        ratio = rms(errors) / rms(single)
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
    assert (rms(off) < 1.05 * np.sqrt(np.diag(WHITE))).all()
    np.testing.assert_allclose(np.mean(rates, axis=0), [*velocity, *spin], atol=0.05)
    np.testing.assert_allclose(np.mean(rates, axis=0)[:3], velocity, atol=3e-3)


def test_turning_and_shifting_the_world_turns_and_shifts_the_answer(rng):
    turn, shift = random_rotations(rng, 1)[0], rng.normal(size=3)
    both, four = (np.kron(np.eye(count), turn) for count in (2, 4))
    root = rng.normal(size=(6, 6)) * np.repeat([1e-3, 1e-2], 3)[:, None]
    noise = root @ root.T + 0.1 * NOISE
    for k in range(15):
        pose = path((0.1, 0.2, 0.0), (0.0, 1.0, 0.5), DT * k * (k > 5))
        position, rotation = moved(*pose, drawn(rng, (1 - CONSTANT) * noise))
        one = position, rotation, noise
        other = turn @ position + shift, turn @ rotation, both @ noise @ both.T
        if k == 0:
            here, there = MotionFilter.start(*one), MotionFilter.start(*other)
        else:
            here, there = here.predicted(DT), there.predicted(DT)
            assert surprise(here, *one) == pytest.approx(surprise(there, *other), rel=1e-6)
            here, there = here.updated(*one), there.updated(*other)
        first, second = here.state, there.state
        np.testing.assert_allclose(second.position, turn @ first.position + shift, atol=1e-9)
        np.testing.assert_allclose(second.rotation, turn @ first.rotation, atol=1e-9)
        np.testing.assert_allclose(second.velocity, both @ first.velocity, atol=1e-8)
        np.testing.assert_allclose(second.covariance, four @ first.covariance @ four.T, atol=1e-8)
        assert second.at_rest == pytest.approx(first.at_rest, abs=1e-6)


MOVES = {"still": [0] * 25, "moving": [1] * 25, "starts and stops": [0] * 8 + [1] * 8 + [0] * 9}
"""Whether the object moves during each step."""


@pytest.mark.parametrize("moves", MOVES.values(), ids=MOVES)
def test_stated_covariance_is_that_of_the_errors_at_every_step(moves):
    squares = []
    for seed in range(60):
        rng = np.random.default_rng([3, seed])
        start = random_rotations(rng, 1)[0]
        velocity, spin = 0.1 * rng.normal(size=3), 0.7 * rng.normal(size=3)
        poses = [path(velocity, spin, t, start) for t in DT * np.cumsum(moves)]
        # Once a film has settled.
        states = zip(run(poses, rng)[4:], poses[4:], strict=True)
        squares.append([nees(error_of(s, *pose), s.covariance[:6, :6]) for s, pose in states])
    for factor, holds in FACTORS:
        assert {consistent(step, factor) for step in np.transpose(squares)} == {holds}, factor


def test_a_first_measurement_is_taken_as_it_is(rng):
    rotation = random_rotations(rng, 1)[0]
    state = MotionFilter.start(np.ones(3), rotation, NOISE).state
    np.testing.assert_allclose(state.position, np.ones(3), atol=1e-15)
    np.testing.assert_allclose(state.rotation, rotation, atol=1e-15)
    np.testing.assert_allclose(state.covariance[:6, :6], NOISE, rtol=1e-12)
    np.testing.assert_array_equal(state.velocity, 0)


def test_an_object_that_lies_still_is_known_to_less_surely_while_unseen_and_one_that_moves_at_once():
    for seed in range(20):
        seen = filters([AT_HOME] * 19, np.random.default_rng([4, seed]))
        filtered = seen[-1]
        assert filtered.state.at_rest > max(0.8, seen[3].state.at_rest - 0.1)
        after = filtered.predicted(DT).updated(np.array([0.01, 0.0, 0.0]), np.eye(3), NOISE)
        assert after.state.at_rest < 0.05
        chances = [filtered.state.at_rest]
        for _ in range(20):
            filtered = filtered.predicted(DT)
            chances.append(filtered.state.at_rest)
        assert (np.diff(chances) < 0).all()
        assert chances[-1] < 0.7


def predicted(p, r, v, covariance, dt, motions=PUSHED):
    """One mode's state and covariance after `motion.predict`."""
    before = np.array([(1.0, p, r, v, covariance)], MODE)
    modes = np.empty_like(before)
    motion.predict(dt, motions, before, False, modes)
    return modes[0].tolist()[1:]


@pytest.mark.parametrize(("spin", "within"), [(0.0, 1e-7), (0.5, 0.03), (2.0, 0.11)])
def test_predicted_covariance_is_that_of_the_motions_derivatives(rng, spin, within):
    p, r = rng.normal(size=3), random_rotations(rng, 1)[0]
    v = np.concatenate([rng.normal(size=3), spin * np.array([0.6, 0.0, 0.8])])
    p1, r1, v1, _ = predicted(p, r, v, np.eye(STATE), DT)

    def outcome(error):
        p2, r2, v2, _ = predicted(p + error[:3], so3.exp(error[3:6]) @ r, v + error[6:], np.eye(STATE), DT)
        return np.concatenate([pose_error(p2, r2, p1, r1), v2 - v1])

    jacobian = numerical_jacobian(outcome, np.zeros(STATE))
    covariance = np.diag(rng.uniform(0.5, 2.0, STATE))
    stated = predicted(p, r, v, covariance, DT, NO_PUSH)[3]
    # The turn within the step bends the way of an error of the spin, by half that turn; this is left out.
    np.testing.assert_allclose(stated, jacobian @ covariance @ jacobian.T, atol=2 * within * DT)


def test_predicted_covariance_is_that_of_samples(rng):
    count, steps = 20000, 20
    start = np.diag(np.repeat(np.square([1e-3, 0.01, 0.02, 0.2]), 3))
    (p, r), v = AT_HOME, np.array([0.1, 0.0, 0.05, 0.0, 0.5, 0.2])
    p1, r1, v1, stated = predicted(p, r, v, start, DT)
    errors = rng.multivariate_normal(np.zeros(STATE), start, count)
    positions, rotations, velocities = p + errors[:, :3], so3.exp(errors[:, 3:6]) @ r, v + errors[:, 6:]
    h = DT / steps
    walk, push = (np.repeat(getattr(PUSHED, key)[0], 3) for key in ("walk", "push"))
    for _ in range(steps):
        kick = push * np.sqrt(h) * rng.normal(size=(count, 6))
        step = h * (velocities + kick / 2) + walk * np.sqrt(h) * rng.normal(size=(count, 6))
        positions, rotations = positions + step[:, :3], so3.exp(step[:, 3:]) @ rotations
        velocities = velocities + kick
    off = np.concatenate([positions - p1, so3.log(rotations @ r1.T), velocities - v1], axis=1)
    scale = np.sqrt(np.diag(stated))
    np.testing.assert_allclose(np.cov((off / scale).T), stated / np.outer(scale, scale), atol=0.06)
    assert np.abs(off.mean(axis=0) / scale).max() < 0.06


def test_two_half_steps_of_one_kind_are_one_step(rng):
    root = rng.normal(size=(STATE, STATE))
    start = *AT_HOME, np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.0]), root @ root.T
    whole = predicted(*start, DT)
    halves = predicted(*predicted(*start, DT / 2), DT / 2)
    for one, other in zip(whole, halves, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)


def drawn_modes(rng):
    """Modes that differ a little, the likeliest first."""
    modes, count = np.zeros(3, MODE), 3
    modes["weight"] = np.sort(rng.dirichlet(np.ones(count)))[::-1]
    root = 1e-3 * rng.normal(size=(count, STATE, STATE))
    modes["covariance"] = root @ np.swapaxes(root, 1, 2)
    modes["position"] = 1e-3 * rng.normal(size=(count, 3))
    modes["velocity"] = 0.1 * rng.normal(size=(count, 6))
    modes["rotation"] = so3.exp(1e-3 * rng.normal(size=(count, 3))) @ random_rotations(rng, 1)
    return modes


def moments(modes):
    """Mean, as an error from the origin and the first rotation, and covariance of all modes together."""
    turns = so3.log(modes["rotation"] @ modes["rotation"][0].T)
    means = np.concatenate([modes["position"], turns, modes["velocity"]], axis=1)
    mean, off = modes["weight"] @ means, means - modes["weight"] @ means
    spread = modes["covariance"] + off[:, :, None] * off[:, None, :]
    return mean, np.einsum("n,nij->ij", modes["weight"], spread)


def test_all_kinds_together_have_the_mean_and_the_spread_of_their_mixture(rng):
    modes = drawn_modes(rng)
    noise = np.diag(rng.uniform(0.5, 2.0, 6))
    found = MotionFilter(modes, noise).state
    assert found.at_rest == modes["weight"][0]
    found.covariance[:6, :6] -= CONSTANT * noise
    mean, spread = moments(modes)
    np.testing.assert_allclose(found.position, mean[:3], atol=1e-12)
    np.testing.assert_allclose(so3.log(found.rotation @ modes["rotation"][0].T), mean[3:6], atol=1e-12)
    np.testing.assert_allclose(found.velocity, mean[6:], atol=1e-12)
    np.testing.assert_allclose(found.covariance, spread, atol=1e-12)


def test_kinds_that_change_into_each_other_keep_their_mean_and_spread(rng):
    modes = drawn_modes(rng)
    first, before = modes["rotation"][0], moments(modes)
    lasting = 1e-9 * rng.uniform(0.5, 2.0, 3)
    stay = np.exp(-1e-9 / lasting)
    transition = np.where(np.eye(3), stay, np.repeat((1 - stay)[:, None] / 2, 3, axis=1))
    expected = transition.T @ modes["weight"]
    # In so short a time that none moves.
    nothing, found = np.zeros((3, 2)), np.empty_like(modes)
    motion.predict(1e-9, Motions(np.zeros(3, bool), nothing, nothing, lasting), modes, True, found)
    np.testing.assert_allclose(found["weight"], expected, rtol=1e-12)
    after = moments(found)
    # About another first rotation.
    mean = after[0] + np.concatenate([np.zeros(3), so3.log(found["rotation"][0] @ first.T), np.zeros(6)])
    np.testing.assert_allclose(mean, before[0], atol=2e-6)
    np.testing.assert_allclose(after[1], before[1], atol=1e-6)


def test_forecasts_of_a_carried_object_are_as_uncertain_as_they_are_wrong(rng):
    """Carried at 0.3 m/s along a circle, an object leaves the straight line that a forecast continues."""
    precise, ahead, fps, inside = NOISE / 25.0, 0.1, 30.0, []

    def place(seconds):
        angle = 0.3 / 0.08 * seconds
        return 0.08 * np.array([np.cos(angle), np.sin(angle), 0.75])

    carried = MotionFilter.start(place(0.0), np.eye(3), precise)
    for k in range(1, 60):
        noise = drawn(rng, (1 - CONSTANT) * precise)[:3]
        carried = carried.predicted(1 / fps).updated(place(k / fps) + noise, np.eye(3), precise)
        if k > 10:
            found = carried.forecast(ahead).likeliest()
            inside.append(nees(place(k / fps + ahead) - found.position, found.covariance[:3, :3]) < 7.81)
    assert np.mean(inside) > 0.5
