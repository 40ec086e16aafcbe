"""Fit the confidence's logistic model on scenes of the simulated platform, where the truth is known.

    python scripts/fit_confidence.py [SCENES]

Right and wrong answers teach the weights: in a tidy world and in one with all imperfections of the real one,
with all cameras, with two and with one, with exact and with perturbed calibration, in tinted and in smeared,
grainy pictures, and where there is no object; and where something is broken: pictures that were mixed up, a
camera that was knocked, cameras that are all somewhere else.
Prints the weights that tracker/pose/judge.py holds, and how reliable they are on scenes left out.
"""

from __future__ import annotations

import dataclasses
import math
import sys
from collections.abc import Iterator
from itertools import chain

import cv2
import numpy as np
from scipy.optimize import minimize

from synthetic.effects import NAMES
from synthetic.frames import Frame, frames
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.geometry import so3
from tracker.objects.model import load_object
from tracker.pipeline import ObjectTracker
from tracker.pose import judge
from tracker.pose.fit import Fit
from tracker.pose.judge import WEIGHTS, features, fits, probably_near

SEED = 101
OBJECTS = ("cube_v2", "cuboid_2x2x8_v2")
FAULTS_WEIGHT = 0.5
"""Of an answer where something is broken, which is rarer than these scenes have it."""

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
    """Answers and whether each is right."""

    rows: list[list[float]] = dataclasses.field(default_factory=list)
    near: list[float] = dataclasses.field(default_factory=list)
    right: list[bool] = dataclasses.field(default_factory=list)
    faulty: list[bool] = dataclasses.field(default_factory=list)

    def add(self, fit: Fit, truth: Frame, faulty: bool) -> None:
        """One more answer."""
        self.rows.append(list(features(fit).values()))
        self.near.append(fits(fit) * probably_near(fit.covariance) / (1.0 + math.exp(-fit.lead)))
        self.right.append(_is_right(fit.position, fit.rotation, truth))
        self.faulty.append(faulty)

    def arrays(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Features (N, F), probability of being near if on the object, whether right, weights (N,)."""
        weights = np.where(self.faulty, FAULTS_WEIGHT, 1.0)
        return np.array(self.rows), np.array(self.near), np.array(self.right, dtype=float), weights


def mixed_up(images: list, rng: np.random.Generator) -> list:
    """The pictures of two cameras in each other's place, or one camera's upside down or as in a mirror."""
    result = list(images)
    one, two = (int(c) for c in rng.permutation(len(images))[:2])
    kind = rng.integers(3)
    if kind == 0:
        result[one], result[two] = images[two], images[one]
    else:
        result[one] = np.ascontiguousarray(images[one][::-1] if kind == 1 else images[one][:, ::-1])
    return result


def situations(rig: CameraRig, images: list, rng: np.random.Generator, k: int) -> Iterator[tuple]:
    """How scene k is looked at: calibration, pictures (None: no picture), whether something is broken."""
    if k % 3 == 1 or k % 6 == 5:
        images = tinted(images, rng)
    if k % 3 == 2:
        images = shaken(images, rng)
    given = perturbed(rig.cameras, rng) if k % 2 else rig
    for used in (*ALL, PAIRS[k % 2], *ONE):
        yield given, [image if c in used else None for c, image in enumerate(images)], False
    yield given, mixed_up(images, rng), True
    yield knocked(given, rng), images, True
    yield strange(given, rng), images, True


def knocked(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """A rig of which one camera is not where its file says: by millimetres, or somewhere else altogether."""
    cameras, c = list(rig.cameras), int(rng.integers(len(rig)))
    shift, turn = (rng.uniform(1e-3, 5e-3), rng.uniform(1e-3, 1e-2)) if rng.random() < 0.5 else (0.03, 0.1)
    moved = perturbed((cameras[c],), rng, shift, turn).cameras[0]
    cameras[c] = dataclasses.replace(moved, camera_from_world_std=cameras[c].camera_from_world_std)
    return CameraRig(tuple(cameras))


def strange(rig: CameraRig, rng: np.random.Generator) -> CameraRig:
    """Cameras that are all somewhere else, as of another robot, and say nothing of it."""
    moved = perturbed(rig.cameras, rng, rng.uniform(3e-3, 2e-2), rng.uniform(1e-2, 1e-1)).cameras
    pairs = zip(moved, rig, strict=True)
    return CameraRig(
        tuple(dataclasses.replace(m, camera_from_world_std=c.camera_from_world_std) for m, c in pairs)
    )


def collect(seed: int, scenes: int) -> Cases:
    """The estimator's answers in all situations: half of the scenes in a tidy world, half in the real one."""
    answers = Cases()
    for name in OBJECTS:
        model = load_object(name)
        tidy = frames(name, scenes // 2, seed, empty=0.12)
        world = frames(name, scenes - scenes // 2, seed + 50, empty=0.12, effects=NAMES)
        for k, truth in enumerate(chain(tidy, world)):
            rng = np.random.default_rng([seed, k])
            for given, images, faulty in situations(truth.given, list(truth.images), rng, k):
                answer = ObjectTracker(model, given).fit(images)
                if isinstance(answer, Fit):
                    answers.add(answer, truth, faulty)
    return answers


def _is_right(position: FloatArray, rotation: FloatArray, truth: Frame) -> bool:
    if not truth.objects:
        return False
    (state,) = truth.objects
    near = np.linalg.norm(position - state.position) < 5e-3
    return bool(near and so3.angle_between(rotation, state.rotation) < np.radians(5))


def fit(rows: FloatArray, near: FloatArray, right: FloatArray, weights: FloatArray) -> FloatArray:
    """Bias and weights (1 + F,), these not positive, under which the confidence is most likely.

    Args:
        rows: (N, F) features.
        near: (N,) probability of being near the truth if on the object.
        right: (N,) whether it was.
        weights: (N,) of each answer.
    """
    spread = rows.std(axis=0) + 1e-9
    design = np.column_stack([np.ones(len(rows)), rows / spread])

    def loss(w: FloatArray) -> tuple[float, FloatArray]:
        trust = 1 / (1 + np.exp(-(design @ w)))
        said = np.clip(near * trust, 1e-6, 1 - 1e-6)
        value = -(weights * np.where(right > 0, np.log(said), np.log1p(-said))).sum()
        slope = weights * np.where(right > 0, -1 / said, 1 / (1 - said)) * near * trust * (1 - trust)
        return value + 0.5 * (w[1:] ** 2).sum(), slope @ design + np.r_[0, w[1:]]

    bounds = [(None, None)] + [(None, 0)] * rows.shape[1]
    start = np.r_[3.0, -np.ones(rows.shape[1])]
    solution = minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x
    return np.concatenate([solution[:1], solution[1:] / spread])


def accept_almost_all() -> None:
    """Lower the limits of acceptance, since the weights have to learn from what is refused as well."""
    judge.MIN_EXPLAINED, judge.MAX_WRONG, judge.MIN_INLIERS = 0.1, 0.6, 4.0
    judge.MIN_LEAD, judge.MIN_TRUST, judge.MIN_DEFINITE = -1.0, 0.0, 0.0


def main(scenes: int) -> None:
    """Collect, fit, print; the reliability is that of other scenes."""
    accept_almost_all()
    weights = fit(*collect(SEED, scenes).arrays())
    print("BIAS =", round(float(weights[0]), 2))
    print("WEIGHTS =", {n: round(float(w), 2) for n, w in zip(WEIGHTS, weights[1:], strict=True)})
    rows, near, right, mass = collect(SEED + 1, scenes // 2).arrays()
    said = near / (1 + np.exp(-(weights[0] + rows @ weights[1:])))
    for title, kind in (("ordinary", mass == 1.0), ("broken", mass < 1.0)):
        print(f"{title}: {kind.sum()} answers, Brier score {np.mean((said - right)[kind] ** 2):.4f}")
        for low, high in ((0, 0.3), (0.3, 0.5), (0.5, 0.7), (0.7, 0.9), (0.9, 0.98), (0.98, 1.01)):
            chosen = kind & (said >= low) & (said < high)
            if chosen.any():
                print(f"  said {said[chosen].mean():.3f}: {chosen.sum()}, {right[chosen].mean():.3f} right")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 240)
