"""A model of the tracker's errors, fitted to films and compared with other films.

An episode is an array (T, 16): time [s], visible fraction, errors (δp, δθ) [m, rad], confidence, and the true
position [m] and orientation (xyzw); errors and confidence are nan where nothing was found.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.optimize import least_squares, lsq_linear, minimize

from tracker.conventions import Array, FloatArray
from tracker.noise.model import UNITS, NoiseState, largest

GROSS = 5e-3, np.radians(5.0)
"""Sizes above which an error is gross [m, rad]."""

COPIES = 12
"""Number of simulations of each episode."""

HIDDEN = 0.6
"""Visible fraction below which errors are judged separately."""

SCALE = 0.3
"""Weighted miss above which a figure counts less in the fit."""

LAGS = 1, 10
"""Lags of the correlations [frames]: 0.1 s and 1 s."""

WEIGHTS = np.array([3.0, 3.0, *[1.0] * 10, 5.0, 5.0])
"""Weights of the figures in the fit: median, 90th percentile and correlations count most."""

SHORTENED = 0.9
"""Quantile of the errors' sizes to which larger errors are shortened in a correlation; otherwise a handful
of frames would dominate it."""

DRAWS = 50
"""Number of bootstrap samples of films for the intervals."""

SLOPE = 6.0
"""Decrease of the log rate of gross errors with the visible fraction; they are too rare to fit it."""

PULL = 0.5
"""Strength of the prior that pulls the logarithm of a number towards the start of the fit."""

FITTED = {
    "bias": (6e-4, 3e-3), "bias_spread": (0.5, 0.5), "slow": (4e-4, 4e-3), "fast": (5e-5, 1e-3),
    "fast_spread": (0.5, 0.5), "moving": (5.0, 5.0), "travel": (0.04, 0.03), "visible": (0.5, 1.0),
}  # fmt: skip
"""Start of the fit of an error's numbers: for the position [m], and for the rotation [rad]."""

Values = dict[str, dict[str, float]]


def simulated(values: Mapping[str, Mapping[str, float]], episodes: Sequence[Array], seed: int = 0) -> Array:
    """Simulate the model's errors for the same true poses; return (N · COPIES, T, 16)."""
    truth = np.repeat(np.stack(episodes), COPIES, axis=0)
    state = NoiseState(values, np.random.default_rng(seed), len(truth))
    result = truth.copy()
    for k in range(truth.shape[1]):
        now = truth[:, k]
        dt = float(np.median(now[:, 0] - truth[:, k - 1, 0])) if k else 0.1
        seen = state.step(now[:, 9:12], now[:, 12:], np.clip(now[:, 1], 0.0, 1.0), dt)
        result[:, k, 2:5] = seen.position - now[:, 9:12]
        result[:, k, 5:8] = _turn(now[:, 12:], seen.orientation)
        result[:, k, 8] = np.where(seen.found, seen.confidence, np.nan)
    return result


def _turn(true: Array, seen: Array) -> FloatArray:
    """Return rotation vectors (N, 3) between quaternions, for small rotations."""
    v, w = true[:, :3], true[:, 3:]
    a, b = seen[:, :3], seen[:, 3:]
    part = w * a - b * v - np.cross(a, v)
    whole = w * b + np.sum(a * v, axis=1, keepdims=True)
    result: FloatArray = 2.0 * part / np.where(whole < 0, -1.0, 1.0)
    return result


def correlation(errors: Array, lag: int) -> float:
    """Return the correlation about zero of errors (N, T, 3) `lag` frames apart, without gross ones."""
    size = np.linalg.norm(errors, axis=2, keepdims=True)
    errors = errors * np.minimum(1.0, np.nanquantile(size, SHORTENED) / np.maximum(size, 1e-12))
    a, b = errors[:, :-lag], errors[:, lag:]
    both = np.isfinite(a[..., 0]) & np.isfinite(b[..., 0])
    a, b = a[both], b[both]
    return float(np.sum(a * b) / np.sqrt(np.sum(a * a) * np.sum(b * b)))


def usual(episodes: Array, part: int) -> Array:
    """Return errors (N, T, 3) of a part (0: position, 1: rotation); nan where either is gross."""
    errors = episodes[..., 2:8].reshape(*episodes.shape[:2], 2, 3)
    return np.where(np.all(_sizes(episodes) < GROSS, axis=2)[..., None], errors[:, :, part], np.nan)


