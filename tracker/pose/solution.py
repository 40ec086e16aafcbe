"""What is unknown, and what is known of it: records that the refinement and its solution work on."""

from __future__ import annotations

import numpy as np

EXPONENT, RIM = 6, 7
UNKNOWNS = 8
"""Pose, exponent and rim."""

MOVING = UNKNOWNS + 6
"""Where cameras lag behind, the object's velocity is unknown, too: its change from what is expected."""

OWN = 7
"""Of each camera: the offset of the pose, and how much its exponent deviates from that of all."""

KNOWN, PULL, ROW = 0, 1, 2
EDGE = ROW + UNKNOWNS
"""Of each edge: sums over its strips of weights, weighted offsets, and weighted motion with the unknowns."""

ROWS = 5
"""Of what a table tells: height and two tilts of the face that is nearly below; height and slope of the
lowest edge."""

CAMERA = np.dtype(
    [
        ("used", np.bool_),  # whether there is a picture
        ("parts", np.int64),  # 3 where each pixel of a mosaic counts for one channel, else 1
        ("scale", np.float64),  # size of the object in the picture over the reference
        ("delay", np.float64),  # by which the picture is older than others [s]
        ("weights", np.float64, (6, 6)),  # inverse covariance of its offset, as its calibration states it
        ("offset", np.float64, (OWN,)),  # by which it sees the object moved [m, rad], and of its exponent
        ("lag", np.float64, (6,)),  # by which it sees it moved since its picture is older [m, rad]
        ("blur", np.float64),  # of its picture's steps [px]
        ("reach", np.float64),  # half width of the strips [px]
        ("strips", np.int64),  # how many
        ("motion", np.float64, (6,)),  # of the pose as it sees it since the strips were collected, and …
        ("since", np.float64, (6,)),  # … since their offsets were measured [m, rad]
        ("edges", np.float64, (12, EDGE)),  # sums over each edge's strips
        ("whole", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations without edges' own offsets, and …
        ("force", np.float64, (UNKNOWNS,)),  # … their right side
        ("information", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations, and …
        ("gradient", np.float64, (UNKNOWNS,)),  # … their right side
        ("lower", np.float64, (OWN, OWN)),  # factor of what is its own, the pivots' inverse on the diagonal
        ("reduced", np.float64, (OWN, UNKNOWNS)),  # of its own by what is shared, forward substituted, and …
        ("change", np.float64, (OWN,)),  # … where what is shared stays; after `own_changes` its update
    ]
)
"""One camera's part in the solution."""

SOLUTION = np.dtype(
    [
        ("size", np.int64),  # n, how many unknowns are shared: UNKNOWNS, or MOVING
        ("rotation", np.float64, (3, 3)),  # world_from_object
        ("position", np.float64, (3,)),  # [m]
        ("shared", np.float64, (MOVING,)),  # exponent, rim, change of velocity; the pose's are not used
        ("own", np.float64),  # variance of edges' own offsets [px² of an object of reference size]
        ("feet", np.float64, (12,)),  # 1 for edges that may stand in a contact shadow, else 0
        ("foot", np.float64),  # variance of how far colours end above such an edge [m²]
        ("prior", np.float64, (MOVING, MOVING)),  # information that there was before, and …
        ("pull", np.float64, (MOVING,)),  # … its right side
        ("known", np.float64, (MOVING, MOVING)),  # information with all else marginalised
        ("lower", np.float64, (MOVING, MOVING)),  # its Cholesky factor
        ("change", np.float64, (MOVING,)),  # update of what is shared
        ("columns", np.float64, (MOVING, ROWS)),  # how the table's say depends on it, and …
        ("less", np.float64, (ROWS, ROWS)),  # … how much less uncertain that makes it
        ("covariance", np.float64, (6, 6)),  # of the pose [m, rad]
        ("rim", np.float64),  # variance of the rim [m²]
        ("blur", np.float64),  # median of the pictures' [px of an object of reference size]
        ("stands", np.float64),  # how well it stands: log odds over an object that may be anywhere
        ("converged", np.bool_),  # whether the last step was negligible
        ("steps", np.int64),  # how many there were
    ]
)
"""What all cameras share in the solution."""
