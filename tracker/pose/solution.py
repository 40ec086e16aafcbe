"""Unknowns and what is known of them: the records of the refinement."""

import numpy as np

EXPONENT, RIM = 6, 7
UNKNOWNS = 8
"""Pose, exponent and rim."""

MOVING = UNKNOWNS + 6
"""With lagging cameras, also the change of the object's velocity from the expected one."""

OWN = 7
"""Per camera: the offset of the pose, and the deviation of its exponent from the shared one."""

KNOWN, PULL, ROW = 0, 1, 2
EDGE = ROW + UNKNOWNS
"""Per edge: sums over its strips of weights, weighted offsets, and weighted Jacobians."""

ROWS = 5
"""Residuals of a table: height and two tilts of the face nearly below; height and slope of the lowest
edge."""

CAMERA = np.dtype(
    [
        ("used", np.bool_),  # whether there is an image in which the object may be
        ("parts", np.int64),  # 3 if each pixel of a mosaic counts for one channel, else 1
        ("scale", np.float64),  # size of the object in the image, relative to the reference
        ("sight", np.float64, (3,)),  # unit vector from the object to it
        ("delay", np.float64),  # age of the image relative to the latest [s]
        ("weights", np.float64, (6, 6)),  # inverse covariance of its offset, as calibrated
        ("offset", np.float64, (OWN,)),  # displacement of the object in its view [m, rad]; of its exponent
        ("lag", np.float64, (6,)),  # the same due to the age of its image [m, rad]
        ("blur", np.float64),  # standard deviation of its image's blur [px]
        ("reach", np.float64),  # half width of the strips [px]
        ("strips", np.int64),  # number of strips, …
        ("every", np.int64),  # … of which every n-th has its pixels; 0: none has, …
        ("pixels", np.int64),  # … and where they end
        ("motion", np.float64, (6,)),  # of the pose in its view since the strips were collected, …
        ("since", np.float64, (6,)),  # … and since their offsets were measured [m, rad]
        ("edges", np.float64, (12, EDGE)),  # sums over each edge's strips
        ("whole", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations without edges' own offsets, and …
        ("force", np.float64, (UNKNOWNS,)),  # … their right-hand side
        ("information", np.float64, (UNKNOWNS, UNKNOWNS)),  # normal equations, and …
        ("gradient", np.float64, (UNKNOWNS,)),  # … their right-hand side
        ("lower", np.float64, (OWN, OWN)),  # Cholesky factor of its own block, inverse pivots on the diagonal
        ("reduced", np.float64, (OWN, UNKNOWNS)),  # cross block with the shared, forward substituted, …
        ("change", np.float64, (OWN,)),  # … and right-hand side; after `own_changes` its update
    ]
)
"""One camera's part of the solution."""

SOLUTION = np.dtype(
    [
        ("size", np.int64),  # n, number of shared unknowns: UNKNOWNS or MOVING
        ("rotation", np.float64, (3, 3)),  # world_from_object
        ("position", np.float64, (3,)),  # [m]
        ("shared", np.float64, (MOVING,)),  # exponent, rim, change of velocity; the first six are unused
        ("own", np.float64),  # variance of edges' own offsets [px² at reference size]
        ("feet", np.float64, (12,)),  # 1 for edges that may lie in a contact shadow, else 0
        ("foot", np.float64),  # variance of how far colours end above such an edge [m²]
        ("velocity", np.float64, (6, 6)),  # covariance of the change of velocity
        ("prior", np.float64, (MOVING, MOVING)),  # prior information, and …
        ("pull", np.float64, (MOVING,)),  # … its right-hand side
        ("known", np.float64, (MOVING, MOVING)),  # posterior information, all else marginalised
        ("lower", np.float64, (MOVING, MOVING)),  # its Cholesky factor
        ("change", np.float64, (MOVING,)),  # update of the shared unknowns
        ("moved", np.float64, (6,)),  # motion of the pose since the offsets were measured [m, rad]
        ("columns", np.float64, (MOVING, ROWS)),  # their effect on the table's residuals, and …
        ("less", np.float64, (ROWS, ROWS)),  # … the reduction of their covariance by these
        ("covariance", np.float64, (6, 6)),  # of the pose [m, rad]
        ("rim", np.float64),  # variance of the rim [m²]
        ("blur", np.float64),  # median over the images [px at reference size]
        ("stands", np.float64),  # log odds that it stands, over an object that may be anywhere
        ("converged", np.bool_),  # whether the last step was negligible
    ]
)
"""The part of the solution that all cameras share."""