def figures(episodes: Array, part: int) -> FloatArray:
    """Return the figures to which a part's numbers are fitted, all positive."""
    errors = usual(episodes, part)
    size, hidden = np.linalg.norm(errors, axis=2), episodes[..., 1] < HIDDEN
    known = errors[np.isfinite(errors[..., 0]).any(axis=1)]
    bias = np.nanmedian(known, axis=1)
    left = np.linalg.norm(known - bias[:, None], axis=2)
    jump = np.linalg.norm(np.diff(errors, axis=1), axis=2)
    still = np.linalg.norm(np.diff(episodes[..., 9:12], axis=1), axis=2) < 2e-4
    kept = [max(correlation(errors, lag), 0.01) for lag in LAGS]
    quantiles = [
        np.nanquantile(values, share)
        for values, share in [
            (size, 0.5), (size, 0.9), (size[~hidden], 0.5), (size[hidden], 0.5), (size[hidden], 0.9),
            (np.linalg.norm(bias, axis=1), 0.5), (np.linalg.norm(bias, axis=1), 0.9),
            (left, 0.5), (left, 0.9), (jump[still], 0.5), (jump[still], 0.9), (jump[~still], 0.5),
        ]
    ]  # fmt: skip
    return np.array([*quantiles, *kept])


def fit(episodes: Sequence[Array], films: Sequence[int], values: Values) -> dict[str, dict[str, Any]]:
    """Fit a model's numbers, each a value and a 95 % interval by bootstrapping over films.

    `films` has the film number of each episode, `values` the initial values; those of the delay stay.
    """
    whole, rng = np.stack(episodes), np.random.default_rng(0)
    of_film = [np.flatnonzero(np.array(films) == film) for film in np.unique(films)]
    draws = rng.integers(len(of_film), size=(DRAWS, len(of_film)))
    drawn = [whole[np.concatenate([of_film[k] for k in chosen])] for chosen in draws]
    found: dict[str, dict[str, Any]] = {}
    for group, measure in (("missed", _missed), ("gross", _gross), ("confidence", _confidence)):
        values[group] = measure(whole)
        found[group] = _known(values[group], [measure(one) for one in drawn])
    found["gross"]["visible"] = (SLOPE, [])
    for part, group in enumerate(("position", "rotation")):
        found[group] = _error(whole, drawn, part, group, values)
        values[group] = {key: value for key, (value, _) in found[group].items()}
    return found


def _known(best: dict[str, float], drawn: Sequence[dict[str, float]]) -> dict[str, Any]:
    """Return numbers with the intervals of their bootstrap samples."""
    ends = {key: np.quantile([one[key] for one in drawn], (0.025, 0.975)) for key in best}
    return {key: (value, [min(ends[key][0], value), max(ends[key][1], value)]) for key, value in best.items()}


def _error(whole: Array, drawn: Sequence[Array], part: int, group: str, values: Values) -> dict[str, Any]:
    expected, start = figures(whole, part), np.log([pair[part] for pair in FITTED.values()])

    def misses(logs: FloatArray) -> FloatArray:
        values[group] = dict(zip(FITTED, np.exp(logs).tolist(), strict=True))
        off = np.log(figures(simulated(values, list(whole)), part) / expected)
        result: FloatArray = np.concatenate([WEIGHTS * off, PULL * (logs - start)])
        return result

    best = least_squares(misses, start, diff_step=0.03, max_nfev=25, loss="soft_l1", f_scale=SCALE)
    spread = WEIGHTS[:, None] * np.cov(np.log([figures(one, part) for one in drawn]).T) * WEIGHTS
    # The prior that pulls towards the start contributes information, too.
    gain, rows = gain_of(best.jac, best.fun), len(expected)
    taught, pulled = gain[:, :rows], gain[:, rows:]
    error = np.sqrt(np.diag(taught @ spread @ taught.T + pulled @ pulled.T))
    return {
        key: (np.exp(log), np.exp([log - 1.96 * e, log + 1.96 * e]))
        for key, log, e in zip(FITTED, best.x, error, strict=True)
    }


def gain_of(jac: FloatArray, misses: FloatArray) -> FloatArray:
    """Return how the solution of `least_squares` with its loss soft_l1 and SCALE changes with each miss.

    SciPy has scaled the rows of `jac` by the root of the loss's curvature, (1 + (miss / SCALE)²)^-3/2.
    """
    return np.asarray(-np.linalg.pinv(jac) * (1.0 + (misses / SCALE) ** 2) ** -0.75)


