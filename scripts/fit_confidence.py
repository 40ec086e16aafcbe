"""Fit the confidence's logistic model on scenes of the simulated platform, where the truth is known.

    python scripts/fit_confidence.py [SCENES]

Right and wrong fits on the way to the answers teach the weights, the answers their scale: with all
cameras, with two and with one, with exact and with perturbed calibration, in tinted and in smeared, grainy
pictures (disturbances that judge nothing), and where there is no object.
Prints the weights that tracker/pose/judge.py holds, and how reliable they are on scenes left out.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from typing import Any

import cv2
import numpy as np
from scipy.optimize import minimize

from synthetic.camera.rigs import sized, standard_rig
from synthetic.frames import Frame, frames
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.objects.model import load_object
from tracker.pipeline import ObjectTracker
from tracker.pose import judge
from tracker.pose.fit import Fit
from tracker.pose.judge import WEIGHTS, features, probably_near

SEED = 101
OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
ALL, PAIRS, ONE = ((0, 1, 2),), ((0, 1), (1, 2)), ((0,),)


def perturbed(
    cameras: tuple, rng: np.random.Generator, shift: float = 5e-4, turn: float = 1.75e-3
) -> CameraRig:
    """A rig whose transforms are off by normal errors [m, rad] that it states."""
    result = []
    for camera in cameras:
        transform = camera.camera_from_world.copy()
        transform[:3, 3] += rng.normal(0, shift, 3)
        transform[:3, :3] = so3.exp(rng.normal(0, turn, 3)) @ transform[:3, :3]
        std = np.zeros((4, 4))
        std[:3, 3] = shift
        std[:3, :3] = turn * np.sqrt(np.maximum(0, 1 - transform[:3, :3] ** 2))
        result.append(dataclasses.replace(camera, camera_from_world=transform, camera_from_world_std=std))
    return CameraRig(tuple(result))


def tinted(images: list, rng: np.random.Generator) -> list:
    """Each camera's colours mixed and curved a little, and darker towards a side."""
    result = []
    for image in images:
        mixing = np.eye(3) * rng.uniform(0.55, 1.35, 3) + rng.uniform(-0.08, 0.08, (3, 3))
        curve, angle, depth = rng.uniform(0.75, 1.35), rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.5)
        y, x = np.mgrid[-1 : 1 : image.shape[0] * 1j, -1 : 1 : image.shape[1] * 1j]
        shade = 1 - depth * (1 + np.cos(angle) * x + np.sin(angle) * y) / 2
        light = np.clip(image / 255.0 @ mixing.T * shade[..., None], 0, 1) ** curve
        result.append(np.rint(255 * light).astype(np.uint8))
    return result


def shaken(images: list, rng: np.random.Generator) -> list:
    """The images smeared along a direction, with grain that grows with the light, or as JPEG."""
    result = []
    for image in images:
        length, angle = rng.uniform(0, 4), rng.uniform(0, np.pi)
        kernel = np.zeros((7, 7), np.float32)
        for t in np.linspace(-length / 2, length / 2, 15):
            kernel[round(3 + t * np.sin(angle)), round(3 + t * np.cos(angle))] += 1
        smeared = cv2.filter2D(image.astype(np.float32), -1, kernel / kernel.sum())
        grain = rng.uniform(1, 16) * np.sqrt(0.2 + smeared / 160) * rng.normal(size=image.shape)
        seen = np.clip(np.rint(smeared + grain), 0, 255).astype(np.uint8)
        if rng.random() < 0.5:
            quality = [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(45, 95))]
            seen = cv2.imdecode(cv2.imencode(".jpg", seen, quality)[1], cv2.IMREAD_COLOR)
        result.append(np.ascontiguousarray(seen))
    return result


