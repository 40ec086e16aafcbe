"""The way from evidence to a pose: search, align, refine, choose."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import chain

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose import align
from tracker.pose.acceptance import log_odds, possible, rank
from tracker.pose.contour import BLUR, Schedule
from tracker.pose.fit import Fit
from tracker.pose.refine import FOLLOWING, SCHEDULE, TUNING, Refiner
from tracker.pose.result import Status
from tracker.pose.rivals import reversed_in_depth
from tracker.pose.search import Searcher
from tracker.pose.views import Box, Evidence, reduced_size, stack_lenses

ALIGN_REACHES = np.array([5, 4, 3])
"""Reach of the label transitions' search in each alignment step [px of the label map]."""

FAR_REACHES = np.array([8, 6, 4, 3])
"""The same from a prediction."""

FEW, MANY = 2, 10
"""Rotations that are tried at the best position, and at each where that did not settle it."""

POSITIONS = 4
"""Positions that are tried, at most."""

REFINED = 5
"""Different hypotheses that are refined in each of the two rounds, at most."""

MIN_PIXELS = 20
"""Face-coloured pixels in all label maps below which there is no object."""

SURE = 3.0
"""Log odds of a fit at which no other hypothesis is tried."""

WINDOW_RIM = 12.0
"""Beyond an object where it is expected, for where it may be instead [px of the label map]."""

SAME_POSITION, SAME_ROTATION = 0.006, 0.15
"""Two hypotheses nearer than this [m, rad] are the same pose."""

Hypothesis = tuple[FloatArray, FloatArray]
"""Rotation (3, 3) and position (3,) [m]."""


