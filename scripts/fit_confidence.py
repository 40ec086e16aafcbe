"""Fit the numbers of the evidence to scenes of the simulated platform with known poses.

    python scripts/fit_confidence.py [SCENES] [NUMBER …]

Only the named numbers are fitted; without names, all.

The data are right and wrong fits: in a tidy world and in one with all imperfections of the real one, with all
cameras, with two and with one, in unusual light, in poor images, without the object, with look-alikes, with
swapped images or channels, and with another robot's calibration.
Prints the numbers for tracker/pose/evidence.py and tracker/pose/judge.py, and their reliability on every
third scene when they are fitted to the others.
"""

import dataclasses
import sys
from collections.abc import Iterator

import numpy as np
from scipy.optimize import minimize

import tracker
from benchmarks.data.plan import LOOK_ALIKE, SHARES, Plan
from benchmarks.data.scenes import OBJECTS
from benchmarks.data.sets import scene_set
from benchmarks.data.store import prepare
from benchmarks.data.workloads import WORKLOADS, case
from benchmarks.score.errors import pose_errors, true_pose
from tracker.compiled import compiled
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.probability import probability_within
from tracker.objects.model import CuboidModel
from tracker.pose.evidence import NUMBERS, Numbers, weigh
from tracker.pose.fit import SEEN, Fit
from tracker.pose.hypotheses import apart
from tracker.pose.judge import NEAR, SINGLE, alone, disputed, fits, rank
from tracker.pose.result import PoseEstimate
from tracker.pose.rivals import reconcilable

SEED = 101
WEIGHTS = {"swapped": 0.5, "other calibration": 0.25}
"""Weights of workloads that are rarer in practice than here, or that no evidence can recognise."""

PROBABILITIES = ("wrong", "misread", "hidden", "broken", "alike", "colored")
ODDS = ("body", "resized", "nothing")
"""Search variables: log odds for probabilities and odds, the logarithm for all others."""

MISTAKES = 1e-4
"""Probability at which the loss of a surprising outcome is capped."""


@dataclasses.dataclass
class Cases:
    """Fits, and whether each is right."""

    seen: list[Array] = dataclasses.field(default_factory=list)
    labels: list[Array] = dataclasses.field(default_factory=list)
    numbers: list[tuple[float, ...]] = dataclasses.field(default_factory=list)
    """stands, log evidence gained by other edge lengths, odds of being near, whether a single camera sees it,
    number of cameras that outvote it, probability that calibration and arena are consistent with it, right,
    weight, the scene's number."""
    rivals: list[tuple[int, int]] = dataclasses.field(default_factory=list)
    group: list[str] = dataclasses.field(default_factory=list)

    def add(self, found: list[Fit], right: list[bool], model: CuboidModel, group: str, scene: int) -> None:
        """Add all fits to one set of images."""
        first, radius = len(self.seen), 0.5 * float(np.linalg.norm(model.size))
        for one, good in zip(found, right, strict=True):
            near = min(max(probability_within(one.covariance, *NEAR), 1e-6), 1 - 1e-6)
            self.seen.append(one.cameras)
            self.labels.append(model.face_labels)
            odds, holds = near / (1 - near), fits(one) * one.inside
            weight = WEIGHTS.get(group, 1.0)
            more = (one.resized - NUMBERS.resized) / NUMBERS.end
            votes = disputed(one)
            self.numbers.append((one.stands, more, odds, alone(one), votes, holds, good, weight, scene))
            self.group.append(group)
        # As for `lead`, rivals that are alike count once.
        ranked = sorted(range(len(found)), key=lambda k: -rank(found[k]))
        for i, one in enumerate(found):
            different = [one]
            for k in ranked:
                other = found[k]
                apart_from_all = k != i and all(apart(other, rival, radius) for rival in different)
                if apart_from_all and not reconcilable(one, other):
                    different.append(other)
                    self.rivals.append((first + i, first + k))


def situations(object_name: str, scenes: int) -> Iterator[tuple]:
    """Yield tracker, images, true pose, workload and number of each scene in each workload."""
    plan = Plan(scenes, SEED, shares={**SHARES, LOOK_ALIKE: 0.4, "absent": 0.6})
    usual = [w for w in WORKLOADS if w.usual and object_name in w.objects]
    bases = dict.fromkeys(w.base for w in usual if w.base in ("realistic", "world", "absent"))
    for base in (*bases, *(w.base for w in usual if w.base.startswith(LOOK_ALIKE))):
        scenes_of = scene_set(object_name, base, plan)
        prepare([(scenes_of.store, scenes_of.numbers)], plan.workers)
        for scene in scenes_of:
            truth = true_pose(scene.position, scene.rotation)
            for workload in (w for w in usual if w.base == base):
                other = scenes_of.another(scene) if workload.other_moment else None
                given = case(workload, object_name, scene, scenes_of.rig, SEED, other)
                one = tracker.ObjectTracker(scenes_of.model, given.rig, scenes_of.colors)
                yield one, given.images, truth, workload.name, scene.index
                if workload.name == "realistic":
                    yield (
                        one,
                        [np.ascontiguousarray(i[..., ::-1]) for i in given.images],
                        truth,
                        "RGB",
                        scene.index,
                    )


