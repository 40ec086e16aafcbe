"""`tracker calibrate board`, `intrinsics`, `extrinsics`: print a board, and calibrate with photos of it."""

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import click

import tracker
from tracker.calibration.board import sighting
from tracker.calibration.board.board import Board, page_of
from tracker.calibration.board.board import printed as content_of
from tracker.calibration.board.extrinsics import Photo, Placed, place_cameras
from tracker.calibration.board.intrinsics import Lens, fit_lens
from tracker.calibration.board.sighting import BoardView, rms, squares_shown
from tracker.calibration.files import Calibrated, calibration_text, file_name, read_all_calibrated
from tracker.cli.options import Range, command, file_option, flag, numbers, option, several
from tracker.cli.outputs import DRAWN, IMAGES, InFile, OutFolder, Recording, refuse_repeated
from tracker.cli.stills import silent_libraries
from tracker.cli.terminal import listing, table
from tracker.color_learning.labelled import read_image
from tracker.conventions import FloatArray
from tracker.errors import CalibrationError
from tracker.files import visible, write_together, write_whole, writing
from tracker.geometry.camera import check_name
from tracker.inputs import camera_in
from tracker.viz.calibration import residual_picture


@dataclass(frozen=True)
class Printed:
    """Options that describe the printed board."""

    squares: str = option("CxR", "Columns and rows of squares, black and white: 5x7.", required=True)
    square: float = option("M", "Edge of a square [m].", float, required=True)
    marker: float = option("M", "Edge of a marker [m].", float, required=True)
    dictionary: str = option(
        "NAME", "Set of markers, by OpenCV's name.", default="DICT_APRILTAG_16h5", show_default=True
    )

    def board(self, legacy: bool = False) -> Board:
        """Make the board; UsageError if --squares cannot be read, CalibrationError for an invalid board."""
        sizes = re.fullmatch(r"(\d{1,4})[x×X](\d{1,4})", self.squares)
        if sizes is None:
            raise click.UsageError(f"--squares {self.squares!r}: expected columns and rows, e.g. 5x7")
        return Board(int(sizes[1]), int(sizes[2]), self.square, self.marker, self.dictionary, legacy)


def _sightings_of(
    paths: Sequence[Path], board: Board
) -> tuple[Board, list[BoardView | None], dict[str, str]]:
    """Return the board with the pattern seen, its view in each photo, and why some photos show none."""
    with silent_libraries():
        images = [read_image(path) for path in paths]
    board = sighting.pattern_seen(images, board)
    found: list[BoardView | None] = []
    faults: dict[str, str] = {}
    for photo, image in zip(map(str, paths), images, strict=True):
        one = sighting.find_board(photo, image, board)
        if one is None:
            faults[photo] = sighting.why_no_board(image, board)
        elif one.blur > sighting.MOST_BLUR:
            faults[photo] = f"the photo is blurred, its edges by {one.blur:.1f} px"
            one = None
        found.append(one)
    if all(one is None for one in found):
        why = "; ".join(f"{fault} ({count} ×)" for fault, count in Counter(faults.values()).most_common(3))
        raise CalibrationError(
            f"board: found in none of {len(paths)} photos: {why}; expected photos of the board that "
            "--dictionary, --squares, --square and --marker describe"
        )
    clearest = max(range(len(found)), key=lambda n: len(found[n] or ()))
    sighting.require_size(str(paths[clearest]), images[clearest], board)
    return board, found, faults


@contextmanager
def _naming(faults: Mapping[str, str]) -> Iterator[None]:
    """Add the unused photos, with the reasons, to the message of a CalibrationError."""
    try:
        yield
    except CalibrationError as error:
        why = (f"{photo}: {fault}" for photo, fault in faults.items())
        raise CalibrationError("; ".join([str(error), *why])) from error


def _draw(path: Path, calibrated: Calibrated, photos: Sequence[tuple[FloatArray, FloatArray, bool]]) -> None:
    """Draw the residuals in the photos of a camera, see `residual_picture`."""
    camera, used = calibrated.camera, sum(counts for *_, counts in photos)
    picture = residual_picture(f"{camera.name}, {used} photos", (camera.width, camera.height), photos)
    tracker.viz.write_image(path, picture)


