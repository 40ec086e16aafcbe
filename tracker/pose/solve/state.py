"""What the refinement works with: the cameras' part, the unknowns, and arrays for the time between."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tracker.conventions import Array, FloatArray
from tracker.pose.edges.offset import OFFSET, scratch
from tracker.pose.edges.strips import MAX_STRIPS, STRIP
from tracker.pose.solve.normal import EDGE
from tracker.pose.solve.step import UNKNOWNS

PIXELS = 1 << 14
"""Pixels of all strips of a camera, at most: a multiple of `pixels.BLOCK`."""


class Cameras(NamedTuple):
    """What is known of C cameras and their pictures before the refinement."""

    used: Array
    """(C,) bool: whether there is a picture."""
    scales: FloatArray
    """(C,) size of the object in the picture over the reference."""
    parts: Array
    """(C,) 3 where each pixel of a mosaic counts for one channel, else 1."""
    channels: Array
    """(C, 3, 256) int32: offsets into the label table of each level."""
    table: Array
    """The label table."""
    weights: FloatArray
    """(C, OWN, OWN) inverse covariance of what each has of its own."""
    blur: float
    """Of a picture that does not show it where no other does either [px of an object of reference size]."""
    lags: FloatArray
    """(C, 6) by which the cameras see the object moved, since their pictures are older; changed in place."""
    delays: FloatArray
    """(C,) by which they are older [s]."""
    calm: FloatArray
    """(6, 6) information on the velocity, where pictures lag behind."""


class Unknowns(NamedTuple):
    """What is solved for; changed in place."""

    rotation: FloatArray
    """(3, 3) world_from_object."""
    position: FloatArray
    """(3,) [m]."""
    shared: FloatArray
    """(UNKNOWNS,) of which EXPONENT and RIM count; (MOVING,) with the velocity's change."""
    offsets: FloatArray
    """(C, OWN) by which the cameras see the object moved [m, rad], and their exponents' deviation."""
    blurs: FloatArray
    """(C,) [px]"""
    own: FloatArray
    """(1,) variance of what the pieces of an edge have in common [px² of an object of reference size]."""


class Workspace(NamedTuple):
    """Arrays that the refinement works in; of one thread alone."""

    strips: Array
    """(C, MAX_STRIPS) of STRIP."""
    found: Array
    """(C, MAX_STRIPS) of OFFSET."""
    counts: Array
    """(C,) strips of each camera."""
    reaches: FloatArray
    """(C,) half widths of the strips [px]."""
    distance: FloatArray
    """(C, PIXELS) from the edges [px], when they were collected."""
    values: FloatArray
    """(C, 3, PIXELS) colours."""
    motion: FloatArray
    """(C, 6) of the pose as each camera sees it since the strips were collected [m, rad], and …"""
    since: FloatArray
    """(C, 6) … since their offsets were measured."""
    residuals: FloatArray
    widths: FloatArray
    information: FloatArray
    """(C, UNKNOWNS, UNKNOWNS) normal equations of each camera, and …"""
    gradient: FloatArray
    """(C, UNKNOWNS) … their right side."""
    edges: FloatArray
    """(C, 12, EDGE) sums over each edge's strips."""
    whole: FloatArray
    """(C, UNKNOWNS, UNKNOWNS) normal equations where edges have no offsets of their own, and …"""
    force: FloatArray
    """(C, UNKNOWNS) … their right side."""
    scratch: Array
    """(1,) of `offset.SCRATCH`."""


def workspace(cameras: int) -> Workspace:
    """A new work space."""
    return Workspace(
        np.zeros((cameras, MAX_STRIPS), STRIP),
        np.zeros((cameras, MAX_STRIPS), OFFSET),
        np.zeros(cameras, np.int64),
        np.zeros(cameras),
        np.empty((cameras, PIXELS)),
        np.empty((cameras, 3, PIXELS)),
        np.zeros((cameras, 6)),
        np.zeros((cameras, 6)),
        np.empty(cameras * MAX_STRIPS),
        np.empty(MAX_STRIPS),
        np.zeros((cameras, UNKNOWNS, UNKNOWNS)),
        np.zeros((cameras, UNKNOWNS)),
        np.zeros((cameras, 12, EDGE)),
        np.zeros((cameras, UNKNOWNS, UNKNOWNS)),
        np.zeros((cameras, UNKNOWNS)),
        scratch(),
    )
