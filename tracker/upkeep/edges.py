"""Reads a known object's edges in pictures of cameras whose calibration is in question."""

from __future__ import annotations

from collections.abc import Sequence

from tracker.calibration.contour import Contour
from tracker.calibration.rig import CameraRig
from tracker.conventions import FloatArray
from tracker.objects.box import Box
from tracker.objects.model import CuboidModel
from tracker.pose.evidence import EvidenceReader, View
from tracker.pose.scale import label_factors
from tracker.pose.solve.contours import contours
from tracker.pose.solve.refiner import Refined, Refiner
from tracker.pose.solve.schedule import FOLLOWING
from tracker.pose.start import LIKELY, Start
from tracker.segmentation.color_model import ColorModel
from tracker.upkeep.footage import Images


class EdgeReader:
    """Reads edges; what it says depends on nothing but its arguments.

    Args:
        model: the object.
        rig: the cameras.
        colors: the colour model.
    """

    def __init__(self, model: CuboidModel, rig: CameraRig, colors: ColorModel) -> None:
        self.rig, self._box, self._colors = rig, Box.of(model), colors
        self._reader = EvidenceReader(colors, label_factors(rig.cameras, self._box, rig.arena))
        self._refiner = Refiner(self._box, rig.cameras, colors.label_table)

    def of(self, rig: CameraRig) -> EdgeReader:
        """The same for cameras that give the same pictures and are calibrated otherwise."""
        other = EdgeReader.__new__(EdgeReader)
        other.rig, other._box, other._colors, other._reader = rig, self._box, self._colors, self._reader
        other._refiner = Refiner(self._box, rig.cameras, self._colors.label_table)
        return other

    def views(self, images: Images) -> list[View | None]:
        """What the pictures say, whatever the calibration."""
        see, read = self._reader.see, self._reader.read
        return [
            None if image is None else read(see(c, image), grey_world=False) for c, image in enumerate(images)
        ]

    def refine(self, views: Sequence[View | None], rotation: FloatArray, position: FloatArray) -> Refined:
        """The pose (3, 3), (3,) [m] that fits the edges best near the one given."""
        return self._refiner.refine(views, rotation, position, FOLLOWING)

    def contours(
        self,
        views: Sequence[View | None],
        rotation: FloatArray,
        position: FloatArray,
        start: Start = LIKELY,
        offsets: FloatArray | None = None,
    ) -> list[Contour | None]:
        """See `tracker.pose.solve.contours`."""
        return contours(self._refiner, views, rotation, position, start, offsets)
