"""Edges of an object in a given pose, measured in camera images, as equations linear in small changes.

Some errors of a pose are its own; others are due to the cameras, and all poses share them. Edges are
measured without assuming that the calibration is correct.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from tracker.calibration.by_object.sightings import Sighting
from tracker.calibration.deviations import calibration_covariance
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.objects.model import Box, CuboidModel
from tracker.pose.fit import Fit, Start
from tracker.pose.refine import EXPECTED_WEAR, EXPONENT_STD
from tracker.pose.refiner import Refiner
from tracker.pose.schedule import FOLLOWING
from tracker.pose.sizes import FOOT_STD
from tracker.pose.solve import FLOOR, trust_of
from tracker.pose.views import Reader, Sight
from tracker.segmentation.color_model import ColorModel


@dataclass(frozen=True, eq=False)
class Contour:
    """Pieces of visible edges whose positions were measured in one camera's image.

    A piece's offset is jacobian · (δp, δθ) + bloom · γ + rim · ρ for an object moved by (δp, δθ)
    along world axes [m, rad], a response of exponent 1 + γ and a rim of width ρ [m]. Pixels of offsets are
    those of an image that shows the object in reference size.
    """

    jacobian: FloatArray
    """Motion (N, 6) of the predicted position along the outward normal per (δp, δθ) [px/m, px/rad]."""
    lens: FloatArray
    """The same (N, 3) per change of the logarithm of the focal length [px] and of the principal point."""
    bloom: FloatArray
    """Offset (N,) per unit of the exponent [px]."""
    rim: FloatArray
    """Offset (N,) per metre of the rim's width [px/m]."""
    offset: FloatArray
    """Measured offset (N,) from the predicted position, along the normal [px]."""
    variance: FloatArray
    """Variance (N,) of the offset [px²]."""
    edge: Array
    """Number (N,) of the piece's edge among the cuboid's twelve."""
    foot: FloatArray
    """Standard deviation (N,) of the offset of edges that contact shadows may shift [px]; else 0."""

    def information(self, columns: FloatArray, weight: FloatArray, own: float) -> FloatArray:
        """Return the weighted products (K, K) of columns (N, K); the pieces of an edge share an offset.

        weight: (N,) weights of the pieces, from 0 to 1.
        own: variance of the offset that an edge's pieces share, without feet [px²]; it is marginalised.
        """
        weights = weight / self.variance
        total = (columns * weights[:, None]).T @ columns
        for edge in np.unique(self.edge):
            where = self.edge == edge
            variance = own + float(self.foot[where].mean()) ** 2
            if variance > 0.0:
                its = np.where(where, weights, 0.0)
                common = its @ columns
                total -= np.outer(common, common) / (its.sum() + 1.0 / variance)
        return total


FAR = 2.0
"""Offset beyond which a piece is assumed to be an edge of something else [px]."""

VAGUE = np.diag(np.repeat([2e-2, 3e-1], 3) ** -2.0)
"""Weak prior information (6, 6), for directions that no camera observes [1/m², 1/rad²]."""


def seen_motion(position: FloatArray) -> FloatArray:
    """Jacobian (6, 6) of an object's apparent pose at (3,) [m] with respect to a camera's error (a, w)."""
    motion = np.eye(6)
    motion[:3, 3:] = -so3.hat(position)
    return motion


def pose_information(contour: Contour, rim_std: float) -> FloatArray:
    """Return a camera's information (6, 6) on a pose, with exponent and rim marginalised [1/m², 1/rad²]."""
    columns = np.column_stack([contour.jacobian, contour.bloom, contour.rim])
    found = contour.information(columns, (np.abs(contour.offset) < FAR).astype(float), EXPECTED_WEAR**2)
    other = found[6:, 6:] + np.diag([EXPONENT_STD**-2, rim_std**-2])
    return found[:6, :6] - found[:6, 6:] @ np.linalg.solve(other, found[6:, :6])