@dataclasses.dataclass
class Cases:
    """Fits and whether each is right."""

    rows: list[list[float]] = dataclasses.field(default_factory=list)
    near: list[float] = dataclasses.field(default_factory=list)
    right: list[bool] = dataclasses.field(default_factory=list)

    def add(self, fit: Fit, truth: Frame) -> None:
        """One more fit."""
        self.rows.append(list(features(fit).values()))
        self.near.append(probably_near(fit.covariance) / (1.0 + math.exp(-fit.lead)))
        self.right.append(_is_right(fit.position, fit.rotation, truth))

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Features (N, F), probability of being near if on the object (N,), whether right (N,)."""
        return np.array(self.rows), np.array(self.near), np.array(self.right, dtype=float)


def collect(seed: int, scenes: int) -> tuple[Cases, Cases]:
    """All fits that the estimator makes on the way, and its answers."""
    every, answers = Cases(), Cases()
    for name in OBJECTS:
        model, rig = load_object(name), sized(standard_rig(), 270)
        exact = ObjectTracker(model, rig)
        for k, truth in enumerate(frames(name, scenes, seed, empty=0.12)):
            rng = np.random.default_rng([seed, k])
            images = list(truth.images)
            if k % 3 == 1 or k % 6 == 5:
                images = tinted(images, rng)
            if k % 3 == 2:
                images = shaken(images, rng)
            tracker = ObjectTracker(model, perturbed(rig.cameras, rng)) if k % 2 else exact
            fits = _listen(tracker)
            for used in (*ALL, PAIRS[k % 2], *ONE):
                fits.clear()
                answer = tracker.fit([image if c in used else None for c, image in enumerate(images)])
                for fit in fits:
                    every.add(fit, truth)
                if isinstance(answer, Fit):
                    answers.add(answer, truth)
    return every, answers


def _listen(tracker: ObjectTracker) -> list[Fit]:
    """A list that gains every fit that the tracker's estimator makes."""
    fits: list[Fit] = []
    estimator = tracker._estimator
    refine = type(estimator).refine

    def record(*arguments: Any) -> Fit:
        fits.append(refine(estimator, *arguments))
        return fits[-1]

    estimator.refine = record  # type: ignore[method-assign]
    return fits


def _is_right(position: FloatArray, rotation: FloatArray, truth: Frame) -> bool:
    if not truth.objects:
        return False
    (state,) = truth.objects
    near = np.linalg.norm(position - state.position) < 5e-3
    return bool(near and so3.angle_between(rotation, state.rotation) < np.radians(5))


def fit(rows: FloatArray, right: FloatArray) -> FloatArray:
    """Bias and weights (1 + F,) of a logistic model whose weights are not positive."""
    spread = rows.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(rows)), rows / spread])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        odds = design @ w
        value = np.logaddexp(0, odds).sum() - right @ odds + (w[1:] ** 2).sum()
        return value, design.T @ (1 / (1 + np.exp(-odds)) - right) + 2 * np.r_[0, w[1:]]

    bounds = [(None, None)] + [(None, 0)] * rows.shape[1]
    solution = minimize(loss, np.zeros(design.shape[1]), jac=True, method="L-BFGS-B", bounds=bounds).x
    return np.concatenate([solution[:1], solution[1:] / spread])


def scale(odds: FloatArray, near: FloatArray, right: FloatArray) -> FloatArray:
    """Offset and factor (2,) on log odds (N,) under which the answers' confidence is calibrated (Platt)."""

    def loss(w: FloatArray) -> float:
        said = np.clip(near / (1 + np.exp(-(w[0] + w[1] * odds))), 1e-6, 1 - 1e-6)
        return float(-(right * np.log(said) + (1 - right) * np.log(1 - said)).sum())

    return np.asarray(minimize(loss, [0.0, 1.0], method="Nelder-Mead").x)


def accept_almost_all() -> None:
    """Lower the limits of acceptance, since the weights have to learn from what is refused as well."""
    judge.MIN_EXPLAINED, judge.MAX_WRONG, judge.MIN_INLIERS = 0.1, 0.6, 4.0
    judge.MIN_LEAD, judge.MIN_TRUST, judge.MIN_DEFINITE = -1.0, 0.0, 0.0


def main(scenes: int) -> None:
    """Collect, fit, print; the reliability is that of other scenes."""
    accept_almost_all()
    every, answers = collect(SEED, scenes)
    rows, near, right = every.arrays()
    weights = fit(rows[near > 0.9], right[near > 0.9])
    rows, near, right = answers.arrays()
    offset, factor = scale(weights[0] + rows @ weights[1:], near, right)
    weights = np.concatenate([[offset + factor * weights[0]], factor * weights[1:]])
    print("BIAS =", round(float(weights[0]), 2))
    print("WEIGHTS =", {n: round(float(w), 2) for n, w in zip(WEIGHTS, weights[1:], strict=True)})
    rows, near, right = collect(SEED + 1, scenes // 2)[1].arrays()
    said = near / (1 + np.exp(-(weights[0] + rows @ weights[1:])))
    print(f"{len(rows)} answers to other scenes; Brier score {np.mean((said - right) ** 2):.4f}")
    for low, high in ((0, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.98), (0.98, 1.01)):
        chosen = (said >= low) & (said < high)
        if chosen.any():
            print(f"said {said[chosen].mean():.3f}: {chosen.sum()} answers, {right[chosen].mean():.3f} right")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200)
