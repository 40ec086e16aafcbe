"""What a camera's picture says of the edges of a posed object: equations that are linear in small changes.

A pose's errors are its own, and those of the cameras, which all poses share. The calibration is in question
while edges are read.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tracker.calibration.by_object.sightings import Footage, Sighting
from tracker.calibration.deviations import calibration_covariance
from tracker.calibration.rig import CameraRig
from tracker.conventions import Array, FloatArray
from tracker.geometry import so3
from tracker.geometry.camera import Camera
from tracker.objects.box import Box
from tracker.objects.model import CuboidModel
from tracker.pose.fit import Fit, Start
from tracker.pose.refine import FOLLOWING
from tracker.pose.refiner import Refiner
from tracker.pose.sizes import FOOT_STD
from tracker.pose.solve import FLOOR, trust_of
from tracker.pose.support import table_of
from tracker.pose.views import Reader, Sight, reader_of
from tracker.segmentation.color_model import ColorModel


@dataclass(frozen=True, eq=False)
class Contour:
    """Pieces of visible edges of which one camera's picture shows where they are.

    A piece's offset is jacobian · (δp, δθ) + bloom · γ + rim · ρ for an object that is moved by (δp, δθ)
    along world axes [m, rad], a response of exponent 1 + γ and a rim of width ρ [m]. Offsets and their
    deviations are in pixels of a picture that shows the object in reference size.
    """

    pixel: FloatArray
    """(N, 2) where the pieces are expected, from the principal point on [px of the picture]."""
    normal: FloatArray
    """(N, 2) unit vectors out of their faces."""
    jacobian: FloatArray
    """(N, 6) motion along the normal with the pose [px/m, px/rad]."""
    bloom: FloatArray
    """(N,) offset per exponent [px]."""
    rim: FloatArray
    """(N,) offset per width of the rim [px/m]."""
    offset: FloatArray
    """(N,) of the piece from where it is expected, along the normal [px]."""
    variance: FloatArray
    """(N,) of that [px²]."""
    edge: Array
    """(N,) which of the cuboid's twelve edges it is part of."""
    foot: FloatArray
    """(N,) standard deviation of the offset of an edge that may stand in its contact shadow [px], else 0."""
    scale: float
    """Pixels of the picture in one of an object of reference size."""

    def information(self, columns: FloatArray, weight: FloatArray, own: float) -> FloatArray:
        """(K, K) products of columns (N, K), where pieces of an edge have an offset in common.

        weight: (N,) of the pieces, from 0 to 1: how far they are believed.
        own: variance of what all pieces of an edge have in common [px²], feet aside: it is integrated out.
        """
        weights = weight / self.variance
        total: FloatArray = (columns * weights[:, None]).T @ columns
        for edge in np.unique(self.edge):
            where = self.edge == edge
            variance = own + float(self.foot[where].mean()) ** 2
            if variance > 0.0:
                its = np.where(where, weights, 0.0)
                common = its @ columns
                total -= np.outer(common, common) / (its.sum() + 1.0 / variance)
        return total


OWN = 0.05
"""Standard deviation of what all pieces of an edge have in common [px]."""

EXPONENT_STD = 0.5
"""Standard deviation of a camera's exponent of response."""

FAR = 2.0
"""Offset from which on a piece is taken to be of something else [px]."""

_VAGUE = np.diag(np.repeat([1e-2, 3e-1], 3) ** -2.0)
"""(6, 6) information that holds what no camera sees [m, rad]."""


def seen_motion(position: FloatArray) -> FloatArray:
    """(6, 6) how an object at a position (3,) seems to move with a camera's error (a, w) [m, rad]."""
    motion = np.eye(6)
    motion[:3, 3:] = -so3.hat(position)
    return motion


def pose_information(contour: Contour, rim_std: float) -> FloatArray:
    """(6, 6) what a camera's edges say of a pose, where exponent and rim are unknown [1/m², 1/rad²]."""
    columns = np.column_stack([contour.jacobian, contour.bloom, contour.rim])
    found = contour.information(columns, (np.abs(contour.offset) < FAR).astype(float), OWN**2)
    other = found[6:, 6:] + np.diag([EXPONENT_STD**-2, rim_std**-2])
    result: FloatArray = found[:6, :6] - found[:6, 6:] @ np.linalg.solve(other, found[6:, :6])
    return result


