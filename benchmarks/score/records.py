"""What the tracker answered to one frame, as a row of a data frame."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import pandas as pd


@dataclasses.dataclass(frozen=True)
class FrameRecord:
    """What the tracker answered to one frame of a workload. Numbers are nan where there is none."""

    workload: str
    """Name of the workload, see `benchmarks.data.workloads`."""
    object: str
    """Name of the object."""
    index: int
    """Number of the frame in its set of scenes."""
    cameras: int
    """Number of cameras that gave an image."""
    visible_fraction: float
    """Mean over these cameras of the visible share of the object's pixels [1]."""
    present: bool
    """Whether there is an object."""
    status: str
    """`Status.value` of the answer."""
    found: bool
    """Whether the answer holds a pose."""
    position_mm: float = math.nan
    """Distance of the positions [mm]."""
    rotation_deg: float = math.nan
    """Angle of the rotation between the two [°]."""
    axis_deg: float = math.nan
    """Angle between the object's longest axes [°]; of cuboids with one longest axis."""
    roll_deg: float = math.nan
    """Angle about the longest axis [°]; of the same."""
    add_mm: float = math.nan
    """Mean distance of the surface's points [mm]."""
    mssd_mm: float = math.nan
    """Greatest distance of the surface's points [mm]."""
    mspd_px: float = math.nan
    """Greatest distance of the projected corners, in the worst of the cameras [px]."""
    nees: float = math.nan
    """dᵀ Σ⁻¹ d of the pose's error d and its stated covariance Σ [1]."""
    confidence: float = math.nan
    """Stated probability of being within 5 mm and 5° [1]."""
    bound_mm: float = math.nan
    """Cramér-Rao bound: square root of the trace of the position's covariance [mm]."""
    bound_deg: float = math.nan
    """The same of the rotation [°]."""
    bound_fixed_mm: float = math.nan
    """As `bound_mm`, with an edge noise of 0.3 px whatever the image [mm]."""
    bound_fixed_deg: float = math.nan
    """As `bound_deg`, with an edge noise of 0.3 px whatever the image [°]."""
    task_position_error: float = math.nan
    """The tasks' position error between true and estimated pose [1]."""
    task_rotation_error: float = math.nan
    """The tasks' rotation error, of cuboids with one longest axis that of the axis alone [1]."""
    milliseconds: float = math.nan
    """Time of the detection [ms]."""
    reference_ms: float = math.nan
    """Time of the reference work on the same pictures [ms]."""


def frame_of(records: Sequence[FrameRecord]) -> pd.DataFrame:
    """One row for each record, with all columns even if there are none."""
    return pd.DataFrame(
        [dataclasses.asdict(record) for record in records],
        columns=[field.name for field in dataclasses.fields(FrameRecord)],
    )
