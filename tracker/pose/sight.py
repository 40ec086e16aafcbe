"""The views of one set of pictures, ready for compiled loops, and what they say of a pose."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.geometry.lens import apply_update
from tracker.objects.box import Box
from tracker.pose.evidence import View
from tracker.pose.hypotheses.explain import explain


class Sight(NamedTuple):
    """The views of one set of pictures, ready for compiled loops."""

    labels: Array
    """(C, h, w) label maps."""
    used: Array
    """(C,) bool: whether there is a picture."""
    views: Sequence[View | None]
    """The views themselves."""
    colored: Array
    """(C,) pixels of each label map that show a face's colour."""

    @classmethod
    def of(cls, views: Sequence[View | None], shape: tuple[int, int, int]) -> Sight:
        """The views of the cameras in their order, None where there is no picture; shape (C, h, w)."""
        labels = np.zeros(shape, np.uint8)
        colored = np.zeros(len(views), np.int64)
        for c, view in enumerate(views):
            if view is not None:
                labels[c, : view.labels.shape[0], : view.labels.shape[1]] = view.labels
                colored[c] = np.count_nonzero(view.labels)
        return cls(labels, np.array([view is not None for view in views]), views, colored)

    def without(self, *cameras: int) -> Sight:
        """The same with the eyes of some cameras closed."""
        used = self.used.copy()
        used[list(cameras)] = False
        views = [view if open_ else None for view, open_ in zip(self.views, used, strict=True)]
        return self._replace(used=used, views=views)

    def hear(
        self,
        lenses: Array,
        box: Box,
        rotation: FloatArray,
        position: FloatArray,
        lags: FloatArray,
        seen: Array,
    ) -> None:
        """Count what the label maps show of a pose, into seen (C,) of SEEN.

        Args:
            lenses: (C,) of LENS, those of the label maps.
            box: the object.
            rotation: (3, 3) world_from_object.
            position: (3,) [m].
            lags: (C, 6) by which the cameras saw the object moved [m, rad].
            seen: filled.
        """
        if not lags.any():
            explain(
                lenses, self.labels, self.used, box.half, box.face_labels, rotation, position, seen
            )  # fmt: skip
        else:
            for c in np.flatnonzero(self.used):
                turned, moved = rotation.copy(), position.copy()
                apply_update(turned, moved, lags[c])
                one = slice(c, c + 1)
                explain(
                    lenses[one], self.labels[one], self.used[one], box.half, box.face_labels, turned, moved,
                    seen[one],
                )  # fmt: skip
        seen["elsewhere"] = self.colored - seen["agree"] - seen["wrong"] - seen["extra"]
