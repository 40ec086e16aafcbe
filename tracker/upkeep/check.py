"""Looks at a known object in recordings, to judge whether the calibration fits."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from tracker.calibration.check import CalibrationCheck, check_calibration
from tracker.calibration.looks import Look
from tracker.calibration.rig import CameraRig
from tracker.objects.model import CuboidModel
from tracker.pipeline import ObjectTracker
from tracker.pose.estimate import SHOWN, USED
from tracker.pose.fit import Fit
from tracker.pose.judge import EXPECTED, apparent
from tracker.pose.result import Status
from tracker.segmentation.color_model import ColorModel
from tracker.upkeep.footage import Footage, Shot

MOST = 40
"""Looks at a film, at most."""

APART = 5
"""Shots from one look at an object in the same place to the next."""

SLOW = 5e-3, float(np.radians(5.0))
"""Velocities up to which an object is still [m/s, rad/s]."""

SURE = 0.3
"""Probability that a pose is the object, if the calibration fits, from which it is looked at: where it does
not, few are."""


def check(
    model: CuboidModel,
    footage: Sequence[Footage],
    rig: CameraRig,
    colors: ColorModel,
    progress: Callable[[int], None] = lambda _: None,
) -> CalibrationCheck:
    """Whether a calibration fits films and stills of an object.

    Args:
        model: the object.
        footage: of the rig's cameras, in the order of the rig.
        rig: the cameras, two or more.
        colors: the object's.
        progress: is told how many more shots were seen.

    Raises:
        CalibrationError: there is one camera only, or the object was seen still in too few shots.
    """
    tracker = ObjectTracker(model, rig, colors, support=False)
    looks: list[Look] = []
    for one in footage:
        chosen = list(_still(tracker, one, progress))
        chosen = (
            [chosen[k] for k in np.unique(np.linspace(0, len(chosen) - 1, MOST).astype(int))]
            if chosen
            else []
        )
        for images in one.images(chosen):
            fit = tracker.fit(images)
            if isinstance(fit, Fit) and fit.own is not None and apparent(fit) >= SURE:
                looks.append(look_of(fit))
    return check_calibration(looks, rig.cameras)


def look_of(fit: Fit) -> Look:
    """What the cameras by themselves say of a pose."""
    assert fit.own is not None
    seen = fit.cameras
    used = fit.own.inliers >= USED
    shown = seen["agree"] + seen["wrong"] + seen["extra"]
    lost = (
        ~used & (seen["predicted"] >= EXPECTED) & (shown > np.maximum(SHOWN[0], SHOWN[1] * seen["predicted"]))
    )
    lost[list(fit.left_out)] = True
    return Look(fit.position, np.where(used[:, None, None], fit.own.information, 0.0), fit.own.moved, lost)


def _still(tracker: ObjectTracker, footage: Footage, progress: Callable[[int], None]) -> Iterator[int]:
    """Numbers of the shots that show the object still; stills do."""
    tracker.reset()
    last = -APART
    for shot in footage.shots():
        progress(1)
        if shot.begins:
            tracker.reset()
            last = -APART
        if all(image is None for image in shot.images):
            continue
        if shot.stamps is None or (_rests(tracker, shot) and shot.number >= last + APART):
            last = shot.number
            yield shot.number


def _rests(tracker: ObjectTracker, shot: Shot) -> bool:
    """Whether a film shows the object still in this shot."""
    assert shot.stamps is not None
    found = tracker.update(shot.images, shot.stamps.tolist())
    state = found.filtered_object_pose
    if found.object_pose is None or state is None or found.status in (Status.FOUND, Status.REFOUND):
        return False
    speeds = np.linalg.norm(state.velocity.reshape(2, 3), axis=1)
    return bool((speeds < SLOW).all())
