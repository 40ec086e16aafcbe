"""`tracker calibrate extrinsics`: cameras' positions, from photos of a board that all see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tracker.cli.board import (
    Printed,
    Smaller,
    board_options,
    draw,
    named,
    photo_table,
    sightings_of,
    size_options,
    told_pattern,
)
from tracker.cli.options import gathered, numbers, option
from tracker.cli.outputs import (
    PICTURE,
    Command,
    InFile,
    OutFolder,
    Recording,
    output_option,
    refuse_overwriting,
)
from tracker.cli.pictures import camera_in
from tracker.cli.terminal import listing, table
from tracker.errors import CalibrationError

if TYPE_CHECKING:
    from tracker.calibration.board.board import Board
    from tracker.calibration.board.extrinsics import Photo, Placed
    from tracker.calibration.board.sighting import BoardView
    from tracker.conventions import FloatArray


@dataclass(frozen=True)
class Given:
    """Where the board lies face up in the first folder."""

    center: tuple[float, float] = option(
        "--center", callback=numbers(2), default="0,0", metavar="X,Y", help="The board's centre [m].  [0,0]"
    )
    height: float = option(
        "--height", type=float, default=0.0, metavar="Z", help="Height of the board's print [m].  [0]"
    )
    yaw: float = option(
        "--yaw",
        type=float,
        default=0.0,
        metavar="DEG",
        help="Angle from the world's x axis to the board's rows, left to right [degrees].  [0]",
    )

    def world_from_board(self) -> FloatArray:
        """(4, 4)."""
        import numpy as np

        from tracker.geometry import so3

        place = np.eye(4)
        place[:3, :3] = so3.exp([0, 0, np.deg2rad(self.yaw)])
        place[:3, 3] = (*self.center, self.height)
        return place


@click.command(cls=Command)
@click.argument("folders", nargs=-1, required=True, metavar="FOLDER...", type=Recording())
@board_options
@click.option(
    "--intrinsics",
    required=True,
    multiple=True,
    metavar="PATH",
    type=InFile(),
    help="Folder of calibration files; or a file, once per camera.",
)
@click.option("--pattern", metavar="GLOB", help="Which files of the folder to take, e.g. '*_full.yml'.")
@gathered(Given)
@output_option(OutFolder(), "DIR", "For the calibration files.")
@size_options
@click.option("--plot", metavar="DIR", type=OutFolder(), help="Draw the residuals, one PNG per camera.")
def extrinsics(
    folders: tuple[Path, ...],
    printed: Printed,
    intrinsics: tuple[Path, ...],
    pattern: str | None,
    given: Given,
    output: Path,
    smaller: Smaller,
    plot: Path | None,
) -> None:
    """Find where cameras are, from photos of a ChArUco board.

    Each FOLDER holds one photo per camera, e.g. camera60.png, of the board in one place. In the first the
    board lies face up as --center, --height and --yaw say. In the others it may be anywhere. More places make
    the result more certain.
    """
    from tracker.calibration.board.extrinsics import place_cameras
    from tracker.calibration.files.platform import read_all_calibrated

    lenses = read_all_calibrated(intrinsics, pattern)
    targets = {name: output / f"{name}.yml" for name in (lens.camera.name for lens in lenses)}
    plots = {} if plot is None else {name: plot / f"{name}.png" for name in targets}
    written = {f"-o for {name}": path for name, path in targets.items()}
    written |= {f"--plot for {name}": path for name, path in plots.items()}
    refuse_overwriting(written, folders, intrinsics)
    board = printed.board()
    paths = photos_of(folders, [lens.camera.name for lens in lenses])
    board, found, faults = sightings_of(list(paths.values()), board)
    sightings = {at: one for at, one in zip(paths, found, strict=True) if one is not None}
    with named(faults):
        placed = place_cameras(lenses, sightings, given.world_from_board())
    files = smaller.write((one, targets[one.camera.name]) for one in placed.cameras)
    for number, one in enumerate(placed.cameras):
        if (picture := plots.get(one.camera.name)) is not None:
            own = {at: missed for at, missed in placed.residuals.items() if at[0] == number}
            photos = [(placed.sightings[at].pixels, own[at], at not in placed.faults) for at in own]
            picture.parent.mkdir(parents=True, exist_ok=True)
            draw(picture, one, photos)
    summary = [["board", told_pattern(board)], *_partly_seen(sightings, board), ["files", files]]
    click.echo("\n\n".join([_photo_table(placed, faults), _camera_table(placed), listing(summary)]))


def photos_of(folders: Sequence[Path], cameras: Sequence[str]) -> dict[Photo, Path]:
    """The photos by (camera, folder); a camera may lack one in some folders.

    Raises:
        CalibrationError: a folder is missing, holds several photos of a camera, one of another, or none.
    """
    photos: dict[Photo, Path] = {}
    for place, folder in enumerate(folders):
        if not folder.is_dir():
            raise CalibrationError(f"{folder}: no such folder; expected one with a photo of each camera")
        images = sorted(path for path in folder.iterdir() if path.suffix.lower() in PICTURE)
        called = {path: camera_in(path.stem, cameras) for path in images}
        for path, camera in called.items():
            if camera not in (None, *cameras):
                raise CalibrationError(f"{path}: named after {camera}, expected {', '.join(cameras)} alone")
        found = 0
        for number, camera in enumerate(cameras):
            own = [path for path in images if called[path] == camera]
            if len(own) > 1:
                names = ", ".join(path.name for path in own)
                raise CalibrationError(f"{folder}: found {names}, expected one photo of {camera}")
            for path in own:
                photos[number, place] = path
            found += len(own)
        if not found:
            raise CalibrationError(f"{folder}: found no photo of {', '.join(cameras)}, e.g. {cameras[0]}.png")
    return photos


def _photo_table(placed: Placed, faults: dict[str, str]) -> str:
    from tracker.calibration.board.sighting import rms

    rows = [["photo", "corners", "blur [px]", "RMS [px]"]]
    for at, residuals in placed.residuals.items():
        one = placed.sightings[at]
        rows.append([one.photo, str(len(one)), f"{one.blur:.2f}", f"{rms([residuals]):.2f}"])
    unused = {placed.sightings[at].photo: fault for at, fault in placed.faults.items()}
    return photo_table(rows, unused | faults)


def _camera_table(placed: Placed) -> str:
    import numpy as np

    rows = [["camera", "x", "y", "z [mm]", "± [mm]", "± [°]", "RMS [px]"]]
    for number, one in enumerate(placed.cameras):
        camera, std = one.camera, one.camera.camera_from_world_std
        assert std is not None
        turned = float(np.rad2deg(np.linalg.norm(std[:3, :3]) / np.sqrt(2)))
        known = [f"{1000 * np.linalg.norm(std[:3, 3]):.2f}", f"{turned:.3f}", f"{placed.rms(number):.3f}"]
        rows.append([camera.name, *(f"{1000 * value:.1f}" for value in camera.position), *known])
    return table(rows)


def _partly_seen(sightings: dict[Photo, BoardView], board: Board) -> list[list[str]]:
    """A board of another size would lie elsewhere: its centre is elsewhere."""
    from tracker.calibration.board.sighting import squares_shown

    first = [one for (_, place), one in sightings.items() if place == 0]
    columns, rows = shown = squares_shown(first, board) if first else (board.columns, board.rows)
    if shown == (board.columns, board.rows):
        return []
    return [["note", f"only {columns}x{rows} squares of the board in its given place are seen"]]
