import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tests.helpers import numerical_jacobian
from tracker.geometry import so3
from tracker.geometry.arena import Arena
from tracker.pose.solution import ROWS, SOLUTION, UNKNOWNS
from tracker.pose.support import FLAT, FREE, LEANING, apply_table, contacts_of, reduce_by_table, table_of

HALF = np.array([0.02, 0.0325, 0.05])
TABLE = table_of(Arena(center=(0.03, -0.02), table=0.01, table_std=(1e-3, 5e-3)), support=True)


def standing(rng, gap, tilt):
    """Rotation and position of a box above TABLE by a gap [m], on the face -z, tilted by so much [rad]."""
    turn = so3.exp(np.array([0.0, 0.0, rng.uniform(-3, 3)]))
    angle = rng.uniform(0, 2 * math.pi)
    rotation = so3.exp(tilt * np.array([math.cos(angle), math.sin(angle), 0.0])) @ turn
    position = np.array([*rng.uniform(-0.1, 0.1, 2), TABLE.height + gap + HALF[2] * rotation[2, 2]])
    return rotation, position


def contacts(rotation, position):
    value, slope, plane = np.empty(ROWS), np.empty((ROWS, 6)), np.empty((ROWS, 3))
    lower = contacts_of(TABLE, HALF, rotation, position, value, slope, plane)
    return value, slope, plane, lower


def step_of(mean, covariance):
    """A solution whose step (n,) is known by so much (n, n)."""
    solution, n = np.zeros(1, SOLUTION)[0], UNKNOWNS
    solution["size"], solution["known"][:n, :n] = n, np.linalg.inv(covariance)
    solution["lower"][:n, :n] = np.linalg.cholesky(solution["known"][:n, :n])
    solution["change"][:n] = mean
    return solution


def measured(rng, spread=1.0):
    """A solution's step as pictures make one, [m] and [rad] of a few thousandths, and its covariance."""
    n = UNKNOWNS
    root = spread * 2e-3 * (np.eye(n) + 0.3 * rng.normal(size=(n, n)))
    return step_of(spread * 1e-3 * rng.normal(size=n), root @ root.T), root @ root.T


def leaned(rotation, position, solution):
    """Log odds, and the pose's covariance afterwards; the step is moved in place."""
    n = UNKNOWNS
    solution["rotation"], solution["position"] = rotation, position
    solution["covariance"] = np.linalg.inv(solution["known"][:n, :n])[:6, :6]
    odds = apply_table(TABLE, HALF, solution)
    reduce_by_table(solution)
    return odds, solution["covariance"].copy()


def test_slopes_are_those_of_the_contacts(rng):
    for _ in range(20):
        rotation, position = so3.exp(rng.uniform(-2, 2, 3)), rng.uniform(-0.1, 0.1, 3)

        def moved(change, rotation=rotation, position=position):
            return contacts(so3.exp(change[3:]) @ rotation, position + change[:3])[0]

        slope = contacts(rotation, position)[1]
        np.testing.assert_allclose(numerical_jacobian(moved, np.zeros(6)), slope, atol=1e-6)


def test_a_tilted_table_is_seen_as_a_tilted_object(rng):
    # Table and object tilted together by a small turn about the place where the table's height is known.
    tilt = np.array([2e-4, -3e-4, 0.0])
    turned, centre = so3.exp(tilt), np.array([*TABLE.center, TABLE.height])
    # The table z = A x + B y rises by (-tilt_y, tilt_x).
    slopes = np.array([0.0, -tilt[1], tilt[0]])
    for lean_by, flat in ((0.0, slice(0, 3)), (0.6, slice(4, 5))):
        rotation, position = standing(rng, 0.0, lean_by)
        value, _, plane, _ = contacts(rotation, position)
        moved = contacts(turned @ rotation, centre + turned @ (position - centre))[0]
        np.testing.assert_allclose((moved + plane @ slopes)[flat], value[flat], atol=2e-6)


