"""`tracker calibrate check`: whether a calibration fits recordings of a known object."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tracker.cli.calibrate_inputs import looking_options, opened
from tracker.cli.calibration import Cameras
from tracker.cli.progress import bar
from tracker.cli.table import listing, table

if TYPE_CHECKING:
    from tracker.calibration.check import CalibrationCheck
    from tracker.calibration.rig import CameraRig


@click.command()
@looking_options
@click.option(
    "-o",
    "--output",
    metavar="FILE",
    type=click.Path(path_type=Path),
    help="Draw what each camera misses (.png, .jpg).",
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def check(
    inputs: tuple[str, ...],
    object_name: str,
    cameras: Cameras,
    colors_name: str | None,
    stills: bool,
    recover: bool,
    quiet: bool,
    output: Path | None,
    as_json: bool,
) -> None:
    """Say whether a calibration fits RECORDINGs, or IMAGEs moment by moment, of an object that is still.

    Each camera by itself is held against the others. One that is not where its file says is named, with
    the motion that reconciles it. What all cameras share cannot be seen so: a calibration whose whole
    world is moved fits.

    Exit code 1: it does not fit. Twenty frames or more, with the object in many places, tell most.
    """
    from tracker.objects.model import load_object
    from tracker.segmentation.color_model import load_colors
    from tracker.upkeep.check import check as look

    model = load_object(object_name)
    colors = load_colors(colors_name or model.colors)
    with (
        opened(inputs, cameras, stills, recover) as (rig, footage, frames),
        bar("frames", frames, quiet) as progress,
    ):
        found = look(model, footage, rig, colors, progress)
    if output is not None:
        from tracker.viz.check_picture import check_picture
        from tracker.viz.image_files import write_image

        write_image(output, check_picture(found, rig))
    if as_json:
        click.echo(json.dumps(_plain(found, rig), allow_nan=False))
    elif not quiet:
        click.echo(_text(found))
    if not found.fits:
        click.get_current_context().exit(1)


def _plain(found: CalibrationCheck, rig: CameraRig) -> dict[str, Any]:
    """The result in plain numbers."""
    import math

    return {
        "fits": found.fits,
        "looks": found.looks,
        "miss_mrad": 1e3 * found.miss,
        "cameras": [
            {
                "name": one.name,
                "looks": one.looks,
                "cannot_use": one.lost,
                "miss_px": None if math.isnan(one.miss_px) else one.miss_px,
                "moved": one.moved,
                "correction": one.correction.tolist(),
                "shift_mm": 1e3 * one.shift,
                "turn_deg": math.degrees(one.turn),
            }
            for one in found.cameras
        ],
    }


def _text(found: CalibrationCheck) -> str:
    """The result for people."""
    import math

    rows = [["camera", "looks", "cannot use", "miss [px]", "moved [mm]", "turned [°]"]]
    for one in found.cameras:
        miss = "" if math.isnan(one.miss_px) else f"{one.miss_px:.2f}"
        moved = [f"{1e3 * one.shift:.1f}", f"{math.degrees(one.turn):.2f}"] if one.moved else []
        rows.append([one.name, str(one.looks), str(one.lost), miss, *moved])
    return "\n".join([table(rows), "", listing([["looks", str(found.looks)], ["verdict", _verdict(found)]])])


def _verdict(found: CalibrationCheck) -> str:
    from tracker.calibration.check import LIMIT

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
