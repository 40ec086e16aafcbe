"""`tracker calibrate table`: where the table is, by objects that rest on it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tracker.cli.calibrate_inputs import check_output, mending_options, opened
from tracker.cli.calibration import Cameras
from tracker.cli.progress import bar
from tracker.cli.table import listing

if TYPE_CHECKING:
    from tracker.upkeep.table import FoundTable


@click.command("table")
@mending_options
def table_command(
    inputs: tuple[str, ...],
    object_name: str,
    output: Path,
    cameras: Cameras,
    colors_name: str | None,
    stills: bool,
    recover: bool,
    quiet: bool,
) -> None:
    """Find the table in RECORDINGs, or in IMAGEs moment by moment, of an object that rests on it.

    Written is the calibration in a world whose z = 0 is the table (x, y and yaw stay as they were), and
    an arena.toml that says how well the table is known.

    The object must rest in five places or more, spread over the table, on whichever face, and be seen by
    two cameras or more. It may be held, lifted and carried in between.
    """
    from tracker.objects.model import load_object
    from tracker.segmentation.color_model import load_colors
    from tracker.upkeep.table import find_table, refuse_one_camera

    check_output(output)
    model = load_object(object_name)
    colors = load_colors(colors_name or model.colors)
    with opened(inputs, cameras, stills, recover) as (rig, footage, frames):
        refuse_one_camera(rig)
        with bar("frames", frames, quiet) as progress:
            found = find_table(model, footage, rig, colors, progress)
    found.rig.save(output)
    if not quiet:
        click.echo(_text(found, output))


def _text(found: FoundTable, output: Path) -> str:
    import numpy as np

    plane = found.plane
    used, still, (height, tilt) = np.count_nonzero(plane.used > 0.5), len(plane.used), plane.std
    slopes = np.degrees(np.arctan(plane.slope))
    rows = [
        [
            "at rest",
            f"in {used} places of {still} where it was still; seen in {found.shots} frames",
        ],
        [
            "height [mm]",
            f"{1e3 * plane.height:+.2f} ± {1e3 * height:.2f}, of the table in the old world",
        ],
        ["tilt [°]", f"{slopes[0]:+.2f} along x, {slopes[1]:+.2f} along y, ± {np.degrees(tilt):.2f}"],
        ["scatter [mm]", f"{1e3 * plane.scatter:.2f}, of objects at rest over the table"],
        ["calibration", str(output)],
    ]
    return listing(rows)