def _missed(whole: Array) -> dict[str, float]:
    """Fit the rates of the Markov chain of missed frames, by maximum likelihood."""
    found, v = np.isfinite(whole[..., 2]), whole[:, 1:, 1].ravel()
    before, after = found[:, :-1].ravel(), found[:, 1:].ravel()

    def surprise(logs: FloatArray) -> float:
        a, b, c, d = np.exp(logs)
        lost, back = a * np.exp(-b * v), c * np.exp(np.minimum(d * v, 40.0))
        rest = back / (lost + back)
        p = np.clip(rest + (before - rest) * np.exp(-0.1 * (lost + back)), 1e-6, 1 - 1e-6)
        return float(-np.sum(np.where(after, np.log(p), np.log(1 - p))))

    # Without a single miss, or a single pose, the likelihood has no maximum, but a model's numbers have.
    names = "lost", "lost_visible", "found", "found_visible"
    start, bounds = np.log([30.0, 15.0, 0.02, 25.0]), np.log([largest(name) for name in names])
    best = minimize(
        surprise,
        start,
        method="Nelder-Mead",
        bounds=[*zip(-bounds, bounds, strict=True)],
        options={"maxiter": 2000},
    )
    return dict(zip(names, np.exp(best.x).tolist(), strict=True))


def _confidence(whole: Array) -> dict[str, float]:
    """Fit the dependence of confidence on visible fraction and error, by regression with slopes ≥ 0."""
    size, c, v = _sizes(whole), whole[..., 8], np.clip(whole[..., 1], 0.05, 1.0)
    given = np.isfinite(c) & (c < 1.0) & (c > 0.0)
    columns = np.stack([np.ones_like(v), np.log(v), -size[..., 0], -size[..., 1]], axis=-1)[given]
    logit = np.log(c[given] / (1.0 - c[given]))
    best = lsq_linear(columns, logit, ([-np.inf, 0.0, 0.0, 0.0], np.inf), method="bvls").x
    return {
        "clear": float(1.0 / (1.0 + np.exp(-best[0]))),
        **dict(zip(("visible", "distance", "angle"), best[1:].tolist(), strict=True)),
        "spread": float(np.std(logit - columns @ best)),
    }


def _gross(whole: Array) -> dict[str, float]:
    """Return how often errors are gross, for how long, and how large they then are."""
    size = _sizes(whole)
    gross, clear = np.any(size > GROSS, axis=2), np.clip(whole[..., 1], 0.05, 1.0)
    begins = max(int(np.sum(gross[:, 1:] & ~gross[:, :-1]) + gross[:, 0].sum()), 1)
    ways = size[gross] if gross.any() else np.array([GROSS])
    # Sampled each 0.1 s, an error that ends at a constant rate goes on with probability exp(-0.1 / seconds),
    # and most of the short ones are missed.
    frames = max(int(gross.sum()), 1) / begins
    seconds = -0.1 / math.log(max(1 - 1 / frames, 1e-3))
    seen = seconds / frames * float(np.sum(np.exp(-SLOPE * clear[np.isfinite(size[..., 0])])))
    return {
        "rate": begins / seen,
        "visible": SLOPE,
        "seconds": seconds,
        "distance": float(np.median(ways[:, 0])),
        "angle": float(np.median(ways[:, 1])),
        "spread": float(np.std(np.log(ways[:, 0]))) or 0.3,
    }


def _sizes(whole: Array) -> FloatArray:
    """Return the sizes (N, T, 2) of the errors [m, rad]."""
    result: FloatArray = np.linalg.norm(whole[..., 2:8].reshape(*whole.shape[:2], 2, 3), axis=3)
    return result


def agreement(measured: Array, modelled: Array) -> list[tuple[str, float, float]]:
    """Return (name, measured, modelled) for each figure."""
    rows = []
    for part, (name, scale) in enumerate((("position [mm]", 1e3), ("rotation [°]", 180 / np.pi))):
        for label, share in (("median", 0.5), ("90th percentile", 0.9)):
            one, other = (
                scale * float(np.nanquantile(_sizes(e)[..., part], share)) for e in (measured, modelled)
            )
            rows.append((f"{name}, {label}", one, other))
        for lag in LAGS:
            one, other = (correlation(usual(e, part), lag) for e in (measured, modelled))
            rows.append((f"{name}, correlation at {lag / 10:g} s", one, other))
    one, other = (100 * float(np.mean(np.isnan(e[..., 2]))) for e in (measured, modelled))
    rows.append(("missed [%]", one, other))
    return rows


def to_toml(about: str, found: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the content of a model's file."""
    lines = [f'about = "{about}"']
    for group, units in UNITS.items():
        lines += ["", f"[{group}]"]
        for key, unit in units.items():
            value, interval = found[group][key]
            ends = ", ".join(f"{x:.3g}" for x in interval)
            if len(interval):
                low, high = (float(f"{x:.3g}") for x in interval)
                value = min(max(float(f"{value:.3g}"), low), high)
            lines.append(f'{key} = {{value = {value:.3g}, unit = "{unit}", interval = [{ends}]}}')
    return "\n".join([*lines, ""])