def pose_errors(
    contours: Sequence[Contour | None], position: FloatArray, cameras: Sequence[Camera], rim_std: float
) -> tuple[FloatArray, FloatArray]:
    """Covariance (6, 6) of a pose's own errors, and how it moves (6, C, 6) with the errors of the cameras.

    With H_c the information of camera c's edges, and D_c the covariance of what its stated error feigns at
    `position` (3,) [m], the pose is the mean of what the cameras say, weighted by M_c = (H_c⁻¹ + D_c)⁻¹.
    """
    motion = seen_motion(position)
    inner, weights = [], []
    for contour, camera in zip(contours, cameras, strict=True):
        found = np.zeros((6, 6)) if contour is None else pose_information(contour, rim_std)
        feigned = motion @ calibration_covariance(camera) @ motion.T
        kept = np.linalg.inv(np.eye(6) + found @ feigned)
        inner.append(kept @ found @ kept.T)
        weights.append(kept @ found)
    total = np.linalg.inv(sum(weights) + _VAGUE)
    own: FloatArray = total @ (sum(inner) + _VAGUE) @ total.T
    return own, np.stack([total @ weight @ motion for weight in weights], axis=1)


Frame = tuple[Sight, Sighting]
"""What the pictures of one moment say, and about where the object is in them."""


class EdgeReader:
    """Reads edges of an object in a rig's pictures; what it says depends on nothing but its arguments."""

    def __init__(
        self, model: CuboidModel, rig: CameraRig, colors: ColorModel, reader: Reader | None = None
    ) -> None:
        self._model, self.rig, self._colors = model, rig, colors
        box = Box.of(model)
        self._reader = reader or reader_of(box, rig, colors)[0]
        self._refiner = Refiner(box, rig.cameras, colors.label_table, table_of(rig.arena, support=False))

    def of(self, rig: CameraRig) -> EdgeReader:
        """The same for cameras that give the same pictures and are calibrated otherwise."""
        return EdgeReader(self._model, rig, self._colors, self._reader)

    def sights(self, footage: Sequence[Footage], seen: Sequence[Sequence[Sighting]]) -> Iterator[Frame]:
        """What the pictures say of which the sightings are, those of one footage after the other."""
        for one, part in zip(footage, seen, strict=True):
            for sighting, images in zip(part, one.images([s.number for s in part]), strict=True):
                yield self._reader(images), sighting

    def fitted(self, frame: Frame) -> tuple[Fit, list[Contour | None]]:
        """The pose that fits the edges best near the one seen, and each camera's edges at it."""
        sight, seen = frame
        fit = self.refine(sight, seen.rotation, seen.position)
        return fit, self.contours(sight, fit.rotation, fit.position, fit.end)

    def refine(self, sight: Sight, rotation: FloatArray, position: FloatArray) -> Fit:
        """The pose (3, 3), (3,) [m] that fits the edges best near the one given."""
        return self._refiner(sight.pictures, rotation, position, FOLLOWING)

    def contours(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        start: Start,
        offsets: FloatArray | None = None,
    ) -> list[Contour | None]:
        """Each camera's edges at a pose (3, 3), (3,) [m], None where it has no picture or sees none.

        offsets: (C, 6) by which each camera is known to see the object moved [m, rad]: the edges are looked
        for there. The offsets returned are still relative to the pose itself.
        """
        solution, cameras, work = self._refiner.edges(sight.pictures, rotation, position, start, offsets)
        result: list[Contour | None] = []
        for c, (lens, camera) in enumerate(zip(self._refiner.model.lenses, cameras, strict=True)):
            found = work.found[c, : camera["strips"]]
            strips, found = work.strips[c, : camera["strips"]][found["usable"]], found[found["usable"]]
            if len(found) == 0:
                result.append(None)
                continue
            scale, jacobian = camera["scale"], strips["jacobian"] / camera["scale"]
            result.append(
                Contour(
                    pixel=strips["pixel"] - lens["center"],
                    normal=strips["normal"].copy(),
                    jacobian=jacobian,
                    bloom=found["bloom"] / scale,
                    rim=strips["rim"] / scale,
                    offset=found["offset"] / scale + jacobian @ camera["offset"][:6],
                    variance=(FLOOR**2 + found["variance"] / scale**2) / trust_of(camera),
                    edge=strips["edge"].copy(),
                    foot=FOOT_STD * np.abs(strips["rim"] / scale) * solution["feet"][strips["edge"]],
                    scale=float(scale),
                )
            )
        return result
