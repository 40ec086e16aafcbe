"""The way from evidence to a pose: search, align, refine, state the uncertainty."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.camera import Camera
from tracker.pose import align, contour
from tracker.pose.acceptance import log_odds
from tracker.pose.covariance import CORRELATION, camera_offset_covariance, pose_covariance, solve_step
from tracker.pose.fit import Fit
from tracker.pose.lens import apply_update
from tracker.pose.result import Status
from tracker.pose.search import Searcher
from tracker.pose.views import ALIGN_SIZE, Box, Evidence, reduced_size, stack_lenses

ALIGN_REACHES = np.array([5, 5, 4, 4, 3])
"""Reach of the label transitions' search in each alignment step [px of the label map]."""

FINE_REACHES = np.array([6, 6, 5, 4])
"""The same on the finer label maps."""

LABELLED = 1.5
"""How far around the object its finer label map reaches, in its radii."""

FEW, MANY = 3, 10
"""Rotations that are tried at the best position, and at each where that did not settle it."""

POSITIONS = 4
"""Positions that are tried, at most."""

REFINED = 5
"""Different hypotheses that are refined, at most."""

MIN_PIXELS = 20
"""Face-coloured pixels in all label maps below which there is no object."""

SURE = 5.0
"""Log odds of a fit at which no other hypothesis is tried."""

SAME_POSITION, SAME_ROTATION = 0.006, 0.15
"""Two hypotheses nearer than this [m, rad] are the same pose."""

REFERENCE_FOCAL = 295.0
"""Focal length [px] at which lengths in the refinement are stated: the platform's at 270×270."""

ASSUMED_SPREAD = 0.12
"""Standard deviation of an edge's place that noise does not explain [px at the reference]."""

TUKEY, MIN_TUKEY = 4.685, 0.5
"""Residual at which a sample's weight reaches zero: in robust standard deviations, and at least [px]."""

START_BLUR = 0.9
"""Blur of the image's steps before it is measured [px at the reference]."""

MIN_BLURS = 8
"""Profiles that must have shown the blur before it is believed."""

FREEZE_SPREAD = 5
"""Steps after which the residuals' scale stays: a scale that follows the weights converges slowly."""

MAX_STEPS = 10
CONVERGED = 1e-5
"""Length of a refinement step [m] below which it ends."""