def collect(scenes: int) -> Cases:
    """Return every fit among which the tracker chooses, in all situations."""
    cases = Cases()
    for name in OBJECTS:
        for one, images, truth, group, number in situations(name, scenes):
            estimator, found, right = one._estimator, [], []
            sight = estimator.reader(images)
            for candidate in estimator.candidates(sight):
                candidate = candidate.changed(resized=estimator.search.resized(sight, candidate))
                fit = estimator.examined(sight, candidate)
                pose = PoseEstimate(fit.position, so3.quaternion(fit.rotation), fit.covariance, 0.0)
                error = pose_errors(pose, truth)
                found.append(fit)
                right.append(bool(error["mm"] < 5 and error["deg"] < 5))
            cases.add(found, right, one.model, group, number)
    return cases


@compiled
def weigh_all(seen, labels, stands, numbers, out):  # type: ignore[no-untyped-def]
    """Compute the evidence (N, 5) of N fits: `weigh` from inner pixels; from all, the object over nothing."""
    for i in range(len(seen)):
        here, _, _, nothing = weigh(seen[i], labels[i], stands[i], numbers, False)
        out[i, 4] = here - nothing
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = weigh(seen[i], labels[i], stands[i], numbers, True)


class Model:
    """Cases as arrays, and the confidence that numbers give them."""

    def __init__(self, cases: Cases) -> None:
        self.seen = np.array(cases.seen, dtype=SEEN)
        self.labels = np.array(cases.labels)
        columns = np.array(cases.numbers, dtype=float).T
        self.stands, self.resized, self.near, self.alone, self.disputed = columns[:5]
        self.holds, self.right, self.weight, self.scene = columns[5:]
        self.one, self.other = np.array(cases.rivals, dtype=int).reshape(-1, 2).T
        self.group = np.array(cases.group)

    def confidence(self, values: dict[str, float]) -> FloatArray:
        """Return the confidence (N,) of all fits."""
        numbers = Numbers(**{name: values[name] for name in Numbers._fields})
        out = np.empty((len(self.seen), 5))
        weigh_all(self.seen, self.labels, np.ascontiguousarray(self.stands), numbers, out)
        here, body, shape, nothing, ahead = out.T
        ahead = numbers.temper * ahead
        against = np.bincount(self.one, _exp(ahead[self.other] - ahead[self.one]), len(here)) + self.disputed
        against += _exp(numbers.temper * (body - here) + numbers.body)
        against += _exp(numbers.temper * (shape - here))
        against += _exp(numbers.temper * (nothing - here) + numbers.nothing)
        against += _exp(numbers.end * self.resized + numbers.resized)
        odds = np.where(self.alone > 0, values["single"], 1.0) * self.near
        return np.asarray(self.holds * odds / (1 + odds) / (1 + against))

    def fit(self, start: dict[str, float], names: list[str], use: Array) -> dict[str, float]:
        """Return the most likely values of the named numbers for the cases in `use`; others stay."""
        first = np.array([_searched(name, start[name]) for name in names])

        def loss(x: FloatArray) -> float:
            values = start | {name: _meant(name, v) for name, v in zip(names, x, strict=True)}
            stated = np.clip(self.confidence(values), MISTAKES, 1 - MISTAKES)
            cost = -np.where(self.right > 0, np.log(stated), np.log1p(-stated))
            return (
                float((self.weight * cost)[use].sum() / self.weight[use].sum())
                + 1e-4 * ((x - first) ** 2).sum()
            )

        found = minimize(
            loss, first, method="L-BFGS-B", options={"maxiter": 80, "eps": 1e-4, "maxfun": 10**6}
        ).x
        return start | {name: _meant(name, v) for name, v in zip(names, found, strict=True)}


def _exp(x: FloatArray) -> FloatArray:
    """Return the exponential of x, clipped to ±40 where it is practically 0 or infinite."""
    return np.exp(np.clip(x, -40.0, 40.0))


def _searched(name: str, value: float) -> float:
    if name in ODDS:
        return value
    return float(np.log(value / (1 - value)) if name in PROBABILITIES else np.log(value))


def _meant(name: str, value: float) -> float:
    if name in ODDS:
        return float(value)
    return float(1 / (1 + np.exp(-value)) if name in PROBABILITIES else np.exp(value))


def main(scenes: int, names: list[str]) -> None:
    """Collect, fit, print; the reliability is measured on held-out scenes."""
    model = Model(collect(scenes))
    start = dict(NUMBERS._asdict()) | {"single": SINGLE}
    names = names or list(start)
    held = model.scene % 3 == 0
    tried = model.confidence(model.fit(start, names, ~held))
    for group in dict.fromkeys(model.group):
        rows = held & (model.group == group)
        stated, right = tried[rows], model.right[rows]
        print(
            f"{group}: {rows.sum()} fits, stated {stated.mean():.3f}, right {right.mean():.3f}, "
            f"Brier score {np.mean((stated - right) ** 2):.4f}"
        )
    found = model.fit(start, names, np.ones(len(held), bool))
    print({name: float(f"{value:.3g}") for name, value in found.items()})


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 100, sys.argv[2:])
