"""`tracker calibrate refine`: how the cameras stand to each other, by an object that moves before them."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tracker.cli.calibrate_inputs import check_output, mending_options, opened
from tracker.cli.calibration import Cameras
from tracker.cli.progress import bar
from tracker.cli.table import listing, table

if TYPE_CHECKING:
    from tracker.upkeep.refine import Refined


@click.command("refine")
@mending_options
@click.option("--focal", is_flag=True, help="Focal lengths and principal points may be wrong, too.")
@click.option(
    "--frames",
    "most",
    metavar="N",
    type=click.IntRange(18, 1000),
    default=90,
    show_default=True,
    help="Frames that are used, in different poses; a third of them judges.",
)
def refine_command(
    inputs: tuple[str, ...],
    object_name: str,
    output: Path,
    cameras: Cameras,
    colors_name: str | None,
    stills: bool,
    recover: bool,
    quiet: bool,
    focal: bool,
    most: int,
) -> None:
    """Find how the cameras stand to each other in RECORDINGs of an object that moves, or in many IMAGEs.

    The edges of the object in all frames together say it, if the object is seen all over the arena and in
    many orientations. A third of the frames only judges: where they are fitted no better, nothing is
    written, and the exit code is 2.

    Edges cannot tell where the world is: x, y and yaw stay as the old cameras have them on the average,
    and z and tilt, too, unless the object rests in five places or more (see `table`).
    """
    from tracker.objects.model import load_object
    from tracker.segmentation.color_model import load_colors
    from tracker.upkeep.refine import refine_cameras

    check_output(output)
    model = load_object(object_name)
    colors = load_colors(colors_name or model.colors)
    given = opened(inputs, cameras, stills, recover)
    with given as (rig, footage, frames), bar("frames", frames, quiet) as progress:
        found = refine_cameras(model, footage, rig, colors, focal=focal, most=most, progress=progress)
    found.rig.save(output)
    if not quiet:
        click.echo(_text(found, focal, output))


def _text(found: Refined, focal: bool, output: Path) -> str:
    import numpy as np

    rows = [["against the mean", "moved [mm]", "±", "turned [°]", "±", *(["focal", "center [px]"] * focal)]]
    for camera, moved, std, lens in zip(found.rig, found.moved, found.std, found.lenses, strict=True):
        shift, turn = 1e3 * np.linalg.norm(moved[:3]), np.degrees(np.linalg.norm(moved[3:]))
        spread = 1e3 * np.sqrt(np.square(std[:3]).mean()), np.degrees(np.sqrt(np.square(std[3:]).mean()))
        row = [camera.name, f"{shift:.2f}", f"{spread[0]:.2f}", f"{turn:.3f}", f"{spread[1]:.3f}"]
        if focal:
            row += [f"{np.expm1(lens[0]):+.2%}", f"{lens[1]:+.2f}, {lens[2]:+.2f}"]
        rows.append(row)
    unknown = "x, y and yaw of the world"
    if found.plane is None:
        unknown += ", z and tilt (the object hardly rested: `tracker calibrate table` finds them)"
    if not focal:
        unknown += "; lenses (see --focal)"
    told = [
        ["before", f"{found.before:.3f} px, offset of edges in frames that did not teach"],
        ["after", f"{found.after:.3f} px"],
        ["frames", str(found.frames)],
        ["as before", unknown],
        ["calibration", str(output)],
    ]
    return f"{table(rows)}\n\n{listing(told)}"