class PoseEstimator:
    """Finds one cuboid in the views of fixed cameras; holds every table and work space that needs."""

    def __init__(self, box: Box, cameras: Sequence[Camera], label_table: Array) -> None:
        self.box, self.label_table = box, label_table
        self.lenses = stack_lenses(cameras)
        small = [camera.resized(*reduced_size(camera.width, camera.height)) for camera in cameras]
        self.small = stack_lenses(small)
        middle = [c.resized(*reduced_size(c.width, c.height, ALIGN_SIZE)) for c in cameras]
        self.middle = stack_lenses(middle)
        self.searcher = Searcher(self.small, box)
        self.cameras = tuple(cameras)
        self.scales = np.array([camera.matrix[0, 0] / REFERENCE_FOCAL for camera in cameras])
        shape = (len(cameras), max(c.height for c in small), max(c.width for c in small))
        self.labels = np.zeros(shape, np.uint8)
        shape = (len(cameras), max(c.height for c in middle), max(c.width for c in middle))
        self.fine_labels = np.zeros(shape, np.uint8)
        self.used = np.zeros(len(cameras), np.bool_)
        self._work = contour.workspace()

    def estimate(self, views: Sequence[Evidence | None]) -> Fit | Status:
        """The best pose for the views of the cameras, in their order; None where there is no image.

        Most images are settled by the first hypothesis. Where its fit is not sure, more are aligned
        and refined, and a different pose that fits nearly as well counts against the best.
        """
        for c, view in enumerate(views):
            self.used[c] = view is not None
            self.labels[c] = 0
            if view is not None:
                self.labels[c, : view.labels.shape[0], : view.labels.shape[1]] = view.labels
        if np.count_nonzero(self.searcher.face_mask[self.labels]) < MIN_PIXELS:
            return Status.NO_OBJECT_COLORS
        positions = self.searcher.positions(self.labels, self.used, POSITIONS)
        if not positions:
            return Status.TOO_FEW_PIXELS
        fits: list[Fit] = []
        for first, last, rotations in ((0, 1, FEW), (0, POSITIONS, MANY)):
            for hypothesis in self._align(positions[first:last], rotations):
                fit = self._refine(views, *hypothesis)
                if all(_differ(fit, other) for other in fits):
                    fits.append(fit)
                if max(log_odds(f) for f in fits) > SURE:
                    break
            if fits and max(log_odds(f) for f in fits) > SURE:
                break
        if not fits:
            return Status.INCONSISTENT_VIEWS
        fits.sort(key=log_odds, reverse=True)
        if len(fits) == 1:
            return fits[0]
        return replace(fits[0], lead=log_odds(fits[0]) - log_odds(fits[1]))

    def _align(self, candidates: Sequence[FloatArray], count: int) -> list[tuple[FloatArray, FloatArray]]:
        """Different (rotation, position) after alignment on the label maps, best first."""
        rotations, positions, scores = [], [], []
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
        chosen: list[tuple[FloatArray, FloatArray]] = []
        for k in np.argsort(-np.array(scores), kind="stable"):
            if scores[k] <= 0 or len(chosen) == REFINED:
                break
            if all(_apart(rotations[k], positions[k], *other) for other in chosen):
                chosen.append((rotations[k], positions[k]))
        return chosen

    def _explain(self, rotation: FloatArray, position: FloatArray) -> Array:
        counts = np.empty((len(self.used), 5), np.int64)
        align.explain(
            self.middle, self.fine_labels, self.used, self.box.half, self.box.face_labels, rotation, position,
            2, counts,
        )  # fmt: skip
        return counts

    def _window(self, scale: float, step: int, spread: float, blur: float) -> contour.Window:
        reach = (5.0, 5.0, 4.0)[step] if step < 3 else 3.2
        return contour.Window(
            reach=max(3, min(contour.MAX_REACH, round(reach * scale))),
            blur=blur,
            tukey=scale * (reach if step < 3 else min(reach, max(MIN_TUKEY, TUKEY * spread))),
            floor=(ASSUMED_SPREAD * scale) ** 2,
            spacing=2.0 * scale,
            margin=3.0 * scale,
        )

    def _refine(self, views: Sequence[Evidence | None], rotation: FloatArray, position: FloatArray) -> Fit:
        rotation, position = rotation.copy(), position.copy()
        for c, view in enumerate(views):
            if view is not None:
                align.label_around(
                    self.middle, c, view.image, view.channels, self.label_table, position,
                    LABELLED * self.searcher.radius, self.fine_labels[c],
                )  # fmt: skip
        align.align(
            self.middle, self.fine_labels, self.used, self.box.half, self.box.face_labels, rotation, position,
            FINE_REACHES, self._work.samples,
        )  # fmt: skip
        cameras = len(views)
        weights = np.linalg.inv([camera_offset_covariance(camera, position) for camera in self.cameras])
        offsets = np.zeros((cameras, 6))
        information, gradient = np.zeros((cameras, 6, 6)), np.zeros((cameras, 6))
        summary = np.zeros((cameras, 6))
        blurs = [START_BLUR * max(1.0, scale) ** 0.5 for scale in self.scales]
        spread, converged = 1.0, False
        known = np.linalg.inv(np.diag([1e3] * 3 + [10.0] * 3))
        for step in range(MAX_STEPS):
            residuals = []
            for c, view in enumerate(views):
                if view is None:
                    continue
                seen_rotation, seen_position = rotation.copy(), position.copy()
                apply_update(seen_rotation, seen_position, offsets[c])
                contour.refine_view(
                    self.lenses, c, view, self.label_table, self.box, seen_rotation, seen_position,
                    self._window(self.scales[c], step, spread, blurs[c]), self._work,
                    information[c], gradient[c], summary[c],
                )  # fmt: skip
                residuals.append(self._work.residuals(int(summary[c, contour.EXPECTED])) / self.scales[c])
                if step >= 2 and summary[c, contour.BLURS] >= MIN_BLURS:
                    measured = summary[c, contour.BLUR_SUM] / summary[c, contour.BLURS]
                    blurs[c] = min(max(measured, 0.5), 3.0 * self.scales[c])
            # The median of all usable residuals, unlike the inliers' mean square, does not shrink by
            # leaving out what disagrees.
            usable = np.concatenate(residuals)
            if step < FREEZE_SPREAD and usable.size:
                spread = 1.4826 * float(np.median(usable))
            trust = 1.0 / (CORRELATION * max(spread / ASSUMED_SPREAD, 1.0)) ** 2
            solved = solve_step(trust * information, trust * gradient, offsets, weights)
            if solved is None:
                break
            known = solved.information
            limit = max(np.linalg.norm(solved.pose[:3]) / 0.02, np.linalg.norm(solved.pose[3:]) / 0.3, 1.0)
            apply_update(rotation, position, solved.pose / limit)
            offsets += solved.offsets / limit
            if (
                step >= 4
                and np.linalg.norm(solved.pose[:3]) + 0.05 * np.linalg.norm(solved.pose[3:]) < CONVERGED
            ):
                converged = True
                break
        counts = self._explain(rotation, position)
        summary[:, contour.SQUARES] /= self.scales**2
        return Fit(
            position, rotation, pose_covariance(known), counts, summary,
            converged,
        )  # fmt: skip


def _apart(rotation: FloatArray, position: FloatArray, rotation2: FloatArray, position2: FloatArray) -> bool:
    """Whether two poses differ by more than alignment on label maps leaves open."""
    turned = np.trace(rotation.T @ rotation2) < 1 + 2 * np.cos(SAME_ROTATION)
    return bool(turned or np.linalg.norm(position - position2) > SAME_POSITION)


def _differ(fit: Fit, other: Fit) -> bool:
    return _apart(fit.rotation, fit.position, other.rotation, other.position)
