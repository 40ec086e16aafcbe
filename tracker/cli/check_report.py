"""What `tracker calibrate check` says of a calibration."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tracker.cli import options
from tracker.cli.render import listing, table
from tracker.errors import TrackerError

if TYPE_CHECKING:
    from tracker.calibration.by_object.check import CalibrationCheck


def stated(inputs: Sequence[str], cameras: options.Cameras) -> tuple[dict[str, float], list[str]]:
    """The deviations of focal lengths that the calibration's files state, and what to say of halved ones."""
    from tracker.calibration.files.calibrated import focal_deviations, halved_by_rows, read_calibrated
    from tracker.calibration.files.folder import calibration_files
    from tracker.logs.opening import calibration_files as files_of

    paths = [Path(path) for path in cameras.calibration]
    if len(paths) == 1 and paths[0].is_dir():
        paths = calibration_files(paths[0], cameras.pattern)
    for recording in () if paths else inputs:
        with suppress(OSError):  # opening it reports what cannot be read
            paths += files_of(Path(recording))
    found = {}
    for path in paths:
        with suppress(TrackerError):
            found[path] = read_calibrated(path)
    halved = (
        [] if cameras.correct_halved_principal_point else [path for path in found if halved_by_rows(path)]
    )
    fault = "its principal point was halved to c/2, expected c/2 - 0.25 px"
    return focal_deviations(found.values()), [
        f"{path}: {fault}: --correct-halved-principal-point mends it while it is read" for path in halved
    ]


def plain(found: CalibrationCheck, warnings: Sequence[str]) -> dict[str, Any]:
    """The result in plain numbers; null where one is not known."""
    from tracker.calibration.by_object.check import DEPTH, FOCAL

    cameras = []
    for one in found.cameras:
        corners, focal = one.corners, one.focal
        numbers = {
            "name": one.name,
            "looks": one.looks,
            "cannot_use": one.lost,
            "miss_px": one.miss_px,
            "moved": one.moved,
            "correction": one.correction.tolist(),
            "shift_mm": 1e3 * one.shift,
            "turn_deg": math.degrees(one.turn),
            "corners_seen_px": corners.seen,
            "corners_stated_px": corners.stated,
            "corners_shift_px": corners.shift,
            "corners_shape_px": corners.shape,
            "distance_m": focal.distance,
            "focal_ratio": focal.ratio,
            "focal_off_percent": 100.0 * focal.off,
            "focal_needed_percent": 100.0 * focal.needed,
            "depth_off_mm": 1e3 * focal.depth,
        }
        cameras.append({name: None if value != value else value for name, value in numbers.items()})
    return {
        "fits": found.fits,
        "looks": found.looks,
        "miss_mrad": 1e3 * found.miss,
        "warnings": list(warnings),
        "corners_focal_length_px": FOCAL,
        "depth_needed_mm": 1e3 * DEPTH,
        "cameras": cameras,
    }


def text(found: CalibrationCheck, warnings: Sequence[str]) -> str:
    """The result for people."""
    from tracker.calibration.by_object.check import DEPTH, FOCAL

    def number(value: float, digits: int) -> str:
        return "" if math.isnan(value) else f"{value:.{digits}f}"

    rows = [["camera", "looks", "cannot use", "miss [px]", "moved [mm]", "turned [°]"]]
    for one in found.cameras:
        moved = [f"{1e3 * one.shift:.1f}", f"{math.degrees(one.turn):.2f}"] if one.moved else []
        rows.append([one.name, str(one.looks), str(one.lost), number(one.miss_px, 2), *moved])
    expected = [["camera", "corners [px]", "stated", "shift", "shape", "fy/fx", "f ± [%]", "depth ± [mm]"]]
    for one in found.cameras:
        corners, focal = one.corners, one.focal
        pixels = [number(px, 2) for px in (corners.seen, corners.stated, corners.shift, corners.shape)]
        off = [number(100.0 * focal.off, 2), number(1e3 * focal.depth, 1)]
        expected.append([one.name, *pixels, f"{focal.ratio:.4f}", *off])
    focals = [one.focal for one in found.cameras if not math.isnan(one.focal.distance)]
    needed = number(100.0 * min((one.needed for one in focals), default=math.nan), 2)
    seen = f"of the object, missed; what files state lets expect so much; at a focal length of {FOCAL:g} px"
    depth = f"of one camera: {1e3 * DEPTH:g} mm need its focal length right to {needed} %"
    below = [["corners", seen], ["depth", depth], *(["warning", one] for one in warnings)]
    below += [["looks", str(found.looks)], ["verdict", _verdict(found)]]
    return "\n".join([table(rows), "", table(expected), "", listing(below)])


def _verdict(found: CalibrationCheck) -> str:
    from tracker.calibration.by_object.check import LIMIT

    if found.fits:
        miss = f"{1e3 * found.miss:.1f} of at most {1e3 * LIMIT:.1f} mrad in the median"
        return f"the calibration fits: cameras miss each other's views by {miss}"
    moved = [one.name for one in found.cameras if one.moved]
    lost = [one.name for one in found.cameras if found.is_lost(one) and not one.moved]
    if len(moved) > 1:
        why = f"{', '.join(moved)} are not where it has them; is it that of other cameras?"
    elif moved:
        why = f"{moved[0]} is not where it has it"
    elif lost:
        why = f"{', '.join(lost)} should see the object and cannot use what is shown"
    else:
        why = f"cameras miss each other's views by {1e3 * found.miss:.1f} mrad in the median"
    return f"the calibration does not fit: {why}"
