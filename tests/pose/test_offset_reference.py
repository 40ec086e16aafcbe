"""The compiled least squares of strips against the same in a few lines of NumPy, on random strips."""

import itertools
import math

import numpy as np
import pytest
from scipy.special import ndtr
from scipy.stats import norm

from tracker.pose.edge_fit import MIN_CONTRAST, NOISE, OFFSET, SHARP, SLOPE, SOFT, measure
from tracker.pose.edge_model import RIDGE, SCRATCH
from tracker.pose.solution import CAMERA
from tracker.pose.strips import BLOCK, FAR, STRIP

REACH, BLUR = 2.8, 0.8
STRIPS = 40
GREEN = (
    np.stack([np.zeros(256), np.arange(256), np.zeros(256)]).astype(np.int32),
    np.where(np.arange(256) > 122, 1, 2).astype(np.uint8),
)
"""Much green is label 1, less is 2."""


def table(x):
    """As far as tables of step and line reach, on their grid."""
    return np.floor((np.clip(x, -4, 4) + 4) * 256 + 0.5) / 256 - 4


def step(x):
    return ndtr(table(x))


def model(strip, d):
    """Surfaces (P, m), line (P,), slopes (P, 0 or 2), change of blur (P,), and which surface is the face."""
    edges = [e for e in (-strip["reach_in"], 0.0, strip["reach_out"]) if abs(e) < REACH + 1.5 * BLUR]
    steps = [np.ones(len(d)), *(step((d - e) / BLUR) for e in edges), np.zeros(len(d))]
    shares = np.stack([a - b for a, b in itertools.pairwise(steps)], axis=1)
    inside, middle = edges.index(0.0), norm.pdf(table(d / BLUR)) / BLUR
    slopes = np.stack([shares[:, inside] * (d + REACH / 2), shares[:, -1] * (d - REACH / 2)], axis=1)
    return shares, middle, slopes[:, : 2 * (strip["outside"] == 0)], -d / BLUR * middle, inside


def solve(columns, values, m, stiffness):
    """Unknowns (n,) of a channel and the inverse of their normal matrix; the first m drawn to their means."""
    prior = np.array([RIDGE] * m + [0.0] + [stiffness] * (columns.shape[1] - m - 1))
    means = columns.T @ values / np.maximum(columns.sum(axis=0), 1e-9)
    inverse = np.linalg.inv(columns.T @ columns + np.diag(prior))
    means[m:] = 0.0
    return inverse @ (columns.T @ values + prior * means), inverse


def reference(strip, parts):
    """What `measure` should find; parts: distances and channels that were measured there."""
    squares, count, wider, sharpness = 0.0, 0, 0.0, 0.0
    for d, channels in parts:
        shares, middle, _, change, inside = model(strip, d)
        columns, m = np.column_stack([shares, middle]), shares.shape[1]
        for values in channels:
            x, inverse = solve(columns, values, m, 0.0)
            left, difference = values - columns @ x, x[inside] - x[inside + 1]
            squares, count = squares + left @ left, count + len(d)
            # What the other columns leave of the change of blur.
            wider -= difference * (change @ left if m == 2 else 0.0)
            own = change @ (change - columns @ (inverse @ (columns.T @ change)))
            sharpness += difference**2 * own if m == 2 else 0.0
    variance = max(NOISE**2, squares / (count - 3 * (m + 1)))
    stiffness = variance / (SLOPE * np.clip((BLUR - SHARP) / (SOFT - SHARP), 1e-3, 1.0)) ** 2
    squares = weight = shift = bloom = least = 0.0
    for g, (d, channels) in enumerate(parts):
        shares, middle, slopes, _, inside = model(strip, d)
        columns, m = np.column_stack([shares, middle, slopes]), shares.shape[1]
        for values in channels:
            x, inverse = solve(columns, values, m, stiffness)
            known, difference = 1.0 / inverse[m, m], x[inside] - x[inside + 1]
            squares += ((values - columns @ x) ** 2).sum()
            weight, shift = weight + known * difference**2, shift + known * difference * x[m]
            bloom += known * difference**3 / max(x[inside] + x[inside + 1], 16.0)
            least = MIN_CONTRAST**2 * known if g == 0 else least
    weight = max(weight, least)
    return {
        "offset": float(np.clip(shift / weight, -REACH, REACH)),
        "variance": max(NOISE**2, squares / (count - 3 * columns.shape[1])) / weight,
        "bloom": math.sqrt(math.pi) / 3 * BLUR * bloom / weight,
        "wider": wider / sharpness if sharpness > 0 else math.nan,
        "sharpness": sharpness / variance,
    }


def random_strips(rng, parts, narrow):
    """STRIPS strips with their distances and values, in whose gaps nothing counts."""
    strips, size = np.zeros(STRIPS, STRIP), STRIPS * 3 * 48
    distance, values = np.full(size, FAR), np.zeros((3, size))
    strips["jacobian"] = rng.normal(0, 100, (STRIPS, 6))
    strips["outside"] = 2 * rng.integers(0, 2, STRIPS)
    strips["inside"], strips["reach_in"], strips["reach_out"], at = 1, 1e3, 1e3, 0
    if narrow:
        strips["reach_in"][::2] = rng.uniform(1.5, 3.5, len(strips[::2]))
        strips["reach_out"][::3] = rng.uniform(1.5, 3.5, len(strips[::3]))
        strips["outside"][::3] = 2  # only a neighbouring face may be narrow
    for strip in strips:
        for g in range(parts):
            count = int(rng.integers(12, 48))
            d = rng.uniform(-REACH, REACH, count)
            for k in range(3):
                clean = np.where(k == 1, 162.0 - 80.0 * step((d - 0.2) / 0.9), 90.0 - 60.0 * k * step(d))
                values[k, at : at + count] = clean + rng.normal(0, 0.3, count)
            distance[at : at + count], strip["first"][g], strip["count"][g] = d, at, count
            channels = values[:, at : at + count] if parts == 1 else values[g, at : at + count]
            strip["squares"] += (channels**2).sum()
            at += -(-count // BLOCK) * BLOCK
    return strips, distance, values


@pytest.mark.parametrize("narrow", [False, True])
@pytest.mark.parametrize("parts", [1, 3])
def test_measure_agrees_with_numpy(rng, parts, narrow):
    strips, distance, values = random_strips(rng, parts, narrow)
    motion, out, camera = rng.normal(0, 5e-4, 6), np.zeros(STRIPS, OFFSET), np.zeros(1, CAMERA)[0]
    camera["strips"], camera["parts"], camera["reach"], camera["motion"] = STRIPS, parts, REACH, motion
    measure(strips, camera, *GREEN, BLUR, 1, (distance, values), np.zeros(1, SCRATCH), out)
    assert out["usable"].mean() > 0.8
    for strip, found in zip(strips[out["usable"]], out[out["usable"]], strict=True):
        groups = []
        for g in range(parts):
            places = slice(strip["first"][g], strip["first"][g] + strip["count"][g])
            d = distance[places] - strip["jacobian"] @ motion
            groups.append((d, list(values[:, places]) if parts == 1 else [values[g, places]]))
        for name, value in reference(strip, groups).items():
            if not math.isnan(value):
                assert found[name] == pytest.approx(value, rel=1e-8, abs=1e-9), name