def pose_errors(
    contours: Sequence[Contour | None], position: FloatArray, cameras: Sequence[Camera], rim_std: float
) -> tuple[FloatArray, FloatArray]:
    """Covariance (6, 6) of a pose's own errors, and its Jacobian (6, C, 6) with respect to camera errors.

    The pose is the mean of the poses that the cameras see, weighted by M_c = (H_c⁻¹ + D_c)⁻¹. H_c is the
    information of camera c's edges, D_c the covariance at `position` (3,) [m] due to its stated error.
    """
    motion = seen_motion(position)
    inner, weights = [], []
    for contour, camera in zip(contours, cameras, strict=True):
        found = np.zeros((6, 6)) if contour is None else pose_information(contour, rim_std)
        feigned = motion @ calibration_covariance(camera) @ motion.T
        kept = np.linalg.inv(np.eye(6) + found @ feigned)
        inner.append(kept @ found @ kept.T)
        weights.append(kept @ found)
    total = np.linalg.inv(sum(weights) + VAGUE)
    own = total @ (sum(inner) + VAGUE) @ total.T
    return own, np.stack([total @ weight @ motion for weight in weights], axis=1)


Frame = tuple[Sight, Sighting]
"""The evaluated images of one moment, and the approximate pose of the object in them."""


class EdgeReader:
    """Measures edges of an object in a rig's images; results depend only on a call's arguments."""

    def __init__(
        self, model: CuboidModel, rig: CameraRig, colors: ColorModel, reader: Reader | None = None
    ) -> None:
        self.model, self.rig, self._colors = model, rig, colors
        box = Box.of(model)
        self._reader = reader or Reader(box, rig, colors)
        self._refiner = Refiner(box, rig, self._reader, support=False)

    def of(self, rig: CameraRig) -> EdgeReader:
        """Return a reader for the same images with another calibration of the cameras."""
        return EdgeReader(self.model, rig, self._colors, self._reader)

    def sights(self, seen: Iterable[Sighting]) -> Iterator[Frame]:
        """Yield each sighting with its evaluated images; those of a recording follow each other in order."""
        for footage, part in groupby(seen, lambda one: one.footage):
            its = list(part)
            for sighting, images in zip(its, footage.images([one.number for one in its]), strict=True):
                yield self._reader(images), sighting

    def fitted(self, frame: Frame) -> tuple[Fit, list[Contour | None]]:
        """Return the pose near the given one that fits the edges best, and each camera's edges there."""
        sight, seen = frame
        fit = self.refine(sight, seen.rotation, seen.position)
        return fit, self.contours(sight, fit.rotation, fit.position, fit.end)

    def refine(self, sight: Sight, rotation: FloatArray, position: FloatArray) -> Fit:
        """Refine a pose (3, 3), (3,) [m] to the edges of the images."""
        return self._refiner(sight, rotation, position, FOLLOWING, ask=False)

    def contours(
        self, sight: Sight, rotation: FloatArray, position: FloatArray, start: Start
    ) -> list[Contour | None]:
        """Return each camera's edges at a pose (3, 3), (3,) [m]; None if it has no image or sees no edge."""
        solution, cameras, work = self._refiner.edges(sight.pictures, rotation, position, start)
        result: list[Contour | None] = [None] * len(cameras)
        for c, (lens, camera) in enumerate(zip(self._refiner.model.lenses, cameras, strict=True)):
            found = work.found[c, : camera["strips"]]
            strips, found = work.strips[c, : camera["strips"]][found["usable"]], found[found["usable"]]
            if len(found) == 0:
                continue
            scale, jacobian = camera["scale"], strips["jacobian"] / camera["scale"]
            normal, away = strips["normal"], strips["pixel"] - lens["center"]
            result[c] = Contour(
                jacobian=jacobian,
                lens=np.column_stack([np.einsum("ni,ni->n", normal, away), normal]) / scale,
                bloom=found["bloom"] / scale,
                rim=strips["rim"] / scale,
                offset=found["offset"] / scale,
                variance=(FLOOR**2 + found["variance"] / scale**2) / trust_of(camera),
                edge=strips["edge"].copy(),
                foot=FOOT_STD * np.abs(strips["rim"] / scale) * solution["feet"][strips["edge"]],
            )
        return result
