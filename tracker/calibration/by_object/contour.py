"""What a camera's picture says of the edges of a posed object: equations that are linear in small changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tracker.conventions import Array, FloatArray


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

        Args:
            columns: derivatives, residuals or both, side by side.
            weight: (N,) of the pieces, from 0 to 1: how far they are believed.
            own: variance of what all pieces of an edge have in common [px²], feet aside, which is integrated
                out.
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
