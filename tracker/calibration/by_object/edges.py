"""Reads a known object's edges in pictures of cameras whose calibration is in question."""

from __future__ import annotations

import numpy as np

from tracker.calibration.by_object.contour import Contour
from tracker.calibration.by_object.sightings import Images
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.objects.box import Box
from tracker.objects.model import CuboidModel
from tracker.pose.fit import Fit, Start
from tracker.pose.refine import FOLLOWING
from tracker.pose.refiner import Refiner
from tracker.pose.sizes import FOOT_STD
from tracker.pose.solve import FLOOR, trust_of
from tracker.pose.support import table_of
from tracker.pose.views import Sight, reader_of
from tracker.segmentation.color_model import ColorModel


class EdgeReader:
    """Reads edges; what it says depends on nothing but its arguments.

    Args:
        model: the object.
        rig: the cameras.
        colors: the colour model.
    """

    def __init__(self, model: CuboidModel, rig: CameraRig, colors: ColorModel) -> None:
        self.rig, self._box, self._colors = rig, Box.of(model), colors
        self._reader, _ = reader_of(self._box, rig, colors)
        self._refiner = self._refiner_of(rig)

    def of(self, rig: CameraRig) -> EdgeReader:
        """The same for cameras that give the same pictures and are calibrated otherwise."""
        other = EdgeReader.__new__(EdgeReader)
        other.rig, other._box, other._colors, other._reader = rig, self._box, self._colors, self._reader
        other._refiner = other._refiner_of(rig)
        return other

    def _refiner_of(self, rig: CameraRig) -> Refiner:
        table = table_of(rig.arena, support=False)
        return Refiner(self._box, rig.cameras, self._colors.label_table, table)

    def sight(self, images: Images) -> Sight:
        """What the pictures say, whatever the calibration."""
        return self._reader(images)

    def refine(self, sight: Sight, rotation: FloatArray, position: FloatArray) -> Fit:
        """The pose (3, 3), (3,) [m] that fits the edges best near the one given."""
        return self._refiner(sight.pictures, rotation, position, FOLLOWING)

    def contours(
        self,
        sight: Sight,
        rotation: FloatArray,
        position: FloatArray,
        start: Start | None = None,
        offsets: FloatArray | None = None,
    ) -> list[Contour | None]:
        """Each camera's edges at a pose (3, 3), (3,) [m], None where it has no picture or sees none.

        Args:
            sight: of the pictures.
            rotation: world_from_object.
            position: of the object's centre.
            start: blur of the pictures, and the exponent and rim with which the object is drawn.
            offsets: (C, 6) by which each camera is known to see the object moved [m, rad]: the edges are
                looked for there. The offsets returned are still relative to the pose itself.
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