def _told_pattern(board: Board) -> str:
    if not board.two_patterns:
        return f"{board} (with {board.rows} rows, OpenCV's old and new patterns are the same)"
    return f"{board}" if board.legacy else f"{board}, today's pattern"


def _part(value: str) -> tuple[int, ...]:
    """Parse width, height, left and top [px] of --crop; UsageError if that fails."""
    part = re.fullmatch(r"(\d{1,5})x(\d{1,5})\+(\d{1,5})\+(\d{1,5})", value)
    if part is None:
        raise click.UsageError(f"--crop {value!r}: expected WxH+L+T, e.g. 540x540+88+0")
    return tuple(int(number) for number in part.groups())


@dataclass(frozen=True)
class Smaller:
    """Options for additional calibration files, for images smaller than the photos."""

    crop: tuple[int, ...] | None = option(
        "WxH+L+T",
        "Write NAME_cropped.yml too, of the photos' part of W×H px that starts at (L, T): on the platform "
        "540x540+88+0.",
        _part,
    )
    halve: bool = flag(
        "Write NAME_downsampled.yml too, with --crop NAME_cropped_and_downsampled.yml: of halved images, the "
        "quarter pixel right."
    )

    def write(self, cameras: Iterable[tuple[Calibrated, Path]]) -> str:
        """Write all files for the cameras and list them; CalibrationError if --crop exceeds the image."""
        texts: dict[Path, str] = {}
        for calibrated, path in cameras:
            files, last, suffix = [(path, calibrated)], calibrated, ""
            if self.crop is not None:
                width, height, left, top = self.crop
                last, suffix = calibrated.cropped(left, top, width, height), "_cropped"
                files.append((path.with_stem(path.stem + suffix), last))
            if self.halve:
                suffix += "_and_downsampled" if suffix else "_downsampled"
                size = last.camera.width // 2, last.camera.height // 2
                files.append((path.with_stem(path.stem + suffix), last.resized(*size)))
            for file, one in files:
                if file in texts:
                    raise CalibrationError(f"{file}: found two cameras for it, expected other names")
                texts[file] = calibration_text(one)
        first = next(iter(texts))
        with writing(CalibrationError, first):
            first.parent.mkdir(parents=True, exist_ok=True)
            write_together(texts.items())
        return ", ".join(map(str, texts))


@command()
def board(
    printed: Printed,
    output: Path = file_option("The page (.pdf, .svg or .png).", ".pdf", ".svg", ".png", required=True),
    legacy: bool = flag("Use the pattern of OpenCV before 4.6 [even rows]."),
) -> None:
    """Write a ChArUco board as a page to print at its true size.

    Print at 100 %, without fitting to the page, on something that stays flat. Then measure a row of squares:
    its length, divided by their number, is --square of the other commands.
    """
    page = page_of(printed.board(legacy))
    write_whole(output, content_of(page, output.suffix.lower()))
    click.echo(f"{output}: {page.board}, on a page of {page.width:g}x{page.height:g} mm")