def density(value, plane, lower):
    """Prior density of contacts (N, 5) by the definition, the table's errors integrated out."""

    def normal(rows, *noise):
        spread = plane[rows] * TABLE.variances @ plane[rows].T + np.diag(np.square(noise))
        return multivariate_normal(cov=spread).pdf(value[:, rows])

    total = FREE * (value[:, 3] - lower > 0)
    for row, (share, height, tilt) in enumerate(FLAT):
        above = 2 * (value[:, 0] > 0) if row == 2 else 1
        total = total + share / 6 * normal(slice(0, 3), height, tilt, tilt) * above
    return total + LEANING[0] / (6 * math.pi) * normal(slice(3, 5), *LEANING[1:])


@pytest.mark.parametrize(("gap", "tilt"), [(5e-4, 0.002), (6e-3, 0.01), (0.02, 0.03), (0.005, 0.4)])
def test_the_step_leads_to_the_mean_of_what_is_likely(rng, gap, tilt):
    rotation, position = standing(rng, gap, tilt)
    step, covariance = measured(rng)
    value, slope, plane, lower = contacts(rotation, position)
    drawn = rng.multivariate_normal(step["change"][:UNKNOWNS], covariance, size=400_000)
    weights = density(value + drawn[:, :6] @ slope.T, plane, lower)
    mean = weights @ drawn / weights.sum()
    spread = np.cov(drawn[:, :6].T, aweights=weights, ddof=0)
    enough = weights.sum() ** 2 / (weights**2).sum()
    odds, after = leaned(rotation, position, step)
    std = np.sqrt(np.diag(covariance))
    # A height that is never negative pulls upwards a little, which the step does without.
    assert (np.abs(step["change"][:UNKNOWNS] - mean) < (5 / math.sqrt(enough) + 0.15) * std).all()
    scale = np.outer(std[:6], std[:6])
    assert (np.abs(after - spread) < (0.25 + 8 / math.sqrt(enough)) * scale).all()
    assert odds == pytest.approx(math.log(weights.mean() / FREE), abs=0.25)


def test_what_is_high_above_or_known_well_enough_stays_and_what_is_below_is_unlikely(rng):
    for gap, tilt, spread in ((0.08, 0.5, 1.0), (0.004, 0.0, 0.02), (0.0005, 0.06, 0.02)):
        rotation, position = standing(rng, gap, tilt)
        step, covariance = measured(rng, spread)
        before = step["change"][:UNKNOWNS].copy()
        _, after = leaned(rotation, position, step)
        limit = 0.35 * np.sqrt(np.diag(covariance))
        assert (np.abs(step["change"][:UNKNOWNS] - before) < limit).all()
        assert (np.diag(after) < 1.5 * np.diag(covariance)[:6]).all()
    # Below the table is nothing.
    rotation, position = standing(rng, -0.05, 0.5)
    step, _ = measured(rng)
    before = step["change"][:UNKNOWNS].copy()
    odds, _ = leaned(rotation, position, step)
    assert odds < -20
    assert np.linalg.norm(step["change"][:UNKNOWNS] - before) < 0.1


def test_the_world_may_be_turned_about_the_table(rng):
    rotation, position = standing(rng, 2e-3, 0.02)
    turn = so3.exp(np.array([0.0, 0.0, 1.1]))
    whole = np.eye(UNKNOWNS)
    whole[:3, :3] = whole[3:6, 3:6] = turn
    step, covariance = measured(rng)
    other = step_of(whole @ step["change"][:UNKNOWNS], whole @ covariance @ whole.T)
    centre = np.array([*TABLE.center, 0.0])
    odds, after = leaned(rotation, position, step)
    turned_odds, turned_after = leaned(turn @ rotation, centre + turn @ (position - centre), other)
    assert turned_odds == pytest.approx(odds, abs=1e-6)
    np.testing.assert_allclose(other["change"][:UNKNOWNS], whole @ step["change"][:UNKNOWNS], atol=1e-9)
    np.testing.assert_allclose(turned_after, whole[:6, :6] @ after @ whole[:6, :6].T, atol=1e-9)


def test_all_ways_to_be_somewhere_are_thought_of():
    assert FLAT[:, 0].sum() + LEANING[0] + FREE * 4 * math.pi * 0.15 == pytest.approx(1)