class PoseEstimator:
    """Finds one cuboid in the views of fixed cameras; holds every table and work space that needs."""

    def __init__(self, box: Box, cameras: Sequence[Camera], label_table: Array) -> None:
        self.box = box
        small = [camera.resized(*reduced_size(camera.width, camera.height)) for camera in cameras]
        self.small = stack_lenses(small)
        self.searcher = Searcher(self.small, box)
        self.refiner = Refiner(box, cameras, label_table)
        shape = (len(cameras), max(c.height for c in small), max(c.width for c in small))
        self.labels: Array = np.zeros(shape, np.uint8)
        self.used: Array = np.zeros(len(cameras), np.bool_)
        self._blur = TUNING.start_blur

    def window(self, c: int, position: FloatArray) -> tuple[int, int, int, int]:
        """Left, top, right, bottom of what an object there fills of camera c's label map, and some more."""
        lens, radius = self.small[c], float(np.linalg.norm(self.box.half))
        x, y, z = lens["rotation"] @ position + lens["translation"]
        width, height = int(lens["width"]), int(lens["height"])
        if z < 2 * radius:
            return 0, 0, width, height
        u, v = lens["focal"] * (x / z, y / z) + lens["center"]
        reach = 1.3 * radius * float(lens["focal"].max()) / (z - radius) + WINDOW_RIM
        left, top = max(0, int(u - reach)), max(0, int(v - reach))
        return left, top, min(width, int(u + reach) + 1), min(height, int(v + reach) + 1)

    def estimate(self, views: Sequence[Evidence | None], *, thorough: bool = True) -> Fit | Status:
        """The best pose for the views of the cameras, in their order; None where there is no image.

        Most images are settled by the first hypothesis. Where its fit is not sure, more are aligned
        and refined, and a different pose that fits nearly as well counts against the best; unless a
        search that is not thorough will do.
        """
        self._show(views)
        if np.count_nonzero(self.searcher.face_mask[self.labels]) < MIN_PIXELS:
            return Status.NO_OBJECT_COLORS
        positions = self.searcher.positions(self.labels, self.used, POSITIONS)
        first = next(positions, None)
        if first is None:
            return Status.TOO_FEW_PIXELS
        # One camera alone may see a single face, which fits at four turns: it never settles the matter.
        several = np.count_nonzero(self.used) > 1
        fits: list[Fit] = []
        more = self._align(chain([first], positions), MANY) if thorough else iter(())
        for hypothesis in chain(self._align([first], FEW), more):
            fit = self.refine(*hypothesis)
            fits.append(fit)
            if several and log_odds(fit) > SURE and fit.converged and possible(fit):
                break
        if not fits:
            return Status.INCONSISTENT_VIEWS
        if not several:
            fits.extend(self._reversed(max(fits, key=rank)))
        fits.sort(key=rank, reverse=True)
        # A pose below the table is none, but what looks like one more than like the best makes that doubtful.
        best = next(filter(possible, fits), fits[0])
        rivals = [fit for fit in fits if _apart(fit.rotation, fit.position, best.rotation, best.position)]
        return replace(best, lead=rank(best) - rank(rivals[0])) if rivals else best

    def follow(self, views: Sequence[Evidence | None], rotation: FloatArray, position: FloatArray) -> Fit:
        """The fit nearest to a predicted pose (3, 3), (3,) [m]; a prediction off by a few pixels will do."""
        self._show(views)
        fit = self.refine(rotation, position, FOLLOWING, self._blur)
        if np.count_nonzero(self.used) == 1:
            fit = max([fit, *self._reversed(fit, self._blur)], key=rank)
        measured = fit.samples[self.used, BLUR] / self.refiner.scales[self.used]
        self._blur = float(np.median(measured)) if fit.converged else TUNING.start_blur
        return fit

    def forget(self) -> None:
        """The next images to follow in are of another recording."""
        self._blur = TUNING.start_blur

    def follow_far(self, hypotheses: Sequence[Hypothesis]) -> Fit | None:
        """As `follow`, in the same views, from the best of poses that may be off by 3 cm and 30°."""
        rotations = np.array([rotation for rotation, _ in hypotheses])
        positions, scores = np.array([position for _, position in hypotheses]), np.empty(len(hypotheses))
        align.try_hypotheses(
            self.small, self.labels, self.used, self.box.half, self.box.face_labels,
            rotations, positions, FAR_REACHES, scores,
        )  # fmt: skip
        best = int(np.argmax(scores))
        return None if scores[best] < align.IMPOSSIBLE / 2 else self.refine(rotations[best], positions[best])

    def _show(self, views: Sequence[Evidence | None]) -> None:
        for c, view in enumerate(views):
            self.used[c] = view is not None
            self.labels[c] = 0
            if view is not None:
                self.labels[c, : view.labels.shape[0], : view.labels.shape[1]] = view.labels
        self.refiner.show(views)

    def refine(
        self,
        rotation: FloatArray,
        position: FloatArray,
        schedule: Schedule = SCHEDULE,
        blur: float = TUNING.start_blur,
    ) -> Fit:
        """The fit nearest to a hypothesis (3, 3), (3,) [m], in the views that were shown last."""
        rotation, position, covariance, samples, converged = self.refiner.refine(
            self.used, rotation, position, schedule, blur
        )
        counts = np.empty((len(self.used), 5), np.int64)
        align.explain(
            self.small, self.labels, self.used, self.box.half, self.box.face_labels, rotation, position,
            counts,
        )  # fmt: skip
        lowest = float(position[2] - np.abs(rotation[2]) @ self.box.half)
        return Fit(position, rotation, covariance, samples, converged, counts, lowest)

    def _reversed(self, fit: Fit, blur: float = TUNING.start_blur) -> list[Fit]:
        """What else the one camera that is used may see; `blur` to begin with, as of `refine`."""
        camera = self.small[self.used]["position"][0]
        rivals = reversed_in_depth(fit.rotation, fit.position, self.box.half, camera)
        return [self.refine(*rival, FOLLOWING, blur) for rival in rivals]

    def _align(self, candidates: Iterable[FloatArray], count: int) -> Iterator[Hypothesis]:
        """Different hypotheses after alignment on the label maps, best first; worked out when asked for."""
        rotations: list[FloatArray] = []
        positions: list[FloatArray] = []
        scores: list[float] = []
        for position in candidates:
            turned, _ = self.searcher.rank(self.labels, self.used, position, count)
            moved = np.repeat(position[None], count, axis=0)
            score = np.empty(count)
            align.try_hypotheses(
                self.small, self.labels, self.used, self.box.half, self.box.face_labels,
                turned, moved, ALIGN_REACHES, score,
            )  # fmt: skip
            rotations.extend(turned)
            positions.extend(moved)
            scores.extend(score)
        chosen: list[Hypothesis] = []
        for k in np.argsort(-np.array(scores), kind="stable"):
            if scores[k] < align.IMPOSSIBLE / 2 or len(chosen) == REFINED:
                break
            if all(_apart(rotations[k], positions[k], *other) for other in chosen):
                chosen.append((rotations[k], positions[k]))
                yield chosen[-1]


def _apart(rotation: FloatArray, position: FloatArray, rotation2: FloatArray, position2: FloatArray) -> bool:
    """Whether two poses differ by more than alignment on label maps leaves open."""
    turned = np.vdot(rotation, rotation2) < 1 + 2 * np.cos(SAME_ROTATION)
    return bool(turned or np.linalg.norm(position - position2) > SAME_POSITION)
