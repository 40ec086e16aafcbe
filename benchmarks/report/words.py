"""What the report says about how things are measured."""

from __future__ import annotations

DEFINITIONS = (
    ("position", "distance between the true and the estimated centre of the object [mm]"),
    (
        "rotation",
        "angle of the one rotation that turns the estimate into the truth [°]; of the cuboid also the angle "
        "between the long axes, and the roll about the long axis",
    ),
    (
        "ADD, MSSD, MSPD",
        "mean and greatest distance of the object's points [mm], and greatest distance of their projections "
        "[px], without regard to symmetry: six colours leave none. Average recall is taken over the "
        "thresholds of the BOP benchmark",
    ),
    (
        "right, wrong, missed",
        "right: within 5 mm and 5°. Wrong: a pose that is not. Missed: no pose, although there is an object. "
        "Wrong and sure: wrong with a confidence above 0.5. False find: a pose although there is no object",
    ),
    (
        "visible fraction",
        "visible pixels of the object, of those it would have without fingers; mean over the cameras used",
    ),
    (
        "NEES",
        "normalised error squared dᵀ Σ⁻¹ d of the six errors d in the covariance Σ that the tracker states; "
        "if Σ is right its median is 5.35",
    ),
    (
        "confidence",
        "the tracker's own probability of being right. Brier score: mean square of confidence minus outcome; "
        "0 is perfect, 0.25 is what always saying 0.5 gets",
    ),
    (
        "bound",
        "Cramér–Rao bound of each frame: how near to the truth the edges in view allow any unbiased estimate "
        "to come. One sample per pixel of visible edge of the true pose in each camera, as uncertain as the "
        "noise and the slope of the colours across that edge make it; information summed over the cameras, "
        "an uncertain calibration marginalised. Given is the square root of the trace of the covariance of "
        "position or rotation. A second bound takes every sample to be uncertain by 0.3 px",
    ),
)
"""Terms of the report."""