@command()
def intrinsics(
    *,
    images: tuple[Path, ...] = several("IMAGE", Recording()),
    printed: Printed,
    name: str = option("NAME", "The camera's, e.g. camera60.", required=True),
    output: Path = file_option("Calibration file (.yml).", ".yml", ".yaml", required=True, new_folders=True),
    smaller: Smaller,
    plot: Path | None = file_option("Draw the residuals (.png, .jpg).", *DRAWN),
) -> None:
    """Find the lens of a camera from photos of a ChArUco board.

    That is focal length, principal point and distortion, with the standard deviation of each. `tracker
    calibrate extrinsics` adds the camera's position.

    Take at least six uncropped photos, preferably fifteen. Tilt the board by 30° to 45° in all directions,
    near and far, out to the image's corners. Photos must be sharp, with the focus that the camera will keep.
    Each photo is checked against a lens fitted without it. Those that do not fit are listed and left out.
    """
    check_name(name, "--name", CalibrationError)
    refuse_repeated(images)
    board = printed.board()
    named = [
        camera_in(path.stem, [name]) or camera_in(path.absolute().parent.name, [name]) for path in images
    ]
    for path, its in zip(images, named, strict=True):
        # Photos may be numbered: camera1.png, camera2.png.
        if its not in (None, name) and (named.count(its) > 1 or len(images) == 1):
            raise CalibrationError(f"{path}: named after {its}, expected photos of {name} alone")
    board, found, faults = _sightings_of(images, board)
    with _naming(faults):
        lens = fit_lens(name, [one for one in found if one is not None], board)
    files = smaller.write([(lens.calibrated, output)])
    if plot is not None:
        _draw(plot, lens.calibrated, [(p.sighting.pixels, p.residuals, p.fault is None) for p in lens.photos])
    rows = [["photo", "corners", "dropped", "blur [px]", "RMS [px]", "left out [px]"]]
    for one in lens.photos:
        counts = [len(one.sighting), one.dropped]
        sizes = [one.sighting.blur, rms([one.residuals]), one.left_out]
        rows.append([one.sighting.photo, *map(str, counts), *(f"{size:.2f}" for size in sizes)])
    unused = {one.sighting.photo: one.fault for one in lens.photos if one.fault}
    summary = listing([["board", _told_pattern(board)], *_found(lens), ["files", files]])
    click.echo(f"{_photo_table(rows, unused | faults)}\n\n{summary}")


def _photo_table(rows: Sequence[Sequence[str]], faults: Mapping[str, str]) -> str:
    """Return a table of photos, with the reasons why others are not used."""
    return "\n".join([table(rows), *(f"not used: {photo}: {fault}" for photo, fault in faults.items())])


def _found(lens: Lens) -> list[list[str]]:
    def with_std(values: FloatArray, std: FloatArray | None, digits: int) -> str:
        assert std is not None
        pairs = zip(values, std, strict=True)
        return ", ".join(f"{value:.{digits}f} ± {deviation:.{digits}f}" for value, deviation in pairs)

    camera, spread = lens.calibrated.camera, lens.calibrated.matrix_std
    assert spread is not None
    bent = with_std(camera.distortion, lens.calibrated.distortion_std, 4)
    rows = [
        ["focal lengths", f"{with_std(camera.matrix.diagonal()[:2], spread.diagonal()[:2], 2)} px"],
        ["principal point", f"{with_std(camera.matrix[:2, 2], spread[:2, 2], 2)} px"],
        ["distortion", f"{bent} (k1 k2 p1 p2 k3)"],
        ["photos used", str(sum(one.fault is None for one in lens.photos))],
        ["RMS", f"{lens.rms:.3f} px; with a lens fitted without them {lens.left_out:.3f} px"],
    ]
    if lens.reach < 0.9:
        beyond = f"beyond {100 * lens.reach:.0f} % of the way from the centre to the image's corners"
        rows.append(["note", f"no corner {beyond}: beyond that the distortion is a guess"])
    return rows


@command()
def extrinsics(
    *,
    folders: tuple[Path, ...] = several("FOLDER", Recording()),
    printed: Printed,
    intrinsics: tuple[Path, ...] = option(
        "PATH",
        "Folder of calibration files; or a file, once per camera.",
        InFile(),
        required=True,
        multiple=True,
    ),
    pattern: str | None = option("GLOB", "Which files of the folder to take, e.g. '*_full.yml'."),
    center: tuple[float, float] = option(
        "X,Y", "The board's centre [m].", numbers(2), default="0,0", show_default=True
    ),
    height: float = option(
        "Z", "Height of the board's print [m].", Range(-10, 10), default=0.0, show_default=True
    ),
    yaw: float = option(
        "DEG",
        "Angle from the world's x axis to the board's rows, left to right [degrees].",
        Range(-360, 360),
        default=0.0,
        show_default=True,
    ),
    output: Path = option("DIR", "For the calibration; new or empty.", OutFolder(new=True), required=True),
    smaller: Smaller,
    plot: Path | None = option(
        "DIR", "Draw the residuals, one PNG per camera; new or empty.", OutFolder(new=True)
    ),
) -> None:
    """Find where cameras are, from photos of a ChArUco board.

    Each FOLDER holds one photo per camera, e.g. camera60.png, of the board in one place. In the first, the
    board lies face up, at --center, --height and --yaw. In the others, it may be anywhere. More places make
    the result more accurate.
    """
    lenses = read_all_calibrated(intrinsics, pattern)
    names = [lens.camera.name for lens in lenses]
    plots = [] if plot is None else [plot / f"{name}.png" for name in names]
    board = printed.board()
    paths = _photos_of(folders, names)
    board, found, faults = _sightings_of(list(paths.values()), board)
    sightings = {at: one for at, one in zip(paths, found, strict=True) if one is not None}
    so3 = tracker.geometry.so3
    world_from_board = so3.transform(so3.exp([0, 0, math.radians(yaw)]), (*center, height))
    with _naming(faults):
        placed = place_cameras(lenses, sightings, world_from_board)
    files = smaller.write((one, output / file_name(one.camera.name)) for one in placed.cameras)
    for number, path in enumerate(plots):
        own = {at: missed for at, missed in placed.residuals.items() if at[0] == number}
        photos = [(placed.sightings[at].pixels, own[at], at not in placed.faults) for at in own]
        path.parent.mkdir(parents=True, exist_ok=True)
        _draw(path, placed.cameras[number], photos)
    summary = [["board", _told_pattern(board)], *_partly_seen(sightings, board), ["files", files]]
    click.echo("\n\n".join([*_placed_tables(placed, faults), listing(summary)]))


