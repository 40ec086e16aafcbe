"""`tracker calibrate intrinsics`: a camera's lens from photos of a board."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tracker.cli.board_options import board_of, board_options, read_photos, sightings_of, told_pattern
from tracker.cli.camera_sizes import size_options, variants
from tracker.cli.table import listing, table
from tracker.errors import CalibrationError

if TYPE_CHECKING:
    from tracker.calibration.intrinsics import Lens

_FILE = click.Path(path_type=Path)


@click.command()
@click.argument("images", nargs=-1, required=True, metavar="IMAGE...", type=_FILE)
@board_options
@click.option("--name", required=True, metavar="NAME", help="The camera's, e.g. camera60.")
@click.option("-o", "--output", required=True, metavar="FILE", type=_FILE, help="Calibration file (.yml).")
@size_options
@click.option("--picture", metavar="FILE", type=_FILE, help="Draw what is missed where (.png, .jpg).")
def intrinsics(
    images: tuple[Path, ...],
    squares: str,
    square: float,
    marker: float,
    dictionary: str,
    name: str,
    output: Path,
    crop: str | None,
    halve: bool,
    picture: Path | None,
) -> None:
    """Focal length, principal point and distortion of a camera, from photos of a ChArUco board.

    At least six photos, better fifteen, of the whole image's size: the board tilted by 30° to 45° in all
    directions, near and far, out to the image's corners; sharp, with the camera's focus as it will stay.
    Photos that do not belong are named and left out. Every photo is judged by a lens fitted without it.

    The file states the standard deviation of every parameter. It does not say where the camera is:
    `tracker calibrate extrinsics` adds that.
    """
    from tracker.calibration.calibrated import write_calibrated
    from tracker.calibration.intrinsics import fit_lens

    if output.suffix.lower() not in (".yml", ".yaml"):
        raise click.UsageError(f"-o {output}: found suffix {output.suffix!r}, expected .yml")
    board = board_of(squares, square, marker, dictionary)
    photos = [str(path) for path in images]
    board, found, faults = sightings_of(photos, read_photos(images), board)
    try:
        lens = fit_lens(name, [one for one in found if one is not None], board)
    except CalibrationError as error:
        raise CalibrationError(
            "; ".join([str(error), *(f"{p}: {why}" for p, why in faults.items())])
        ) from error
    files = variants(lens.calibrated, output, crop, halve)
    for path, calibrated in files.items():
        write_calibrated(calibrated, path)
    if picture is not None:
        _draw(lens, picture)
    click.echo(_photo_table(lens, faults))
    click.echo()
    click.echo(
        listing([["board", told_pattern(board)], *_found(lens), ["files", ", ".join(map(str, files))]])
    )


def _photo_table(lens: Lens, faults: dict[str, str]) -> str:
    from tracker.calibration.board_pose import rms

    rows = [["photo", "corners", "dropped", "blur [px]", "RMS [px]", "left out [px]"]]
    for one in lens.photos:
        numbers = [len(one.sighting), one.dropped]
        sizes = [one.sighting.blur, rms([one.residuals]), one.left_out]
        rows.append([one.sighting.photo, *map(str, numbers), *(f"{size:.2f}" for size in sizes)])
    named = {one.sighting.photo: one.fault for one in lens.photos if one.fault is not None} | faults
    return "\n".join([table(rows), *(f"not used: {photo}: {fault}" for photo, fault in named.items())])


def _found(lens: Lens) -> list[list[str]]:
    camera, std, bent = lens.calibrated.camera, lens.calibrated.matrix_std, lens.calibrated.distortion_std
    assert std is not None
    assert bent is not None

    def told(values: list[tuple[float, float]], digits: int) -> str:
        return ", ".join(f"{value:.{digits}f} ± {deviation:.{digits}f}" for value, deviation in values)

    matrix = camera.matrix
    used = sum(one.fault is None for one in lens.photos)
    rows = [
        ["focal lengths", told([(matrix[0, 0], std[0, 0]), (matrix[1, 1], std[1, 1])], 2) + " px"],
        ["principal point", told([(matrix[0, 2], std[0, 2]), (matrix[1, 2], std[1, 2])], 2) + " px"],
        ["distortion", told(list(zip(camera.distortion, bent, strict=True)), 4) + " (k1 k2 p1 p2 k3)"],
        ["photos used", str(used)],
        ["RMS", f"{lens.rms:.3f} px; before a lens fitted without them {lens.left_out:.3f} px"],
    ]
    if lens.reach < 0.9:
        rows.append(
            [
                "note",
                f"no corner beyond {lens.reach:.0%} of the way from the centre to the image's corners: "
                "the distortion is guessed there",
            ]
        )
    return rows


def _draw(lens: Lens, picture: Path) -> None:
    from tracker.viz.board_residuals import residual_picture
    from tracker.viz.image_files import write_image

    camera = lens.calibrated.camera
    photos = [(one.sighting.pixels, one.residuals, one.fault is None) for one in lens.photos]
    title = f"{camera.name}, {sum(one.fault is None for one in lens.photos)} photos"
    write_image(picture, residual_picture(title, (camera.width, camera.height), photos))
