"""Fit the probability that a die is real to scenes of the simulated platform with known poses.

    python scripts/fit_dice_probability.py [SCENES]

Prints the weights for tracker/tasks/rearrange_dice/finder.py, with images and with masks alone, and their
reliability on every third scene, which is left out of the fit.
"""

import itertools
import sys

import numpy as np
from scipy.optimize import minimize

from benchmarks.data.dice import KINDS, dice_store
from benchmarks.data.plan import Plan
from benchmarks.score.dice import judge_positions
from synthetic.camera.rigs import sized, standard_rig
from tracker.conventions import Array, FloatArray
from tracker.tasks.rearrange_dice import finder, segment_dice

SEED = 71_000
"""Seed of the scenes; the benchmarks use another."""

BINS = (0.5, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)


def gains_and_truth(scenes: int, *, shaded: bool) -> tuple[FloatArray, Array, Array]:
    """Return, for every reported die, the log of its gain, whether it is real, and whether it is held out."""
    rig = sized(standard_rig(), 270)
    rows = []
    for kind in KINDS:
        for scene in dice_store(kind, Plan(seed=SEED)).scenes(range(scenes)):
            masks = [segment_dice(image) for image in scene.images]
            dice = finder.locate(rig, masks, scene.images if shaded else None)
            right = judge_positions(scene.positions, dice).right
            pairs = zip(dice, right, strict=True)
            rows += [(np.log(max(die.gain, 1.0)), ok, scene.index % 3 == 2) for die, ok in pairs]
    gains, right, held = np.array(rows, dtype=np.float64).T
    return gains, right > 0, held > 0


def log_odds(weights: FloatArray, gains: FloatArray) -> FloatArray:
    """Return the log odds of dice with these log gains."""
    return weights[0] + weights[1] * gains


def fit(gains: FloatArray, right: Array) -> FloatArray:
    """Return offset and slope (2,) of the most likely logistic model."""
    sign = np.where(right, 1.0, -1.0)
    found = minimize(lambda w: np.logaddexp(0, -sign * log_odds(w, gains)).sum(), np.array([0.0, 1.0]))
    return np.asarray(found.x, dtype=np.float64)


def main(scenes: int = 150) -> None:
    """Fit and print both models."""
    finder.LEAST = 0.0
    for shaded in (True, False):
        gains, right, held = gains_and_truth(scenes, shaded=shaded)
        weights = fit(gains[~held], right[~held])
        stated = 1 / (1 + np.exp(-log_odds(weights, gains[held])))
        print(f"{'with images' if shaded else 'masks alone'}: ({weights[0]:.2f}, {weights[1]:.3f})")
        print(f"  Brier score {np.mean((stated - right[held]) ** 2):.4f} of {held.sum()} dice left out")
        for low, high in itertools.pairwise(BINS):
            own = (stated >= low) & (stated < high)
            if own.any():
                real = right[held][own].mean()
                shares = f"{stated[own].mean():.3f}, real {real:.3f}"
                print(f"  stated {low:.2f} to {high:.2f}: {own.sum()} dice, {shares}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