def _photos_of(folders: Sequence[Path], cameras: Sequence[str]) -> dict[Photo, Path]:
    """Return the photos by numbers of (camera, folder); some folders may lack a photo of a camera."""
    photos: dict[Photo, Path] = {}
    for place, folder in enumerate(folders):
        if not folder.is_dir():
            raise CalibrationError(f"{folder}: no such folder; expected one with a photo of each camera")
        found: dict[str, list[Path]] = {camera: [] for camera in cameras}
        for path in sorted(path for path in visible(folder) if path.suffix.lower() in IMAGES):
            named = camera_in(path.stem, cameras)
            if named is None or named not in found:
                whose = named or "no camera"
                raise CalibrationError(f"{path}: named after {whose}, expected {', '.join(cameras)} alone")
            found[named].append(path)
        for number, (camera, own) in enumerate(found.items()):
            if len(own) > 1:
                names = ", ".join(path.name for path in own)
                raise CalibrationError(f"{folder}: found {names}, expected one photo of {camera}")
            if own:
                photos[number, place] = own[0]
        if not any(found.values()):
            raise CalibrationError(f"{folder}: found no photo of {', '.join(cameras)}, e.g. {cameras[0]}.png")
    return photos


def _placed_tables(placed: Placed, faults: dict[str, str]) -> list[str]:
    """Return a table of the photos and one of the cameras."""
    photos = [["photo", "corners", "blur [px]", "RMS [px]"]]
    for at, residuals in placed.residuals.items():
        seen = placed.sightings[at]
        photos.append([seen.photo, str(len(seen)), f"{seen.blur:.2f}", f"{rms([residuals]):.2f}"])
    unused = {placed.sightings[at].photo: fault for at, fault in placed.faults.items()}
    cameras = [["camera", "x", "y", "z [mm]", "± [mm]", "± [°]", "RMS [px]"]]
    for number, one in enumerate(placed.cameras):
        camera, std = one.camera, one.camera.camera_from_world_std
        assert std is not None
        turned = math.degrees(math.hypot(*std[:3, :3].ravel()) / math.sqrt(2))
        known = [f"{1000 * placed.spreads[number]:.2f}", f"{turned:.3f}", f"{placed.rms(number):.3f}"]
        cameras.append([camera.name, *(f"{1000 * value:.1f}" for value in camera.position), *known])
    return [_photo_table(photos, unused | faults), table(cameras)]


def _partly_seen(sightings: dict[Photo, BoardView], board: Board) -> list[list[str]]:
    """Note if only part of the board is seen: the centre of a smaller board would be elsewhere."""
    first = [one for (_, place), one in sightings.items() if place == 0]
    columns, rows = shown = squares_shown(first, board) if first else (board.columns, board.rows)
    if shown == (board.columns, board.rows):
        return []
    return [["note", f"only {columns}x{rows} squares of the board in its given place are seen"]]
